//! The proxy of a trained model: a sparse grid of its densities, fine enough to locate the surfaces along a ray. A
//! renderer uses it to place its few samples (hybrid rendering, Tri-MipRF Section 3.4); colour and density of a picture
//! come from the model. The proxy is an asset: it is stored in the model file.

mod bake;
mod choose;
mod grid;
mod guide;
mod layers;
mod pack;

pub use bake::{Baking, bake};
pub use choose::{BEHIND, Chooser, Chosen, Pick, Rule, Shaded, share_colors};
pub use grid::{BRICK, BRICK_CELLS, CODES, Proxy};
pub use guide::Guide;
pub use layers::{Layering, Layers};
