//! The policy of the gradient with respect to poses: the direction and distance by which each ray is displaced.

use crate::{
    Config, Space, ViewSet,
    config::CameraPoses,
    engine::exposure::photographs,
    geometry::elements::{Ray, Sphere},
    math::{
        basis::across,
        rng::{Draws, Random, Sequence},
    },
};

/// The displacement of rays, from which the gradient with respect to poses is computed.
#[derive(Clone, Debug)]
pub struct PosePolicy {
    /// The space that rays pass through.
    pub space: Space<f32>,
    /// Number of photographs.
    pub photographs: usize,
    /// Number of features of a sample that are compared; the rest of a row is padding.
    pub width: usize,
    random: Random,
}

impl PosePolicy {
    /// Creates the policy of a configuration over training views. Returns `None` without views, or if the configuration
    /// does not refine poses.
    pub fn new(config: &Config, views: Option<&ViewSet>) -> Option<Self> {
        let views = views.filter(|_| config.train.cameras == CameraPoses::Refine)?;
        Some(Self {
            space: Space::new(&config.scene),
            photographs: photographs(views).into_iter().max().map_or(0, |last| last as usize + 1),
            width: crate::field::encoders::of(config).width(config),
            random: Random::new(config.seed),
        })
    }

    /// Returns the random numbers of a step.
    pub fn draws(&self, step: u64) -> Draws {
        self.random.at(Sequence::Motion, step)
    }

    /// Returns the sphere of a sample at distance `t` along the displaced ray `moved`: its position in the unit cube,
    /// clamped to the cube, and the `radius` of the original sample.
    #[inline]
    pub fn sphere(&self, moved: &Ray, t: f32, radius: f32) -> Sphere {
        let point = std::array::from_fn(|axis| moved.origin[axis] + t * moved.direction[axis]);
        Sphere { position: self.space.to_cube(point).map(|place| place.clamp(0.0, 1.0)), radius }
    }
}

/// Returns a random unit vector perpendicular to ray number `index` of a step.
#[inline]
pub fn direction(draws: &Draws, index: u32, ray: &Ray) -> [f32; 3] {
    // A normalised random point of a disc needs no sine and cosine, which differ between devices.
    let [x, y] = disc(draws, index);
    let scale = (x * x + y * y).sqrt().recip();
    let [u, v] = across(ray.direction);
    std::array::from_fn(|axis| scale * (x * u[axis] + y * v[axis]))
}

/// Returns a random point of the unit disc: the first of four random points of a square that lies in the disc. If none
/// does, returns the last of them.
#[inline]
fn disc(draws: &Draws, index: u32) -> [f32; 2] {
    let mut point = [0.0; 2];
    for word in draws.bits(index) {
        point = [word >> 16, word & 0xffff].map(|half| (half as f32 + 0.5) / 32_768.0 - 1.0);
        if point[0] * point[0] + point[1] * point[1] <= 1.0 {
            break;
        }
    }
    point
}

/// Returns the ray displaced along `by`, at every distance by the ray's radius there.
#[inline]
pub fn moved(ray: &Ray, by: [f32; 3]) -> Ray {
    Ray {
        origin: std::array::from_fn(|axis| ray.origin[axis] + ray.radius * by[axis]),
        direction: std::array::from_fn(|axis| ray.direction[axis] + ray.slope * by[axis]),
        ..*ray
    }
}
