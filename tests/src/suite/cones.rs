//! Tests of pixels with several cones: a pixel is the mean of its cones, and equal cones act as one.

use super::Bench;
use crate::fixtures::{TestRandom, lively, noise, small};
use glam::DVec3;
use trimip_core::{
    Backend, Camera, Intrinsics, Layout, Renderer, Result, Viewer,
    config::{ConePattern, schedule::Schedule},
    engine::{
        backend::Sampler,
        batch::{Interval, Radiance, Ray, Rays, Samples, Segment, Sphere, Tile},
        trainer::Trainer,
    },
};

/// Largest difference of a pixel's value. The cones of a subdivided pixel and those of a finer camera differ by roundings of
/// 6e-8, which the slope of the networks amplifies over about twenty samples.
const PIXEL_TOLERANCE: f32 = 5e-4;

/// A pixel with n·n cones is the mean of n·n pixels of a camera with n times the resolution.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn parts<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let intrinsics =
        Intrinsics { width: 7, height: 6, fx: 6.0, fy: 5.5, cx: 3.3, cy: 3.1, ..Intrinsics::default() };
    let camera = |n: u32| {
        let k = f64::from(n);
        let fine = Intrinsics {
            width: n * intrinsics.width,
            height: n * intrinsics.height,
            fx: k * intrinsics.fx,
            fy: k * intrinsics.fy,
            cx: k * intrinsics.cx,
            cy: k * intrinsics.cy,
            ..Intrinsics::default()
        };
        Camera::look_at(fine, DVec3::new(2.0, -3.0, 1.5), DVec3::ZERO, DVec3::Z)
    };
    let mut config = small();
    let parameters = lively(&Layout::new(&config), 9);
    let mut render = |cones: u32, camera: &Camera| {
        config.renderer.cones = cones;
        let mut trainer = Trainer::new(make(), &config, noise(1, 8, 1, 1))?;
        trainer.set_parameters(&parameters);
        trainer.occupy_all();
        trainer.render(camera)
    };
    for n in [2, 3] {
        let (coarse, fine) = (render(n, &camera(1))?, render(1, &camera(n))?);
        for (i, pixel) in coarse.pixels.iter().enumerate() {
            let (x, y) = (i as u32 % coarse.width, i as u32 / coarse.width);
            let parts = (0..n * n).map(|j| ((n * y + j / n) * fine.width + n * x + j % n) as usize);
            let parts: Vec<_> = parts.map(|j| fine.pixels[j]).collect();
            let mean = |pick: &dyn Fn(usize) -> f32| (0..parts.len()).map(pick).sum::<f32>() / (n * n) as f32;
            let pairs = [
                (pixel.rgb[0], mean(&|j| parts[j].rgb[0])),
                (pixel.rgb[1], mean(&|j| parts[j].rgb[1])),
                (pixel.rgb[2], mean(&|j| parts[j].rgb[2])),
                (pixel.opacity, mean(&|j| parts[j].opacity)),
                (pixel.depth, mean(&|j| parts[j].depth)),
            ];
            for (found, expected) in pairs {
                let bound = PIXEL_TOLERANCE * expected.abs().max(1.0);
                assert!((found - expected).abs() < bound, "{n}, pixel {i}: {found}, not {expected}");
            }
        }
    }
    Ok(())
}

/// A quincunx pixel is the mean of the same pixel in five pictures: one of the original camera, and four whose rays are moved by
/// a quarter of a pixel along both axes.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn quincunx<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let intrinsics =
        Intrinsics { width: 7, height: 6, fx: 6.0, fy: 5.5, cx: 3.3, cy: 3.1, ..Intrinsics::default() };
    let mut config = small();
    let parameters = lively(&Layout::new(&config), 9);
    let mut render = |pattern: ConePattern, [x, y]: [f64; 2]| {
        config.renderer.pattern = pattern;
        let mut trainer = Trainer::new(make(), &config, noise(1, 8, 1, 1))?;
        trainer.set_parameters(&parameters);
        trainer.occupy_all();
        // Shifts the principal point so that the ray of a pixel passes through (x, y) within it, not through (0.5, 0.5).
        let moved = Intrinsics { cx: intrinsics.cx + 0.5 - x, cy: intrinsics.cy + 0.5 - y, ..intrinsics };
        trainer.render(&Camera::look_at(moved, DVec3::new(2.0, -3.0, 1.5), DVec3::ZERO, DVec3::Z))
    };
    let found = render(ConePattern::Quincunx, [0.5, 0.5])?;
    let places = [[0.5, 0.5], [0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]];
    let five: Vec<_> =
        places.into_iter().map(|place| render(ConePattern::Grid, place)).collect::<Result<_>>()?;
    for (i, pixel) in found.pixels.iter().enumerate() {
        for c in 0..3 {
            let mean = five.iter().map(|frame| frame.pixels[i].rgb[c]).sum::<f32>() / 5.0;
            assert!((pixel.rgb[c] - mean).abs() < PIXEL_TOLERANCE, "pixel {i}: {}, not {mean}", pixel.rgb[c]);
        }
    }
    Ok(())
}

/// In a training step the cone rule sets the number of cones per pixel at each scale, up to the schedule's limit. The cones of a
/// pixel tile it. Drawing a range of a step's pixels gives the same rays as drawing the whole step.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn by_scale<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    const PIXELS: u32 = 300;
    let mut config = small();
    // A pixel of the finest scale is 0.204 units wide in the middle of the box.
    (config.renderer.cones, config.renderer.cone_width) = (4, 0.204);
    config.train.cones = Schedule::new(vec![[0.0, 1.0], [0.5, 3.0]]);
    config.train.scale_weighting = Schedule::new(vec![[0.0, 0.5]]);
    let views = noise(3, 24, 3, 21);
    let parameters = lively(&Layout::new(&config), 1);
    let mut bench = Bench::new(make(), &config, Some(views.clone()), &parameters)?;
    for (progress, sides) in [(0.2, [1, 1, 1]), (0.7, [1, 2, 3])] {
        let Bench { backend, stages, workspace, .. } = &mut bench;
        let mut draw_part = |range: std::ops::Range<u32>| {
            stages.sampler.set_progress(progress);
            let allocation = stages.sampler.scale_weights().allocate(PIXELS);
            stages.sampler.training_rays(&mut workspace.stream, 5, &allocation, range, &mut workspace.rays);
            let Rays { rays, groups, targets, first, .. } = &workspace.rays;
            (backend.read(rays), backend.read(groups), backend.read(targets), *first)
        };
        let (rays, groups, targets, first) = draw_part(0..PIXELS);
        assert_eq!((groups.len(), targets.len(), first), (PIXELS as usize, PIXELS as usize, 0));
        let mut next = 0;
        for (group, target) in groups.iter().zip(&targets) {
            // The weight 4^(level / 2) identifies the scale.
            let level = target.weight.log2().round() as usize;
            let side = sides[level];
            assert_eq!((group.start, group.count), (next, side * side), "{progress}, scale {level}");
            next += group.count;
            // The camera of a pixel is the one at the origin of its rays; the cones lie at the centres of a regular grid in the
            // pixel.
            let own = &rays[group.range()];
            let place = |ray: &Ray, camera: &Camera| {
                let direction = DVec3::from_array(ray.direction.map(f64::from));
                let local = camera.rotation.transpose() * direction;
                let k = &camera.intrinsics;
                [k.cx + k.fx * local.x / -local.z, k.cy - k.fy * local.y / -local.z]
            };
            let at_origin = |camera: &&Camera| {
                let origin = DVec3::from_array(own[0].origin.map(f64::from));
                (camera.origin - origin).length() < 1e-5
            };
            let cameras = views.views[views.scales[level].views.clone()].iter().map(|view| &view.camera);
            let camera = cameras.into_iter().find(at_origin).expect("a camera of this scale");
            let places: Vec<_> = own.iter().map(|ray| place(ray, camera)).collect();
            let corner = places[0].map(f64::floor);
            for (i, at) in (0_u32..).zip(&places) {
                for (axis, part) in [i % side, i / side].into_iter().enumerate() {
                    let expected = corner[axis] + (f64::from(part) + 0.5) / f64::from(side);
                    assert!((at[axis] - expected).abs() < 1e-4, "cone {i} of {side}²: {at:?}");
                }
            }
        }
        assert_eq!(rays.len(), next as usize);
        for range in [0..77, 77..150, 150..151, 151..PIXELS] {
            let part = draw_part(range.clone());
            let own = &groups[range.start as usize..range.end as usize];
            let (start, end) = (own[0].start, own[own.len() - 1].range().end);
            assert_eq!(part.3, start);
            assert_eq!(part.0, rays[start as usize..end]);
            assert_eq!(part.2, targets[range.start as usize..range.end as usize]);
            let moved = own.iter().map(|group| Segment { start: group.start - start, ..*group });
            assert_eq!(part.1, moved.collect::<Vec<_>>());
        }
    }
    Ok(())
}

/// A group of n equal cones renders the same pixel as a single one, and each of its cones has 1/n of the single cone's gradient.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn equal<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = small();
    let parameters = lively(&Layout::new(&config), 3);
    let mut bench = Bench::new(make(), &config, None, &parameters)?;
    let mut random = TestRandom::new(23);
    let cone: Vec<(Interval, Radiance)> = (0..9)
        .map(|i| {
            let rgb = [0; 3].map(|_| random.between(0.0, 1.0) as f32);
            let density = random.between(-2.0, 3.0).exp() as f32;
            (Interval { t: 2.0 + 0.1 * i as f32, length: 0.1 }, Radiance { rgb, density })
        })
        .collect();
    let mut run = |count: u32| {
        let Bench { backend, stages, workspace, parameters } = &mut bench;
        let all: Vec<_> = (0..count).flat_map(|_| cone.clone()).collect();
        let each = cone.len() as u32;
        workspace.rays.place(backend, &vec![Ray { cosine: 0.8, ..Ray::default() }; count as usize]);
        backend.write(&mut workspace.rays.groups, &[Segment { start: 0, count }]);
        let Samples { segments, rays, intervals, spheres, counts } = &mut workspace.samples;
        let own: Vec<_> = (0..count).map(|i| Segment { start: i * each, count: each }).collect();
        backend.write(segments, &own);
        backend.write(rays, &(0..count * each).map(|i| i / each).collect::<Vec<_>>());
        backend.write(intervals, &all.iter().map(|(interval, _)| *interval).collect::<Vec<_>>());
        backend.write(spheres, &vec![Sphere::default(); all.len()]);
        backend.write(counts, &[[count * each; 2]]);
        backend.write(&mut workspace.radiance, &all.iter().map(|(_, value)| *value).collect::<Vec<_>>());
        let (rays, samples) = (&workspace.rays, &workspace.samples);
        let tile = &mut Tile { stream: &mut workspace.stream, parameters, rays, samples };
        stages.renderer.composite(tile, &workspace.radiance, &mut workspace.cones, &mut workspace.pixels);
        backend.write(&mut workspace.pixel_gradients, &[[0.3, -0.7, 1.1, 0.4]]);
        let (by_pixel, gradients) = (&workspace.pixel_gradients, &mut workspace.radiance_gradients);
        stages.renderer.backward(tile, &workspace.radiance, &workspace.cones, by_pixel, gradients);
        (backend.read(&workspace.pixels)[0], backend.read(&workspace.radiance_gradients))
    };
    let (one, gradient) = run(1);
    let close = |found: f32, expected: f32| (found - expected).abs() <= 1e-6 * expected.abs().max(0.1);
    for count in [2, 4, 9] {
        let (pixel, gradients) = run(count);
        let channels = pixel.channels().into_iter().zip(one.channels());
        assert!(
            channels.into_iter().all(|(a, b)| close(a, b)) && close(pixel.depth, one.depth),
            "{count}: {pixel:?}"
        );
        for (i, found) in gradients.iter().enumerate() {
            let expected = gradient[i % cone.len()];
            let fraction = |value: f32| value / count as f32;
            assert!(
                close(found.density, fraction(expected.density))
                    && (0..3).all(|c| close(found.rgb[c], fraction(expected.rgb[c]))),
                "{count} cones, sample {i}: {found:?}, not a {count}th of {expected:?}"
            );
        }
    }
    Ok(())
}
