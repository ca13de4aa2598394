//! The program of the README: trains on a folder of photographs and renders one of its cameras.
//!
//! `cargo run --release -p trimip --example first -- FOLDER`

use std::path::Path;
use trimip::{Error, Training, backends, data, events::Event, settings, view};

fn main() -> trimip::Result<()> {
    let folder = std::env::args().nth(1);
    let folder =
        folder.ok_or_else(|| Error::input("arguments", "no folder", "name a folder of photographs"))?;
    first(&folder, 60.0, Path::new("runs/first"))
}

/// Trains for `seconds` on the photographs of `folder`, then renders the first camera to `out/view.png`.
pub fn first(folder: &str, seconds: f64, out: &Path) -> trimip::Result<()> {
    let settings = settings::defaults().with("data.root", folder)?.with("train.seconds", seconds)?;
    let trained = Training::new(settings, out).run(&mut |event: &Event| println!("{event:?}"))?;
    let camera = data::open(&trained.config.section()?)?.train.views[0].camera;
    let frame = backends::load(&trained.model()?)?.render(&camera)?;
    view::pictures::write_frame(&out.join("view.png"), &frame)
}
