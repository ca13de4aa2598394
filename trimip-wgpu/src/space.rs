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
    padding: f32,
    cell_extent: [f32; 3],
    more_padding: f32,
}

impl GpuSpace {
    /// Converts a space, with a grid of `resolution` cells along each side.
    pub fn new(space: &Space<f32>, resolution: u32) -> Self {
        let aabb = space.aabb();
        Self {
            aabb_min: aabb.min,
            resolution,
            aabb_max: aabb.max,
            longest: aabb.longest(),
            inverse_extent: aabb.extent().map(f32::recip),
            padding: 0.0,
            cell_extent: aabb.extent().map(|side| side / resolution as f32),
            more_padding: 0.0,
        }
    }
}
