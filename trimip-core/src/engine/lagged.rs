//! Parameters of photographs that are trained beside a model's: their gradients come to the host with a step's sums and move
//! them some steps later, by Adam.

use crate::{
    Result,
    config::OptimizerConfig,
    engine::step_result::MOST_PENDING,
    field::{
        adamw::Rule,
        tensors::{Tensor, TensorFile},
    },
};
use std::collections::VecDeque;

/// Number of steps after which a step's gradient moves the parameters, on every backend: a device runs ahead of the host.
pub const LAG: usize = MOST_PENDING;

/// `N` parameters of each photograph, their moments, and gradients that did not move them yet.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Lagged<const N: usize> {
    /// One row per photograph.
    pub values: Vec<[f32; N]>,
    m: Vec<[f32; N]>,
    v: Vec<[f32; N]>,
    /// Gradients of the last steps, oldest first.
    arrived: VecDeque<Vec<[f32; N]>>,
}

impl<const N: usize> Lagged<N> {
    /// Zeros for `count` photographs.
    pub fn new(count: usize) -> Self {
        let zeros = || vec![[0.0; N]; count];
        Self { values: zeros(), m: zeros(), v: zeros(), arrived: VecDeque::new() }
    }

    /// Takes the gradient of the next step.
    pub fn take(&mut self, gradient: Vec<[f32; N]>) {
        self.arrived.push_back(gradient);
    }

    /// The oldest gradient, and the step that it moves the parameters in, if that is due after `steps` steps, of which
    /// `in_transit` have not arrived.
    pub fn due(&mut self, steps: u64, in_transit: usize) -> Option<(u64, Vec<[f32; N]>)> {
        if self.arrived.len() + in_transit <= LAG {
            return None;
        }
        let gradient = self.arrived.pop_front()?;
        Some((steps.saturating_sub((self.arrived.len() + in_transit) as u64).max(1), gradient))
    }

    /// Moves the parameters in `step` (Adam, without decay).
    pub fn apply(&mut self, config: &OptimizerConfig, rate: f64, step: u64, gradient: &[[f32; N]]) {
        let rule = Rule { shrink: 1.0, ..Rule::<f32>::new(config, rate, step) };
        let moments = self.m.as_flattened_mut().iter_mut().zip(self.v.as_flattened_mut());
        let values = self.values.as_flattened_mut().iter_mut();
        for ((value, (m, v)), &gradient) in values.zip(moments).zip(gradient.as_flattened()) {
            if (gradient * gradient).is_finite() {
                rule.apply(value, m, v, gradient);
            }
        }
    }

    /// Adds everything that training needs to go on: tensors of shape [photographs, N], whose names begin with `prefix`.
    pub fn to_tensors(&self, prefix: &str, file: &mut TensorFile) {
        let shape = [self.values.len(), N];
        let mut add = |name: String, values: &[[f32; N]]| {
            let tensor = Tensor::f32(&shape, values.as_flattened().to_vec());
            file.tensors.insert(format!("{prefix}{name}"), tensor);
        };
        add("values".into(), &self.values);
        add("first".into(), &self.m);
        add("second".into(), &self.v);
        self.arrived.iter().enumerate().for_each(|(i, values)| add(format!("pending.{i}"), values));
    }

    /// The state in a checkpoint of a run on as many photographs; `name` is its place.
    pub fn restored(&self, prefix: &str, file: &TensorFile, name: &str) -> Result<Self> {
        let shape = [self.values.len(), N];
        let of =
            |tensor: &str| Ok(file.f32(name, &format!("{prefix}{tensor}"), &shape)?.as_chunks().0.to_vec());
        let pending = |i: &usize| file.tensors.contains_key(&format!("{prefix}pending.{i}"));
        let arrived =
            (0..LAG).take_while(pending).map(|i| of(&format!("pending.{i}"))).collect::<Result<_>>()?;
        Ok(Self { values: of("values")?, m: of("first")?, v: of("second")?, arrived })
    }
}
