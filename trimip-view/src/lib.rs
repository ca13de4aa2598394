//! A model in a browser. A page of plain modules asks for views over a web socket; one thread renders them, coarse while the
//! camera moves and fine when it stands still, and answers with JPEG pictures.
//!
//! Data flows one way: [`protocol`] (what a page may ask) → [`render_thread`] (the thread that renders) → [`picture`] (a frame as a
//! picture) → [`server`] (the server: the page, the socket, who may enter). [`scene`] holds what is shown: the model, its box,
//! and the photographs beside it. [`live_view`] stands between a run and the pages that watch it.

#![forbid(unsafe_code)]

mod listener;
pub mod live_view;
pub mod page;
pub mod picture;
pub mod protocol;
pub mod render_thread;
pub mod scene;
pub mod server;

pub use live_view::LiveView;
pub use scene::Scene;
pub use server::{Listener, Server};
