//! `train`: plans, trains or resumes, evaluates and reports.

use crate::{
    args::{ProgressStyle, TrainArguments},
    interrupt,
    measures::table,
    progress::{Display, Reading},
    ranks, settings, terminal,
};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::Instant;
use trimip::run::Recorded;
use trimip::{Listeners, Outcome, Result, RunFolder, Trained, Training, backends, events::Event};
use trimip_core::run::Observer;
use trimip_view::LiveView;

/// Trains with the given settings. All input is validated before any long work begins.
pub fn run(arguments: &TrainArguments) -> Result<u8> {
    let started = Instant::now();
    let (scene, file) = (&arguments.scene.folder, &arguments.settings.config);
    let system = arguments.settings.system.as_deref();
    let root = arguments
        .out
        .clone()
        .unwrap_or_else(|| settings::default_folder(file.as_deref(), scene.as_deref(), system));
    let training = match &arguments.continue_for {
        Some(time) => extension(arguments, &root, time)?,
        None => {
            let (given, config) = settings::load_scene(&arguments.scene, &arguments.settings)?;
            backends::check(&config.backend)?;
            if let Some(file) = file {
                RunFolder::new(&root).spare(file)?;
            }
            Training::new(given, &root).overwrite(arguments.fresh)
        }
    };
    let live_view = arguments.view.then(|| watched(&root, arguments.port)).transpose()?;
    let training = training.max_steps(arguments.stop_after).since(started).with_ranks(ranks::all());
    let display = Display::new(arguments.progress, arguments.verbose);
    let trained = train_before(live_view, training, &display)?;
    conclude(&trained, arguments.progress)
}

/// Returns the training that extends the finished run of a folder by `time`.
fn extension(arguments: &TrainArguments, root: &Path, time: &str) -> Result<Training> {
    let seconds = settings::duration("--continue-for", time)?;
    let mut sets = Vec::new();
    if let Some(root) = &arguments.scene.folder {
        sets.push(format!("data.root={}", trimip::SettingValue::from(settings::scene_root(root)?)));
    }
    sets.extend(arguments.settings.set.iter().cloned());
    Ok(Training::extend(root, seconds, sets))
}

/// Binds the live view of a run folder and prints its address.
fn watched(root: &Path, port: u16) -> Result<LiveView> {
    let name = root.file_name().map_or_else(|| "run".into(), |name| name.to_string_lossy().into_owned());
    let at = SocketAddr::new(Ipv4Addr::LOCALHOST.into(), port);
    let live_view = LiveView::bind(at, name, interrupt::install()?)?;
    terminal::aside(format!("watch at {} once the first step is done", live_view.address()));
    Ok(live_view)
}

/// Trains with progress on the terminal; Ctrl-C stops it.
///
/// # Errors
/// When the settings, the data, the folder or the device are refused.
pub fn train(training: Training, style: ProgressStyle) -> Result<Trained> {
    train_before(None, training, &Display::new(style, false))
}

/// Like [`train`], with progress on `display` and, if there is one, in a live view.
fn train_before(live_view: Option<LiveView>, training: Training, display: &Display) -> Result<Trained> {
    let stop = interrupt::install()?;
    let mut nobody = ();
    let mut observer = live_view.clone();
    let reading = Reading::default();
    let mut events = |event: &Event| {
        // The first event follows the planning and precedes the first step.
        interrupt::saves();
        reading.finish();
        display.show(event);
        if let Some(live_view) = &live_view {
            live_view.handle(event);
        }
    };
    let rows = |done, total| {
        reading.rows(done, total);
        !stop.load(Ordering::Relaxed)
    };
    let observer: &mut dyn Observer = match &mut observer {
        Some(live_view) => live_view,
        None => &mut nobody,
    };
    let listeners = Listeners { events: &mut events, reading: &rows, observer, stop: &stop };
    let trained = training.run_with(listeners);
    reading.finish();
    trained
}

/// Writes the report, whatever the outcome, and returns the exit code.
///
/// # Errors
/// When the training failed or missed its quality floor, or when its results could not be written.
pub fn conclude(trained: &Trained, style: ProgressStyle) -> Result<u8> {
    let recorded = Recorded::of(trained);
    let written = trimip_report::write(&recorded);
    let ended = match &trained.outcome {
        Ok(Outcome::AlreadyComplete) => return written.and_then(|()| already_finished(trained, style)),
        other => other,
    };
    if let Some(last) = recorded.history.last() {
        terminal::note(format!("verdict: {}", recorded.report().verdict().words()));
        if last.bounded {
            let measured = last.scales.iter().map(|scale| scale.images).max().unwrap_or(0);
            terminal::note(format!(
                "measured on {measured} of {}, as many as eval.time_fraction allowed; trimip-cli eval {} measures all",
                terminal::count(last.frames as u64, "test view"),
                recorded.folder.root().display()
            ));
        }
    }
    let ended = ended.clone()?;
    written?;
    if let Some(error) = &trained.unwritten {
        return Err(error.clone());
    }
    terminal::note(format!("report: {}", recorded.folder.html().display()));
    let interrupted = interrupt::install()?.load(Ordering::Relaxed);
    Ok(if ended == Outcome::Stopped && interrupted { interrupt::EXIT_CODE } else { 0 })
}

/// Reports that the folder already holds this run, finished. The caller has rewritten the report, because an earlier
/// stop or a different quality floor may have left another one.
fn already_finished(trained: &Trained, style: ProgressStyle) -> Result<u8> {
    let finished = vec![format!(
        "finished: {} holds this run, {}, trained and evaluated; --fresh trains it again",
        trained.folder.root().display(),
        terminal::count(trained.history.totals.step, "step")
    )];
    Display::new(style, false).show(&Event::Plan {
        lines: finished.clone(),
        summary: finished,
        memory_bytes: 0,
    });
    if let Some(last) = trained.history.last().filter(|_| terminal::watched()) {
        table(&last.scales).iter().for_each(terminal::prose);
    }
    trained.judge().map(|()| 0)
}
