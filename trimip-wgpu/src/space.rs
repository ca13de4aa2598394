//! The space in the layout of the shaders.

use bytemuck::{Pod, Zeroable};
use trimip_core::Space;

/// The twin of `Space` in `space.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub struct GpuSpace {
    aabb_min: [f32; 3],
    /// Cells along each side of the occupancy grid.
    pub resolution: u32,
    aabb_max: [f32; 3],
    longest: f32,
    inverse_extent: [f32; 3],
    /// Radius of the ball that keeps its shape; 0 in a bounded space.
    ball: f32,
    cell_extent: [f32; 3],
    cell: f32,
}

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
