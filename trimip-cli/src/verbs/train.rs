//! `train`: plan, train or resume, evaluate, report.

use crate::{
    args::TrainArguments,
    backends,
    fresh::report_is_fresh,
    history::{Evaluation, History, up_to},
    interrupt, machine,
    machine::Machine,
    plan::{Plan, Subject},
    progress::{Display, Recorder, open, table},
    report::{Report, Status, provenance},
    run_folder::RunFolder,
    settings,
    store::FileStore,
    terminal,
};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use trimip_core::{
    Config, Error, Result, Settings, adamw,
    checkpoint::Checkpoint,
    config::TrainConfig,
    evaluate::mean_quality,
    events::{Event, EventSink, Totals},
    run::{Outcome, Run, progress},
    scene_plan::{self, Facts, Finding},
    tensors::write_atomically,
};

/// Trains what the settings say; everything that can be refused is refused before anything long begins.
pub fn run(arguments: &TrainArguments) -> Result<u8> {
    let started = Instant::now();
    let (scene, file) = (&arguments.scene.folder, &arguments.settings.config);
    let root =
        arguments.out.clone().unwrap_or_else(|| settings::default_folder(file.as_deref(), scene.as_deref()));
    let folder = RunFolder::new(&root);
    if let Some(time) = &arguments.continue_for {
        return extend(arguments, &folder, time, started);
    }
    let (given, config) = settings::load_scene(&arguments.scene, &arguments.settings)?;
    backends::check(&config.backend)?;
    if let Some(file) = file {
        folder.spare(file)?;
    }
    folder.expect_no_others()?;
    folder.prepare()?;
    let _held = folder.lock()?;
    // A run that goes on keeps the plan it began with; another one is planned when its scene is known.
    let (mut settings, mut findings) = (given.clone(), Vec::new());
    let earlier = if arguments.fresh { None } else { folder.findings()? };
    if let Some(earlier) = earlier {
        scene_plan::adopt(&mut settings, &earlier)?;
        findings = earlier;
        keep_extension(&mut settings, &folder)?;
    }
    let config = Config::from_settings(&settings)?;
    let checkpoint = if arguments.fresh { None } else { folder.resume_point(&config)? };
    if let Some(checkpoint) = &checkpoint
        && let Some(code) = finished(arguments, &folder, &settings, &config, checkpoint)?
    {
        return Ok(code);
    }
    let begin =
        Beginning { settings: if checkpoint.is_some() { settings } else { given }, findings, checkpoint };
    go(arguments, &folder, begin, None, started)
}

/// Keeps the budget to which an earlier `--continue-for` extended the folder's run, where the given one is no longer: the
/// command that began a run goes on with it, and finds it finished.
fn keep_extension(settings: &mut Settings, folder: &RunFolder) -> Result<()> {
    let extended = || folder.events().iter().any(|event| matches!(event, Event::Extended { .. }));
    let Ok(text) = std::fs::read_to_string(folder.config()) else { return Ok(()) };
    if !extended() {
        return Ok(());
    }
    let kept = Config::from_toml(&folder.config().display().to_string(), &text)?.train;
    let given = Config::from_settings(settings)?.train;
    if given.steps > 0 && given.steps < kept.steps {
        settings.decide("train.steps", &kept.steps.to_string())?;
    } else if given.steps == 0 && kept.steps == 0 && given.seconds < kept.seconds {
        settings.decide("train.seconds", &format!("{:?}", kept.seconds))?;
    }
    Ok(())
}

/// What a run begins with.
struct Beginning {
    settings: Settings,
    /// What the plan decided, where the run goes on.
    findings: Vec<Finding>,
    checkpoint: Option<Checkpoint>,
}

/// Goes on with the finished run of a folder for `time` longer, with the settings that it was trained with.
fn extend(arguments: &TrainArguments, folder: &RunFolder, time: &str, started: Instant) -> Result<u8> {
    let more = settings::duration("--continue-for", time)?;
    if !folder.checkpoint().exists() {
        return Err(Error::input(
            folder.root().display(),
            "holds no run to go on with",
            "name the folder of the run with --out, or leave --continue-for out to train one",
        ));
    }
    let _held = folder.lock()?;
    let checkpoint = Checkpoint::read(&folder.checkpoint())?;
    let totals = checkpoint.state.totals;
    if progress(&checkpoint.config, &totals) < 1.0 {
        return Err(Error::input(
            folder.root().display(),
            format!("its run is not finished ({:.0} %)", 100.0 * progress(&checkpoint.config, &totals)),
            "finish it first: leave --continue-for out, and give the folder or configuration that it was begun with",
        ));
    }
    let mut settings = Settings::defaults();
    settings.apply_file(&folder.config().display().to_string(), &checkpoint.config.to_toml())?;
    let findings = folder.findings()?.unwrap_or_default();
    for change in findings.iter().flat_map(|finding| &finding.changes) {
        let now = settings.value(&change.path);
        settings.decide(&change.path, &now)?;
    }
    let mut sets = Vec::new();
    if let Some(root) = &arguments.scene.folder {
        sets.push(format!("data.root={}", toml::Value::String(settings::scene_root(root)?)));
    }
    sets.extend(arguments.settings.set.iter().cloned());
    sets.iter().try_for_each(|set| settings.apply_assignment(set))?;
    let old = &checkpoint.config.train;
    // Of a run of steps, as many more as take the time.
    let budget = match old.steps {
        0 => format!("train.seconds={:?}", old.seconds.max(totals.seconds) + more),
        steps => {
            let rate = totals.step as f64 / totals.seconds.max(f64::MIN_POSITIVE);
            format!("train.steps={}", steps + (rate * more).ceil().max(1.0) as u64)
        }
    };
    settings.apply_assignment(&budget)?;
    let config = Config::from_settings(&settings)?;
    checkpoint.expect_config(
        &folder.checkpoint().display().to_string(),
        &Config {
            train: TrainConfig { steps: old.steps, seconds: old.seconds, ..config.train.clone() },
            ..config.clone()
        },
    )?;
    let at = progress(&config, &totals);
    let message = format!(
        "extended: goes on for {} after {}; the schedule stretches to the new length and stands at {:.0} % of it: learning rate \
         {:.1e}, marching step {}",
        terminal::duration(more),
        terminal::duration(totals.seconds),
        100.0 * at,
        adamw::learning_rate(&config.optimizer, at),
        config.renderer.step_scale.at(at)
    );
    go(
        arguments,
        folder,
        Beginning { settings, findings, checkpoint: Some(checkpoint) },
        Some(message),
        started,
    )
}

/// Opens the scene, plans where that is not done, and trains; `extended` says how a finished run goes on.
fn go(
    arguments: &TrainArguments,
    folder: &RunFolder,
    begin: Beginning,
    extended: Option<String>,
    started: Instant,
) -> Result<u8> {
    let Beginning { mut settings, mut findings, checkpoint } = begin;
    let mut config = Config::from_settings(&settings)?;
    folder.prepare()?;
    let stop = interrupt::install()?;
    let scene = open(&config.data)?;
    let (compute, test) = (backends::compute(&config)?, scene.test.cameras());
    let facts = Facts { train: &scene.train, test: &test, stated: scene.stated.as_ref(), compute: &compute };
    if checkpoint.is_none() {
        findings = scene_plan::make(&mut settings, &facts)?;
        config = Config::from_settings(&settings)?;
    }
    let doubts = scene_plan::warnings(&config, &facts);
    let totals = checkpoint.as_ref().map_or_else(Totals::default, |checkpoint| checkpoint.state.totals);
    let subject = Subject {
        name: &scene.name,
        description: &scene.description,
        train: &scene.train,
        test: scene.test.as_ref(),
    };
    let memory = backends::predict_memory(&config, &scene.train);
    let plan = Plan::new(&config, &subject, &findings, &memory, folder.root(), totals.step);
    // A GPU has memory of its own, and says itself what it has no room for.
    let on_host = config.backend == "cpu";
    let mut warnings = scene.warnings.clone();
    warnings.extend(doubts);
    warnings.extend(on_host.then(|| plan.memory_warning(&Machine::detect())).flatten());
    warnings.extend(backends::software_warning(&config));
    let mut session = backends::train(&config, scene.train)?;
    let resumed = checkpoint.is_some();
    // What was read is not needed beside what it was read into.
    if let Some(checkpoint) = checkpoint {
        session.restore(&checkpoint)?;
    }

    // Nothing of an earlier run is touched before everything that can be refused was refused.
    if arguments.fresh {
        folder.clear()?;
    }
    // Without a checkpoint the run begins at its beginning, and so do its events.
    let kept = if resumed { up_to(folder.events(), totals.step) } else { Vec::new() };
    let mut recorder = Recorder::new(folder, &kept, Display::new(arguments.progress))?;
    // The first event is the run's mark on its folder: it stands before every other file.
    recorder.emit(&Event::Plan { lines: plan.lines, memory_bytes: plan.memory_bytes });
    if !resumed {
        folder.write_findings(&findings)?;
    }
    folder.prepare_images()?;
    write_atomically(&folder.config(), config.to_toml().as_bytes())?;
    for message in warnings {
        recorder.emit(&Event::Warning { message });
    }
    match extended {
        Some(message) => recorder.emit(&Event::Extended { totals, message }),
        None if resumed => recorder.emit(&Event::Resumed { totals }),
        None => {}
    }
    let mut store = FileStore::new(folder, config.eval.images as usize);
    let last_step = arguments.stop_after.map_or(u64::MAX, |steps| totals.step.saturating_add(steps));
    let outcome = Run {
        config: &config,
        session: session.as_mut(),
        frames: scene.test.as_ref(),
        store: &mut store,
        events: &mut recorder,
        stop: &stop,
    }
    .train_until(totals, last_step);

    recorder.emit(&Event::SessionEnded {
        backend: session.backend().to_string(),
        device: session.device_name(),
        wall_seconds: started.elapsed().as_secs_f64(),
        peak_memory_bytes: machine::peak_memory(),
        provenance: provenance::here_and_now(scene.test.len()),
    });
    if recorder.history.last().is_some() && !matches!(outcome, Ok(Outcome::Stopped)) {
        store.finish()?;
    }
    conclude(outcome, &mut recorder, folder, &scene.name, &config, &settings, &stop)
}

/// When the folder holds this very run, trained and evaluated: says so, writes its report anew where it is stale, and gives its exit code.
fn finished(
    arguments: &TrainArguments,
    folder: &RunFolder,
    settings: &Settings,
    config: &Config,
    checkpoint: &Checkpoint,
) -> Result<Option<u8>> {
    let totals = checkpoint.state.totals;
    let history = History::of(&up_to(folder.events(), totals.step));
    if progress(config, &totals) < 1.0 || !folder.model().exists() || !evaluated(config, &history, &totals) {
        return Ok(None);
    }
    let floor = history.last().map_or(Ok(()), |e| mean_quality(&e.scales).judge(&config.eval));
    if !report_is_fresh(folder) {
        let status =
            floor.as_ref().map_or_else(|error| Status::Failed(error.message.clone()), |()| Status::Finished);
        let scene = scene_name(config);
        Report::gather(folder, status, &scene, config, settings, &history).write(folder)?;
    }
    Display::new(arguments.progress).show(&Event::Plan {
        lines: vec![format!(
            "finished: {} holds this run, {}, trained and evaluated; --fresh trains it again",
            folder.root().display(),
            terminal::count(totals.step, "step")
        )],
        memory_bytes: 0,
    });
    if let Some(last) = history.last().filter(|_| terminal::watched()) {
        table(&last.scales).iter().for_each(terminal::prose);
    }
    floor.map(|()| Some(0))
}

/// True when the history holds the final evaluation that the configuration asks for.
fn evaluated(config: &Config, history: &History, totals: &Totals) -> bool {
    let bounded = config.eval.share > 0.0;
    let asked = |e: &Evaluation| e.bounded && bounded || config.eval.final_stride(e.frames) == Some(e.stride);
    config.eval.final_stride(1).is_none()
        || history.last().is_some_and(|e| e.totals.step == totals.step && asked(e))
}

/// What the scene is called where its data is not opened: the data folder's name.
fn scene_name(config: &Config) -> String {
    let name = Path::new(&config.data.root).file_name();
    name.map_or_else(|| "builtin".to_string(), |name| name.to_string_lossy().into_owned())
}

/// Writes the report whatever the outcome was, then returns it as exit code or error.
fn conclude(
    outcome: Result<Outcome>,
    recorder: &mut Recorder,
    folder: &RunFolder,
    scene: &str,
    config: &Config,
    settings: &Settings,
    stop: &AtomicBool,
) -> Result<u8> {
    let status = match &outcome {
        Ok(Outcome::Finished) => Status::Finished,
        Ok(Outcome::Stopped) => Status::Stopped,
        Err(error) => Status::Failed(error.message.clone()),
    };
    let report = Report::gather(folder, status, scene, config, settings, &recorder.history);
    let written = report.write(folder);
    if let Some(last) = recorder.history.last() {
        terminal::note(format!("verdict: {}", report.verdict().words()));
        if last.bounded {
            let measured = last.scales.iter().map(|scale| scale.images).max().unwrap_or(0);
            terminal::note(format!(
                "measured on {measured} of {}, as many as eval.share had time for; trimip-cli eval {} measures all",
                terminal::count(last.frames as u64, "test view"),
                folder.root().display()
            ));
        }
    }
    let outcome = outcome?;
    written?;
    if let Some(error) = recorder.take_failure() {
        return Err(error);
    }
    terminal::note(format!("report: {}", folder.html().display()));
    Ok(if outcome == Outcome::Stopped && stop.load(Ordering::Relaxed) { interrupt::EXIT_CODE } else { 0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::tests::evaluation;

    #[test]
    fn a_run_is_finished_when_the_evaluation_asked_for_is_there() {
        let mut config = Config::default();
        config.train.steps = 40;
        let totals = Totals { step: 40, ..Totals::default() };
        assert_eq!(progress(&config, &totals), 1.0);
        let history = History::of(&[evaluation(40, 1, true, 25.0)]);
        assert!(evaluated(&config, &history, &totals));
        assert!(!evaluated(&config, &History::default(), &totals));
        config.eval.r#final = trimip_core::config::FinalEval::Stride(2);
        assert!(!evaluated(&config, &history, &totals));
        config.eval.r#final = trimip_core::config::FinalEval::Flag(false);
        assert!(evaluated(&config, &History::default(), &totals));
    }
}
