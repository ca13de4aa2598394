//! Ray marching: places samples at the midpoints of steps that lie in occupied cells.

use crate::CpuBackend;
use crate::cursor::Cursor;
use crate::occupancy::CpuOccupancy;
use crate::simd::{Kernel, Lanes};
use trimip_core::engine::batch::{Interval, Ray, Rays, Samples, Segment, Sphere};
use trimip_core::engine::policy::RendererPolicy;
use trimip_core::geometry::space::Path;

/// Marches a ray from the cursor on. Calls `place` for the midpoint of every step that lies in an occupied cell, and
/// passes that cell, until `place` returns false. Returns true if the ray has left the box.
///
/// The distance field serves to skip empty cubes; the samples are exactly those that a test of every step would find.
#[inline(always)]
pub fn advance(
    policy: &RendererPolicy,
    ray: &Ray,
    occupancy: &CpuOccupancy,
    cursor: &mut Cursor,
    place: impl FnMut(Interval, Sphere, [u32; 3]) -> bool,
) -> bool {
    let space = &policy.space;
    match space.ball() {
        None => follow(&space.straight_path(ray, occupancy.resolution()), occupancy, cursor, place),
        Some(ball) => {
            follow(&space.contracted_path(*ball, ray, occupancy.resolution()), occupancy, cursor, place)
        }
    }
}

/// Number of steps that are tested at once: one vector register holds a value of each.
const BLOCK: usize = 16;

/// The next steps of a cursor.
struct Steps {
    /// Ray parameter, distance, position and cell of each step's midpoint.
    s: [f32; BLOCK],
    t: [f32; BLOCK],
    positions: [[f32; 3]; BLOCK],
    cells: [[u32; 3]; BLOCK],
    /// Chebyshev distance from each cell within which all cells are empty; 0 for an occupied cell.
    empty: [u32; BLOCK],
}

impl Steps {
    /// Computes the steps that begin with number `index`, and their cells. Steps beyond the end of the ray have
    /// arbitrary values.
    #[inline(always)]
    fn of(path: &impl Path, occupancy: &CpuOccupancy, first: f32, step: f32, index: f32) -> Self {
        let mut steps = Self {
            s: [0.0; BLOCK],
            t: [0.0; BLOCK],
            positions: [[0.0; 3]; BLOCK],
            cells: [[0; 3]; BLOCK],
            empty: [0; BLOCK],
        };
        // One loop per quantity, because the compiler vectorises such loops.
        for i in 0..BLOCK {
            steps.s[i] = first + (index + i as f32 + 0.5) * step;
        }
        for i in 0..BLOCK {
            steps.t[i] = path.distance(steps.s[i]);
        }
        for i in 0..BLOCK {
            steps.positions[i] = path.position(steps.t[i]);
        }
        for i in 0..BLOCK {
            steps.cells[i] = path.cell(steps.positions[i]);
        }
        for i in 0..BLOCK {
            steps.empty[i] = occupancy.empty_around(steps.cells[i]);
        }
        steps
    }

    /// Returns the ray parameter up to which the ray stays within the empty cells around the last step.
    #[inline(always)]
    fn clear(&self, path: &impl Path) -> f32 {
        let last = BLOCK - 1;
        path.clear(self.s[last], self.positions[last], self.cells[last], self.empty[last])
    }
}

/// Implements [`advance`] along a path.
#[inline(always)]
fn follow(
    path: &impl Path,
    occupancy: &CpuOccupancy,
    cursor: &mut Cursor,
    mut place: impl FnMut(Interval, Sphere, [u32; 3]) -> bool,
) -> bool {
    let Cursor { first, leave, step, mut index } = *cursor;
    let inverse_step = step.recip();
    loop {
        if !(first + (index + 0.5) * step < leave) {
            return true;
        }
        let steps = Steps::of(path, occupancy, first, step, index);
        for i in 0..BLOCK {
            if !(steps.s[i] < leave) {
                return true;
            }
            if steps.empty[i] == 0 {
                let (position, t) = (steps.positions[i], steps.t[i]);
                let sphere = Sphere { position, radius: path.radius(t) };
                if !place(path.interval(t, step), sphere, steps.cells[i]) {
                    cursor.index = index + (i + 1) as f32;
                    return false;
                }
            }
        }
        index += BLOCK as f32;
        if steps.empty[BLOCK - 1] > 0 {
            // Continues with the first step whose midpoint does not lie before the end of the empty cells. Rounding may
            // move this end by a few 1e-7 of the distance, so a step that close to it is tested rather than skipped.
            let next = (steps.clear(path) - first) * inverse_step - 0.5;
            let next = (next * (1.0 - 1e-6) - 0.01).ceil();
            // If `next` is NaN or infinite, no further step is skipped.
            if next.is_finite() {
                index = index.max(next);
            }
        }
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
            // Makes room for a ray whose cells are all occupied, so that placing a sample is a plain store.
            let most = start + most_samples;
            samples.rays.resize(most);
            samples.intervals.resize(most);
            samples.spheres.resize(most);
            let owners = &mut samples.rays[start..];
            let (intervals, spheres) = (&mut samples.intervals[start..], &mut samples.spheres[start..]);
            let mut cursor = Cursor::new(policy, ray, jitter, rays.first + i as u32);
            advance(policy, ray, occupancy, &mut cursor, |interval, sphere, _| {
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
