//! The map from the world to the encoder's unit cube. All code that places samples, skips empty cells or scales radii
//! uses a [`Space`]; the GPU's twin is one WGSL file. The present map is affine: it maps the scene's box to the cube.

use crate::{Aabb, config::SceneConfig, elements::Ray, scalar::Real};

/// The map from the world to the unit cube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Space<R> {
    aabb: Aabb<R>,
    inverse_extent: [R; 3],
}

impl<R: Real> Space<R> {
    /// The space of a configuration.
    pub fn new(scene: &SceneConfig) -> Self {
        Self::of(Aabb::new(scene))
    }

    /// The space that maps the box `aabb` of the world to the cube.
    pub fn of(aabb: Aabb<R>) -> Self {
        Self { aabb, inverse_extent: aabb.extent().map(R::recip) }
    }

    /// The cube as a box in the units of radii; for this map, the scene's box in the world.
    #[inline]
    pub fn aabb(&self) -> &Aabb<R> {
        &self.aabb
    }

    /// The distances (enter, leave) between which a ray can have samples; enter ≥ leave if there are none.
    #[inline]
    pub fn intersect(&self, origin: [R; 3], direction: [R; 3]) -> (R, R) {
        self.aabb.intersect(origin, direction)
    }

    /// Maps a point of the world to coordinates of the cube.
    #[inline(always)]
    pub fn to_cube(&self, point: [R; 3]) -> [R; 3] {
        std::array::from_fn(|i| (point[i] - self.aabb.min[i]) * self.inverse_extent[i])
    }

    /// Maps a position in the cube to the world: the inverse of [`to_cube`](Self::to_cube).
    #[inline]
    pub fn to_world(&self, position: [R; 3]) -> [R; 3] {
        let extent = self.aabb.extent();
        std::array::from_fn(|i| self.aabb.min[i] + position[i] * extent[i])
    }

    /// Factor by which the map scales a sphere's radius at a point of the world: the cube root of the map's Jacobian
    /// determinant, in the units of [`aabb`](Self::aabb). An affine map keeps radii.
    #[inline(always)]
    pub fn scale(&self, _point: [R; 3]) -> R {
        R::one()
    }

    /// Side of a cube with the volume of one cell, in units of radii, for a grid of `resolution` cells along each
    /// side.
    pub fn cell(&self, resolution: u32) -> R {
        let [x, y, z] = self.aabb.extent();
        (x * y * z).cbrt() / R::from_u32(resolution)
    }
}

impl Space<f32> {
    /// Upper bound on the steps of length `step` along a ray: the diagonal, plus one step for rounding at each end.
    pub fn most_steps(&self, step: f32) -> usize {
        let [x, y, z] = self.aabb.extent().map(f64::from);
        ((x * x + y * y + z * z).sqrt() / f64::from(step)).ceil() as usize + 2
    }

    /// The path of a ray through a grid of `resolution` cells along each side.
    #[inline(always)]
    pub fn way(&self, ray: &Ray, resolution: u32) -> Way {
        let cells = resolution as f32;
        Way {
            space: *self,
            ray: *ray,
            cells,
            last: resolution - 1,
            cell_extent: self.aabb.extent().map(|side| side / cells),
            inverse_direction: ray.direction.map(f32::recip),
        }
    }
}

/// A ray's path through the cells of a grid over the cube.
pub struct Way {
    space: Space<f32>,
    ray: Ray,
    cells: f32,
    last: u32,
    cell_extent: [f32; 3],
    inverse_direction: [f32; 3],
}

impl Way {
    /// Position in the cube at distance `t`.
    #[inline(always)]
    pub fn position(&self, t: f32) -> [f32; 3] {
        self.space.to_cube(self.point(t))
    }

    /// Radius of the cone's sphere at distance `t`, in the units of [`Space::aabb`].
    #[inline(always)]
    pub fn radius(&self, t: f32) -> f32 {
        self.ray.slope * t * self.space.scale(self.point(t))
    }

    /// Cell of a position.
    #[inline(always)]
    pub fn cell(&self, position: [f32; 3]) -> [u32; 3] {
        position.map(|p| ((p * self.cells) as u32).min(self.last))
    }

    /// Distance beyond `t` at which the ray leaves the aligned cube of `size` cells that contains `cell`; infinite if
    /// it cannot be computed.
    #[inline(always)]
    pub fn exit(&self, t: f32, cell: [u32; 3], size: u32) -> f32 {
        let mut exit = f32::INFINITY;
        for axis in 0..3 {
            let lower = cell[axis] & !(size - 1);
            let edge = if self.ray.direction[axis] > 0.0 { lower + size } else { lower };
            let edge = edge as f32 * self.cell_extent[axis] + self.space.aabb.min[axis];
            let distance = (edge - self.ray.origin[axis]) * self.inverse_direction[axis];
            // An axis along which the ray does not move gives ±∞ or NaN: no exit there.
            if distance > t && distance < exit {
                exit = distance;
            }
        }
        exit
    }

    /// Distance beyond `t` at which the ray leaves the cube of all cells closer than `distance` cells to `cell`, along
    /// each axis; infinite if it cannot be computed.
    #[inline(always)]
    pub fn exit_around(&self, t: f32, cell: [u32; 3], distance: u32) -> f32 {
        let reach = distance as f32;
        let mut exit = f32::INFINITY;
        for axis in 0..3 {
            let cell = cell[axis] as f32;
            let edge = if self.ray.direction[axis] > 0.0 { cell + reach } else { cell - reach + 1.0 };
            let edge = edge * self.cell_extent[axis] + self.space.aabb.min[axis];
            let distance = (edge - self.ray.origin[axis]) * self.inverse_direction[axis];
            // An axis along which the ray does not move gives ±∞ or NaN: no exit there.
            if distance > t && distance < exit {
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

    fn long() -> Space<f64> {
        Space::of(Aabb { min: [-1.0, 2.0, 0.5], max: [3.0, 4.0, 1.5] })
    }

    #[test]
    fn corners_become_corners_and_come_back() {
        let space = long();
        assert_eq!(space.to_cube([-1.0, 2.0, 0.5]), [0.0; 3]);
        assert_eq!(space.to_cube([3.0, 4.0, 1.5]), [1.0; 3]);
        let point = [0.3, 3.1, 0.77];
        for (found, expected) in space.to_world(space.to_cube(point)).into_iter().zip(point) {
            assert!((found - expected).abs() < 1e-15);
        }
    }

    /// det J of the map to the cube, times the box's volume, equals scale³ (central differences).
    #[test]
    fn radii_scale_by_the_jacobian() {
        let (space, point, h) = (long(), [0.3, 3.1, 0.77], 1e-5);
        let column = |axis: usize| {
            let moved = |by: f64| {
                let mut point = point;
                point[axis] += by;
                space.to_cube(point)
            };
            let (more, less) = (moved(h), moved(-h));
            glam::DVec3::from_array(std::array::from_fn(|i| (more[i] - less[i]) / (2.0 * h)))
        };
        let determinant = glam::DMat3::from_cols(column(0), column(1), column(2)).determinant();
        let [x, y, z] = space.aabb().extent();
        assert!(((determinant * x * y * z).cbrt() - space.scale(point)).abs() < 1e-9);
    }

    #[test]
    fn a_ray_leaves_a_block_of_cells_where_the_block_ends() {
        let space = Space::of(Aabb { min: [-1.0, 0.0, 0.0], max: [3.0, 2.0, 1.0] });
        let ray = Ray { origin: [-2.0, 0.26, 0.3], direction: [0.8, 0.6, 0.0], slope: 0.01, cosine: 1.0 };
        let way = space.way(&ray, 16);
        let t = 1.5;
        let position = way.position(t);
        let cell = way.cell(position);
        assert_eq!(cell, [0, 9, 4]);
        // The block of four cells from x = -1 to 0 and y = 1 to 1.5: y = 1.16 at t, 1.5 at (1.5 - 0.26) / 0.6.
        let exit = way.exit(t, cell, 4);
        assert!((exit - 2.066_666_7).abs() < 1e-5, "{exit}");
        assert!((way.radius(t) - 0.015).abs() < 1e-9);
    }
}
