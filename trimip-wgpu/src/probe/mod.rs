//! Compares every scalar function of the shaders, on one table of inputs, with the function of the same name in f64. Each
//! probe is a kernel that consists of the parts that it needs and of one function, which is called on every input.

mod cameras;
mod functions;
mod products;
mod spaces;

use crate::gpu::Source::Text;
use crate::gpu::{Access, Buffer, Gpu, Kernel, Size, Source};
use std::sync::Arc;

/// Calls the function `probe`, which each probe defines, on every input.
const SHELL: Source = Text(
    "
@group(0) @binding(20) var<storage, read> probe_inputs: array<vec4<f32>>;
@group(0) @binding(21) var<storage, read_write> probe_outputs: array<vec4<f32>>;
@compute @workgroup_size(GROUP)
fn run_probe(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < arrayLength(&probe_inputs) {
        probe_outputs[id.x] = probe(probe_inputs[id.x]);
    }
}
",
);

const BINDINGS: &[(u32, Access)] = &[(20, Access::Read), (21, Access::Write), (22, Access::Parameters)];

shared! {
    /// A probe has no parameters.
    struct Nothing as Nothing {
        nothing: u32,
    }
}

/// Lists the parts of a probe, and its function `probe` with the given body.
macro_rules! files {
    ($($part:expr),+; $body:literal) => {
        &[
            $($part,)+
            $crate::gpu::Source::Text(concat!("fn probe(x: vec4<f32>) -> vec4<f32> {\n", $body, "\n}\n")),
        ]
    };
}

use files;

/// Returns the device for the tests; `None` if there is no device and none is required.
pub(crate) fn gpu() -> Option<Arc<Gpu>> {
    if crate::adapters().is_empty() {
        assert!(std::env::var_os("TRIMIP_REQUIRE_GPU").is_none(), "a GPU is required, there is no adapter");
        println!("skipped: this machine has no adapter for wgpu");
        return None;
    }
    Some(Gpu::open("").expect("the adapter opens"))
}

fn run(gpu: &Arc<Gpu>, files: &[Source], inputs: &[[f32; 4]]) -> Vec<[f32; 4]> {
    let (mut from, mut to) = (Buffer::zeros(gpu, 0), Buffer::<[f32; 4]>::zeros(gpu, 0));
    from.write(inputs);
    to.resize(inputs.len());
    let kernel = Kernel::new("run_probe", &[SHELL, Source::of::<Nothing>()], BINDINGS).and(files, &[]);
    let binds = [from.bind(), to.bind()];
    gpu.dispatch(&gpu.pipeline(kernel), &binds, &Nothing::default(), Size::Items(inputs.len() as u64));
    let found = to.read();
    gpu.check("a probe").expect("the probe compiles");
    found
}

/// Compares a shader function with a function in f64: |found − expected| ≤ absolute + relative · |expected|. Values
/// whose expected value is not finite in f32 are skipped.
fn compare(
    files: &[Source],
    inputs: &[[f32; 4]],
    expected: impl Fn([f64; 4]) -> [f64; 4],
    (absolute, relative): (f64, f64),
) {
    let Some(gpu) = gpu() else { return };
    let found = run(&gpu, files, inputs);
    for (input, found) in inputs.iter().zip(&found) {
        let expected = expected(input.map(f64::from));
        for (&found, &expected) in found.iter().zip(&expected) {
            if (expected as f32).is_finite() {
                let error = (f64::from(found) - expected).abs();
                let bound = absolute + relative * expected.abs();
                assert!(
                    error <= bound,
                    "at {input:?}: {found}, not {expected} (off by {error}, bound {bound})"
                );
            }
        }
    }
}

/// Returns numbers of all magnitudes and both signs.
fn numbers() -> Vec<f32> {
    let mut numbers = vec![0.0];
    for exponent in -30..=30 {
        for mantissa in [1.0, 1.37, 1.99] {
            let number = mantissa * 2_f32.powi(exponent);
            numbers.extend([number, -number]);
        }
    }
    numbers
}

fn singles(keep: impl Fn(f32) -> bool) -> Vec<[f32; 4]> {
    numbers().into_iter().filter(|&x| keep(x)).map(|x| [x, 0.0, 0.0, 0.0]).collect()
}

/// Returns unit directions all over the sphere.
fn directions() -> Vec<[f32; 4]> {
    let direction = |i: u8| {
        let (z, angle) = (1.0 - (f32::from(i) + 0.5) / 50.0, 2.4 * f32::from(i));
        let r = (1.0 - z * z).sqrt();
        [r * angle.cos(), r * angle.sin(), z, 0.0]
    };
    (0..100).map(direction).collect()
}
