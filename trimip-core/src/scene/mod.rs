//! What photographs show: their pixels ([`pixels`]) in views of several scales ([`views`]), rendered pictures ([`frame`]), how many
//! cones a pixel has ([`cones`]), which distances are known ([`depths`]) and what they tell about space ([`known_space`]),
//! silhouettes and the visual hull. Scenes far from the origin of their coordinates have one of their own ([`origin`]). Fingerprints
//! tell two data sets apart.

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
