//! Paths of rays through the cells of a grid over the cube: straight in a bounded space, curved in an unbounded one. Distances
//! t are in world units and positions in coordinates of the cube; s is the parameter in which steps are uniform.

use super::contraction::{Ball, Curve, STRETCH};
use crate::{
    Space,
    geometry::elements::{Interval, Ray},
    math::rounding::floor,
};

/// Bound of the f32 rounding error of a place along a ray, relative to the coordinates from which the place is computed: four units in
/// the last place.
pub const ROUNDING: f32 = 4.8e-7;

/// Positions of steps along a ray, and the distance that can be skipped in empty cells.
pub trait Path {
    /// Returns the distance at the parameter `s`.
    fn distance(&self, s: f32) -> f32;
    /// Returns the interval of a step of the parameter at distance `t`; its length is in the units of the field's density.
    fn interval(&self, t: f32, step: f32) -> Interval;
    /// Returns the position in the cube at distance `t`.
    fn position(&self, t: f32) -> [f32; 3];
    /// Returns the radius of the cone's sphere at distance `t`, in the units of [`Space::aabb`].
    fn radius(&self, t: f32) -> f32;
    /// Returns the cell of a position.
    fn cell(&self, position: [f32; 3]) -> [u32; 3];
    /// Returns a parameter up to which the ray, from `s` on, surely stays within the cube of all cells less than `distance` cells
    /// from `cell`. At `s`, the ray is at `position`, which lies in `cell`. The result lies before `s` if the ray may leave at
    /// once, and is not finite if it cannot be computed.
    fn clear(&self, s: f32, position: [f32; 3], cell: [u32; 3], distance: u32) -> f32;
}

/// A ray's path through the cells of a grid over the cube of a bounded space.
pub struct StraightPath {
    space: Space<f32>,
    ray: Ray,
    cells: f32,
    last: u32,
    cell_extent: [f32; 3],
    inverse_direction: [f32; 3],
}

impl StraightPath {
    #[inline(always)]
    pub(super) fn new(space: &Space<f32>, ray: &Ray, resolution: u32) -> Self {
        let cells = resolution as f32;
        Self {
            space: *space,
            ray: *ray,
            cells,
            last: resolution - 1,
            cell_extent: space.aabb().extent().map(|side| side / cells),
            inverse_direction: ray.direction.map(f32::recip),
        }
    }
}

impl Path for StraightPath {
    #[inline(always)]
    fn distance(&self, s: f32) -> f32 {
        s
    }

    #[inline(always)]
    fn interval(&self, t: f32, step: f32) -> Interval {
        Interval { t, length: step }
    }

    #[inline(always)]
    fn position(&self, t: f32) -> [f32; 3] {
        self.space.place(self.point(t))
    }

    #[inline(always)]
    fn radius(&self, t: f32) -> f32 {
        self.ray.radius_at(t)
    }

    #[inline(always)]
    fn cell(&self, position: [f32; 3]) -> [u32; 3] {
        position.map(|p| floor((p * self.cells).max(0.0).min(self.last as f32)).1)
    }

    #[inline(always)]
    fn clear(&self, _: f32, _: [f32; 3], cell: [u32; 3], distance: u32) -> f32 {
        self.exit_around(cell, distance)
    }
}

/// A ray's path through the cells of a grid over the cube of an unbounded space.
pub struct ContractedPath {
    straight: StraightPath,
    ball: Ball<f32>,
    curve: Curve<f32>,
    /// Shortest side of a cell, world units.
    cell: f32,
}

impl ContractedPath {
    #[inline(always)]
    pub(super) fn new(ball: Ball<f32>, straight: StraightPath) -> Self {
        let [x, y, z] = straight.cell_extent;
        Self {
            ball,
            curve: ball.parameterisation(straight.ray.origin, straight.ray.direction),
            cell: x.min(y).min(z),
            straight,
        }
    }
}

impl Path for ContractedPath {
    #[inline(always)]
    fn distance(&self, s: f32) -> f32 {
        self.curve.distance(s)
    }

    #[inline(always)]
    fn interval(&self, t: f32, step: f32) -> Interval {
        Interval { t, length: step * self.curve.slowness(t) * self.ball.radial(self.straight.point(t)) }
    }

    #[inline(always)]
    fn position(&self, t: f32) -> [f32; 3] {
        self.straight.space.place(self.ball.contract(self.straight.point(t)))
    }

    #[inline(always)]
    fn radius(&self, t: f32) -> f32 {
        self.straight.ray.radius_at(t) * self.ball.lateral(self.straight.point(t))
    }

    #[inline(always)]
    fn cell(&self, position: [f32; 3]) -> [u32; 3] {
        self.straight.cell(position)
    }

    /// Follows from a bound on the curved path: in contracted space the ray moves at most [`STRETCH`] times as far as its
    /// parameter grows.
    #[inline(always)]
    fn clear(&self, s: f32, position: [f32; 3], cell: [u32; 3], distance: u32) -> f32 {
        let reach = distance as f32;
        let mut margin = f32::INFINITY;
        for axis in 0..3 {
            let within = position[axis] * self.straight.cells - cell[axis] as f32;
            margin = margin.min((within + reach - 1.0).min(reach - within));
        }
        s + margin.max(0.0) * self.cell * (1.0 / STRETCH as f32)
    }
}

impl StraightPath {
    /// Returns the distance up to which the ray stays within the aligned cube of `size` cells along each side that contains
    /// `cell`, in which the ray is at some earlier distance; infinite if it cannot be computed.
    #[inline(always)]
    pub fn exit(&self, cell: [u32; 3], size: u32) -> f32 {
        self.first_edge(|axis, forward| {
            let lower = cell[axis] & !(size - 1);
            (if forward { lower + size } else { lower }) as f32
        })
    }

    /// Returns the distance up to which the ray stays within the cube of all cells less than `distance` cells from `cell`
    /// along each axis; infinite if it cannot be computed.
    #[inline(always)]
    pub fn exit_around(&self, cell: [u32; 3], distance: u32) -> f32 {
        let reach = distance as f32;
        self.first_edge(|axis, forward| {
            let cell = cell[axis] as f32;
            if forward { cell + reach } else { cell - reach + 1.0 }
        })
    }

    /// Returns the distance at which the ray reaches the first of three edges, one across each axis. `edge` gives their positions in
    /// cells from the corner of the box. The distance is reduced by the rounding error of places on the ray: otherwise a ray about to
    /// cross an edge could count as already beyond that edge, and miss it.
    #[inline(always)]
    fn first_edge(&self, edge: impl Fn(usize, bool) -> f32) -> f32 {
        let mut exit = f32::INFINITY;
        for axis in 0..3 {
            let (origin, inverse) = (self.ray.origin[axis], self.inverse_direction[axis]);
            let edge = edge(axis, self.ray.direction[axis] > 0.0) * self.cell_extent[axis]
                + self.space.aabb().min[axis];
            let distance = (edge - origin) * inverse - ROUNDING * (edge.abs() + origin.abs()) * inverse.abs();
            // An axis along which the ray does not move gives ±∞ or NaN, and no edge.
            if distance.is_finite() && distance < exit {
                exit = distance;
            }
        }
        exit
    }

    #[inline(always)]
    fn point(&self, t: f32) -> [f32; 3] {
        std::array::from_fn(|i| self.ray.origin[i] + t * self.ray.direction[i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Aabb;

    #[test]
    fn a_ray_leaves_a_block_of_cells_where_the_block_ends() {
        let space = Space::of(Aabb { min: [-1.0, 0.0, 0.0], max: [3.0, 2.0, 1.0] });
        let ray = Ray {
            origin: [-2.0, 0.26, 0.3],
            direction: [0.8, 0.6, 0.0],
            slope: 0.01,
            cosine: 1.0,
            ..Ray::default()
        };
        let straight = space.straight_path(&ray, 16);
        let t = 1.5;
        let position = straight.position(t);
        let cell = straight.cell(position);
        assert_eq!(cell, [0, 9, 4]);
        // The block of four cells along each side reaches from x = -1 to 0 and from y = 1 to 1.5. The ray has y = 1.16 at
        // t, and y = 1.5 at (1.5 - 0.26) / 0.6.
        let exit = straight.exit(cell, 4);
        assert!((exit - 2.066_666_7).abs() < 1e-5, "{exit}");
        assert!((straight.radius(t) - 0.015).abs() < 1e-9);
    }

    /// Checks that a straight ray that starts exactly where it crosses the edge of a cell stays in its cell up to the distance
    /// of `clear`.
    #[test]
    fn a_ray_at_an_edge_is_never_said_to_stay_beyond_it() {
        let space = Space::of(Aabb { min: [-1.5; 3], max: [1.5; 3] });
        let (mut skipped, mut at_edges) = (0, 0);
        for i in 0..6000_u32 {
            let turn = 2.4 * i as f32;
            let height = ((i % 97) as f32 / 48.0 - 1.0) * if i % 3 == 0 { 1e-3 } else { 0.9 };
            let d = [turn.cos(), turn.sin(), height];
            let norm = d.iter().map(|d| d * d).sum::<f32>().sqrt();
            let direction = d.map(|d| d / norm);
            let target = [(1.7 * turn).sin(), (0.3 * turn).cos(), (2.3 * turn).cos()];
            let origin = std::array::from_fn(|axis| target[axis] - 4.0 * direction[axis]);
            let ray = Ray { origin, slope: 0.01, direction, cosine: 1.0, ..Ray::default() };
            let path = space.straight_path(&ray, 128);
            let axis = i as usize % 3;
            let edge = (20 + i % 90) as f32 * path.cell_extent[axis] - 1.5;
            let crossing = (edge - origin[axis]) * path.inverse_direction[axis];
            for t in [crossing.next_down(), crossing, crossing.next_up()] {
                let position = path.position(t);
                if !(t > 0.0 && position.iter().all(|x| (0.0..1.0).contains(x))) {
                    continue;
                }
                at_edges += 1;
                let cell = path.cell(position);
                let clear = path.clear(t, position, cell, 1);
                for part in 1..20 {
                    let at = t + (clear - t) * part as f32 / 20.0;
                    if at > t {
                        assert_eq!(path.cell(path.position(at)), cell, "{ray:?} from {t} at {at}");
                        skipped += 1;
                    }
                }
            }
        }
        assert!(at_edges > 5000 && skipped > at_edges, "{skipped} of {at_edges}");
    }

    /// Checks that a curved ray stays within the surrounding cells up to the parameter of `clear` (50 places in each stretch
    /// of 200 rays).
    #[test]
    fn a_curved_ray_stays_within_the_cells_that_are_said_to_be_clear() {
        let space = Space::contracted(Aabb { min: [-2.0, -1.0, 0.0], max: [2.0, 3.0, 4.0] });
        let ball = *space.ball().unwrap();
        let (mut skipped, mut steps) = (0.0, 0);
        for i in 0..200 {
            let turn = 2.4 * i as f32;
            let origin = [3.0 * turn.cos(), 1.0 + 2.0 * turn.sin(), 2.0 + (0.1 * turn).sin()];
            let aim = [(1.7 * turn).sin(), 1.0 + (0.3 * turn).cos(), 2.0 + (2.3 * turn).cos()];
            let d: [f32; 3] = std::array::from_fn(|axis| aim[axis] - origin[axis]);
            let norm = d.iter().map(|d| d * d).sum::<f32>().sqrt();
            let ray =
                Ray { origin, slope: 0.01, direction: d.map(|d| d / norm), cosine: 1.0, ..Ray::default() };
            let path = space.contracted_path(ball, &ray, 32);
            let (enter, leave) = space.parameterisation(ray.origin, ray.direction).range();
            let (mut s, distance) = (enter, 1 + i % 5);
            while s < leave {
                let position = path.position(path.distance(s));
                let cell = path.cell(position);
                let clear = path.clear(s, position, cell, distance);
                assert!(clear >= s);
                for part in 0..50 {
                    let at = s + (clear - s) * (part as f32 + 0.5) / 50.0;
                    if at < leave {
                        let inside = path.cell(path.position(path.distance(at)));
                        let away = (0..3).map(|axis| inside[axis].abs_diff(cell[axis])).max().unwrap();
                        assert!(away < distance, "{cell:?} {inside:?} {distance}");
                    }
                }
                skipped += clear - s;
                steps += 1;
                s = clear.max(s + 0.02);
            }
        }
        assert!(skipped / steps as f32 > 0.05, "{skipped} in {steps}");
    }
}
