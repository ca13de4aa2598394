//! Compares every scalar function of the shaders, on one table of inputs, with the function of the same name in f64.

use crate::buffer::Buffer;
use crate::device::{Gpu, Size};
use crate::kernel::{Access, Kernel};
use crate::products::{Finish, GRADIENT_SCALE, accumulate, multiply, multiplying, tile};
use crate::projections::PROJECTIONS;
use crate::rows::Rows;
use glam::{DMat3, DVec3};
use std::sync::Arc;
use trimip_core::batch::Ray;
use trimip_core::config::DensityFunction;
use trimip_core::encoders::tri_mip::{Pyramid, Shape, level_input, taps};
use trimip_core::space::Path;
use trimip_core::{
    Aabb, Camera, Cone, Intrinsics, Lens, Space, activation, camera, compositing, loss, rng, sh,
};

/// Calls the function `probe`, which each probe defines, on every input.
const SHELL: &str = "
@group(0) @binding(20) var<storage, read> probe_inputs: array<vec4<f32>>;
@group(0) @binding(21) var<storage, read_write> probe_outputs: array<vec4<f32>>;
@compute @workgroup_size(GROUP)
fn run_probe(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < arrayLength(&probe_inputs) {
        probe_outputs[id.x] = probe(probe_inputs[id.x]);
    }
}
";

const BINDINGS: &[(u32, Access)] = &[(20, Access::Read), (21, Access::Write), (22, Access::Parameters)];

/// The WGSL files and the function body of a probe.
macro_rules! files {
    ($($file:literal),+; $body:literal) => { files!($($file),+; with "", $body) };
    ($($file:literal),+; with $more:expr, $body:literal) => {
        &[
            $(include_str!(concat!("shaders/", $file)),)+
            $more,
            concat!("fn probe(x: vec4<f32>) -> vec4<f32> {\n", $body, "\n}\n"),
            SHELL,
        ]
    };
}

/// The device for the tests; `None` if there is none and none is required.
pub(crate) fn gpu() -> Option<Arc<Gpu>> {
    if crate::adapters().is_empty() {
        assert!(std::env::var_os("TRIMIP_REQUIRE_GPU").is_none(), "a GPU is required, there is no adapter");
        println!("skipped: this machine has no adapter for wgpu");
        return None;
    }
    Some(Gpu::open("").expect("the adapter opens"))
}

fn run(gpu: &Arc<Gpu>, files: &'static [&'static str], inputs: &[[f32; 4]]) -> Vec<[f32; 4]> {
    let (mut from, mut to) = (Buffer::zeros(gpu, 0), Buffer::<[f32; 4]>::zeros(gpu, 0));
    from.write(inputs);
    to.resize(inputs.len());
    let kernel = Kernel::new("run_probe", files, BINDINGS);
    gpu.dispatch(&kernel, &[from.bind(), to.bind()], &0_u32, Size::Items(inputs.len() as u64));
    let found = to.read();
    gpu.check("a probe").expect("the probe compiles");
    found
}

/// Compares a function of floats with one in f64: |found − expected| ≤ absolute + relative · |expected|. Nothing is
/// compared where the expected value is not finite in f32.
fn compare(
    files: &'static [&'static str],
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

/// Numbers of all magnitudes and both signs.
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

#[test]
fn activations() {
    // The exp of drivers is accurate to about 17 ulp (2e-6) at 0 and less accurate for larger arguments.
    compare(
        files!("activation.wgsl"; "return vec4<f32>(density_of(EXP, x.x), density_derivative(EXP, x.x), sigmoid(x.x), sigmoid_derivative(x.x));"),
        &singles(|x| x.abs() < 80.0),
        |[x, ..]| {
            let density = activation::Density { kind: DensityFunction::Exp, shift: 0.0, scale: 1.0 };
            [
                density.value(x),
                density.derivative(x),
                activation::sigmoid(x),
                activation::sigmoid_derivative(x),
            ]
        },
        (1e-37, 2e-5),
    );
    compare(
        files!("activation.wgsl"; "return vec4<f32>(density_of(SOFTPLUS, x.x), density_derivative(SOFTPLUS, x.x), density_of(2u, x.x), density_derivative(2u, x.x));"),
        &singles(|x| x.abs() < 80.0),
        |[x, ..]| {
            let of = |kind| activation::Density { kind, shift: 0.0, scale: 1.0 };
            let [softplus, relu] = [DensityFunction::Softplus, DensityFunction::Relu].map(of);
            [softplus.value(x), softplus.derivative(x), relu.value(x), relu.derivative(x)]
        },
        (1e-37, 2e-5),
    );
}

#[test]
fn thin_samples_keep_their_relative_accuracy() {
    compare(
        files!("compositing.wgsl"; "return vec4<f32>(alpha_of(x.x), 0.0, 0.0, 0.0);"),
        &singles(|x| x >= 0.0),
        |[x, ..]| [compositing::weight(1.0, x).0, 0.0, 0.0, 0.0],
        (0.0, 3e-6),
    );
}

#[test]
fn the_loss_and_what_is_finite() {
    compare(
        files!("grid.wgsl", "exposure_none.wgsl", "loss.wgsl"; "return vec4<f32>(smooth_l1(x.x, 1.0), smooth_l1(x.x, 0.05));"),
        &singles(|_| true),
        |[x, ..]| {
            let ((a, b), (c, d)) = (loss::smooth_l1(x, 1.0), loss::smooth_l1(x, f64::from(0.05_f32)));
            [a, b, c, d]
        },
        (0.0, 1e-6),
    );
    let Some(gpu) = gpu() else { return };
    let inputs = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, f32::MAX, -1e-45].map(|x| [x; 4]);
    let found = run(
        &gpu,
        files!("grid.wgsl", "exposure_none.wgsl", "loss.wgsl"; "return vec4<f32>(select(0.0, 1.0, is_finite(x.x)), 0.0, 0.0, 0.0);"),
        &inputs,
    );
    assert_eq!(found.iter().map(|row| row[0]).collect::<Vec<_>>(), [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
}

#[test]
fn spheres_in_cones() {
    let inputs: Vec<[f32; 4]> = [1e-6, 5e-4, 0.3]
        .into_iter()
        .flat_map(|disc| [0.0_f32, 1e-3, 0.5, 4.0].map(|t| [disc, t, (1.0 + t * t).sqrt().recip(), 0.0]))
        .collect();
    compare(
        files!("grid.wgsl", "ray.wgsl", "camera.wgsl"; with PROJECTIONS, "return vec4<f32>(sphere_slope(x.x, x.y, x.z), 0.0, 0.0, 0.0);"),
        &inputs,
        |[disc, tangent, cosine, _]| [camera::sphere_slope(disc, tangent, cosine), 0.0, 0.0, 0.0],
        (0.0, 1e-6),
    );
}

/// Unit directions all over the sphere.
fn directions() -> Vec<[f32; 4]> {
    let direction = |i: u8| {
        let (z, angle) = (1.0 - (f32::from(i) + 0.5) / 50.0, 2.4 * f32::from(i));
        let r = (1.0 - z * z).sqrt();
        [r * angle.cos(), r * angle.sin(), z, 0.0]
    };
    (0..100).map(direction).collect()
}

#[test]
fn cones_of_pixels() {
    // The view's rotation has no zero entries; x is pixel x, pixel y, the index of the part and the parts along a
    // side.
    let intrinsics =
        Intrinsics { width: 64, height: 48, fx: 60.0, fy: 50.0, cx: 31.0, cy: 25.5, ..Intrinsics::default() };
    let rotation = DMat3::from_cols_array(&[0.36, 0.48, -0.8, -0.8, 0.6, 0.0, 0.48, 0.64, 0.6]);
    let camera = Camera { intrinsics, rotation, origin: DVec3::new(1.0, -2.0, 0.5) };
    let inputs: Vec<[f32; 4]> = [[0.0, 0.0], [31.0, 25.0], [63.0, 47.0], [5.0, 40.0]]
        .into_iter()
        .flat_map(|[x, y]| [[0.0, 1.0], [3.0, 2.0], [5.0, 3.0]].map(|[index, side]| [x, y, index, side]))
        .collect();
    let cone = |x: [f64; 4]| camera.cone_in::<f64>(x[0] as u32, x[1] as u32, x[2] as u32, x[3] as u32);
    compare(
        files!("grid.wgsl", "ray.wgsl", "camera.wgsl"; with PROJECTIONS, "let rows = array<vec4<f32>, 3>(vec4<f32>(0.36, -0.8, 0.48, 1.0), vec4<f32>(0.48, 0.6, 0.64, -2.0), vec4<f32>(-0.8, 0.0, 0.6, 0.5)); let view = View(rows, vec4<f32>(60.0, 50.0, 31.0, 25.5), 1.0 / sqrt(3.14159265 * 3000.0), 64u, 0u, 0u, vec4<f32>(), vec4<f32>(), vec4<f32>()); let c = cone_in(view, u32(x.x), u32(x.y), u32(x.z), u32(x.w)); return vec4<f32>(c.direction, c.slope);"),
        &inputs,
        |x| {
            let Cone { direction: [u, v, w], slope, .. } = cone(x);
            [u, v, w, slope]
        },
        (2e-7, 2e-6),
    );
}

/// Compares the cones of a lens that the WGSL in `files` states too.
fn bent(files: &'static [&'static str], lens: Lens) {
    let intrinsics = Intrinsics { width: 64, height: 48, fx: 40.0, fy: 42.0, cx: 31.0, cy: 25.5, lens };
    let camera = Camera { intrinsics, rotation: DMat3::IDENTITY, origin: DVec3::ZERO };
    let inputs: Vec<[f32; 4]> = (0..64)
        .flat_map(|x| (0..48).map(move |y| [x as f32, y as f32, 0.0, 1.0]))
        .filter(|x| (x[0] as u32).is_multiple_of(3))
        .collect();
    let cone = |x: [f64; 4]| {
        let Cone { direction: [u, v, w], slope, .. } = camera.cone::<f64>(x[0] as u32, x[1] as u32);
        [u, v, w, slope]
    };
    assert!(inputs.iter().all(|x| cone(x.map(f64::from))[3] > 0.0));
    compare(files, &inputs, cone, (2e-6, 2e-5));
}

#[test]
fn cones_of_a_phone() {
    bent(
        files!("grid.wgsl", "ray.wgsl", "camera.wgsl"; with PROJECTIONS, "let rows = array<vec4<f32>, 3>(vec4<f32>(1.0, 0.0, 0.0, 0.0), vec4<f32>(0.0, 1.0, 0.0, 0.0), vec4<f32>(0.0, 0.0, 1.0, 0.0)); let view = View(rows, vec4<f32>(40.0, 42.0, 31.0, 25.5), 1.0 / sqrt(3.14159265 * 1680.0), 64u, 0u, 1u, vec4<f32>(0.0578421, -0.0805099, 0.01, -0.002), vec4<f32>(0.0, 0.0, 0.0, 10.0), vec4<f32>(-0.00098, 0.00015575, 0.0, 0.0)); let c = cone_in(view, u32(x.x), u32(x.y), u32(x.z), u32(x.w)); return vec4<f32>(c.direction, c.slope);"),
        Lens::perspective([0.0578421, -0.0805099, 0.01, -0.002], [-0.00098, 0.00015575], [0.0; 3]),
    );
}

#[test]
fn cones_of_a_rational_lens() {
    bent(
        files!("grid.wgsl", "ray.wgsl", "camera.wgsl"; with PROJECTIONS, "let rows = array<vec4<f32>, 3>(vec4<f32>(1.0, 0.0, 0.0, 0.0), vec4<f32>(0.0, 1.0, 0.0, 0.0), vec4<f32>(0.0, 0.0, 1.0, 0.0)); let view = View(rows, vec4<f32>(40.0, 42.0, 31.0, 25.5), 1.0 / sqrt(3.14159265 * 1680.0), 64u, 0u, 1u, vec4<f32>(0.1, 0.02, 0.003, 0.0), vec4<f32>(0.3, 0.02, 0.001, 10.0), vec4<f32>(0.001, -0.002, 0.0, 0.0)); let c = cone_in(view, u32(x.x), u32(x.y), u32(x.z), u32(x.w)); return vec4<f32>(c.direction, c.slope);"),
        Lens::perspective([0.1, 0.02, 0.003, 0.0], [0.001, -0.002], [0.3, 0.02, 0.001]),
    );
}

#[test]
fn cones_of_a_fisheye() {
    bent(
        files!("grid.wgsl", "ray.wgsl", "camera.wgsl"; with PROJECTIONS, "let rows = array<vec4<f32>, 3>(vec4<f32>(1.0, 0.0, 0.0, 0.0), vec4<f32>(0.0, 1.0, 0.0, 0.0), vec4<f32>(0.0, 0.0, 1.0, 0.0)); let view = View(rows, vec4<f32>(40.0, 42.0, 31.0, 25.5), 1.0 / sqrt(3.14159265 * 1680.0), 64u, 0u, 2u, vec4<f32>(-0.02, 0.004, -0.002, 0.0003), vec4<f32>(0.0, 0.0, 0.0, 3.14159), vec4<f32>(0.001, -0.0005, 0.002, -0.001)); let c = cone_in(view, u32(x.x), u32(x.y), u32(x.z), u32(x.w)); return vec4<f32>(c.direction, c.slope);"),
        Lens::fisheye([-0.02, 0.004, -0.002, 0.0003], [0.001, -0.0005], [0.002, -0.001]),
    );
}

#[test]
fn rays_through_the_space() {
    let space = Space::of(Aabb { min: [-1.0, 2.0, 0.5], max: [3.0, 4.0, 1.5] });
    let origin = [0.1, 2.9, 0.8];
    let inputs: Vec<[f32; 4]> = directions().into_iter().map(|[x, y, z, _]| [x, y, z, 0.17]).collect();
    compare(
        files!("grid.wgsl", "ray.wgsl", "space.wgsl"; "let space = Space(vec3<f32>(-1.0, 2.0, 0.5), 16u, vec3<f32>(3.0, 4.0, 1.5), 4.0, vec3<f32>(0.25, 0.5, 1.0), 0.0, vec3<f32>(0.25, 0.125, 0.0625), 0.0); return sphere_at(space, Ray(vec3<f32>(0.1, 2.9, 0.8), 0.03, x.xyz, 1.0, 0.0), x.w);"),
        &inputs,
        |[x, y, z, t]| {
            let [direction, origin] = [[x, y, z], origin.map(|o: f32| f64::from(o))];
            let point = std::array::from_fn(|i| origin[i] + t * direction[i]);
            let [u, v, w] = space.to_cube(point);
            [u, v, w, f64::from(0.03_f32) * t * space.scale(point)]
        },
        (3e-7, 2e-6),
    );
    // Enter, leave, and the exit of a block of four cells; all divide by a component of the direction.
    let near = Space::of(Aabb { min: [-1.0_f32, 2.0, 0.5], max: [3.0, 4.0, 1.5] });
    compare(
        files!("grid.wgsl", "ray.wgsl", "space.wgsl"; "let space = Space(vec3<f32>(-1.0, 2.0, 0.5), 16u, vec3<f32>(3.0, 4.0, 1.5), 4.0, vec3<f32>(0.25, 0.5, 1.0), 0.0, vec3<f32>(0.25, 0.125, 0.0625), 0.0); let ray = Ray(vec3<f32>(0.1, 2.9, 0.8), 0.03, x.xyz, 1.0, 0.0); let cell = cell_of(space, sphere_at(space, ray, x.w).xyz); return vec4<f32>(intersect(space, ray), cells_exit(space, ray, x.w, cell, 4u), 0.0);"),
        &inputs,
        |x| {
            let [u, v, w, t] = x.map(|x| x as f32);
            let ray = Ray { origin, slope: 0.03, direction: [u, v, w], cosine: 1.0, ..Ray::default() };
            let way = near.way(&ray, 16);
            let exit = way.exit(t, way.cell(way.position(t)), 4);
            let (enter, leave) = near.course(ray.origin, ray.direction).range();
            [enter, leave, exit, 0.0].map(f64::from)
        },
        (1e-6, 1e-5),
    );
}

/// A contracted space around a ball of radius 1.25 at (0.5, 3, 1), and rays in one direction from places within the ball,
/// near it and far away.
#[test]
fn rays_through_a_contracted_space() {
    let space = Space::contracted(Aabb { min: [-2.0, 0.5, -1.5], max: [3.0, 5.5, 3.5] });
    let ball = *space.ball().expect("it is contracted");
    let direction = [0.48, -0.6, 0.64];
    let places = [0.3, 1.1, 2.0, 7.0].into_iter().flat_map(|far: f32| {
        directions().into_iter().map(move |[x, y, z, _]| [0.5 + far * x, 3.0 + far * y, 1.0 + far * z])
    });
    let inputs: Vec<[f32; 4]> =
        places.flat_map(|[x, y, z]| [0.17, 1.9, 31.0].map(|t| [x, y, z, t])).collect();
    let at = |[x, y, z, t]: [f64; 4]| [x + t * direction[0], y + t * direction[1], z + t * direction[2]];
    compare(
        files!("grid.wgsl", "ray.wgsl", "space.wgsl"; "let space = Space(vec3<f32>(-2.0, 0.5, -1.5), 16u, vec3<f32>(3.0, 5.5, 3.5), 5.0, vec3<f32>(0.2), 1.25, vec3<f32>(0.3125), 0.3125); let ray = Ray(x.xyz, 0.03, vec3<f32>(0.48, -0.6, 0.64), 1.0, 0.0); let course = course_of(space, ray); return sphere_at(space, ray, x.w);"),
        &inputs,
        |x| {
            let [u, v, w] = space.to_cube(at(x));
            [u, v, w, f64::from(0.03_f32) * x[3] * space.scale(at(x))]
        },
        (1e-6, 4e-6),
    );
    compare(
        files!("grid.wgsl", "ray.wgsl", "space.wgsl"; "let space = Space(vec3<f32>(-2.0, 0.5, -1.5), 16u, vec3<f32>(3.0, 5.5, 3.5), 5.0, vec3<f32>(0.2), 1.25, vec3<f32>(0.3125), 0.3125); let ray = Ray(x.xyz, 0.03, vec3<f32>(0.48, -0.6, 0.64), 1.0, 0.0); let course = course_of(space, ray); return vec4<f32>(to_world(space, to_cube(space, ray.origin)), parameter_at(course, x.w));"),
        &inputs,
        |x| {
            let [u, v, w, t] = x;
            let s = ball.course([u, v, w], direction).parameter(t);
            [u, v, w, s]
        },
        (2e-5, 2e-5),
    );
    compare(
        files!("grid.wgsl", "ray.wgsl", "space.wgsl"; "let space = Space(vec3<f32>(-2.0, 0.5, -1.5), 16u, vec3<f32>(3.0, 5.5, 3.5), 5.0, vec3<f32>(0.2), 1.25, vec3<f32>(0.3125), 0.3125); let ray = Ray(x.xyz, 0.03, vec3<f32>(0.48, -0.6, 0.64), 1.0, 0.0); let course = course_of(space, ray); return vec4<f32>(course.enter, course.leave, distance_at(course, parameter_at(course, x.w)), length_at(space, course, ray, x.w, 0.01));"),
        &inputs,
        |x| {
            let [u, v, w, t] = x;
            let curve = ball.course([u, v, w], direction);
            let (enter, leave) = curve.range();
            [enter, leave, t, 0.01 * curve.slowness(t) * ball.radial(at(x))]
        },
        (2e-5, 1e-4),
    );
    // Place and width of a sample, and the same without contraction.
    let bounded = Space::of(Aabb { min: [-2.0, 0.5, -1.5], max: [3.0, 5.5, 3.5] });
    compare(
        files!("grid.wgsl", "ray.wgsl", "space.wgsl"; "var space = Space(vec3<f32>(-2.0, 0.5, -1.5), 16u, vec3<f32>(3.0, 5.5, 3.5), 5.0, vec3<f32>(0.2), 1.25, vec3<f32>(0.3125), 0.3125); let ray = Ray(x.xyz, 0.03, vec3<f32>(0.48, -0.6, 0.64), 1.0, 0.0); let curved = along(space, course_of(space, ray), ray, x.w, 0.25); space.ball = 0.0; return vec4<f32>(curved, along(space, course_of(space, ray), ray, x.w, 0.25));"),
        &inputs,
        |x| {
            let [u, v, w, t] = x;
            let [place, width] = space.along(&space.course([u, v, w], direction), at(x), t, 0.25);
            let [flat, flat_width] = bounded.along(&bounded.course([u, v, w], direction), at(x), t, 0.25);
            [place, width, flat, flat_width]
        },
        (2e-6, 1e-4),
    );
    // The parameter up to which a block of four cells is clear.
    let near = Space::contracted(Aabb { min: [-2.0_f32, 0.5, -1.5], max: [3.0, 5.5, 3.5] });
    compare(
        files!("grid.wgsl", "ray.wgsl", "space.wgsl"; "let space = Space(vec3<f32>(-2.0, 0.5, -1.5), 16u, vec3<f32>(3.0, 5.5, 3.5), 5.0, vec3<f32>(0.2), 1.25, vec3<f32>(0.3125), 0.3125); let ray = Ray(x.xyz, 0.03, vec3<f32>(0.48, -0.6, 0.64), 1.0, 0.0); let course = course_of(space, ray); let position = to_cube(space, ray.origin); return vec4<f32>(cells_clear(space, x.w, position, cell_of(space, position), 4u), 0.0, 0.0, 0.0);"),
        &inputs,
        |[x, y, z, s]| {
            let position = near.to_cube([x as f32, y as f32, z as f32]);
            let cells = position.map(|p| f64::from(p) * 16.0);
            let margin = cells.map(|c| (c - 4.0 * (c / 4.0).floor()).min(4.0 * (c / 4.0).floor() + 4.0 - c));
            let least = margin.into_iter().fold(f64::INFINITY, f64::min);
            [s + least * 0.3125 / trimip_core::space::contraction::STRETCH, 0.0, 0.0, 0.0]
        },
        (2e-5, 1e-6),
    );
}

#[test]
fn harmonics() {
    let directions = directions();
    let expected = |first: usize| {
        move |[x, y, z, _]: [f64; 4]| {
            let all = sh::spherical_harmonics([x, y, z]);
            [0, 1, 2, 3].map(|i| all[first + i])
        }
    };
    let bound = (5e-7, 1e-6);
    compare(
        files!("grid.wgsl", "ray.wgsl", "field_params.wgsl", "activation.wgsl", "harmonics.wgsl", "field.wgsl"; "let h = spherical_harmonics(x.xyz); return vec4<f32>(h[0], h[1], h[2], h[3]);"),
        &directions,
        expected(0),
        bound,
    );
    compare(
        files!("grid.wgsl", "ray.wgsl", "field_params.wgsl", "activation.wgsl", "harmonics.wgsl", "field.wgsl"; "let h = spherical_harmonics(x.xyz); return vec4<f32>(h[4], h[5], h[6], h[7]);"),
        &directions,
        expected(4),
        bound,
    );
    compare(
        files!("grid.wgsl", "ray.wgsl", "field_params.wgsl", "activation.wgsl", "harmonics.wgsl", "field.wgsl"; "let h = spherical_harmonics(x.xyz); return vec4<f32>(h[8], h[9], h[10], h[11]);"),
        &directions,
        expected(8),
        bound,
    );
    compare(
        files!("grid.wgsl", "ray.wgsl", "field_params.wgsl", "activation.wgsl", "harmonics.wgsl", "field.wgsl"; "let h = spherical_harmonics(x.xyz); return vec4<f32>(h[12], h[13], h[14], h[15]);"),
        &directions,
        expected(12),
        bound,
    );
}

#[test]
fn levels_and_texels() {
    let pyramid = Pyramid { sides: [64, 32, 96], levels: 5, log2_base_radius: [-7.0, -6.5, -5.25] };
    let radii: Vec<[f32; 4]> =
        (-80..40).flat_map(|i| [0.0, 1.0, 2.0].map(|p| [i as f32 / 4.0, p, 0.0, 0.0])).collect();
    compare(
        files!("../encoders/shaders/planes.wgsl", "../encoders/shaders/texels.wgsl", "../encoders/shaders/tri_mip.wgsl"; "let pyramid = Pyramid(vec3<f32>(-7.0, -6.5, -5.25), 5u, vec3<u32>(64u, 32u, 96u), 0u, -6.25, 1u, 64u); let b = blend_levels(pyramid, u32(x.y), x.x); return vec4<f32>(f32(b.lower), b.fraction, f32(level_start(pyramid, b.lower, u32(x.y))), level_feature(x.x, pyramid.reference));"),
        &radii,
        |[radius, plane, ..]| {
            let plane = plane as usize;
            let blend = pyramid.blend(plane, radius);
            let start = pyramid.offset(blend.lower, plane) / trimip_core::encoders::tri_mip::CHANNELS;
            let level = level_input(radius, pyramid.reference());
            [blend.lower as f64, blend.fraction, start as f64, level]
        },
        (1e-6, 0.0),
    );
    // At the border, between texels, and beyond either end.
    let places: Vec<[f32; 4]> = [0.0, 0.003, 0.01, 0.3, 0.5, 0.77, 0.998, 1.0]
        .into_iter()
        .flat_map(|a| [0.0_f32, 0.12, 0.999, 1.0].map(|b| [a, b, 0.0, 0.0]))
        .collect();
    compare(
        files!("../encoders/shaders/planes.wgsl", "../encoders/shaders/texels.wgsl", "../encoders/shaders/tri_mip.wgsl"; "let t = texel_taps(vec2<u32>(32u, 48u), x.xy); return vec4<f32>(f32(t.columns.x), f32(t.columns.y), f32(t.rows.x), f32(t.rows.y));"),
        &places,
        |[a, b, ..]| {
            let taps = taps(Shape { rows: 48, columns: 32 }, a, b);
            [taps.columns[0], taps.columns[1], taps.rows[0], taps.rows[1]].map(|x| x as f64)
        },
        (0.0, 0.0),
    );
    compare(
        files!("../encoders/shaders/planes.wgsl", "../encoders/shaders/texels.wgsl", "../encoders/shaders/tri_mip.wgsl"; "let t = texel_taps(vec2<u32>(32u, 48u), x.xy); return vec4<f32>(tap_weight(t, 0u, 0u), tap_weight(t, 0u, 1u), tap_weight(t, 1u, 0u), tap_weight(t, 1u, 1u));"),
        &places,
        |[a, b, ..]| {
            let [below, above] = taps(Shape { rows: 48, columns: 32 }, a, b).weights;
            [below[0], below[1], above[0], above[1]]
        },
        (4e-6, 0.0),
    );
}

#[test]
fn fixed_point_there_and_back() {
    // 30 fractional bits. A sum of two values of either sign is right whichever words carry.
    compare(
        files!("fixed.wgsl"; "let a = to_fixed(x.x); let b = to_fixed(x.y); let low = a.x + b.x; let high = a.y + b.y + select(0u, 1u, low < a.x); return vec4<f32>(from_fixed(a), from_fixed(negated(a)), from_fixed(vec2<u32>(low, high)), 0.0);"),
        &numbers()
            .into_iter()
            .flat_map(|x| [0.0_f32, 1.5, -1.5, 7e-4, -1e6].map(|y| [x, y, 0.0, 0.0]))
            .collect::<Vec<_>>(),
        |[x, y, ..]| [x, -x, x + y, 0.0],
        (2.0 / f64::from(1 << 30), 3e-7),
    );
}

#[test]
fn random_numbers_are_the_same_integers() {
    let Some(gpu) = gpu() else { return };
    let draws = rng::Random::new(9).at(rng::Stream::Pixel, 77);
    let counts = [1, 2, 1000, 65_536, 4_000_000_000_u32];
    let inputs: Vec<[f32; 4]> = (0..200_u32)
        .map(|i| {
            let bits = draws.bits(i);
            // Index, random bits and count are passed as the bits of floats.
            [i, bits[0], counts[i as usize % counts.len()], 0].map(f32::from_bits)
        })
        .collect();
    let found = run(
        &gpu,
        files!("random.wgsl"; "let i = bitcast<vec4<u32>>(x); return vec4<f32>(f32(below(i.y, i.z) >> 16u), f32(below(i.y, i.z) & 0xffffu), unit(i.y), 0.0);"),
        &inputs,
    );
    for (input, found) in inputs.iter().zip(&found) {
        let [_, bits, count, _] = input.map(f32::to_bits);
        let expected = rng::below(bits, count);
        assert_eq!(found[0] as u32 * 65_536 + found[1] as u32, expected, "below({bits}, {count})");
        assert_eq!(found[2], rng::unit(bits));
    }
    // The hash itself, on words passed in the same way. The upper 24 bits of four numbers are exact floats.
    let words: Vec<[u32; 4]> =
        (0..50).map(|step| rng::Random::new(step).at(rng::Stream::Cell, step).words()).collect();
    let inputs: Vec<[f32; 4]> = words.iter().map(|words| words.map(f32::from_bits)).collect();
    let found = run(
        &gpu,
        files!("random.wgsl"; "return vec4<f32>(random_bits(bitcast<vec4<u32>>(x), 12345u) >> vec4<u32>(8u));"),
        &inputs,
    );
    for (step, found) in (0..50).zip(&found) {
        let expected = rng::Random::new(step).at(rng::Stream::Cell, step).bits(12_345);
        assert_eq!(found.map(|x| x as u32), expected.map(|bits| bits >> 8));
    }
}

/// Small whole numbers: f16 represents them exactly, and f32 their products and sums.
fn whole(count: usize, seed: u64) -> Vec<f32> {
    let draws = rng::Random::new(seed).at(rng::Stream::Pixel, 0);
    (0..count as u32).map(|i| rng::below(draws.bits(i)[0], 17) as f32 - 8.0).collect()
}

/// Packs two f16 numbers into a word; the values are whole numbers of at most 8.
fn halves(values: &[f32]) -> Vec<u32> {
    let half = |x: f32| {
        let bits = x.to_bits();
        // Sign, exponent minus 112, upper 10 of 23 mantissa bits; zero is zero.
        if x == 0.0 {
            0
        } else {
            (bits >> 16 & 0x8000) | ((bits >> 23 & 0xff) - 112) << 10 | (bits >> 13 & 0x3ff)
        }
    };
    values.chunks_exact(2).map(|pair| half(pair[0]) | half(pair[1]) << 16).collect()
}

/// Products and weight gradients of matrices, in f32 and, if the device has them, with cooperative matrices. Both are
/// exact on whole numbers.
#[test]
fn products_of_matrices_are_exact_on_whole_numbers() {
    let Some(gpu) = gpu() else { return };
    let ways = [None, gpu.matrices()];
    for matrices in &ways[..1 + usize::from(gpu.matrices().is_some())] {
        for (k, n, rows) in
            [(48, 128, 100), (128, 16, 64), (16, 32, 1), (32, 48, 333), (160, 16, 70), (16, 96, 469)]
        {
            let (left, weights) = (whole(rows * k, 1), whole(k * n, 2));
            let (right, mask) = (whole(rows * n, 3), whole(rows * n, 4));
            let buffer = |values: &[f32], room: usize| {
                let mut buffer = Buffer::zeros(&gpu, room);
                buffer.write(values);
                buffer
            };
            let room = rows.next_multiple_of(64) * n;
            let mut packed: Buffer<u32> = Buffer::zeros(&gpu, 0);
            match matrices {
                None => packed.write(bytemuck::cast_slice(&weights)),
                Some(_) => packed.write(&halves(&weights)),
            }
            let mut counts: Buffer<u32> = Buffer::zeros(&gpu, 0);
            counts.write(&[rows as u32]);
            let overflows: Buffer<u32> = Buffer::zeros(&gpu, 1);
            let left_buffer = buffer(&left, 0);
            let exact =
                |r: usize, c: usize| (0..k).map(|i| left[r * k + i] * weights[i * n + c]).sum::<f32>();
            let exact_only = [(Finish::Add, 1), (Finish::AddRelu, 1)];
            let finishes = [(Finish::Store, 1), (Finish::Relu, 1), (Finish::Mask, 4)].into_iter();
            let finishes = finishes.chain(exact_only.into_iter().filter(|_| matrices.is_none()));
            let before: Vec<f32> = (0..rows * n).map(|at| (at % 13) as f32 - 6.0).collect();
            for (finish, scale) in finishes {
                let product = buffer(&before, room);
                let mask_buffer = buffer(&mask, 0);
                let mut binds = vec![left_buffer.bind(), packed.bind(), product.bind()];
                if finish == Finish::Mask {
                    binds.push(mask_buffer.bind());
                }
                binds.push(counts.bind());
                binds.extend(matrices.map(|_| overflows.bind()));
                let counted = Rows { counts: counts.raw().clone(), counter: 0, capacity: rows };
                let kernel = multiply(k, n, finish, *matrices, scale);
                gpu.dispatch(&kernel, &binds, &0_u32, multiplying(&counted, k, n, *matrices));
                let found = gpu.redeem(gpu.send::<f32>(product.raw(), 0, rows * n));
                for (at, found) in found.iter().enumerate() {
                    let exact = exact(at / n, at % n);
                    let expected = match finish {
                        Finish::Store => exact,
                        Finish::Relu => exact.max(0.0),
                        Finish::Add => before[at] + exact,
                        Finish::AddRelu => (before[at] + exact).max(0.0),
                        Finish::Mask => {
                            if mask[at] > 0.0 {
                                exact
                            } else {
                                0.0
                            }
                        }
                    };
                    assert_eq!(*found, expected, "{matrices:?} {finish:?} [{rows}, {k}]·[{k}, {n}] at {at}");
                }
            }
            let chunks = 4;
            let partial = buffer(&[], chunks * k * n);
            let right_buffer = buffer(&right, 0);
            let mut binds = vec![left_buffer.bind(), right_buffer.bind(), partial.bind(), counts.bind()];
            binds.extend(matrices.map(|_| overflows.bind()));
            let (tiles, scale) = match matrices {
                None => ((k / (16 * tile(k) as usize)) * (n / (16 * tile(n) as usize)), 1.0),
                Some(matrices) => (matrices.tiles(k, n) as usize, GRADIENT_SCALE as f32),
            };
            let kernel = accumulate(k, n, chunks as u32, *matrices);
            gpu.dispatch(&kernel, &binds, &0_u32, Size::Groups((tiles * chunks) as u64));
            let found = gpu.redeem(gpu.send::<f32>(partial.raw(), 0, chunks * k * n));
            for at in 0..k * n {
                let sum: f32 = (0..chunks).map(|chunk| found[chunk * k * n + at]).sum();
                let expected: f32 = (0..rows).map(|r| left[r * k + at / n] * right[r * n + at % n]).sum();
                assert_eq!(sum, scale * expected, "{matrices:?} [{rows}, {k}]ᵀ·[{rows}, {n}] at {at}");
            }
        }
    }
    let Some(matrices) = gpu.matrices() else { return };
    // A value that f16 cannot represent becomes the largest f16 and is counted: here two numbers and a NaN.
    let mut counts: Buffer<u32> = Buffer::zeros(&gpu, 0);
    counts.write(&[1]);
    let (mut left, mut ones): (Buffer<f32>, Buffer<u32>) = (Buffer::zeros(&gpu, 0), Buffer::zeros(&gpu, 0));
    let mut row = [1.0_f32; 16];
    (row[3], row[4], row[9]) = (1e6, -1e30, f32::NAN);
    left.write(&row);
    ones.write(&halves(&[1.0; 256]));
    let (product, overflows) = (Buffer::<f32>::zeros(&gpu, 64 * 16), Buffer::<u32>::zeros(&gpu, 1));
    let binds = [left.bind(), ones.bind(), product.bind(), counts.bind(), overflows.bind()];
    gpu.dispatch(&multiply(16, 16, Finish::Store, Some(matrices), 1), &binds, &0_u32, Size::Groups(1));
    assert_eq!(overflows.read(), [3]);
    gpu.check("products").expect("the kernels compile");
}

#[test]
fn ceilings_are_numbers() {
    let Some(gpu) = gpu() else { return };
    let ceilings = crate::ceilings::Ceilings::measure(&gpu);
    println!("{ceilings:?}");
    // A software driver on one slow core exceeds the lower bounds, and no device reaches the upper ones.
    assert!(
        (1e7..1e15).contains(&ceilings.bytes) && (1e7..1e17).contains(&ceilings.operations),
        "{ceilings:?}"
    );
}
