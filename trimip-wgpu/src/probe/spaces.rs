//! Checks rays through the bounded and the contracted space.

use super::{compare, directions, files};
use crate::space::SPACE;
use trimip_core::engine::batch::Ray;
use trimip_core::geometry::space::Path;
use trimip_core::{Aabb, Space};

#[test]
fn rays_through_the_space() {
    let space = Space::of(Aabb { min: [-1.0, 2.0, 0.5], max: [3.0, 4.0, 1.5] });
    let origin = [0.1, 2.9, 0.8];
    let inputs: Vec<[f32; 4]> = directions().into_iter().map(|[x, y, z, _]| [x, y, z, 0.17]).collect();
    compare(
        files!(SPACE; "let space = Space(vec3<f32>(-1.0, 2.0, 0.5), 16u, vec3<f32>(3.0, 4.0, 1.5), 4.0, vec3<f32>(0.25, 0.5, 1.0), 0.0, vec3<f32>(0.25, 0.125, 0.0625), 0.0); return sphere_at(space, Ray(vec3<f32>(0.1, 2.9, 0.8), 0.03, x.xyz, 1.0, 0.0), x.w);"),
        &inputs,
        |[x, y, z, t]| {
            let [direction, origin] = [[x, y, z], origin.map(|o: f32| f64::from(o))];
            let point = std::array::from_fn(|i| origin[i] + t * direction[i]);
            let [u, v, w] = space.to_cube(point);
            [u, v, w, f64::from(0.03_f32) * t * space.scale(point)]
        },
        (3e-7, 2e-6),
    );
    // The parameters at which a ray enters and leaves the space, and leaves a block of four cells. All of them divide
    // by a component of the direction.
    let near = Space::of(Aabb { min: [-1.0_f32, 2.0, 0.5], max: [3.0, 4.0, 1.5] });
    compare(
        files!(SPACE; "let space = Space(vec3<f32>(-1.0, 2.0, 0.5), 16u, vec3<f32>(3.0, 4.0, 1.5), 4.0, vec3<f32>(0.25, 0.5, 1.0), 0.0, vec3<f32>(0.25, 0.125, 0.0625), 0.0); let ray = Ray(vec3<f32>(0.1, 2.9, 0.8), 0.03, x.xyz, 1.0, 0.0); let cell = cell_of(space, sphere_at(space, ray, x.w).xyz); return vec4<f32>(intersect(space, ray), cells_exit(space, ray, cell, 4u), 0.0);"),
        &inputs,
        |x| {
            let [u, v, w, t] = x.map(|x| x as f32);
            let ray = Ray { origin, slope: 0.03, direction: [u, v, w], cosine: 1.0, ..Ray::default() };
            let way = near.straight_path(&ray, 16);
            let exit = way.exit(way.cell(way.position(t)), 4);
            let (enter, leave) = near.parameterisation(ray.origin, ray.direction).range();
            [enter, leave, exit, 0.0].map(f64::from)
        },
        (1e-6, 1e-5),
    );
}

/// Checks a contracted space around a ball of radius 1.25 at (0.5, 3, 1), with rays in one direction from points within
/// the ball, near it and far away.
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
        files!(SPACE; "let space = Space(vec3<f32>(-2.0, 0.5, -1.5), 16u, vec3<f32>(3.0, 5.5, 3.5), 5.0, vec3<f32>(0.2), 1.25, vec3<f32>(0.3125), 0.3125); let ray = Ray(x.xyz, 0.03, vec3<f32>(0.48, -0.6, 0.64), 1.0, 0.0); let parameterisation = parameterisation_of(space, ray); return sphere_at(space, ray, x.w);"),
        &inputs,
        |x| {
            let [u, v, w] = space.to_cube(at(x));
            [u, v, w, f64::from(0.03_f32) * x[3] * space.scale(at(x))]
        },
        (1e-6, 4e-6),
    );
    compare(
        files!(SPACE; "let space = Space(vec3<f32>(-2.0, 0.5, -1.5), 16u, vec3<f32>(3.0, 5.5, 3.5), 5.0, vec3<f32>(0.2), 1.25, vec3<f32>(0.3125), 0.3125); let ray = Ray(x.xyz, 0.03, vec3<f32>(0.48, -0.6, 0.64), 1.0, 0.0); let parameterisation = parameterisation_of(space, ray); return vec4<f32>(to_world(space, to_cube(space, ray.origin)), parameter_at(parameterisation, x.w));"),
        &inputs,
        |x| {
            let [u, v, w, t] = x;
            let s = ball.parameterisation([u, v, w], direction).parameter(t);
            [u, v, w, s]
        },
        (2e-5, 2e-5),
    );
    compare(
        files!(SPACE; "let space = Space(vec3<f32>(-2.0, 0.5, -1.5), 16u, vec3<f32>(3.0, 5.5, 3.5), 5.0, vec3<f32>(0.2), 1.25, vec3<f32>(0.3125), 0.3125); let ray = Ray(x.xyz, 0.03, vec3<f32>(0.48, -0.6, 0.64), 1.0, 0.0); let parameterisation = parameterisation_of(space, ray); return vec4<f32>(parameterisation.enter, parameterisation.leave, distance_at(parameterisation, parameter_at(parameterisation, x.w)), length_at(space, parameterisation, ray, x.w, 0.01));"),
        &inputs,
        |x| {
            let [u, v, w, t] = x;
            let curve = ball.parameterisation([u, v, w], direction);
            let (enter, leave) = curve.range();
            [enter, leave, t, 0.01 * curve.slowness(t) * ball.radial(at(x))]
        },
        (2e-5, 1e-4),
    );
    // Parameter of a sample's midpoint along the ray, and the sample's width, with and without contraction.
    let bounded = Space::of(Aabb { min: [-2.0, 0.5, -1.5], max: [3.0, 5.5, 3.5] });
    compare(
        files!(SPACE; "var space = Space(vec3<f32>(-2.0, 0.5, -1.5), 16u, vec3<f32>(3.0, 5.5, 3.5), 5.0, vec3<f32>(0.2), 1.25, vec3<f32>(0.3125), 0.3125); let ray = Ray(x.xyz, 0.03, vec3<f32>(0.48, -0.6, 0.64), 1.0, 0.0); let curved = along(space, parameterisation_of(space, ray), ray, x.w, 0.25); space.ball = 0.0; return vec4<f32>(curved, along(space, parameterisation_of(space, ray), ray, x.w, 0.25));"),
        &inputs,
        |x| {
            let [u, v, w, t] = x;
            let [place, width] = space.along(&space.parameterisation([u, v, w], direction), at(x), t, 0.25);
            let [flat, flat_width] =
                bounded.along(&bounded.parameterisation([u, v, w], direction), at(x), t, 0.25);
            [place, width, flat, flat_width]
        },
        (2e-6, 1e-4),
    );
    // The ray parameter up to which a ray surely stays within a block of four cells.
    let near = Space::contracted(Aabb { min: [-2.0_f32, 0.5, -1.5], max: [3.0, 5.5, 3.5] });
    compare(
        files!(SPACE; "let space = Space(vec3<f32>(-2.0, 0.5, -1.5), 16u, vec3<f32>(3.0, 5.5, 3.5), 5.0, vec3<f32>(0.2), 1.25, vec3<f32>(0.3125), 0.3125); let ray = Ray(x.xyz, 0.03, vec3<f32>(0.48, -0.6, 0.64), 1.0, 0.0); let parameterisation = parameterisation_of(space, ray); let position = to_cube(space, ray.origin); return vec4<f32>(cells_clear(space, x.w, position, cell_of(space, position), 4u), 0.0, 0.0, 0.0);"),
        &inputs,
        |[x, y, z, s]| {
            let position = near.to_cube([x as f32, y as f32, z as f32]);
            let cells = position.map(|p| f64::from(p) * 16.0);
            let margin = cells.map(|c| (c - 4.0 * (c / 4.0).floor()).min(4.0 * (c / 4.0).floor() + 4.0 - c));
            let least = margin.into_iter().fold(f64::INFINITY, f64::min);
            [s + least * 0.3125 / trimip_core::geometry::space::contraction::STRETCH, 0.0, 0.0, 0.0]
        },
        (2e-5, 1e-6),
    );
}
