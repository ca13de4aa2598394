//! Marching, pruning and compositing on the CPU, ray by ray.

use crate::buffer::Buffer;
use crate::hybrid::Hybrid;
use crate::occupancy::CpuOccupancy;
use crate::simd::{Kernel, Lanes, Simd};
use crate::visibility::visibility_pass;
use crate::{CpuBackend, WorkerScratch};
use trimip_core::engine::backend::Stages;
use trimip_core::engine::batch::{
    Interval, Radiance, Ray, Rays, Samples, Segment, Sphere, Target, Tile, Workspace,
};
use trimip_core::engine::policy::RendererPolicy;
use trimip_core::engine::proxy::Guide;
use trimip_core::geometry::space::Path;
use trimip_core::math::compositing::{Visibility, composite, composite_gradient};
use trimip_core::math::rng::Sequence;
use trimip_core::{Config, Pixel, Renderer, Result};

/// The progress of marching along a ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cursor {
    /// Parameter of the start of the first step: the distance, in a bounded space.
    first: f32,
    /// Parameter at which the ray leaves the space; −∞ if it misses it.
    leave: f32,
    /// Length of a step of the parameter.
    step: f32,
    /// Number of steps done.
    index: f32,
}

impl Cursor {
    /// The same with other steps.
    pub fn with_step(self, step: f32) -> Self {
        Self { step, ..self }
    }
}

/// The renderer: its policy, and what chooses the samples of pictures.
pub struct CpuRenderer {
    pub(crate) simd: Simd,
    pub(crate) policy: RendererPolicy,
    /// Chooses the samples of pictures; none in training, and for volume rendering.
    pub(crate) hybrid: Option<Hybrid>,
}

impl CpuRenderer {
    /// Creates the renderer of a configuration.
    pub fn new(simd: Simd, config: &Config) -> Self {
        Self { simd, policy: RendererPolicy::new(config), hybrid: None }
    }

    /// The cursor of a ray at its entry into the box, before its first step. `jitter` moves the first step by a
    /// random fraction of a step; `index` is the ray's index within the training step.
    pub(crate) fn start(&self, ray: &Ray, jitter: Option<u64>, index: u32) -> Cursor {
        let policy = &self.policy;
        let (enter, leave) = policy.space.parameterisation(ray.origin, ray.direction).range();
        let offset = jitter.map_or(0.0, |step| policy.random.uniform(Sequence::Jitter, step, index)[0]);
        let radius = ray.radius * policy.step_per_radius;
        let by_radius = radius + policy.step_per_radius * ray.slope * 0.5 * (enter + leave);
        // A comparison with NaN is false and selects the uniform step.
        let step = if by_radius > policy.step_length() { by_radius } else { policy.step_length() };
        let first = enter + offset * step;
        let hits = leave > first && leave.is_finite();
        Cursor { first, leave: if hits { leave } else { f32::NEG_INFINITY }, step, index: 0.0 }
    }

    /// Calls `place` for the midpoint of every step from the cursor on that lies in an occupied cell, until it returns
    /// false. Returns true if the ray has left the box.
    ///
    /// Skips empty cubes by the distance field; the samples are exactly those of testing every step.
    #[inline(always)]
    pub(crate) fn advance(
        &self,
        ray: &Ray,
        occupancy: &CpuOccupancy,
        cursor: &mut Cursor,
        place: impl FnMut(Interval, Sphere) -> bool,
    ) -> bool {
        let space = &self.policy.space;
        match space.ball() {
            None => follow(&space.straight_path(ray, occupancy.resolution()), occupancy, cursor, place),
            Some(ball) => {
                follow(&space.contracted_path(*ball, ray, occupancy.resolution()), occupancy, cursor, place)
            }
        }
    }
}

/// [`CpuRenderer::advance`] along a path.
#[inline(always)]
fn follow(
    path: &impl Path,
    occupancy: &CpuOccupancy,
    cursor: &mut Cursor,
    mut place: impl FnMut(Interval, Sphere) -> bool,
) -> bool {
    let Cursor { first, leave, step, mut index } = *cursor;
    let inverse_step = step.recip();
    loop {
        let s = first + (index + 0.5) * step;
        if !(s < leave) {
            return true;
        }
        let t = path.distance(s);
        let position = path.position(t);
        let cell = path.cell(position);
        let empty = occupancy.empty_around(cell);
        if empty == 0 {
            index += 1.0;
            if place(path.interval(t, step), Sphere { position, radius: path.radius(t) }) {
                continue;
            }
            cursor.index = index;
            return false;
        }
        let exit = path.clear(s, position, cell, empty);
        // The first step whose midpoint is not before the exit. Rounding may move it by a few 1e-7 of the
        // distance; a step that close to the exit is tested rather than skipped.
        let steps = (exit - first) * inverse_step - 0.5;
        let next = (steps * (1.0 - 1e-6) - 0.01).ceil();
        // Without an exit, or with NaN: advance one step.
        index = if next.is_finite() { next.max(index + 1.0) } else { index + 1.0 };
    }
}

impl Renderer<CpuBackend> for CpuRenderer {
    fn policy(&self) -> &RendererPolicy {
        &self.policy
    }

    fn policy_mut(&mut self) -> &mut RendererPolicy {
        &mut self.policy
    }

    fn set_guide(&mut self, guide: Option<Guide>) -> Result<()> {
        self.hybrid = guide.map(Hybrid);
        Ok(())
    }

    fn visibility_pass(
        &self,
        stages: &Stages<CpuBackend>,
        parameters: &Buffer<f32>,
        workspace: &mut Workspace<CpuBackend>,
        jitter: Option<u64>,
    ) {
        visibility_pass(stages, parameters, workspace, jitter);
    }

    fn march(
        &self,
        _: &mut WorkerScratch,
        rays: &Rays<CpuBackend>,
        occupancy: &CpuOccupancy,
        jitter: Option<u64>,
        samples: &mut Samples<CpuBackend>,
    ) {
        self.simd.run(March { renderer: self, rays, occupancy, jitter, samples });
    }

    fn prune(
        &self,
        _: &mut WorkerScratch,
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
                match self.policy.pruning.decide(&mut depth, own) {
                    Visibility::Keep => kept.push(i),
                    Visibility::Skip => {}
                    Visibility::Terminate => break,
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
        tile: &mut Tile<'_, CpuBackend>,
        radiance: &Buffer<Radiance>,
        cones: &mut Buffer<Pixel>,
        pixels: &mut Buffer<Pixel>,
    ) {
        let (rays, samples) = (tile.rays, tile.samples);
        cones.resize(rays.rays.len());
        pixels.resize(rays.groups.len());
        let (segments, rays_of, targets): (&[Segment], &[Ray], &[Target]) =
            (&samples.segments, &rays.rays, &rays.targets);
        let (intervals, radiance): (&[Interval], &[Radiance]) = (&samples.intervals, radiance);
        let cones: &mut [Pixel] = cones;
        for (i, (pixel, group)) in pixels.iter_mut().zip(rays.groups.iter()).enumerate() {
            let background = targets.get(i).map_or(self.policy.background, |target| target.background);
            let group = group.range();
            let parts = segments[group.clone()].iter().zip(&rays_of[group.clone()]);
            for (cone, (segment, ray)) in cones[group.clone()].iter_mut().zip(parts) {
                let own = intervals[segment.range()].iter().zip(&radiance[segment.range()]);
                let result = composite(
                    own.map(|(interval, own)| (own.density * interval.length, own.rgb, interval.t)),
                    background,
                );
                let depth = result.distance * ray.cosine;
                *cone = Pixel { rgb: result.rgb, opacity: result.opacity, depth };
            }
            *pixel = Pixel::mean(&cones[group]);
        }
    }

    fn backward(
        &self,
        tile: &mut Tile<'_, CpuBackend>,
        radiance: &Buffer<Radiance>,
        cones: &Buffer<Pixel>,
        pixel_gradients: &Buffer<[f32; 4]>,
        radiance_gradients: &mut Buffer<Radiance>,
    ) {
        let (rays, samples) = (tile.rays, tile.samples);
        radiance_gradients.resize(radiance.len());
        for (group, &gradient) in rays.groups.iter().zip(pixel_gradients.iter()) {
            let fraction = (group.count as f32).recip();
            let gradient = gradient.map(|g| g * fraction);
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

/// Marches every ray of a tile to its end.
struct March<'a> {
    renderer: &'a CpuRenderer,
    rays: &'a Rays<CpuBackend>,
    occupancy: &'a CpuOccupancy,
    jitter: Option<u64>,
    samples: &'a mut Samples<CpuBackend>,
}

impl Kernel for March<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { renderer, rays, occupancy, jitter, samples } = self;
        samples.segments.resize(rays.rays.len());
        let most_samples = renderer.policy.most_samples();
        let mut count = 0;
        for (i, ray) in rays.rays.iter().enumerate() {
            let start = count;
            // Room for a ray that is occupied along its whole length, so that placing a sample is a plain store.
            let most = start + most_samples;
            samples.rays.resize(most);
            samples.intervals.resize(most);
            samples.spheres.resize(most);
            let owners = &mut samples.rays[start..];
            let (intervals, spheres) = (&mut samples.intervals[start..], &mut samples.spheres[start..]);
            let mut cursor = renderer.start(ray, jitter, rays.first + i as u32);
            renderer.advance(ray, occupancy, &mut cursor, |interval, sphere| {
                let place = count - start;
                (owners[place], intervals[place], spheres[place]) = (i as u32, interval, sphere);
                count += 1;
                true
            });
            samples.segments[i] = Segment { start: start as u32, count: (count - start) as u32 };
        }
        samples.rays.resize(count);
        samples.intervals.resize(count);
        samples.spheres.resize(count);
        samples.counts.resize(1);
        samples.counts[0] = [count as u32; 2];
    }
}
