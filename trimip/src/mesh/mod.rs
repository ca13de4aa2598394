//! Triangle meshes of a model's surface: extraction, cleaning, simplification, textures, files, pictures, silhouettes.

mod clean;
mod colors;
mod extract;
mod fit;
#[cfg(test)]
mod fixtures;
mod fusion;
mod hidden;
mod marching;
mod occupied;
mod open;
mod pictures;
mod samples;
mod seen;
mod silhouettes;
mod simplify;
mod smooth;
mod solid;
mod surface;
mod texture;
mod threads;
mod usdz;
mod write;

pub use clean::{Removed, clean};
pub use extract::{Extracted, Extraction, Source, Surface, extract};
pub use fit::Photographs;
pub use marching::{Grid, march};
pub use pictures::{Likeness, picture, psnr};
pub use silhouettes::{Overlap, overlap, rasterise};
pub use simplify::{Goal, for_collisions, simplify};
pub use surface::{Defects, Mesh, Texture};
pub use texture::{SIDES, Texturing, texture};
pub use write::{Coordinates, MeshFormat, write, write_in, write_textured};
