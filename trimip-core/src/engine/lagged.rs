//! Parameters of photographs that are trained alongside the parameters of the model. Their gradients reach the host
//! with a step's sums, and Adam applies them some steps later.

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

/// Number of steps between a step and the use of its gradient. It is the same on every backend: a device may run this
/// many steps ahead of the host.
pub const LAG: usize = MOST_PENDING;

/// `N` parameters of each photograph, their moments, and the gradients that were not applied yet.
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
    /// Creates zeros for `count` photographs.
    pub fn new(count: usize) -> Self {
        let zeros = || vec![[0.0; N]; count];
        Self { values: zeros(), m: zeros(), v: zeros(), arrived: VecDeque::new() }
    }

    /// Queues the gradient of the next step, one row per photograph.
    pub fn take(&mut self, gradient: Vec<[f32; N]>) {
        self.arrived.push_back(gradient);
    }

    /// Removes and returns the oldest gradient, with the number of its step, if it is due after `steps` steps.
    /// `in_transit` is the number of these steps whose gradients have not arrived.
    pub fn due(&mut self, steps: u64, in_transit: usize) -> Option<(u64, Vec<[f32; N]>)> {
        if self.arrived.len() + in_transit <= LAG {
            return None;
        }
        let gradient = self.arrived.pop_front()?;
        Some((steps.saturating_sub((self.arrived.len() + in_transit) as u64).max(1), gradient))
    }

    /// Updates the parameters with the gradient of step `step`, one row per photograph (Adam, without weight decay).
    /// Skips gradients whose square is not finite.
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

    /// Adds the tensors from which training resumes, of shape [photographs, N], with names that begin with `prefix`.
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

    /// Reads the state from a checkpoint of a run on the same number of photographs; `name` names the checkpoint in
    /// errors.
    ///
    /// # Errors
    /// When a tensor is missing, or has another type or shape.
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
