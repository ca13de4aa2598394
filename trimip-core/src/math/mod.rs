//! Formulas independent of scenes and devices, generic over f32 and f64 ([`scalar::Real`]): compositing (NeRF Eq. 3), deferred shading
//! (SNeRG), spherical harmonics, soft Voronoi cells of the sphere, counter-based random numbers, sets of bits, unit vectors perpendicular
//! to a direction, functions of symmetric matrices, rounding.

pub mod basis;
pub mod bits;
pub mod compositing;
pub mod deferred;
pub mod rng;
pub mod rounding;
pub mod scalar;
pub mod sh;
pub mod symmetric;
pub mod voronoi;
