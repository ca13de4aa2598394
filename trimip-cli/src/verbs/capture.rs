//! `capture`: makes a scene from a film or from photographs without cameras. With `--train`, also trains a model and
//! writes a film and a page.

use super::{export, render, train};
use crate::{
    args::{Arguments, CaptureArguments, ProgressStyle, SettingsArguments, Verb},
    capture_display::Display,
    interrupt, settings, terminal,
};
use clap::Parser;
use std::path::Path;
use trimip::{Error, Result, backends};
use trimip_capture::{Captured, Event, programs, quoted, quoted_path};

/// Number of frames of the film, and longest side of these frames in pixels.
const FRAMES: u32 = 120;
const LONGEST: u32 = 640;

/// Path of the page's program, which `tools/web.sh` builds.
const PAGE: &str = "target/web/trimip_web.js";

/// Makes the capture and, with `--train`, trains on the scene.
pub fn run(arguments: &CaptureArguments) -> Result<u8> {
    if let Some(minutes) = arguments.minutes.filter(|minutes| !(minutes.is_finite() && *minutes > 0.0)) {
        return Err(Error::input(
            format!("--minutes {minutes}"),
            "is not a duration",
            "give a number above 0",
        ));
    }
    if arguments.train {
        let set = arguments.set.clone();
        let (_, config) = settings::load(&SettingsArguments { set, ..SettingsArguments::default() })?;
        backends::check(&config.backend)?;
    }
    let stop = interrupt::install_for(
        "stopping; the same command continues from here; press Ctrl-C again to end at once",
    )?;
    // Every stage that is done is kept, and the programs that this one started have to end first.
    interrupt::saves();
    let display = Display::new(arguments.progress);
    let captured = trimip_capture::run(&arguments.request(), &stop, &|event| display.show(event));
    if let Ok(captured) = &captured
        && !arguments.train
    {
        display.show(&Event::Note { text: &format!("next: trimip-cli {}", quoted_path(&captured.root)) });
    }
    display.finish();
    let captured = captured?;
    if !arguments.train {
        return Ok(0);
    }
    let root = path_of(&captured.root);
    let mut words = vec!["train".to_string(), root];
    if let Some(minutes) = arguments.minutes {
        words.extend(["--minutes".into(), minutes.to_string()]);
    }
    words.extend(arguments.set.iter().flat_map(|set| ["--set".into(), set.clone()]));
    match arguments.progress {
        ProgressStyle::Auto => {}
        ProgressStyle::Bar => words.extend(["--progress".into(), "bar".into()]),
        ProgressStyle::Json => words.extend(["--progress".into(), "json".into()]),
    }
    let code = command(&words)?;
    if code != 0 {
        return Ok(code);
    }
    show(&captured)
}

/// Writes a film along the cameras and a page of the trained model, if the programs that they need are installed.
fn show(captured: &Captured) -> Result<u8> {
    let run = settings::default_folder(None, Some(&captured.root), None);
    let (run_name, film) = (path_of(&run), path_of(&run.join("flythrough.mp4")));
    if programs::find("ffmpeg").is_some() {
        let [width, height] = captured.size;
        let width = (u64::from(width) * u64::from(LONGEST) / u64::from(width.max(height).max(1))).max(16);
        let mut words =
            vec!["render".to_string(), run_name.clone(), "--flythrough".into(), FRAMES.to_string()];
        words.extend(["--width".into(), width.min(u64::from(captured.size[0]).max(16)).to_string()]);
        words.extend(["--out".into(), path_of(&run.join("flythrough")), "--video".into(), film]);
        let code = command(&words)?;
        if code != 0 {
            return Ok(code);
        }
    } else {
        terminal::aside("no film: there is no ffmpeg on this machine");
    }
    if Path::new(PAGE).is_file() {
        return command(&["export".into(), "web".into(), run_name]);
    }
    terminal::aside(format!(
        "no page: {PAGE} is missing; build it with tools/web.sh, then run: trimip-cli export web {}",
        quoted_path(&run)
    ));
    Ok(0)
}

/// Prints a command and runs it in this process.
fn command(words: &[String]) -> Result<u8> {
    let told: Vec<String> = words.iter().map(|word| quoted(word)).collect();
    terminal::aside(format!("trimip-cli {}", told.join(" ")));
    let program = std::iter::once("trimip-cli".to_string());
    let parsed = Arguments::try_parse_from(program.chain(words.iter().cloned()));
    match parsed.map_err(Error::run)?.verb {
        Some(Verb::Train(arguments)) => train::run(&arguments),
        Some(Verb::Render(arguments)) => render::run(&arguments),
        Some(Verb::Export(arguments)) => export::run(&arguments),
        _ => Err(Error::run("capture cannot run this command")),
    }
}

/// Returns a path as an argument that cannot be read as an option.
fn path_of(path: &Path) -> String {
    let plain = path.display().to_string();
    if plain.starts_with('-') { format!("./{plain}") } else { plain }
}
