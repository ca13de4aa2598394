//! Photographs and what they show: pixels ([`pixels`]) in views of several scales ([`views`]), rendered pictures ([`frame`]), the
//! cones of a pixel ([`cones`]), known distances ([`depths`]) and the space known from them ([`known_space`]), silhouettes and
//! the visual hull. A scene far from the origin of its coordinates has a local origin ([`origin`]). Fingerprints distinguish
//! data sets.

pub mod cones;
pub mod depths;
pub mod edge_exponents;
pub mod fingerprint;
pub mod frame;
pub mod hull;
pub mod known_space;
pub mod origin;
pub mod pixels;
pub mod plain;
pub mod silhouettes;
pub mod strays;
pub mod views;
