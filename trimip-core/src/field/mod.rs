//! The radiance field without a device. [`encoders`] and [`losses`] are registries of declarations. [`networks`] has
//! the shapes of the two networks, [`params`] the layout of all parameters, and [`adamw`] the update of the parameters.
//! [`exact`] is the whole model in f64. [`model`], [`packed`] and [`tensors`] read and write the files of a model.

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
