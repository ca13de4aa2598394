//! Shows a model in a browser until the process ends.
//!
//! `cargo run --release -p trimip-view --example viewer -- runs/example`

use std::path::Path;
use trimip::{Error, Result};
use trimip_view::{Callbacks, Listener, Scene, Server};

fn main() -> Result<()> {
    let model = std::env::args().nth(1);
    let model = model.ok_or_else(|| Error::input("arguments", "none", "name a run folder or model file"))?;
    let server = open(Path::new(&model))?;
    println!("open {} in a browser; Ctrl-C ends", server.address);
    loop {
        std::thread::park();
    }
}

/// Serves the model on a free port of this machine.
pub fn open(model: &Path) -> Result<Server> {
    let (scene, renderers) = Scene::open(model, &[])?;
    let listener = Listener::bind(([127, 0, 0, 1], 0).into())?;
    Server::open(listener, scene, renderers, Callbacks::default())
}
