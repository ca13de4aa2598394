//! The axis-aligned box that bounds a scene, and where a ray runs through it.

use crate::{
    Config,
    config::{Contraction, SceneConfig},
    math::scalar::Real,
};
use glam::DVec3;

/// An axis-aligned box, world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb<R> {
    /// Lower corner.
    pub min: [R; 3],
    /// Upper corner.
    pub max: [R; 3],
}

impl<R: Real> Aabb<R> {
    /// Returns the configured box.
    pub fn new(scene: &SceneConfig) -> Self {
        Self {
            min: scene.aabb_min.map(|x| R::from_f64(x.into())),
            max: scene.aabb_max.map(|x| R::from_f64(x.into())),
        }
    }

    /// Returns the side lengths.
    #[inline]
    pub fn extent(&self) -> [R; 3] {
        std::array::from_fn(|i| self.max[i] - self.min[i])
    }

    /// Returns the centre.
    #[inline]
    pub fn centre(&self) -> [R; 3] {
        std::array::from_fn(|i| R::from_f64(0.5) * (self.min[i] + self.max[i]))
    }

    /// Returns half of each side: the distances from the centre to the faces.
    #[inline]
    pub fn half(&self) -> [R; 3] {
        self.extent().map(|side| R::from_f64(0.5) * side)
    }

    /// Returns the longest side.
    pub fn longest(&self) -> R {
        let [x, y, z] = self.extent();
        x.max(y).max(z)
    }

    /// Returns the distances at which a ray enters the box (at least 0) and leaves it; enter ≥ leave if the ray misses the
    /// box.
    ///
    /// This is the slab method. It does not divide by a direction component of exactly zero, because 0·∞ is NaN: such a ray
    /// is inside the slab everywhere or nowhere.
    #[inline]
    pub fn intersect(&self, origin: [R; 3], direction: [R; 3]) -> (R, R) {
        let (mut enter, mut leave) = (R::zero(), R::infinity());
        for axis in 0..3 {
            let (below, above) = (self.min[axis] - origin[axis], self.max[axis] - origin[axis]);
            if direction[axis] == R::zero() {
                if below > R::zero() || above < R::zero() {
                    return (R::zero(), R::zero());
                }
            } else {
                let inverse = direction[axis].recip();
                let (a, b) = (below * inverse, above * inverse);
                enter = enter.max(a.min(b));
                leave = leave.min(a.max(b));
            }
        }
        (enter, leave)
    }
}

impl SceneConfig {
    /// Returns the scene's box or, if space is contracted, the box around the uncontracted ball: half as large, with the
    /// same centre. World units.
    pub fn subject(&self) -> Aabb<f64> {
        let aabb = Aabb::<f64>::new(self);
        let fraction = match self.contraction {
            Contraction::None => 1.0,
            Contraction::Ball => 0.5,
        };
        let corner = |sign: f64| {
            std::array::from_fn(|i| {
                0.5 * (aabb.min[i] + aabb.max[i]) + sign * 0.5 * fraction * (aabb.max[i] - aabb.min[i])
            })
        };
        Aabb { min: corner(-1.0), max: corner(1.0) }
    }
}

impl Config {
    /// Returns the length of the uniform marching step in world units: longest side · √3 / steps (code).
    pub fn step_length(&self) -> f32 {
        Aabb::<f32>::new(&self.scene).longest() * 3.0_f32.sqrt() / self.renderer.steps_per_diagonal as f32
    }

    /// Returns this configuration with its box centred at the origin, and the centre of the original box. Far from the
    /// origin, f32 is too coarse for positions within the box.
    pub fn centred(&self) -> (Self, DVec3) {
        let scene = Aabb::<f64>::new(&self.scene);
        let centre: [f64; 3] = std::array::from_fn(|axis| 0.5 * (scene.min[axis] + scene.max[axis]));
        let mut config = self.clone();
        let shifted = |corner: [f64; 3]| std::array::from_fn(|axis| (corner[axis] - centre[axis]) as f32);
        (config.scene.aabb_min, config.scene.aabb_max) = (shifted(scene.min), shifted(scene.max));
        (config, DVec3::from_array(centre))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CUBE: Aabb<f64> = Aabb { min: [-1.0; 3], max: [1.0; 3] };

    #[test]
    fn a_box_is_its_centre_and_halves() {
        let aabb = Aabb { min: [-1.0, 2.0, 0.25], max: [3.0, 2.5, 0.75] };
        assert_eq!((aabb.centre(), aabb.half()), ([1.0, 2.25, 0.5], [2.0, 0.25, 0.25]));
    }

    #[test]
    fn rays_through_beside_and_along_the_box() {
        assert_eq!(CUBE.intersect([-3.0, 0.0, 0.0], [1.0, 0.0, 0.0]), (2.0, 4.0));
        assert_eq!(CUBE.intersect([0.0, 0.0, 0.0], [0.0, 0.0, -1.0]), (0.0, 1.0));
        let misses = |(enter, leave): (f64, f64)| enter >= leave;
        assert!(misses(CUBE.intersect([-3.0, 1.5, 0.0], [1.0, 0.0, 0.0])));
        assert!(misses(CUBE.intersect([3.0, 0.0, 0.0], [1.0, 0.0, 0.0])), "behind the ray");
        let s = 0.5_f64.sqrt();
        assert!(misses(CUBE.intersect([-3.0, -2.0, 0.0], [-s, s, 0.0])));
    }

    #[test]
    fn rays_that_lie_in_a_face_give_no_nan() {
        for axis in [1.0, -1.0] {
            let (enter, leave) = CUBE.intersect([axis, axis, -5.0], [0.0, 0.0, 1.0]);
            assert_eq!((enter, leave), (4.0, 6.0));
        }
        let (enter, leave) = CUBE.intersect([1.0, 1.0, 1.0], [-0.0, 0.0, 1.0]);
        assert!(enter >= leave || leave == 0.0);
    }
}
