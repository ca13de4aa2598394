//! Hidden voids of a solid: points that no line of sight from outside reaches. A field has noise there, because no
//! photograph shows these points, and a mesh would spend most of its triangles on the noise.

use super::threads;
use glam::DVec3;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use trimip_core::Camera;

/// Number of candidate directions of parallel lines of sight, evenly spread over the sphere.
const DIRECTIONS: usize = 96;

/// One bit per point of a grid, x fastest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bits {
    size: [usize; 3],
    words: Vec<u64>,
}

impl Bits {
    /// Creates a set with all bits clear.
    pub fn new(size: [usize; 3]) -> Self {
        Self { size, words: vec![0; size.iter().product::<usize>().div_ceil(64)] }
    }

    /// Returns the index of a point.
    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        x + self.size[0] * (y + self.size[1] * z)
    }

    /// Returns the bit at an index, x fastest.
    pub fn get(&self, index: usize) -> bool {
        self.words[index / 64] >> (index % 64) & 1 == 1
    }

    /// Sets the bit at an index, x fastest.
    pub fn set(&mut self, index: usize) {
        self.words[index / 64] |= 1 << (index % 64);
    }
}

/// Returns the directions of the lines of sight, as unit vectors: the candidates within the field of view of a camera, or all
/// candidates if no camera has one in its field of view.
pub fn directions(cameras: &[Camera]) -> Vec<[f64; 3]> {
    let all = (0..DIRECTIONS).map(towards);
    let sees = |camera: &Camera, direction: &[f64; 3]| {
        let half_angle = camera.intrinsics.half_angle();
        // A camera looks along its negative z axis.
        (-camera.rotation.z_axis).dot(DVec3::from_array(*direction)) >= half_angle.cos()
    };
    let seen: Vec<_> =
        all.clone().filter(|direction| cameras.iter().any(|camera| sees(camera, direction))).collect();
    if seen.is_empty() { all.collect() } else { seen }
}

/// Returns the visible points. A line of sight in one of the directions reaches such a point from outside the grid without
/// meeting a point of `solid`. The neighbours of these points that are not solid are visible too. `threads` = 0: one per
/// core.
pub fn visible(solid: &Bits, directions: &[[f64; 3]], threads: usize) -> Bits {
    let seen: Vec<AtomicU64> = solid.words.iter().map(|_| AtomicU64::new(0)).collect();
    let next = AtomicUsize::new(0);
    let threads = threads::count(threads).min(DIRECTIONS);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some(&direction) = directions.get(next.fetch_add(1, Ordering::Relaxed)) {
                    look(solid, direction, &seen);
                }
            });
        }
    });
    let seen = Bits { size: solid.size, words: seen.into_iter().map(AtomicU64::into_inner).collect() };
    beside(&seen, solid)
}

/// Returns a direction of an equal-area spiral over the sphere. No direction is parallel to a plane of the grid.
fn towards(index: usize) -> [f64; 3] {
    let z = 1.0 - (2 * index + 1) as f64 / DIRECTIONS as f64;
    let angle = (index as f64 + 0.77) * std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    let across = (1.0 - z * z).sqrt();
    [across * angle.cos(), across * angle.sin(), z]
}

/// Follows lines in one direction from every point at which such a line enters the grid, until each meets the solid.
fn look(solid: &Bits, direction: [f64; 3], seen: &[AtomicU64]) {
    let size = solid.size;
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for i in 0..size[u] {
            for j in 0..size[v] {
                let mut start = [0; 3];
                (start[u], start[v]) = (i, j);
                start[axis] = if direction[axis] > 0.0 { 0 } else { size[axis] - 1 };
                follow(solid, start, direction, seen);
            }
        }
    }
}

/// Follows one line from face to face of the cells around the points (Amanatides and Woo 1987).
fn follow(solid: &Bits, start: [usize; 3], direction: [f64; 3], seen: &[AtomicU64]) {
    let strides = [1, solid.size[0], solid.size[0] * solid.size[1]];
    let mut index = solid.index(start);
    let step = direction.map(|d| d.abs().recip());
    let mut next = step.map(|step| 0.5 * step);
    // Number of points left along each axis.
    let mut left: [usize; 3] = std::array::from_fn(|axis| {
        if direction[axis] > 0.0 { solid.size[axis] - 1 - start[axis] } else { start[axis] }
    });
    while !solid.get(index) {
        let (word, bit) = (&seen[index / 64], 1 << (index % 64));
        // Most bits are set already, and reading is cheaper than writing.
        if word.load(Ordering::Relaxed) & bit == 0 {
            word.fetch_or(bit, Ordering::Relaxed);
        }
        let axis = match next {
            [x, y, z] if x <= y && x <= z => 0,
            [_, y, z] if y <= z => 1,
            _ => 2,
        };
        if left[axis] == 0 {
            return;
        }
        left[axis] -= 1;
        next[axis] += step[axis];
        index = if direction[axis] > 0.0 { index + strides[axis] } else { index - strides[axis] };
    }
}

/// Returns the points of `seen` and their neighbours along the axes that are not solid; the lines of sight miss some points.
fn beside(seen: &Bits, solid: &Bits) -> Bits {
    let mut all = seen.clone();
    let [nx, ny, nz] = seen.size;
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                let index = seen.index([x, y, z]);
                if seen.get(index) || solid.get(index) {
                    continue;
                }
                let near =
                    [(x, nx, 1), (y, ny, nx), (z, nz, nx * ny)].into_iter().any(|(at, size, stride)| {
                        (at > 0 && seen.get(index - stride)) || (at + 1 < size && seen.get(index + stride))
                    });
                if near {
                    all.set(index);
                }
            }
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip_core::Intrinsics;

    /// Returns a box of `n` points per side: walls one point thick around a void, and a square hole in one wall, `hole` points wide.
    fn hollow(n: usize, hole: usize) -> Bits {
        let mut bits = Bits::new([n; 3]);
        let wall = |c: usize| c == 2 || c == n - 3;
        let within = |c: usize| (2..n - 2).contains(&c);
        for index in 0..n * n * n {
            let [x, y, z] = [index % n, index / n % n, index / (n * n)];
            let open = x == 2 && [y, z].iter().all(|c| c.abs_diff(n / 2) * 2 < hole);
            if [x, y, z].into_iter().all(within) && [x, y, z].into_iter().any(wall) && !open {
                bits.set(index);
            }
        }
        bits
    }

    #[test]
    fn a_void_is_hidden_and_all_around_the_solid_is_visible() {
        let solid = hollow(21, 0);
        let seen = visible(&solid, &directions(&[]), 0);
        for index in 0..21 * 21 * 21 {
            let inside = [index % 21, index / 21 % 21, index / 441].iter().all(|c| (2..19).contains(c));
            assert_eq!(seen.get(index), !inside, "{index}");
        }
    }

    #[test]
    fn a_wide_opening_shows_the_opposite_wall() {
        let solid = hollow(21, 9);
        let seen = visible(&solid, &directions(&[]), 0);
        assert!(seen.get(seen.index([17, 10, 10])), "straight behind the opening");
        let narrow = visible(&hollow(21, 1), &directions(&[]), 1);
        assert!(!narrow.get(seen.index([3, 3, 3])), "the corner beside a narrow opening is behind its wall");
        for index in 0..21 * 21 * 21 {
            assert!(!(seen.get(index) && solid.get(index)), "a solid point is never seen through");
        }
    }

    #[test]
    fn what_cameras_above_do_not_see_is_hidden() {
        // A plate seen only from above.
        let mut solid = Bits::new([15; 3]);
        (0..225).for_each(|i| solid.set(i + 225 * 7));
        let k = Intrinsics {
            width: 100,
            height: 100,
            fx: 150.0,
            fy: 150.0,
            cx: 50.0,
            cy: 50.0,
            ..Intrinsics::default()
        };
        let camera = Camera::look_at(k, DVec3::new(0.0, 0.0, 4.0), DVec3::ZERO, DVec3::Y);
        let found = directions(&[camera]);
        assert!((2..DIRECTIONS / 4).contains(&found.len()) && found.iter().all(|d| d[2] < -0.8), "{found:?}");
        let seen = visible(&solid, &found, 3);
        // Lines at up to 25° from the vertical that pass the plate's edge reach points up to 3.3 spacings under it. The
        // neighbours of these points count as visible too.
        for index in 0..15_usize.pow(3) {
            let [x, y, z] = [index % 15, index / 15 % 15, index / 225];
            let under = z <= 7 && (5..10).contains(&x) && (5..10).contains(&y);
            assert!(!(under && seen.get(index)) && (z <= 7 || seen.get(index)), "{index}");
        }
    }

    #[test]
    fn directions_cover_the_sphere() {
        let all: Vec<_> = (0..DIRECTIONS).map(towards).collect();
        for probe in [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, -0.8]] {
            let dot = |d: &[f64; 3]| d.iter().zip(probe).map(|(a, b)| a * b).sum::<f64>();
            assert!(all.iter().map(dot).fold(-1.0, f64::max) > 0.97, "{probe:?}");
        }
        assert!(all.iter().flatten().all(|x| x.abs() > 1e-3));
    }
}
