//! `eval`: measures a model per scale on its test set.

use crate::{args::EvalArguments, interrupt, measures::table, progress::bar, ranks, terminal};
use indicatif::ProgressBar;
use serde_json::json;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use trimip::run::folder as run_folder;
use trimip::view::{
    PIXELS_PER_DEGREE, PerceptualMetrics, RankGroup, TestViews, Watching, evaluate, evaluate_on_worker,
};
use trimip::{Error, Result, backends, settings};
use trimip_core::{
    atomic::write_atomically, engine::exchange::Ranks, measures::quality::Remedy, run::evaluate::ViewResult,
};

/// Evaluates a model; the exit code is 1 if it misses `eval.min_psnr`.
pub fn run(arguments: &EvalArguments) -> Result<u8> {
    let mut model = run_folder::read_model(&arguments.model)?;
    settings::override_model(&mut model, &arguments.set)?;
    let config = model.config.clone();
    backends::check(&config.backend)?;
    let mut perceptual = PerceptualMetrics::open(&config.eval)?;
    if let Some(parent) = arguments.json.as_deref().and_then(|path| path.parent()) {
        run_folder::create_writable(if parent.as_os_str().is_empty() { ".".as_ref() } else { parent })?;
    }
    let stop = interrupt::install()?;
    let scene = trimip_data::open_test(&config.section()?)?;
    for warning in &scene.warnings {
        terminal::note(format!("warning: {warning}"));
    }
    let mut session = backends::load(&model)?;
    backends::software_remark(&config).iter().for_each(|remark| terminal::note(format!("warning: {remark}")));
    session.notes().iter().for_each(|note| terminal::note(format!("warning: {note}")));

    let stride = arguments.stride as usize;
    let bar = bar("{bar:20} {percent:>3} %  {wide_msg}", 1000);
    let mut watch = OnBar { bar: &bar, stop: &stop };
    let all = ranks::all();
    let (viewer, frames) = (session.as_mut(), scene.frames.as_ref());
    let test = TestViews { frames, data: &config.data, stride };
    let group = all.as_deref().map(|ranks| RankGroup { ranks, model: &model });
    let measured = evaluate(viewer, test, &mut perceptual, &mut watch, group)?;
    bar.finish_and_clear();
    let Some(measured) = measured else { return Ok(interrupt::EXIT_CODE) };

    table(&measured.scales).iter().for_each(terminal::prose);
    measured.mean.remark(Remedy::of(&config)).iter().for_each(terminal::prose);
    if let Some(path) = &arguments.json {
        let report = json!({
            "model": arguments.model.display().to_string(),
            "scene": scene.name,
            "backend": session.backend(),
            "stride": stride,
            "seconds": measured.seconds,
            "background": config.data.background,
            "edge_exponents": config.data.edge_exponents,
            "flip_pixels_per_degree": PIXELS_PER_DEGREE,
            "lpips": config.eval.lpips,
            "scales": measured.scales,
            "mean": measured.mean,
            "views": measured.views,
        });
        write_atomically(path, serde_json::to_string_pretty(&report).map_err(Error::run)?.as_bytes())?;
    }
    measured.mean.judge(&config.eval)?;
    Ok(0)
}

/// Does this rank's part of [`run`]; called on ranks other than 0.
///
/// # Errors
/// When the model or its test set cannot be opened on this machine.
pub fn work(arguments: &EvalArguments, ranks: &dyn Ranks) -> Result<()> {
    let mut model = run_folder::read_model(&arguments.model)?;
    settings::override_model(&mut model, &arguments.set)?;
    let mut perceptual = PerceptualMetrics::open(&model.config.eval)?;
    let scene = trimip_data::open_test(&model.config.section()?)?;
    let (mut viewer, frames) = (backends::load_beside(&model, ranks.on_machine())?, scene.frames.as_ref());
    let stride = arguments.stride as usize;
    let test = TestViews { frames, data: &model.config.data, stride };
    let mut watch = Interrupted(interrupt::install()?);
    let group = RankGroup { ranks, model: &model };
    evaluate_on_worker(viewer.as_mut(), test, &mut perceptual, &mut watch, group)
}

/// Stops rendering after the user pressed Ctrl-C.
struct Interrupted(Arc<AtomicBool>);

impl Watching for Interrupted {
    fn rendering(&mut self, _: usize, _: usize, _: f64) -> bool {
        !self.0.load(Ordering::Relaxed)
    }
}

/// Advances a bar with the rendered rows and stops after the user pressed Ctrl-C.
struct OnBar<'a> {
    bar: &'a ProgressBar,
    stop: &'a AtomicBool,
}

impl Watching for OnBar<'_> {
    fn rendering(&mut self, done: usize, total: usize, part: f64) -> bool {
        self.bar.set_position((1000.0 * (done as f64 + part) / total.max(1) as f64) as u64);
        !self.stop.load(Ordering::Relaxed)
    }

    fn view(&mut self, view: &ViewResult<'_>, done: usize, total: usize) -> bool {
        let (at, name) = (done + 1, view.name);
        self.bar.set_message(format!("view {at} of {total}  {name} 1/{}: {:.2} dB", view.scale, view.psnr));
        !self.stop.load(Ordering::Relaxed)
    }
}
