//! Loads a model and renders one view of it.
//!
//! `cargo run --release -p trimip --example render -- runs/example view.png`

use std::path::Path;
use trimip::{Error, Intrinsics, backends, read_model, view};

fn main() -> trimip::Result<()> {
    run(&std::env::args().skip(1).collect::<Vec<_>>())
}

/// Renders a model to a picture file. The first argument names a run folder or model file, the second the picture.
pub fn run(arguments: &[String]) -> trimip::Result<()> {
    let [model, picture] = arguments else {
        return Err(Error::input("arguments", "not two", "name a run folder or model file, and a picture"));
    };
    let model = read_model(Path::new(model))?;
    let table = view::turntable::Turntable { count: 1, elevation: 30.0, ..Default::default() };
    let intrinsics = Intrinsics::from_angle(64, 48, 0.7);
    let cameras = view::turntable::cameras(&model.config.scene, &table, intrinsics)?;
    let frame = backends::load(&model)?.render(&cameras[0].1)?;
    view::pictures::write_frame(Path::new(picture), &frame)
}
