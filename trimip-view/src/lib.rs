//! A model in a browser. A page of plain modules asks for views over a web socket; one thread renders them, coarse while the
//! camera moves and fine when it stands still, and answers with JPEG pictures.
//!
//! Data flows one way: [`protocol`] (what a page may ask) → [`studio`] (the thread that renders) → [`picture`] (a frame as a
//! picture) → [`door`] (the server: the page, the socket, who may enter). [`scene`] holds what is shown: the model, its box,
//! and the photographs beside it. [`audience`] stands between a run and the pages that watch it.

#![forbid(unsafe_code)]

pub mod audience;
pub mod door;
mod listener;
pub mod page;
pub mod picture;
pub mod protocol;
pub mod scene;
pub mod studio;

pub use audience::Audience;
pub use door::{Door, Threshold};
pub use scene::Scene;
