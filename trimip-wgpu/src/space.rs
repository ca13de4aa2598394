//! The space in the layout of the shaders, and its WGSL.

use crate::gpu::Source::{self, Parts, Text};
use crate::shaders::RAY;
use trimip_core::Space;
use trimip_core::geometry::space::ROUNDING;
use trimip_core::geometry::space::contraction::{FARTHEST, STRETCH};

shared! {
    /// A space and the cells of its occupancy grid.
    pub struct GpuSpace as Space {
        aabb_min: [f32; 3],
        /// Number of cells along each side of the occupancy grid.
        pub resolution: u32,
        aabb_max: [f32; 3],
        /// Longest side of the box.
        longest: f32,
        /// Inverse size of the box. The quotients are computed on the host, where they are exact to half an ulp; a
        /// device's own division may be less accurate.
        inverse_extent: [f32; 3],
        /// Radius of the uncontracted ball in the middle of the box; 0 in a bounded space.
        ball: f32,
        cell_extent: [f32; 3],
        /// Shortest side of a cell.
        cell: f32,
    }
}

/// A distance that is larger than all others.
const FAR: f32 = 3.0e38;

/// Shader source: the map from the world to the unit cube, and rays through the cube.
pub const SPACE: Source = Parts(&[
    RAY,
    Source::of::<GpuSpace>(),
    Source::real("FAR", FAR),
    Source::real("FARTHEST", FARTHEST as f32),
    Source::real("STRETCH", STRETCH as f32),
    Source::real("ROUNDING", ROUNDING),
    Text(include_str!("shaders/space.wgsl")),
]);

impl GpuSpace {
    /// Converts a space, with a grid of `resolution` cells along each side.
    pub fn new(space: &Space<f32>, resolution: u32) -> Self {
        let aabb = space.aabb();
        let cell_extent = aabb.extent().map(|side| side / resolution as f32);
        Self {
            aabb_min: aabb.min,
            resolution,
            aabb_max: aabb.max,
            longest: aabb.longest(),
            inverse_extent: aabb.extent().map(f32::recip),
            ball: space.ball().map_or(0.0, |ball| ball.radius),
            cell_extent,
            cell: cell_extent.into_iter().fold(f32::INFINITY, f32::min),
        }
    }
}
