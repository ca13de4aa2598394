//! Names of the tensors in model and checkpoint files that are not slots of parameters. [`crate::field::params::Layout`]
//! has the names of the slots.

/// The occupancy grid: one bit per cell, in cell order, lowest bit first.
pub const OCCUPANCY: &str = "occupancy";

/// The running maximum of the densities of the occupancy grid's cells, in checkpoints.
pub const OCCUPANCY_DENSITY: &str = "occupancy.density";

/// Prefix of the names of scene assets: tensors that a renderer needs in addition to the parameters, such as a mesh or a
/// hierarchy. Assets are saved with the model; a renderer ignores assets that it does not use.
pub const ASSET: &str = "asset.";
