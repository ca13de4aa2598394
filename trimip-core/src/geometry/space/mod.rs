//! The map from the world to the encoder's unit cube. All code that places samples, skips empty cells or scales radii uses
//! a [`Space`]; its GPU counterpart is one WGSL file. A bounded space maps the scene's box to the cube. An unbounded space
//! first contracts the world into the box, see [`contraction`].

pub mod contraction;
mod path;

pub use contraction::{Ball, Curve};
pub use path::{ContractedPath, Path, ROUNDING, StraightPath};

use crate::{
    Aabb,
    config::{Contraction, SceneConfig},
    geometry::elements::Ray,
    math::scalar::Real,
};

/// The map from the world to the unit cube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Space<R> {
    aabb: Aabb<R>,
    inverse_extent: [R; 3],
    /// The uncontracted ball of an unbounded space.
    ball: Option<Ball<R>>,
}

impl<R: Real> Space<R> {
    /// Returns the space of a configuration.
    pub fn new(scene: &SceneConfig) -> Self {
        let aabb = Aabb::new(scene);
        match scene.contraction {
            Contraction::None => Self::of(aabb),
            Contraction::Ball => Self::contracted(aabb),
        }
    }

    /// Returns the space that maps the box `aabb` of the world to the cube.
    pub fn of(aabb: Aabb<R>) -> Self {
        Self { aabb, inverse_extent: aabb.extent().map(R::recip), ball: None }
    }

    /// Returns the space that contracts the world into the cube `aabb`. The ball in the middle of the cube, half as wide as
    /// the cube, stays uncontracted.
    pub fn contracted(aabb: Aabb<R>) -> Self {
        let half = R::from_f64(0.5);
        let ball = Ball { centre: aabb.centre(), radius: half * half * aabb.longest() };
        Self { ball: Some(ball), ..Self::of(aabb) }
    }

    /// Returns the box that is stretched to the unit cube, in the units of radii; for a bounded space, the scene's box in
    /// the world.
    #[inline]
    pub fn aabb(&self) -> &Aabb<R> {
        &self.aabb
    }

    /// Returns the uncontracted ball; `None` in a bounded space.
    #[inline]
    pub fn ball(&self) -> Option<&Ball<R>> {
        self.ball.as_ref()
    }

    /// Returns the map between the distance along a ray and the parameter in which its marching steps are uniform.
    #[inline]
    pub fn parameterisation(&self, origin: [R; 3], direction: [R; 3]) -> RayParameter<R> {
        match &self.ball {
            None => {
                let (enter, leave) = self.aabb.intersect(origin, direction);
                RayParameter::Straight { enter, leave }
            }
            Some(ball) => RayParameter::Curved(ball.parameterisation(origin, direction)),
        }
    }

    /// Maps a point of the world to coordinates of the cube.
    #[inline(always)]
    pub fn to_cube(&self, point: [R; 3]) -> [R; 3] {
        match &self.ball {
            None => self.place(point),
            Some(ball) => self.place(ball.contract(point)),
        }
    }

    /// Maps a position in the cube to the world: the inverse of [`to_cube`](Self::to_cube).
    #[inline]
    pub fn to_world(&self, position: [R; 3]) -> [R; 3] {
        let extent = self.aabb.extent();
        let place = std::array::from_fn(|i| self.aabb.min[i] + position[i] * extent[i]);
        self.ball.as_ref().map_or(place, |ball| ball.expand(place))
    }

    /// Returns the factor by which the map scales a sphere's radius at a point of the world, in the units of
    /// [`aabb`](Self::aabb): the largest singular value of the map's Jacobian, which is 1 in a bounded space. Far away, a
    /// ray runs nearly along the line to the centre; the largest singular value is then the lateral factor, which scales
    /// the width of a pixel.
    #[inline(always)]
    pub fn scale(&self, point: [R; 3]) -> R {
        self.ball.as_ref().map_or(R::one(), |ball| ball.lateral(point))
    }

    /// Returns the density per world unit at a point of the world, divided by the field's density: 1 in a bounded space. In
    /// an unbounded space, the field's density is per unit of contracted length along the line to the centre, so a wall has
    /// the same density in the field at any distance.
    #[inline(always)]
    pub fn density_scale(&self, point: [R; 3]) -> R {
        self.ball.as_ref().map_or(R::one(), |ball| ball.radial(point))
    }

    /// Returns the position of a sample in the ray's parameter, and the growth of the parameter over the sample's `length`, both in
    /// units of the box's longest side (4 radii of the ball). The sample lies at distance `t`, at the point `point`; its `length` is
    /// in the units of the field's density.
    #[inline(always)]
    pub fn along(&self, parameterisation: &RayParameter<R>, point: [R; 3], t: R, length: R) -> [R; 2] {
        let longest = self.aabb.longest();
        let step = length / (parameterisation.length(t, R::one()) * self.density_scale(point));
        [parameterisation.parameter(t) / longest, step / longest]
    }

    /// Maps a point of the box to coordinates of the cube.
    #[inline(always)]
    pub(crate) fn place(&self, point: [R; 3]) -> [R; 3] {
        std::array::from_fn(|i| (point[i] - self.aabb.min[i]) * self.inverse_extent[i])
    }

    /// Returns the side of a cube that has the volume of one cell of a grid with `resolution` cells along each side, in the
    /// units of radii.
    pub fn cell(&self, resolution: u32) -> R {
        let [x, y, z] = self.aabb.extent();
        (x * y * z).cbrt() / R::from_u32(resolution)
    }
}

impl Space<f32> {
    /// Returns an upper bound on the number of steps of length `step` along a ray, plus one step for rounding at each end.
    /// The longest ray is the diagonal of a bounded space, or 8 radii of an unbounded one.
    pub fn most_steps(&self, step: f32) -> usize {
        let [x, y, z] = self.aabb.extent().map(f64::from);
        let longest = match &self.ball {
            None => (x * x + y * y + z * z).sqrt(),
            Some(ball) => 8.0 * f64::from(ball.radius),
        };
        (longest / f64::from(step)).ceil() as usize + 2
    }

    /// Returns the path of a ray through a grid of `resolution` cells along each side of a bounded space.
    #[inline(always)]
    pub fn straight_path(&self, ray: &Ray, resolution: u32) -> StraightPath {
        StraightPath::new(self, ray, resolution)
    }

    /// Returns the path of a ray through a grid of `resolution` cells along each side of an unbounded space.
    #[inline(always)]
    pub fn contracted_path(&self, ball: Ball<f32>, ray: &Ray, resolution: u32) -> ContractedPath {
        ContractedPath::new(ball, StraightPath::new(self, ray, resolution))
    }
}

/// Map between the distance t along a ray and the parameter in which its marching steps are uniform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RayParameter<R> {
    /// The parameter is the distance. It ranges from the ray's entry into the box to its exit.
    Straight {
        /// Distance at which the ray enters the box.
        enter: R,
        /// Distance at which the ray leaves the box.
        leave: R,
    },
    /// The parameter grows with the contracted distance.
    Curved(Curve<R>),
}

impl<R: Real> RayParameter<R> {
    /// Returns the parameters between which a ray can have samples; enter ≥ leave if it can have none.
    #[inline]
    pub fn range(&self) -> (R, R) {
        match self {
            Self::Straight { enter, leave } => (*enter, *leave),
            Self::Curved(curve) => curve.range(),
        }
    }

    /// Returns the distance at the parameter `s`.
    #[inline]
    pub fn distance(&self, s: R) -> R {
        match self {
            Self::Straight { .. } => s,
            Self::Curved(curve) => curve.distance(s),
        }
    }

    /// Returns the parameter at distance `t`.
    #[inline]
    pub fn parameter(&self, t: R) -> R {
        match self {
            Self::Straight { .. } => t,
            Self::Curved(curve) => curve.parameter(t),
        }
    }

    /// Returns the length in world units of a step of the parameter at distance `t`.
    #[inline]
    pub fn length(&self, t: R, step: R) -> R {
        match self {
            Self::Straight { .. } => step,
            Self::Curved(curve) => step * curve.slowness(t),
        }
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

    /// Checks that det J of the map to the cube, times the box's volume, equals scale³ (central differences).
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
}
