//! The radiance field without a device. The registries of [`encoders`] and [`losses`] declare their members; [`networks`] states the
//! shapes of the two networks, [`params`] the layout of all parameters, [`adamw`] their update. [`exact`] is the whole model in f64.
//! [`model`], [`packed`] and [`tensors`] are its files.

pub mod activation;
pub mod adamw;
pub(crate) mod deflate;
pub mod encoders;
pub mod exact;
pub mod losses;
pub mod model;
pub mod networks;
pub mod packed;
pub mod params;
pub(crate) mod slot;
pub(crate) mod tensor_names;
pub mod tensors;
