//! The viewer: shows a model in a browser. A page of plain JavaScript modules requests views over a web socket. One thread renders them,
//! coarsely while the camera moves and at full resolution when it stands still, and answers with JPEG pictures.
//!
//! Modules, in the direction of the data: [`protocol`] (requests of a page) → [`render_thread`] (the thread that renders) → [`picture`]
//! (from a frame to a picture) → [`server`] (the page, the socket, and access control). [`scene`] holds the visible content: the model, its
//! box, and the photographs. [`live_view`] connects a training run with the pages that watch it.

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
pub use server::{Callbacks, Listener, Server};
