//! Marching along rays: samples at the midpoints of steps that lie in occupied cells.

use crate::CpuBackend;
use crate::cursor::Cursor;
use crate::occupancy::CpuOccupancy;
use crate::simd::{Kernel, Lanes};
use trimip_core::engine::batch::{Interval, Ray, Rays, Samples, Segment, Sphere};
use trimip_core::engine::policy::RendererPolicy;
use trimip_core::geometry::space::Path;

/// Calls `place` for the midpoint of every step from the cursor on that lies in an occupied cell, until it returns
/// false. Returns true if the ray has left the box.
///
/// Skips empty cubes by the distance field; the samples are exactly those of testing every step.
#[inline(always)]
pub fn advance(
    policy: &RendererPolicy,
    ray: &Ray,
    occupancy: &CpuOccupancy,
    cursor: &mut Cursor,
    place: impl FnMut(Interval, Sphere) -> bool,
) -> bool {
    let space = &policy.space;
    match space.ball() {
        None => follow(&space.straight_path(ray, occupancy.resolution()), occupancy, cursor, place),
        Some(ball) => {
            follow(&space.contracted_path(*ball, ray, occupancy.resolution()), occupancy, cursor, place)
        }
    }
}

/// [`advance`] along a path.
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

/// Marches every ray of a tile to its end.
pub struct March<'a> {
    pub policy: &'a RendererPolicy,
    pub rays: &'a Rays<CpuBackend>,
    pub occupancy: &'a CpuOccupancy,
    pub jitter: Option<u64>,
    pub samples: &'a mut Samples<CpuBackend>,
}

impl Kernel for March<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { policy, rays, occupancy, jitter, samples } = self;
        samples.segments.resize(rays.rays.len());
        let most_samples = policy.most_samples();
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
            let mut cursor = Cursor::new(policy, ray, jitter, rays.first + i as u32);
            advance(policy, ray, occupancy, &mut cursor, |interval, sphere| {
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
