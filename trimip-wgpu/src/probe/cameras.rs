//! Checks the cones of pixels, for pinhole cameras and for lenses that bend rays.

use super::{compare, files};
use crate::gpu::Source;
use crate::sampler::CAMERA;
use glam::{DMat3, DVec3};
use trimip_core::scene::cones::PixelPattern;
use trimip_core::{Camera, Cone, Intrinsics, Lens, geometry::camera};

#[test]
fn spheres_in_cones() {
    let inputs: Vec<[f32; 4]> = [1e-6, 5e-4, 0.3]
        .into_iter()
        .flat_map(|disc| [0.0_f32, 1e-3, 0.5, 4.0].map(|t| [disc, t, (1.0 + t * t).sqrt().recip(), 0.0]))
        .collect();
    compare(
        files!(CAMERA; "return vec4<f32>(sphere_slope(x.x, x.y, x.z), 0.0, 0.0, 0.0);"),
        &inputs,
        |[disc, tangent, cosine, _]| [camera::sphere_slope(disc, tangent, cosine), 0.0, 0.0, 0.0],
        (0.0, 1e-6),
    );
}

#[test]
fn cones_of_pixels() {
    // The view's rotation mixes all axes. An input holds pixel x, pixel y, the index of the pixel's part, and the
    // number of parts along a side.
    let intrinsics =
        Intrinsics { width: 64, height: 48, fx: 60.0, fy: 50.0, cx: 31.0, cy: 25.5, ..Intrinsics::default() };
    let rotation = DMat3::from_cols_array(&[0.36, 0.48, -0.8, -0.8, 0.6, 0.0, 0.48, 0.64, 0.6]);
    let camera = Camera { intrinsics, rotation, origin: DVec3::new(1.0, -2.0, 0.5) };
    let inputs: Vec<[f32; 4]> = [[0.0, 0.0], [31.0, 25.0], [63.0, 47.0], [5.0, 40.0]]
        .into_iter()
        .flat_map(|[x, y]| [[0.0, 1.0], [3.0, 2.0], [5.0, 3.0]].map(|[index, side]| [x, y, index, side]))
        .collect();
    let cone = |x: [f64; 4]| {
        let [x, y, index, side] = x.map(|x| x as u32);
        camera.cone_in::<f64>(x, y, index, PixelPattern::Grid(side))
    };
    compare(
        files!(CAMERA; "let rows = array<vec4<f32>, 3>(vec4<f32>(0.36, -0.8, 0.48, 1.0), vec4<f32>(0.48, 0.6, 0.64, -2.0), vec4<f32>(-0.8, 0.0, 0.6, 0.5)); let view = View(rows, vec4<f32>(60.0, 50.0, 31.0, 25.5), 1.0 / sqrt(3.14159265 * 3000.0), 64u, 0u, 0u, vec4<f32>(), vec4<f32>(), vec4<f32>(), vec4<u32>()); let c = cone_in(view, u32(x.x), u32(x.y), u32(x.z), u32(x.w)); return vec4<f32>(c.direction, c.slope);"),
        &inputs,
        |x| {
            let Cone { direction: [u, v, w], slope, .. } = cone(x);
            [u, v, w, slope]
        },
        (2e-7, 2e-6),
    );
}

/// Compares the cones of `lens` with the cones that the WGSL in `files` computes; it states the same lens.
fn bent(files: &[Source], lens: Lens) {
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
        files!(CAMERA; "let rows = array<vec4<f32>, 3>(vec4<f32>(1.0, 0.0, 0.0, 0.0), vec4<f32>(0.0, 1.0, 0.0, 0.0), vec4<f32>(0.0, 0.0, 1.0, 0.0)); let view = View(rows, vec4<f32>(40.0, 42.0, 31.0, 25.5), 1.0 / sqrt(3.14159265 * 1680.0), 64u, 0u, 1u, vec4<f32>(0.0578421, -0.0805099, 0.01, -0.002), vec4<f32>(0.0, 0.0, 0.0, 10.0), vec4<f32>(-0.00098, 0.00015575, 0.0, 0.0), vec4<u32>()); let c = cone_in(view, u32(x.x), u32(x.y), u32(x.z), u32(x.w)); return vec4<f32>(c.direction, c.slope);"),
        Lens::perspective([0.0578421, -0.0805099, 0.01, -0.002], [-0.00098, 0.00015575], [0.0; 3]),
    );
}

#[test]
fn cones_of_a_rational_lens() {
    bent(
        files!(CAMERA; "let rows = array<vec4<f32>, 3>(vec4<f32>(1.0, 0.0, 0.0, 0.0), vec4<f32>(0.0, 1.0, 0.0, 0.0), vec4<f32>(0.0, 0.0, 1.0, 0.0)); let view = View(rows, vec4<f32>(40.0, 42.0, 31.0, 25.5), 1.0 / sqrt(3.14159265 * 1680.0), 64u, 0u, 1u, vec4<f32>(0.1, 0.02, 0.003, 0.0), vec4<f32>(0.3, 0.02, 0.001, 10.0), vec4<f32>(0.001, -0.002, 0.0, 0.0), vec4<u32>()); let c = cone_in(view, u32(x.x), u32(x.y), u32(x.z), u32(x.w)); return vec4<f32>(c.direction, c.slope);"),
        Lens::perspective([0.1, 0.02, 0.003, 0.0], [0.001, -0.002], [0.3, 0.02, 0.001]),
    );
}

#[test]
fn cones_of_a_fisheye() {
    bent(
        files!(CAMERA; "let rows = array<vec4<f32>, 3>(vec4<f32>(1.0, 0.0, 0.0, 0.0), vec4<f32>(0.0, 1.0, 0.0, 0.0), vec4<f32>(0.0, 0.0, 1.0, 0.0)); let view = View(rows, vec4<f32>(40.0, 42.0, 31.0, 25.5), 1.0 / sqrt(3.14159265 * 1680.0), 64u, 0u, 2u, vec4<f32>(-0.02, 0.004, -0.002, 0.0003), vec4<f32>(0.0, 0.0, 0.0, 3.14159), vec4<f32>(0.001, -0.0005, 0.002, -0.001), vec4<u32>()); let c = cone_in(view, u32(x.x), u32(x.y), u32(x.z), u32(x.w)); return vec4<f32>(c.direction, c.slope);"),
        Lens::fisheye([-0.02, 0.004, -0.002, 0.0003], [0.001, -0.0005], [0.002, -0.001]),
    );
}
