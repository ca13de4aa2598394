//! Triangle meshes of a model's surface: extraction, cleaning, simplification, files, silhouettes.

mod clean;
mod extract;
#[cfg(test)]
mod fixtures;
mod hidden;
mod marching;
mod occupied;
mod open;
mod seen;
mod silhouettes;
mod simplify;
mod surface;
mod write;

pub use clean::{Removed, clean};
pub use extract::{Extracted, Extraction, extract};
pub use marching::{Grid, march};
pub use silhouettes::{Overlap, overlap, rasterise};
pub use simplify::{Goal, simplify};
pub use surface::{Defects, Mesh};
pub use write::{Coordinates, MeshFormat, write, write_in};
