//! Tests of ray marching: skipping empty space gives the samples of querying every step, on random occupancy and
//! difficult rays.

use super::Bench;
use crate::{
    fixtures::{TestRandom, lively, small},
    reference,
};
use glam::DVec3;
use trimip_core::config::schedule::Schedule;
use trimip_core::{
    Backend, Config, Layout, Renderer, Result,
    engine::{backend::Occupancy, batch::Ray},
};

/// Distance below which f32 and f64 may decide differently about a sample: to a cell's border in unit-box coordinates,
/// and to the end of the ray's path in the box in world units. Positions of order 5 world units have a rounding error
/// of 5e-7.
const BORDER: f64 = 4e-6;

/// Largest fraction of samples that may lie this close to a border.
const BORDER_SHARE: f64 = 0.005;

/// Returns rays through, beside, along and from inside the box; the first 30 are parallel to an axis.
pub fn rays(seed: u64) -> Vec<Ray> {
    let mut random = TestRandom::new(seed);
    let mut rays = Vec::new();
    let mut push = |origin: DVec3, direction: DVec3| {
        rays.push(Ray {
            origin: origin.to_array().map(|x| x as f32),
            direction: direction.to_array().map(|x| x as f32),
            slope: 0.01,
            cosine: 1.0,
            ..Ray::default()
        });
    };
    for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
        let aside = axis.any_orthonormal_vector();
        for sign in [1.0, -1.0] {
            push(-4.0 * sign * axis + 0.3 * aside, sign * axis);
            push(-4.0 * sign * axis, sign * axis);
            // In a face of the box, and outside the box.
            push(-4.0 * sign * axis + 1.5 * aside, sign * axis);
            push(-4.0 * sign * axis + 1.6 * aside, sign * axis);
            // From inside.
            push(0.7 * aside, sign * axis);
        }
    }
    for _ in 0..60 {
        let direction = random.direction();
        let target = 2.2 * random.direction() * random.between(0.0, 1.0);
        push(target - 4.0 * direction, direction);
        push(random.direction(), random.direction());
        // Nearly parallel to an axis: one tiny component.
        push(DVec3::new(-4.0, random.between(-1.4, 1.4), 0.2), DVec3::new(1.0, 1e-7, -3e-4).normalize());
        // Pointing away from the box.
        push(4.0 * direction, direction);
    }
    rays
}

/// Returns one bit per cell. About half of the blocks of 4³ cells are empty; in the others a cell is set with
/// probability `fraction`.
pub fn bits(resolution: u32, fraction: f64, seed: u64) -> Vec<u8> {
    let mut random = TestRandom::new(seed);
    let cells = resolution.pow(3);
    let blocks: Vec<bool> =
        (0..resolution.div_ceil(4).pow(3)).map(|_| random.between(0.0, 1.0) < 0.5).collect();
    let mut bits = vec![0_u8; cells.div_ceil(8) as usize];
    for cell in 0..cells {
        let [x, y, z] = [cell % resolution, cell / resolution % resolution, cell / resolution / resolution];
        let side = resolution.div_ceil(4);
        let block = blocks[(x / 4 + side * (y / 4 + side * (z / 4))) as usize];
        if block && random.between(0.0, 1.0) < fraction {
            bits[cell as usize / 8] |= 1 << (cell % 8);
        }
    }
    bits
}

/// Returns a configuration with several steps per cell of the occupancy grid, and many per block.
pub fn configuration(resolution: u32) -> Config {
    let mut config = small();
    config.occupancy.resolution = resolution;
    config.renderer.steps_per_diagonal = 700;
    config
}

/// Returns the distances of each ray's samples.
pub fn marched<B: Backend>(bench: &mut Bench<B>, rays: &[Ray], jitter: Option<u64>) -> Vec<Vec<f32>> {
    let Bench { backend, stages, workspace, .. } = bench;
    workspace.rays.place(backend, rays);
    stages.renderer.march(
        &mut workspace.stream,
        &workspace.rays,
        &stages.occupancy,
        jitter,
        &mut workspace.samples,
    );
    let (segments, intervals) =
        (backend.read(&workspace.samples.segments), backend.read(&workspace.samples.intervals));
    let owners = backend.read(&workspace.samples.rays);
    let of = |(i, s): (usize, &trimip_core::engine::batch::Segment)| {
        let range = s.start as usize..(s.start + s.count) as usize;
        assert!(owners[range.clone()].iter().all(|&owner| owner as usize == i), "samples know their ray");
        intervals[range].iter().map(|interval| interval.t).collect()
    };
    segments.iter().enumerate().map(of).collect()
}

/// Samples match those of the reference march, except near borders.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn brute_force<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    // The widest cones have a radius of 0.05 in the middle of the box. A `per_radius` above 0 lengthens their steps,
    // but a cell still has several.
    for (resolution, fraction, per_radius) in
        [(32, 0.02, 0.0), (32, 0.5, 0.0), (20, 0.9, 0.0), (8, 0.1, 0.0), (32, 0.5, 0.2), (20, 0.9, 0.7)]
    {
        let mut config = configuration(resolution);
        config.renderer.step_per_radius = per_radius;
        let parameters = lively(&Layout::new(&config), 1);
        let mut bench = Bench::new(make(), &config, None, &parameters)?;
        let bits = bits(resolution, fraction, 5);
        bench.stages.occupancy.restore(&bits, None);
        assert_eq!(bench.stages.occupancy.bits(), bits, "bits survive");
        let rays = rays(3);
        let found = marched(&mut bench, &rays, None);
        let (mut total, mut borderline) = (0, 0);
        for (ray, found) in rays.iter().zip(&found) {
            let (origin, direction) = (ray.origin.map(f64::from), ray.direction.map(f64::from));
            let leave = reference::tile(&config, origin, direction).map_or(0.0, |tile| tile.1);
            let length = reference::ray_step(&config, ray, 0.0);
            let mut found = found.iter().map(|&t| f64::from(t)).peekable();
            for sample in reference::march(&config, ray, 0.0, |_| true) {
                let scaled = sample.position.map(|p| p * f64::from(resolution));
                let cell = scaled.map(|p| (p as u32).min(resolution - 1));
                let index = cell[0] + resolution * (cell[1] + resolution * cell[2]);
                let expected = bits[index as usize / 8] >> (index % 8) & 1 == 1;
                let there = found.next_if(|t| (t - sample.t).abs() < 0.1 * length).is_some();
                total += usize::from(expected);
                if expected != there {
                    let border =
                        scaled.iter().any(|p| (p - p.round()).abs() < BORDER * f64::from(resolution));
                    let end = leave - sample.t < BORDER * length.max(1.0);
                    assert!(border || end, "{ray:?} at {}: {there}, not {expected}", sample.t);
                    borderline += 1;
                }
            }
            // Any other sample lies after the last reference step, at the very end of the box.
            assert!(found.all(|t| (leave - t).abs() < 1e-5), "{ray:?}: samples that no step has");
        }
        assert!(total > 500, "the rays meet {total} occupied steps");
        assert!(f64::from(borderline) < BORDER_SHARE * total as f64, "{borderline} of {total} at a border");
    }
    Ok(())
}

/// The step length follows the schedule's scale at the given progress.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn scale<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let mut config = configuration(8);
    config.renderer.step_scale = Schedule::new(vec![[0.0, 4.0], [0.5, 2.0]]);
    let mut bench = Bench::new(make(), &config, None, &lively(&Layout::new(&config), 1))?;
    let ray = Ray {
        origin: [-4.0, 0.1, 0.2],
        direction: [1.0, 0.0, 0.0],
        slope: 0.0,
        cosine: 1.0,
        ..Ray::default()
    };
    for (progress, scale) in [(0.0, 4.0), (0.49, 4.0), (0.5, 2.0), (1.0, 2.0)] {
        bench.stages.renderer.set_progress(progress);
        let length = (scale * reference::step_length(&config)) as f32;
        let found = marched(&mut bench, &[ray], None).remove(0);
        assert_eq!(found.len(), (3.0 / length).round() as usize, "a box of 3 at {progress}");
        assert!(found.windows(2).all(|t| ((t[1] - t[0]) / length - 1.0).abs() < 1e-3), "{progress}");
    }
    Ok(())
}

/// Jitter moves the first step of a ray by less than one step, differently for each ray and training step, and changes
/// nothing else.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn jitter<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = configuration(8);
    let mut bench = Bench::new(make(), &config, None, &lively(&Layout::new(&config), 1))?;
    let ray = Ray {
        origin: [-4.0, 0.1, 0.2],
        direction: [1.0, 0.0, 0.0],
        slope: 0.01,
        cosine: 1.0,
        ..Ray::default()
    };
    let length = reference::step_length(&config) as f32;
    let straight = marched(&mut bench, &[ray; 200], None);
    let mut firsts = Vec::new();
    for step in [1, 2] {
        for (moved, straight) in marched(&mut bench, &[ray; 200], Some(step)).iter().zip(&straight) {
            let offset = (moved[0] - straight[0]) / length;
            assert!((-1e-3..1.0).contains(&offset), "offset {offset}");
            assert!(moved.windows(2).all(|t| ((t[1] - t[0]) / length - 1.0).abs() < 1e-3), "uniform steps");
            firsts.push(offset);
        }
    }
    let mean = firsts.iter().sum::<f32>() / 400.0;
    // Offsets are uniform in [0, 1): the standard error of the mean of 400 is 0.0144, and the bound is about four times
    // that.
    assert!((mean - 0.5).abs() < 0.06, "mean offset {mean}");
    assert_ne!(firsts[..200], firsts[200..], "each step draws anew");
    Ok(())
}
