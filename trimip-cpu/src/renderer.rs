//! Marching, pruning and compositing on the CPU, ray by ray.

use crate::buffer::Buffer;
use crate::occupancy::CpuOccupancy;
use crate::see::see;
use crate::simd::Simd;
use crate::{CpuBackend, Lane};
use trimip_core::backend::Stages;
use trimip_core::batch::{Interval, Radiance, Ray, Rays, Samples, Segment, Sphere, Workspace};
use trimip_core::compositing::{Pruning, Seen, composite, composite_gradient};
use trimip_core::rng::{Random, Stream};
use trimip_core::schedule::Schedule;
use trimip_core::{Config, Pixel, Renderer, Space};

/// How far a ray has been marched.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cursor {
    /// Distance of the first step's beginning.
    first: f32,
    /// Distance at which the ray leaves the box; −∞ when it misses.
    leave: f32,
    /// Length of a step.
    step: f32,
    /// Steps done.
    index: f32,
}

/// Space, step and background.
pub struct CpuRenderer {
    pub(crate) simd: Simd,
    space: Space<f32>,
    /// Length of a step of the schedule's scale 1.
    uniform_step: f32,
    step_scale: Schedule,
    /// Length of a step as the schedule has it.
    step_length: f32,
    /// Least length of a step in radii of the ray's sphere in the middle of the box.
    step_per_radius: f32,
    pub(crate) pruning: Pruning<f32>,
    background: [f32; 3],
    random: Random,
}

impl CpuRenderer {
    /// The renderer of a configuration.
    pub fn new(simd: Simd, config: &Config) -> Self {
        let uniform_step = config.step_length();
        let step_scale = config.renderer.step_scale.clone();
        Self {
            simd,
            space: Space::new(&config.scene),
            uniform_step,
            step_length: uniform_step * step_scale.at(0.0) as f32,
            step_scale,
            step_per_radius: config.renderer.step_per_radius,
            pruning: Pruning::new(config.renderer.min_transmittance, config.renderer.min_weight),
            background: config.data.background,
            random: Random::new(config.seed),
        }
    }

    /// Where a ray begins in the box: before its first step, which `jitter` moves by a random part of a step; `index` is
    /// the ray's number within the training step.
    pub(crate) fn start(&self, ray: &Ray, jitter: Option<u64>, index: u32) -> Cursor {
        let (enter, leave) = self.space.intersect(ray.origin, ray.direction);
        let offset = jitter.map_or(0.0, |step| self.random.uniform(Stream::Jitter, step, index)[0]);
        let by_radius = self.step_per_radius * ray.slope * 0.5 * (enter + leave);
        // A comparison with NaN is false: the uniform step.
        let step = if by_radius > self.step_length { by_radius } else { self.step_length };
        let first = enter + offset * step;
        let hits = leave > first && leave.is_finite();
        Cursor { first, leave: if hits { leave } else { f32::NEG_INFINITY }, step, index: 0.0 }
    }

    /// Calls `place` for the middle of every step from the cursor on that lies in an occupied cell, at most `limit`
    /// times; returns true when the ray has left the box.
    ///
    /// Empty cubes of 16, 4 or 1 cells are skipped whole, so that the samples are exactly those of testing every step.
    #[inline(always)]
    pub(crate) fn advance(
        &self,
        ray: &Ray,
        occupancy: &CpuOccupancy,
        cursor: &mut Cursor,
        limit: usize,
        mut place: impl FnMut(Interval, Sphere),
    ) -> bool {
        let way = self.space.way(ray, occupancy.resolution());
        let Cursor { first, leave, step, mut index } = *cursor;
        let inverse_step = step.recip();
        let mut placed = 0;
        loop {
            let t = first + (index + 0.5) * step;
            if !(t < leave) {
                return true;
            }
            if placed == limit {
                cursor.index = index;
                return false;
            }
            let position = way.position(t);
            let cell = way.cell(position);
            let Some(size) = occupancy.empty_around(cell) else {
                place(Interval { t, length: step }, Sphere { position, radius: way.radius(t) });
                placed += 1;
                index += 1.0;
                continue;
            };
            let exit = way.exit(t, cell, size);
            // The first step whose middle is not before the exit. What rounding may move is a few 1e-7 of the distance;
            // a step that close to the exit is asked rather than skipped.
            let steps = (exit - first) * inverse_step - 0.5;
            let next = (steps * (1.0 - 1e-6) - 0.01).ceil();
            // No exit, or NaN: one step.
            index = if next.is_finite() { next.max(index + 1.0) } else { index + 1.0 };
        }
    }
}

impl Renderer<CpuBackend> for CpuRenderer {
    fn follow(&mut self, progress: f64) {
        self.step_length = self.uniform_step * self.step_scale.at(progress) as f32;
    }

    fn see(
        &self,
        stages: &Stages<CpuBackend>,
        parameters: &Buffer<f32>,
        space: &mut Workspace<CpuBackend>,
        jitter: Option<u64>,
    ) {
        see(stages, parameters, space, jitter);
    }

    fn march(
        &self,
        _: &mut Lane,
        rays: &Rays<CpuBackend>,
        occupancy: &CpuOccupancy,
        jitter: Option<u64>,
        samples: &mut Samples<CpuBackend>,
    ) {
        samples.segments.resize(rays.rays.len());
        let most_samples = self.space.most_steps(self.step_length);
        let mut count = 0;
        for (i, ray) in rays.rays.iter().enumerate() {
            let start = count;
            // Room for a ray that is occupied all along, so that placing a sample is a plain store.
            let most = start + most_samples;
            samples.rays.resize(most);
            samples.intervals.resize(most);
            samples.spheres.resize(most);
            let owners = &mut samples.rays[start..];
            let (intervals, spheres) = (&mut samples.intervals[start..], &mut samples.spheres[start..]);
            let mut cursor = self.start(ray, jitter, rays.first + i as u32);
            self.advance(ray, occupancy, &mut cursor, usize::MAX, |interval, sphere| {
                let place = count - start;
                (owners[place], intervals[place], spheres[place]) = (i as u32, interval, sphere);
                count += 1;
            });
            samples.segments[i] = Segment { start: start as u32, count: (count - start) as u32 };
        }
        samples.rays.resize(count);
        samples.intervals.resize(count);
        samples.spheres.resize(count);
        samples.counts.resize(1);
        samples.counts[0] = [count as u32; 2];
    }

    fn prune(
        &self,
        _: &mut Lane,
        radiance: &Buffer<Radiance>,
        samples: &mut Samples<CpuBackend>,
        kept: &mut Buffer<u32>,
    ) {
        kept.clear();
        for segment in samples.segments.iter_mut() {
            let start = kept.len() as u32;
            let mut depth = 0.0;
            for i in segment.start..segment.start + segment.count {
                let own = radiance[i as usize].density * samples.intervals[i as usize].length;
                match self.pruning.see(&mut depth, own) {
                    Seen::Yes => kept.push(i),
                    Seen::No => {}
                    Seen::Hidden => break,
                }
            }
            *segment = Segment { start, count: kept.len() as u32 - start };
        }
        samples.rays.keep_rows(kept, 1);
        samples.intervals.keep_rows(kept, 1);
        samples.spheres.keep_rows(kept, 1);
        samples.counts[0][1] = kept.len() as u32;
    }

    fn composite(
        &self,
        _: &mut Lane,
        rays: &Rays<CpuBackend>,
        samples: &Samples<CpuBackend>,
        radiance: &Buffer<Radiance>,
        cones: &mut Buffer<Pixel>,
        pixels: &mut Buffer<Pixel>,
    ) {
        cones.resize(rays.rays.len());
        pixels.resize(rays.groups.len());
        for (i, (pixel, group)) in pixels.iter_mut().zip(rays.groups.iter()).enumerate() {
            let background = rays.targets.get(i).map_or(self.background, |target| target.background);
            let group = group.range();
            for index in group.clone() {
                let result = composite(
                    samples.segments[index].range().map(|i| {
                        let Interval { t, length } = samples.intervals[i];
                        (radiance[i].density * length, radiance[i].rgb, t)
                    }),
                    background,
                );
                let depth = result.distance * rays.rays[index].cosine;
                cones[index] = Pixel { rgb: result.rgb, opacity: result.opacity, depth };
            }
            *pixel = Pixel::mean(&cones[group]);
        }
    }

    fn backward(
        &self,
        _: &mut Lane,
        rays: &Rays<CpuBackend>,
        samples: &Samples<CpuBackend>,
        radiance: &Buffer<Radiance>,
        cones: &Buffer<Pixel>,
        pixel_gradients: &Buffer<[f32; 4]>,
        radiance_gradients: &mut Buffer<Radiance>,
    ) {
        radiance_gradients.resize(radiance.len());
        for (group, &gradient) in rays.groups.iter().zip(pixel_gradients.iter()) {
            let share = (group.count as f32).recip();
            let gradient = gradient.map(|g| g * share);
            for (cone, segment) in cones[group.range()].iter().zip(&samples.segments[group.range()]) {
                let first = segment.start as usize;
                composite_gradient(
                    segment.count as usize,
                    |i| {
                        let i = first + i;
                        (radiance[i].density * samples.intervals[i].length, radiance[i].rgb)
                    },
                    cone.channels(),
                    gradient,
                    |i, by_depth, rgb| {
                        let i = first + i;
                        radiance_gradients[i] =
                            Radiance { rgb, density: by_depth * samples.intervals[i].length };
                    },
                );
            }
        }
    }
}
