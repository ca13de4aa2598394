//! `view`: shows a model in a browser, until Ctrl-C.

use crate::{args::ViewArguments, interrupt, terminal};
use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::Duration;
use trimip::backends;
use trimip::run::keep_crop;
use trimip_core::Result;
use trimip_view::server::Keep;
use trimip_view::{Callbacks, Listener, Scene, Server};

/// Interval at which the program checks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// Opens the model and serves it until Ctrl-C.
pub fn run(arguments: &ViewArguments) -> Result<u8> {
    let (mut scene, renderers) = Scene::open(&arguments.model, &arguments.set)?;
    scene.cropped = arguments.crop.opens(&mut scene.config);
    backends::software_remark(&scene.config)
        .iter()
        .for_each(|remark| terminal::aside(format!("warning: {remark}")));
    scene.notes.iter().for_each(|note| terminal::aside(format!("warning: {note}")));
    let stop = interrupt::install()?;
    let model = arguments.model.clone();
    // Only pages on this machine may change the model.
    let keep: Option<Keep> =
        arguments.bind.is_loopback().then(|| Box::new(move |crop| keep_crop(&model, crop)) as Keep);
    let callbacks = Callbacks { keep, ..Callbacks::default() };
    let listener = Listener::bind(SocketAddr::new(arguments.bind, arguments.port))?;
    let server = Server::open(listener, scene, renderers, callbacks)?;
    if !arguments.bind.is_loopback() {
        terminal::aside(
            "warning: everybody who knows the address below can see the model, and nothing is encrypted",
        );
    }
    terminal::line(&server.address);
    terminal::aside("open this address in a browser; Ctrl-C ends");
    while !stop.load(Ordering::Relaxed) {
        thread::sleep(LOOK);
    }
    Ok(0)
}
