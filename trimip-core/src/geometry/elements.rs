//! The elements of the batches: plain values with the same layout on every device.

use crate::Cone;
use crate::geometry::camera::apex_distance;
use bytemuck::{Pod, Zeroable};
use std::ops::Range;

/// The axis of a pixel's cone.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Ray {
    /// Apex of the cone, or the point where a cylinder begins; world units.
    pub origin: [f32; 3],
    /// Growth of the sphere's radius per unit of distance (Eq. 3).
    pub slope: f32,
    /// Unit direction.
    pub direction: [f32; 3],
    /// Cosine of the angle to the optical axis; depth = distance · cosine.
    pub cosine: f32,
    /// Radius of the sphere at `origin`, world units; 0 if rays are not parallel.
    pub radius: f32,
    /// Padding: WGSL aligns vectors of three floats to the size of four.
    pub padding: [f32; 3],
}

impl Ray {
    /// Returns the radius of the inscribed sphere at distance `t`.
    #[inline(always)]
    pub fn radius_at(&self, t: f32) -> f32 {
        self.radius + self.slope * t
    }

    /// Returns the distance from the cone's apex to the point at distance `t` along the ray.
    #[inline(always)]
    pub fn apex_distance(&self, t: f32) -> f32 {
        apex_distance(self.radius, self.slope, t)
    }

    /// Returns true if the camera has no ray for the pixel.
    #[inline]
    pub fn is_none(&self) -> bool {
        self.slope == 0.0 && self.radius == 0.0
    }
}

impl From<Cone<f32>> for Ray {
    fn from(cone: Cone<f32>) -> Self {
        let Cone { origin, radius, direction, slope, cosine } = cone;
        Self { origin, slope, direction, cosine, radius, padding: [0.0; 3] }
    }
}

/// The target of a training ray.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Target {
    /// Colour of the photograph's pixel on the background.
    pub rgb: [f32; 3],
    /// Weight of the pixel: its area, 4^level, divided by the probability of its scale, times `importance` and the share of the
    /// pixel that counts; 0 if the lens has no ray for it.
    pub weight: f32,
    /// Background colour behind the ray.
    pub background: [f32; 3],
    /// Opacity of the photograph's pixel, in [0, 1].
    pub opacity: f32,
    /// Edge exponent γ of the photograph, see [`edge_exponents`](crate::scene::edge_exponents).
    pub exponent: f32,
    /// Distance of the point where the ray ends, world units; see [`KnownDepth`](crate::scene::depths::KnownDepth).
    pub distance: f32,
    /// Standard deviation of `distance`; 0 if no point is known.
    pub deviation: f32,
    /// Probability of the pixel if all pixels of its scale were equally likely, divided by its actual probability: 1 without
    /// an [`ErrorMap`](crate::engine::error_map::ErrorMap). It is a factor of `weight`.
    pub importance: f32,
}

/// A sphere inscribed in a cone: the input of a query of the field.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Sphere {
    /// Centre, in coordinates of the unit cube.
    pub position: [f32; 3],
    /// Radius, in the units of [`Space::aabb`](crate::Space::aabb).
    pub radius: f32,
}

/// The range of a ray's samples, or of a pixel's cones: `start .. start + count`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
pub struct Segment {
    /// First index.
    pub start: u32,
    /// Number of indices.
    pub count: u32,
}

impl Segment {
    /// Returns the indices as a range.
    #[inline]
    pub fn range(&self) -> Range<usize> {
        self.start as usize..(self.start + self.count) as usize
    }
}

/// A sample's place on its ray.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Interval {
    /// Distance of the interval's midpoint along the ray's unit direction.
    pub t: f32,
    /// Length δ of the interval.
    pub length: f32,
}

/// Density and colour of a sample, or the gradient of the loss with respect to them.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Radiance {
    /// RGB in [0, 1].
    pub rgb: [f32; 3],
    /// Density per world unit.
    pub density: f32,
}

/// A place at which the field is evaluated: a sphere, and the direction in which it is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Query {
    /// Centre, world units.
    pub point: [f64; 3],
    /// Radius, world units.
    pub radius: f32,
    /// Unit vector from the eye to the centre.
    pub direction: [f32; 3],
}
