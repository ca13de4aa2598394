//! Extreme geometry: spheres of zero and of huge radius, rays along edges, cameras and boxes of every shape.

use super::finding::{Finding, Make, Tell, apart, not_finite, relative, worst};
use super::rig::{Rig, small};
use glam::{DMat3, DVec3};
use trimip_core::engine::backend::Sampler;
use trimip_core::engine::batch::{Ray, Sphere};
use trimip_core::field::encoders::tri_mip::FEATURES;
use trimip_core::field::model::Model;
use trimip_core::field::tensors::{Tensor, TensorFile};
use trimip_core::{
    Aabb, Backend, Camera, Config, Intrinsics, Layout, Result, Viewer, engine::loaded::LoadedModel,
    math::bits,
};

fn found(case: impl Into<String>, law: &'static str, worst: f64, bound: f64) -> Finding {
    Finding { part: "geometry", case: case.into(), law, worst, bound }
}

/// Runs the cases of this part.
pub fn cases<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    spheres(make, tell)?;
    rays(make, tell)?;
    cameras(make, tell)?;
    boxes(make, tell)?;
    Ok(())
}

/// Checks that radii of zero, below zero and NaN select the finest level, and huge radii the coarsest.
fn spheres<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    let mut rig = Rig::new(make, &small())?;
    let at = |radius| Sphere { position: [0.3, 0.7, 0.51], radius };
    let mut features = |radii: &[f32]| -> Vec<Vec<f32>> {
        let spheres: Vec<Sphere> = radii.iter().map(|&radius| at(radius)).collect();
        rig.features(&spheres).chunks(FEATURES).take(radii.len()).map(<[f32]>::to_vec).collect()
    };
    let same = |all: &[Vec<f32>]| {
        worst(all.iter().flat_map(|row| row.iter().zip(&all[0]).map(|(a, b)| apart(*a, f64::from(*b)))))
    };
    let finest = features(&[1e-6, 0.0, -0.0, 1e-40, f32::MIN_POSITIVE, f32::NAN, -1.0]);
    let coarsest = features(&[1e3, 1e30, f32::MAX, f32::INFINITY]);
    let apart = worst(finest[0].iter().zip(&coarsest[0]).map(|(a, b)| f64::from((a - b).abs())));
    [
        found(
            "radius 0, denormal, negative, not a number",
            "the features of the finest level",
            same(&finest),
            0.0,
        ),
        found("radius 1e3 to infinite", "the features of the coarsest level", same(&coarsest), 0.0),
        found(
            "smallest and largest radius",
            "give different features",
            if apart > 0.0 { 0.0 } else { 1.0 },
            0.0,
        ),
    ]
    .into_iter()
    .for_each(tell);
    Ok(())
}

/// Returns rays in all directions, from outside, from inside, on faces and on edges.
fn directions() -> Vec<Ray> {
    let s = 0.5_f32.sqrt();
    let t = 3_f32.sqrt().recip();
    let ray = |origin, direction| Ray { origin, direction, slope: 0.001, cosine: 1.0, ..Ray::default() };
    vec![
        ray([-4.0, 0.1, 0.2], [1.0, 0.0, 0.0]),
        ray([0.1, 5.0, 0.2], [0.0, -1.0, 0.0]),
        ray([0.1, 0.2, -9.0], [0.0, 0.0, 1.0]),
        ray([-3.0, -3.0, -3.0], [t, t, t]),
        ray([-3.0, 3.0, 0.4], [s, -s, 0.0]),
        ray([0.0, 0.0, 0.0], [s, 0.0, s]),
        ray([1.49, 1.49, 1.49], [-t, -t, -t]),
        // On a face, pointing outwards; on a face, pointing along it; along an edge.
        ray([1.5, 0.0, 0.0], [1.0, 0.0, 0.0]),
        ray([1.5, 0.0, -4.0], [0.0, 0.0, 1.0]),
        ray([1.5, 1.5, -4.0], [0.0, 0.0, 1.0]),
        // A tiny direction component; grazing a corner; missing the box; pointing away from it; from very far.
        ray([-4.0, 0.3, 0.3], [1.0, 1e-30, -1e-38]),
        ray([-4.0, 1.4999, 0.0], [1.0, 0.0, 0.0]),
        ray([-4.0, 1.6, 0.0], [1.0, 0.0, 0.0]),
        ray([4.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
        ray([1e6, 0.0, 0.0], [-1.0, 0.0, 0.0]),
    ]
}

fn rays<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    let config = small();
    let mut rig = Rig::new(make, &config)?;
    let rays = directions();
    let (marched, spheres) = rig.march(&rays);
    let aabb = Aabb::<f64>::new(&config.scene);
    let step = f64::from(config.step_length());
    let length = |ray: &Ray| {
        let (enter, leave) = aabb.intersect(ray.origin.map(f64::from), ray.direction.map(f64::from));
        (leave - enter).max(0.0)
    };
    // A million units away, f32 resolves distances to 1/16.
    let slack =
        |ray: &Ray| 1.0 + ray.origin.iter().fold(0.0_f64, |m, x| m.max(x.abs().into())) * 1.2e-7 / step;
    let errors = rays
        .iter()
        .zip(&marched)
        .map(|(ray, marched)| (apart(marched.len() as f64, length(ray) / step) - slack(ray)).max(0.0));
    let ascending = marched.iter().flat_map(|ts| ts.windows(2)).filter(|pair| !(pair[0] < pair[1])).count();
    let outside = |sphere: &Sphere| worst(sphere.position.map(|x| f64::from((x - 1.0).max(-x))));
    [
        found(
            "rays along axes, diagonals, faces and edges",
            "samples cover the ray within the box, to one step",
            worst(errors),
            0.0,
        ),
        found("rays along axes, diagonals, faces and edges", "distances ascend", ascending as f64, 0.0),
        found(
            "rays along axes, diagonals, faces and edges",
            "samples lie within the box",
            worst(spheres.iter().map(outside)),
            1e-6,
        ),
    ]
    .into_iter()
    .for_each(tell);
    Ok(())
}

/// Compares camera rays with those computed in f64.
fn cameras<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    let mut rig = Rig::new(make, &small())?;
    let mut cases: Vec<(String, Intrinsics)> = [0.001_f64, 0.1, 40.0, 120.0, 179.0]
        .into_iter()
        .map(|degrees| {
            (format!("field of view {degrees}°"), Intrinsics::from_angle(64, 48, degrees.to_radians()))
        })
        .collect();
    let k =
        |width, height, fx, fy, cx, cy| Intrinsics { width, height, fx, fy, cx, cy, ..Intrinsics::default() };
    cases.extend([
        ("an image of one pixel".into(), k(1, 1, 1.0, 1.0, 0.5, 0.5)),
        ("an image of one row".into(), k(500, 1, 300.0, 300.0, 250.0, 0.5)),
        ("an image of one column".into(), k(1, 500, 300.0, 300.0, 0.5, 250.0)),
        ("pixels 100 times as wide as high".into(), k(64, 64, 10.0, 1000.0, 32.0, 32.0)),
        ("a principal point far outside".into(), k(64, 64, 100.0, 100.0, -900.0, 2000.0)),
        ("16,384 pixels across".into(), k(16_384, 2, 20_000.0, 20_000.0, 8_192.0, 1.0)),
    ]);
    for (name, intrinsics) in cases {
        let camera = Camera::look_at(intrinsics, DVec3::new(2.0, -3.0, 1.0), DVec3::ZERO, DVec3::Z);
        let count = intrinsics.width * intrinsics.height;
        let workspace = &mut rig.workspace;
        rig.stages.sampler.camera_rays(&mut workspace.stream, &camera, 0..count, &mut workspace.rays);
        let rays = rig.backend.read(&workspace.rays.rays);
        let (mut errors, mut slopes) = (Vec::new(), Vec::new());
        for (i, ray) in rays.iter().enumerate() {
            let exact = camera.cone::<f64>(i as u32 % intrinsics.width, i as u32 / intrinsics.width);
            errors.extend((0..3).map(|c| apart(ray.direction[c], exact.direction[c])));
            slopes.push(relative(ray.slope, exact.slope));
        }
        tell(found(name.clone(), "directions as in f64", worst(errors), 1e-6));
        tell(found(name, "radii as in f64, relative", worst(slopes), 4e-6));
    }
    Ok(())
}

/// Number of steps along the diagonal of a box: few enough to render a long box, enough to detect a wrong position.
const STEPS: u32 = 2048;

/// Checks boxes of all sizes and shapes, filled with one medium whose upper half along an axis is empty. A ray along
/// the axis passes through the medium for half of the box's side.
fn boxes<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    for (name, centre, sides) in [
        ("a flat box, 1:1000", 0.0, [3.0, 3.0, 0.003]),
        ("a long box, 1000:1", 0.0, [3.0, 0.003, 0.003]),
        ("a box 1e-6 large", 0.0, [3e-6; 3]),
        ("a box 1e6 large", 0.0, [3e6; 3]),
        ("a box 1e6 away from the origin", 1e6, [3.0; 3]),
    ] {
        let mut config = small();
        config.renderer.steps_per_diagonal = STEPS;
        config.scene.aabb_min = sides.map(|side| (centre - 0.5 * side) as f32);
        config.scene.aabb_max = sides.map(|side| (centre + 0.5 * side) as f32);
        let step = f64::from(config.step_length());
        let (mut errors, mut strange) = (Vec::new(), 0.0);
        for axis in 0..3_usize {
            // An optical depth of 2 along the whole side, so that the depth along half of it can be measured well.
            let density = 2.0 / sides[axis];
            let mut trainer = LoadedModel::new(make()?, &medium(&config, density, axis))?;
            let mut along = DVec3::ZERO;
            along[axis] = 1.0;
            let corner = DVec3::splat(centre) - 0.5 * DVec3::from_array(sides);
            let mut origin = corner + 0.25 * DVec3::from_array(sides);
            origin[axis] = corner[axis] - sides[axis];
            let up = if axis == 2 { DVec3::X } else { DVec3::Z };
            let right = along.cross(up);
            let intrinsics = Intrinsics {
                width: 1,
                height: 1,
                fx: 100.0,
                fy: 100.0,
                cx: 0.5,
                cy: 0.5,
                ..Intrinsics::default()
            };
            let rotation = DMat3::from_cols(right, up, -along);
            let pixel = trainer.render(&Camera { intrinsics, rotation, origin })?.pixels[0];
            strange += not_finite(&[pixel.rgb[0], pixel.rgb[1], pixel.rgb[2], pixel.opacity, pixel.depth]);
            let covered = -(1.0 - f64::from(pixel.opacity)).ln() / density;
            errors.push((apart(covered, 0.5 * sides[axis]) - 2.0 * step).max(0.0) / sides[axis]);
        }
        tell(found(name, "the medium covers half a side, to two steps and 1e-4 of it", worst(errors), 1e-4));
        tell(found(name, "all numbers are finite", strange, 0.0));
    }
    Ok(())
}

/// Returns a model of constant density that is occupied in the lower half along `axis`.
fn medium(config: &Config, density: f64, axis: usize) -> Model {
    let layout = Layout::new(config);
    let mut values = layout.initial(config);
    let last = format!("density.{}.weight", config.field.density_layers);
    for slot in &layout.slots {
        let part = &mut values[slot.range.clone()];
        let inputs = slot.shape[0] as f64;
        if slot.name == "planes" {
            part.fill(1.0);
        } else if slot.name == last {
            // Density = exp(logit - 1), where the hidden units are 1.
            part.iter_mut().step_by(slot.shape[1]).for_each(|w| *w = ((density.ln() + 1.0) / inputs) as f32);
        } else if slot.name.starts_with("density") {
            part.fill((1.0 / inputs) as f32);
        }
    }
    let resolution = config.occupancy.resolution;
    let mut bits = vec![0_u8; (resolution.pow(3) as usize).div_ceil(8)];
    for cell in 0..resolution.pow(3) {
        if trimip_core::geometry::occupancy::coordinates(cell, resolution)[axis] < resolution / 2 {
            bits::set(&mut bits, cell as usize);
        }
    }
    let mut file = TensorFile::default();
    layout.to_tensors(&values, "", &mut file);
    file.tensors.insert("occupancy".into(), Tensor::u8(&[bits.len()], bits));
    Model::new(config.clone(), file)
}
