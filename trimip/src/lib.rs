//! Tri-MipRF (Hu et al., ICCV 2023) as a library: anti-aliased radiance fields from photographs, on the CPU or a GPU.
//!
//! ```text
//! settings ─────────────────────────┐
//! photographs → data::open → Scene ─┴→ Training → run folder → Model → Viewer → Frame → PNG, EXR
//!                                                                      └→ mesh::extract → Mesh → PLY, OBJ, GLB, USDZ
//! ```
//!
//! Start with [`settings::defaults`], [`Training`] and [`Viewer`]:
//!
//! - settings: [`settings::defaults`] are the documented defaults, [`Settings`] holds values that override them, [`Config`] is
//!   their typed form;
//! - data: [`data::open`] reads a folder of photographs or generates the built-in scene;
//! - training: [`Training`] trains into a run folder with callbacks and resumes an existing run; [`backends::train`]
//!   opens a bare [`Session`] for a custom training loop;
//! - models: [`read_model`] and [`model::Model::write`] load and save a model, [`backends::load`] opens a [`Viewer`];
//! - pictures: [`Viewer::render`] returns a [`Frame`], [`view::write`] writes it as PNG or EXR;
//! - meshes and points: [`mesh::extract`] returns a triangle mesh, [`Viewer::query`] density and colour at points of the world;
//! - losses: [`settings::with_sections`] adds loss terms of another crate ([`losses::LossSection`]);
//! - metrics: [`view::evaluate`] compares a model with its test photographs;
//! - systems: [`systems`] are the settings of Tri-MipRF and of the systems compared with it.
//!
//! ```
//! # fn main() -> trimip::Result<()> {
//! use trimip::{Training, backends, data, settings};
//!
//! // The built-in scene at 16 pixels, and a model of the smallest useful size.
//! let settings = settings::defaults()
//!     .with("data.format", "builtin")?
//!     .with("data.builtin_size", 16)?
//!     .with("data.builtin_train", 4)?
//!     .with("encoder.plane_size", 32)?
//!     .with("encoder.levels", 4)?
//!     .with("train.steps", 8)?
//!     .with("train.samples_per_step", 512)?
//!     .with("eval.final", false)?;
//! let folder = std::env::temp_dir().join(format!("trimip-{}", std::process::id()));
//! let trained = Training::new(settings, &folder).run(&mut |event: &trimip::events::Event| drop(event.clone()))?;
//!
//! let camera = data::open(&trained.config.section()?)?.train.views[0].camera;
//! let frame = backends::load(&trained.model()?)?.render(&camera)?;
//! assert_eq!((frame.width, frame.height), (16, 16));
//! # std::fs::remove_dir_all(folder).unwrap();
//! # Ok(())
//! # }
//! ```

#![forbid(unsafe_code)]

pub mod backends;
pub mod formatting;
pub mod inspect;
pub mod machine;
pub mod mesh;
pub mod ranks;
pub mod report;
pub mod run;
pub mod settings;
pub mod systems;
pub mod view;

pub use run::folder::{RunFolder, read_model};
pub use run::train::{Listeners, Outcome, Trained, Training};
/// Readers of data sets, and the built-in scene.
pub use trimip_data as data;

/// Vectors and matrices, in the version that the types of cameras use.
#[doc(no_inline)]
pub use glam;
#[doc(no_inline)]
pub use trimip_core::{
    Addition, Advice, Alpha, Backend, Camera, Checker, Config, Crop, Definitions, Error, ErrorKind,
    ForeignSection, Fragment, Frame, Frames, Intrinsics, Origin, Pixel, Place, Query, Result, Section,
    Session, SettingValue, Settings, StepReport, View, ViewSet, Viewer, config,
    engine::{batch::Radiance, checkpoint, events, exchange},
    field::{losses, model},
    measures::{metrics, quality},
    run::evaluate,
    scene_plan,
};

/// Compiles the program in the README of the crate.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
