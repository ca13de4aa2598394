//! Tests of every registered camera model: the rays of its pixels match f64, whole pixels match the literal equations, and pictures of a
//! homogeneous medium follow the law of Beer and Lambert. These tests cover a newly registered model without changes.

use super::{Bench, wide};
use crate::{
    fixtures::{constant, every_encoder, lively, noise, photographs, small},
    reference::{self, Reference, march},
};
use glam::DVec3;
use trimip_core::{
    Backend, Camera, Config, Intrinsics, Layout, Result, ViewSet, Viewer,
    config::ConePattern,
    engine::{
        backend::Sampler,
        batch::{Ray, Rays},
        trainer::Trainer,
    },
    geometry::projections::Model,
    scene::cones::PixelPattern,
};

/// Absolute tolerance of directions, origins and cosines: a few roundings in f32, and the errors of a driver's sines and cosines.
const RAY_TOLERANCE: f64 = 5e-6;

/// Relative tolerance of radii, each the square root of a sum of products in f32. Near the ends of an angle's range, drivers have larger
/// errors.
const RADIUS_TOLERANCE: f64 = 1e-4;

/// Tolerance of a whole pixel: feature errors of 1e-5, amplified by the networks' slope of about 10, over some twenty samples.
const PIXEL_TOLERANCE: f64 = 1e-3;

/// Returns a camera of each model, outside of the box of [`small`] and turned away from every axis.
fn cameras(width: u32, height: u32) -> Vec<Camera> {
    let camera = |model: &Model| {
        let k = model.example(width, height);
        let k = Intrinsics { cx: k.cx + 0.3, fy: 0.9 * k.fy, ..k };
        Camera::look_at(k, DVec3::new(2.4, -2.9, 1.5), DVec3::ZERO, DVec3::Z)
    };
    Model::ALL.iter().map(camera).collect()
}

/// Returns the name of a camera's model.
fn name(camera: &Camera) -> &'static str {
    camera.intrinsics.lens.model.name()
}

/// Returns the distance between a ray and the exact cone in f64, in units of the tolerances.
fn distance(found: &Ray, camera: &Camera, [x, y, index]: [u32; 3], pattern: PixelPattern) -> f64 {
    let exact = camera.cone_in::<f64>(x, y, index, pattern);
    let apart = |a: [f32; 3], b: [f64; 3]| (DVec3::from(a.map(f64::from)) - DVec3::from(b)).length();
    let relative =
        |a: f32, b: f64| if b == 0.0 { f64::from(a).abs() } else { (f64::from(a) / b - 1.0).abs() };
    let place = apart(found.direction, exact.direction)
        .max(apart(found.origin, exact.origin))
        .max((f64::from(found.cosine) - exact.cosine).abs());
    let size = relative(found.slope, exact.slope).max(relative(found.radius, exact.radius));
    (place / RAY_TOLERANCE).max(size / RADIUS_TOLERANCE)
}

/// The rays of a camera match f64, for whole pixels, pixels divided into cones, and the quincunx.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn rays<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for pattern in [PixelPattern::WHOLE, PixelPattern::Grid(3), PixelPattern::Quincunx] {
        let mut config = small();
        config.renderer.cone_width = 0.0;
        (config.renderer.cones, config.renderer.pattern) = match pattern {
            PixelPattern::Grid(side) => (side, ConePattern::Grid),
            PixelPattern::Quincunx => (1, ConePattern::Quincunx),
        };
        let parameters = lively(&Layout::new(&config), 9);
        let mut bench = Bench::new(make(), &config, None, &parameters)?;
        for camera in cameras(13, 9) {
            let Bench { backend, stages, workspace, .. } = &mut bench;
            stages.sampler.camera_rays(&mut workspace.stream, &camera, 0..13 * 9, &mut workspace.rays);
            let found = backend.read(&workspace.rays.rays);
            let count = pattern.count();
            assert_eq!(found.len() as u32, 13 * 9 * count);
            for (i, ray) in (0..).zip(&found) {
                let pixel = i / count;
                let error = distance(ray, &camera, [pixel % 13, pixel / 13, i % count], pattern);
                assert!(error < 1.0, "{}, pixel {pixel}, cone {}: {ray:?}", name(&camera), i % count);
            }
        }
    }
    Ok(())
}

/// Returns photographs of noise at two scales, taken by one camera of each model.
pub fn views() -> ViewSet {
    let mut next = 0_u32;
    photographs(&cameras(16, 12), 2, |_, _| {
        next = next.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (next | 0xff00_0000).to_le_bytes()
    })
}

/// Every training ray belongs to a pixel of a photograph, and every photograph has training rays.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn training<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    const PIXELS: u32 = 256;
    let (config, views) = (small(), views());
    let parameters = lively(&Layout::new(&config), 1);
    let mut bench = Bench::new(make(), &config, Some(views.clone()), &parameters)?;
    let Bench { backend, stages, workspace, .. } = &mut bench;
    let allocation = stages.sampler.scale_weights().allocate(PIXELS);
    stages.sampler.training_rays(&mut workspace.stream, 3, &allocation, 0..PIXELS, &mut workspace.rays);
    let Rays { rays, targets, .. } = &workspace.rays;
    let (rays, targets) = (backend.read(rays), backend.read(targets));
    let mut drawn = vec![0; views.views.len()];
    for (ray, target) in rays.iter().zip(&targets) {
        assert!(target.weight > 0.0);
        let own = |camera: &Camera| {
            let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
            (0..width * height)
                .any(|i| distance(ray, camera, [i % width, i / width, 0], PixelPattern::WHOLE) < 1.0)
        };
        let view = views.views.iter().position(|view| own(&view.camera));
        drawn[view.unwrap_or_else(|| panic!("{ray:?} is of no pixel"))] += 1;
    }
    assert!(drawn.iter().all(|&count| count > 0), "{drawn:?}");
    Ok(())
}

/// Whole pixels of every model, with every encoder, match the literal equations.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn pixels<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for mut config in every_encoder() {
        config.renderer.min_transmittance = 0.0;
        let layout = Layout::new(&config);
        let parameters = lively(&layout, 9);
        let mut trainer = Trainer::new(make(), &config, noise(1, 8, 1, 1))?;
        trainer.set_parameters(&parameters);
        trainer.occupy_all();
        let literal = Reference::new(&config, &layout, &wide(&parameters));
        for camera in cameras(4, 3) {
            let frame = trainer.render(&camera)?;
            for (i, pixel) in frame.pixels.iter().enumerate() {
                let ray = Ray::from(camera.cone::<f32>(i as u32 % 4, i as u32 / 4));
                let expected = literal.pixel(&ray, &march(&config, &ray, 0.0, |_| true));
                let place = format!("{:?}, {}, pixel {i}", config.encoder.kind, name(&camera));
                for c in 0..3 {
                    let error = (f64::from(pixel.rgb[c]) - expected.rgb[c]).abs();
                    assert!(error < PIXEL_TOLERANCE, "{place}: {pixel:?}, not {:?}", expected.rgb);
                }
                let error = (f64::from(pixel.depth) - expected.depth).abs();
                assert!(error < PIXEL_TOLERANCE * expected.depth.max(1.0), "{place}: {}", pixel.depth);
            }
        }
    }
    Ok(())
}

/// In a medium of uniform density σ, a pixel whose ray has the length L within the box has the opacity 1 − exp(−σ·L), and the depth that
/// follows from L. Cameras lie in front of the box and near its middle.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn homogeneous<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    const SIGMA: f64 = 0.4;
    let mut config: Config = small();
    config.renderer.steps_per_diagonal = 2000;
    let parameters = constant(&config, &Layout::new(&config), SIGMA, [0.1, 0.7, 0.4]);
    let mut trainer = Trainer::new(make(), &config, noise(1, 8, 1, 1))?;
    trainer.set_parameters(&parameters);
    trainer.occupy_all();
    let step = reference::step_length(&config);
    let inside = |camera: &Camera| Camera { origin: DVec3::new(0.2, -0.1, 0.3), ..*camera };
    let before = cameras(9, 7);
    for camera in before.iter().copied().chain(before.iter().map(inside)) {
        let frame = trainer.render(&camera)?;
        let mut seen = 0;
        for (i, pixel) in frame.pixels.iter().enumerate() {
            let cone = camera.cone::<f64>(i as u32 % 9, i as u32 / 9);
            let (enter, leave) = reference::tile(&config, cone.origin, cone.direction).unwrap_or((0.0, 0.0));
            seen += usize::from(leave > enter);
            let exact = 1.0 - (-SIGMA * (leave - enter)).exp();
            let place = format!("{}, pixel {i}", name(&camera));
            // The bound is twice the effect of two errors: the steps cover L to within half a step, and the f32 density
            // differs from SIGMA by at most 1e-4.
            let bound = SIGMA * step + 2e-4;
            assert!((f64::from(pixel.opacity) - exact).abs() < bound, "{place}: {} {exact}", pixel.opacity);
            let far = leave + 1.0 / SIGMA;
            let depth = cone.cosine * ((enter + 1.0 / SIGMA) - far * (-SIGMA * (leave - enter)).exp());
            assert!((f64::from(pixel.depth) - depth).abs() < bound * far, "{place}: {} {depth}", pixel.depth);
        }
        assert!(seen > 20, "{}: {seen} rays meet the box", name(&camera));
    }
    Ok(())
}
