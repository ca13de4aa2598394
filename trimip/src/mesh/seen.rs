//! Counts the cameras that see each part of a solid: follows lines of sight of every camera through the grid to the
//! first solid point.

use super::{Grid, hidden::Bits, threads};
use glam::DVec3;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use trimip_core::{Aabb, Camera, Cone};

/// Number of blocks along the longest side of the grid; cameras are counted for each block.
const BLOCKS: usize = 64;

/// Number of lines of sight (rays) along the longer side of a picture: enough for several per visible block.
const LINES: u32 = 192;

/// Maximum number of cameras that are used, evenly spread over all cameras.
const MOST_CAMERAS: usize = 128;

/// The number of cameras that see each block of a grid.
pub struct Sightings {
    grid: Grid,
    /// Number of points along each side of a block.
    side: usize,
    blocks: [usize; 3],
    counts: Vec<u16>,
}

impl Sightings {
    /// Counts the cameras whose lines of sight end in each block of `solid`, which has the points of `grid`. Nothing outside the
    /// grid occludes. `threads` = 0: one per core.
    pub fn of(solid: &Bits, grid: &Grid, cameras: &[Camera], threads: usize) -> Self {
        let side = grid.points.into_iter().max().unwrap_or(1).div_ceil(BLOCKS);
        let blocks = grid.points.map(|points| points.div_ceil(side));
        let mut own = Self { grid: *grid, side, blocks, counts: vec![0; blocks.iter().product()] };
        let cameras: Vec<&Camera> =
            cameras.iter().step_by(cameras.len().div_ceil(MOST_CAMERAS).max(1)).collect();
        let (next, counts) = (AtomicUsize::new(0), Mutex::new(std::mem::take(&mut own.counts)));
        let threads = threads::count(threads);
        std::thread::scope(|scope| {
            for _ in 0..threads.min(cameras.len()) {
                scope.spawn(|| {
                    while let Some(camera) = cameras.get(next.fetch_add(1, Ordering::Relaxed)) {
                        let seen = own.seen_by(solid, camera);
                        let mut counts = counts.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
                        counts.iter_mut().zip(seen).for_each(|(count, seen)| *count += u16::from(seen));
                    }
                });
            }
        });
        own.counts = counts.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
        own
    }

    /// Returns the number of cameras that see a point of the world: the greatest count of the eight nearest blocks.
    pub fn at(&self, point: [f64; 3]) -> u16 {
        let corner: [f64; 3] = std::array::from_fn(|axis| {
            (point[axis] - self.grid.origin[axis]) / (self.grid.spacing * self.side as f64) - 0.5
        });
        let near = |corner_bits: usize| {
            let block = std::array::from_fn(|axis| {
                let index = corner[axis].floor() + (corner_bits >> axis & 1) as f64;
                index.clamp(0.0, self.blocks[axis] as f64 - 1.0) as usize
            });
            self.counts[self.index(block)]
        };
        (0..8).map(near).max().unwrap_or(0)
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        x + self.blocks[0] * (y + self.blocks[1] * z)
    }

    /// Returns true for each block in which a line of sight of the camera ends.
    fn seen_by(&self, solid: &Bits, camera: &Camera) -> Vec<bool> {
        let k = &camera.intrinsics;
        let mut seen = vec![false; self.blocks.iter().product()];
        let step = (f64::from(k.width.max(k.height)) / f64::from(LINES)).max(1.0);
        let places = |side: u32| {
            let count = (f64::from(side) / step).ceil() as u32;
            (0..count).map(move |i| (((f64::from(i) + 0.5) * step) as u32).min(side - 1))
        };
        for (y, x) in places(k.height).flat_map(|y| places(k.width).map(move |x| (y, x))) {
            let cone = camera.cone::<f64>(x, y);
            if !cone.is_none()
                && let Some(point) = self.first(solid, &cone)
            {
                seen[self.index(point.map(|index| index / self.side))] = true;
            }
        }
        seen
    }

    /// Returns the first solid point of the grid along a line of sight. Steps from face to face of the cells around the points (Amanatides
    /// and Woo 1987).
    fn first(&self, solid: &Bits, cone: &Cone<f64>) -> Option<[usize; 3]> {
        let Grid { origin, spacing, points } = self.grid;
        // In these units of the spacing, the cell around a grid point spans from its index to the next index.
        let start: [f64; 3] = std::array::from_fn(|axis| (cone.origin[axis] - origin[axis]) / spacing + 0.5);
        let whole = Aabb { min: [0.0; 3], max: points.map(|count| count as f64) };
        let (enter, leave) = whole.intersect(start, cone.direction);
        if enter >= leave {
            return None;
        }
        let at = DVec3::from(start) + enter * DVec3::from(cone.direction);
        let mut cell: [usize; 3] =
            std::array::from_fn(|axis| at[axis].floor().clamp(0.0, points[axis] as f64 - 1.0) as usize);
        // Distance along the line to the next face across each axis.
        let mut next: [f64; 3] = std::array::from_fn(|axis| {
            let face = cell[axis] as f64 + f64::from(cone.direction[axis] > 0.0);
            match cone.direction[axis] {
                0.0 => f64::INFINITY,
                direction => (face - start[axis]) / direction,
            }
        });
        loop {
            if solid.get(cell[0] + points[0] * (cell[1] + points[1] * cell[2])) {
                return Some(cell);
            }
            let axis = (0..3).min_by(|&a, &b| next[a].total_cmp(&next[b]))?;
            cell[axis] = match cone.direction[axis] > 0.0 {
                true => cell[axis] + 1,
                false => cell[axis].checked_sub(1)?,
            };
            if cell[axis] >= points[axis] {
                return None;
            }
            next[axis] += cone.direction[axis].abs().recip();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip_core::Intrinsics;

    /// A grid of 33 points over the cube from −1 to 1.
    const GRID: Grid = Grid { origin: [-1.0; 3], spacing: 1.0 / 16.0, points: [33; 3] };

    fn solid(inside: impl Fn(DVec3) -> bool) -> Bits {
        let mut bits = Bits::new(GRID.points);
        for i in 0..33 * 33 * 33 {
            if inside(DVec3::from(GRID.point([i % 33, i / 33 % 33, i / 33 / 33]))) {
                bits.set(i);
            }
        }
        bits
    }

    fn looking(from: DVec3, at: DVec3) -> Camera {
        Camera::look_at(Intrinsics::from_angle(64, 64, 0.9), from, at, DVec3::Z)
    }

    #[test]
    fn cameras_see_the_side_that_faces_them_and_nothing_behind_it() {
        // Two walls across the x axis. Seen from the left, the left wall hides the right one.
        let walls = solid(|p| (p.x + 0.5).abs() < 0.05 || (p.x - 0.5).abs() < 0.05);
        let left = looking(DVec3::new(-3.0, 0.05, 0.1), DVec3::ZERO);
        let right = looking(DVec3::new(3.0, 0.05, 0.1), DVec3::ZERO);
        let sightings = Sightings::of(&walls, &GRID, &[left, left, right], 2);
        let at = |x: f64| sightings.at([x, 0.0, 0.0]);
        assert_eq!([at(-0.5), at(0.5), at(0.0)], [2, 1, 0]);
        // Cameras between the walls see the wall that they face; a camera outside the grid that looks away sees none.
        let within = |to: f64| looking(DVec3::new(0.0, 0.05, 0.1), DVec3::new(to, 0.05, 0.1));
        let away = looking(DVec3::new(-3.0, 0.0, 0.1), DVec3::new(-9.0, 0.0, 0.1));
        let sightings = Sightings::of(&walls, &GRID, &[within(1.0), within(-1.0), away], 1);
        assert_eq!([-0.5, 0.5].map(|x| sightings.at([x, 0.0, 0.0])), [1, 1]);
    }

    #[test]
    fn what_lies_beside_the_pictures_is_not_seen() {
        let wall = solid(|p| p.x.abs() < 0.05);
        // The picture is 2·3·tan(0.1) = 0.6 units wide at the wall.
        let narrow = Camera {
            intrinsics: Intrinsics::from_angle(300, 300, 0.2),
            ..looking(DVec3::new(-3.0, 0.0, 0.1), DVec3::new(0.0, 0.0, 0.1))
        };
        let sightings = Sightings::of(&wall, &GRID, &[narrow; 3], 0);
        for (y, expected) in [(0.0, 3), (0.25, 3), (0.5, 0), (-0.5, 0)] {
            assert_eq!(sightings.at([0.0, y, 0.1]), expected, "{y}");
        }
    }
}
