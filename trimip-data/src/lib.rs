//! Photographs with cameras, ready for training and testing: Blender JSON folders, COLMAP models, LLFF captures,
//! exports of OpenSfM, Bundler, Metashape, RealityCapture, Polycam and Record3D, data sets of NSVF and ARKitScenes, the
//! public multi-scale set's `metadata.json`, and a built-in ray-traced scene that needs no files. Poses are
//! camera-to-world with OpenGL axes. Lengths are in world units, angles in radians, focal lengths in pixels.
//!
//! ```text
//! folder → frames  → masks, points, origin → decoded pixels → scales 1, 1/2, 1/4, ... → training views
//! layout   readers   survey                  source           pyramid                   ViewSet
//!                    │
//!                    └→ one frame at a time, on request ──────────────────────────────→ test frames
//!                                                                                       Frames
//! ```
//!
//! Start with [`open`], which returns the [`Scene`] that a [`DataConfig`] names: its training views, test frames and points.
//! [`inspect()`] describes and checks a scene without training, and [`in_memory`] reads single files from bytes.
//!
//! ```
//! use trimip_core::Frames;
//! use trimip_data::settings::DataConfig;
//!
//! let mut data = DataConfig { format: trimip_data::builtin::FORMAT.into(), ..DataConfig::default() };
//! (data.builtin_size, data.builtin_train, data.builtin_test) = (32, 4, 2);
//! let scene = trimip_data::open(&data)?;
//! assert_eq!(scene.train.views.len(), 4 * 4); // four views at the scales 1, 1/2, 1/4, 1/8
//! assert_eq!(scene.train.scales[3].weight, 64.0);
//! assert_eq!(scene.test.load(1)?.views[2].camera.intrinsics.width, 8);
//! # Ok::<(), trimip_core::Error>(())
//! ```

#![deny(unsafe_code)]

mod advice;
mod archive;
pub mod builtin;
pub mod checks;
mod collection;
pub mod colmap;
mod depth_image;
mod depth_images;
mod depths;
mod describe;
mod division;
mod files;
mod foreign;
pub mod in_memory;
mod inspect;
mod intrinsics;
mod json;
mod layout;
mod lens;
mod list;
mod listing;
mod mask;
mod masks;
mod material;
mod material_archive;
mod names;
mod npy;
mod numbers;
mod orientation;
mod photograph;
mod pictures;
mod ply;
mod points;
mod pose;
pub mod pyramid;
mod readers;
mod realign;
mod scene;
mod section;
mod sector;
pub mod settings;
mod source;
mod split;
mod stated_box;
mod store;
mod survey;
mod tiff;
mod warnings;
mod watch;
mod webp;
mod workers;
mod write;
mod zip;

pub use collection::{BLENDER_SCENES, Collection, has_split, is_scene};
pub use foreign::Foreign;
pub use inspect::{Inspection, examine, inspect};
pub use lens::{lens_of, lens_terms};
pub use material::{Material, foreign_format, has_cameras, is_film};
pub use material_archive::unpack_material;
pub use points::{Observation, Point};
pub use scene::{Scene, TestSet, open, open_test, open_watched};
pub use section::SECTION;
pub use settings::DataConfig;
pub use watch::{Watch, unwatched};
pub use write::{Summary, write_builtin, write_multiscale};
pub use zip::is_archive;
