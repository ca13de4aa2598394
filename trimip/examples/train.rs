//! Trains for a minute on a folder of photographs, or on the built-in scene, and writes a picture of the model.
//!
//! `cargo run --release -p trimip --example train -- [FOLDER] [SETTING=VALUE ..]`

use std::path::Path;
use trimip::{Training, backends, data, events::Event, settings, view};

fn main() -> trimip::Result<()> {
    run(&std::env::args().skip(1).collect::<Vec<_>>(), Path::new("runs/example"))
}

/// Trains into the run folder `out` as the arguments specify.
pub fn run(arguments: &[String], out: &Path) -> trimip::Result<()> {
    let mut settings = settings::defaults().with("train.seconds", 60)?.with("data.format", "builtin")?;
    for argument in arguments {
        match argument.contains('=') {
            true => settings.apply_assignment(argument)?,
            false => settings = settings.with("data.root", argument.as_str())?.with("data.format", "auto")?,
        }
    }
    let trained = Training::new(settings, out).run(&mut |event: &Event| {
        if let Event::Step { totals, batch_psnr, .. } = event {
            println!("step {}: {batch_psnr:.2} dB", totals.step);
        }
    })?;
    let camera = data::open(&trained.config.section()?)?.train.views[0].camera;
    let frame = backends::load(&trained.model()?)?.render(&camera)?;
    view::pictures::write_frame(&out.join("view.png"), &frame)
}
