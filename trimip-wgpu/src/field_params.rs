//! Parameters of the kernels of the field, except those of its networks.

use crate::gpu::Source::{self, Parts, Text};
use trimip_core::config::ViewEncoding;

shared! {
    /// Parameters of the kernels before and after the networks.
    pub struct FieldParams as Params {
        pub counter: u32,
        /// Width of the colour network's input: the encoded view direction, the geometry features with their sines and
        /// cosines, and padding.
        pub width: u32,
        /// Number of values of the encoded view direction, and number of geometry features.
        pub view: u32,
        pub geometry: u32,
        /// Width of the density network's output: the logit, the geometry features, and padding.
        pub outputs: u32,
        /// How the view direction is encoded ([`ViewEncoding`]), and the sharpness of soft Voronoi cells.
        pub encoding: u32,
        pub sharpness: f32,
        /// Numbers of frequencies of the view direction and of the geometry features.
        pub view_frequencies: u32,
        pub geometry_frequencies: u32,
        /// Activation function of the density, with its shift and its factor.
        pub density: u32,
        pub shift: f32,
        pub scale: f32,
        /// 1 if the field has no networks; the features are then the logits of density and colour.
        pub direct: u32,
        /// 1 with deferred shading: a row of the colour network's input belongs to a ray instead of a sample.
        pub deferred: u32,
        /// With deferred shading: number of rays, and least opacity of a ray that has a colour.
        pub rays: u32,
        pub least: f32,
    }
}

/// Shader source: the parameters and their binding.
pub const PARAMS: Source = Parts(&[
    Source::of::<FieldParams>(),
    Source::whole("HARMONICS", ViewEncoding::Harmonics as u32),
    Source::whole("VORONOI", ViewEncoding::Voronoi as u32),
    Text(include_str!("shaders/field_params.wgsl")),
]);
