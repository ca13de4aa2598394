//! A sample of a ray, and encoders as functions of a sample.

use trimip_core::{
    Config,
    engine::batch::{Interval, Ray, Sphere},
};

/// An encoder written from its equations.
pub trait Literal {
    /// Returns the features of a sample.
    fn features(&self, sample: &Sample) -> Vec<f64>;
}

/// A sample of a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Distance along the ray.
    pub t: f64,
    /// Distance from the apex of the ray's cone.
    pub apex: f64,
    /// Length of the sample's interval, δ.
    pub length: f64,
    /// Centre of the sample's sphere in the unit box.
    pub position: [f64; 3],
    /// Radius of that sphere in world units.
    pub radius: f64,
    /// Unit direction of the ray.
    pub direction: [f64; 3],
}

impl Sample {
    /// Converts a backend's sample to f64.
    pub fn new(ray: &Ray, interval: &Interval, sphere: &Sphere) -> Self {
        Self {
            t: interval.t.into(),
            apex: apex(ray, interval.t.into()),
            length: interval.length.into(),
            position: sphere.position.map(f64::from),
            radius: sphere.radius.into(),
            direction: ray.direction.map(f64::from),
        }
    }
}

/// Returns the radius of a ray's sphere at distance `t`.
pub fn radius(ray: &Ray, t: f64) -> f64 {
    f64::from(ray.radius) + f64::from(ray.slope) * t
}

/// Returns the distance from the apex of the cone to the point at distance `t` along the ray. A cylinder counts as a
/// cone with a very distant apex.
pub fn apex(ray: &Ray, t: f64) -> f64 {
    if ray.radius > 0.0 { 1e5 * t } else { t }
}

/// Returns the world length of a marching step: longest side · √3 / steps.
pub fn step_length(config: &Config) -> f64 {
    let scene = &config.scene;
    let side = |axis: usize| f64::from(scene.aabb_max[axis]) - f64::from(scene.aabb_min[axis]);
    side(0).max(side(1)).max(side(2)) * 3.0_f64.sqrt() / f64::from(config.renderer.steps_per_diagonal)
}
