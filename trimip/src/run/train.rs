//! Training into a run folder: plan, train or go on, evaluate. Everything that can be refused is refused before anything
//! long begins, and nothing of an earlier run is touched before that.

use super::{
    begin::Beginning,
    folder::{RunFolder, read_model},
    guard::Lock,
    history::{History, up_to},
    overview::{Overview, Subject},
    provenance,
    recorder::Recorder,
    store::FileStore,
};
use crate::{backends, machine};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;
use trimip_core::{
    Config, Error, Result, Settings,
    evaluate::mean_quality,
    events::{Event, EventSink, Totals},
    model::Model,
    run::{Outcome, Run},
    scene_plan::{self, Facts},
    tensors::write_atomically,
};
use trimip_data::Watch;

/// Who is told of a training, and who stops it.
pub struct Listeners<'a> {
    /// Takes every event of the run.
    pub events: &'a mut dyn EventSink,
    /// Is told how many rows of the photographs are read, and of how many.
    pub reading: Watch<'a>,
    /// Once it is true the run stops after the current step and saves.
    pub stop: &'a AtomicBool,
}

/// A training to be run.
#[derive(Clone, Debug)]
pub struct Training {
    folder: RunFolder,
    work: Work,
    stop_after: Option<u64>,
    started: Instant,
}

#[derive(Clone, Debug)]
enum Work {
    /// Train these settings; replace an earlier run where it is to be fresh.
    Train { settings: Box<Settings>, fresh: bool },
    /// Train a finished run for these seconds longer, with these assignments over its settings.
    Extend { seconds: f64, assignments: Vec<String> },
}

/// How a training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The schedule is done and the final evaluation made.
    Finished,
    /// It was asked to stop; the checkpoint is written.
    Stopped,
    /// The folder held this very run, trained and evaluated; nothing was done.
    Before,
}

/// What came of a training. The folder is held for this process until it is dropped.
#[derive(Debug)]
pub struct Trained {
    /// The run's folder.
    pub folder: RunFolder,
    /// Name of the scene.
    pub scene: String,
    /// The effective configuration, scene plan included.
    pub config: Config,
    /// The same with origins.
    pub settings: Settings,
    /// The course of the run.
    pub history: History,
    /// How it ended, or why it failed; what was trained before a failure is saved.
    pub outcome: Result<Ended>,
    /// The first failure to write events to the folder.
    pub unwritten: Option<Error>,
    _held: Lock,
}

impl Trained {
    /// The model as the folder holds it: the finished one, or that of the last checkpoint.
    ///
    /// # Errors
    /// When the training failed before there was one.
    pub fn model(&self) -> Result<Model> {
        read_model(self.folder.root())
    }

    /// Size of the model file, bytes; `None` where the run is not finished.
    pub fn model_bytes(&self) -> Option<u64> {
        std::fs::metadata(self.folder.model()).ok().map(|metadata| metadata.len())
    }

    /// Holds the final evaluation against `eval.min_psnr` and `eval.min_gain`.
    ///
    /// # Errors
    /// When it misses one of them.
    pub fn judge(&self) -> Result<()> {
        let last = self.history.last();
        last.map_or(Ok(()), |e| mean_quality(&e.scales).judge(&self.config.eval))
    }
}

impl Training {
    /// Trains `settings` into a folder. A run of the same settings that is there goes on, and is not run again where it is
    /// finished.
    pub fn new(settings: Settings, folder: &Path) -> Self {
        Self::of(folder, Work::Train { settings: Box::new(settings), fresh: false })
    }

    /// Goes on with the finished run of a folder for `seconds` longer; `assignments`, each `section.key=value`, change
    /// settings that do not belong to the model.
    pub fn extend(folder: &Path, seconds: f64, assignments: Vec<String>) -> Self {
        Self::of(folder, Work::Extend { seconds, assignments })
    }

    fn of(folder: &Path, work: Work) -> Self {
        Self { folder: RunFolder::new(folder), work, stop_after: None, started: Instant::now() }
    }

    /// Replaces the run that is in the folder.
    #[must_use]
    pub fn fresh(mut self, wanted: bool) -> Self {
        if let Work::Train { fresh, .. } = &mut self.work {
            *fresh = wanted;
        }
        self
    }

    /// Stops after this many steps and saves, as if asked to; the same training goes on from there.
    #[must_use]
    pub fn stop_after(mut self, steps: Option<u64>) -> Self {
        self.stop_after = steps;
        self
    }

    /// Counts the run's wall time from here; without this call from the making of the `Training`.
    #[must_use]
    pub fn since(mut self, started: Instant) -> Self {
        self.started = started;
        self
    }

    /// Trains; `events` takes every event of the run.
    ///
    /// # Errors
    /// When the settings, the data, the folder or the device are refused, or when the training fails.
    pub fn run(self, events: &mut dyn EventSink) -> Result<Trained> {
        let stop = AtomicBool::new(false);
        let trained = self.run_with(Listeners { events, reading: &trimip_data::unwatched, stop: &stop })?;
        trained.outcome.clone()?;
        Ok(trained)
    }

    /// Trains with listeners. A failure in the course of the training stands in [`Trained::outcome`].
    ///
    /// # Errors
    /// When the settings, the data, the folder or the device are refused.
    pub fn run_with(self, listeners: Listeners<'_>) -> Result<Trained> {
        let folder = &self.folder;
        let (begin, held) = match &self.work {
            Work::Train { settings, fresh } => {
                backends::check(&Config::from_settings(settings)?.backend)?;
                folder.expect_no_others()?;
                folder.prepare()?;
                let held = folder.lock()?;
                (Beginning::of(settings.as_ref().clone(), folder, *fresh)?, held)
            }
            Work::Extend { seconds, assignments } => {
                if !folder.checkpoint().exists() {
                    return Err(Error::input(
                        folder.root().display(),
                        "holds no run to go on with",
                        "name the folder of the run with --out, or leave --continue-for out to train one",
                    ));
                }
                let held = folder.lock()?;
                (Beginning::extend(folder, *seconds, assignments)?, held)
            }
        };
        if let Some(history) = begin.finished(folder)? {
            let config = Config::from_settings(&begin.settings)?;
            return Ok(Trained {
                folder: folder.clone(),
                scene: scene_name(&config),
                config,
                settings: begin.settings,
                history,
                outcome: Ok(Ended::Before),
                unwritten: None,
                _held: held,
            });
        }
        self.go(begin, held, listeners)
    }

    /// Opens the scene, plans where that is not done, and trains.
    fn go(&self, begin: Beginning, held: Lock, listeners: Listeners<'_>) -> Result<Trained> {
        let Beginning { mut settings, mut findings, checkpoint, extended } = begin;
        let folder = &self.folder;
        let mut config = Config::from_settings(&settings)?;
        folder.prepare()?;
        let scene = trimip_data::open_watched(&config.data, listeners.reading)?;
        let (compute, test) = (backends::compute(&config)?, scene.test.cameras());
        let facts =
            Facts { train: &scene.train, test: &test, stated: scene.stated.as_ref(), compute: &compute };
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
        let overview = Overview::new(&config, &subject, &findings, &memory, folder.root(), totals.step);
        // A GPU has memory of its own, and says itself what it has no room for.
        let on_host = config.backend == "cpu";
        let mut warnings = scene.warnings.clone();
        warnings.extend(doubts);
        warnings.extend(on_host.then(|| overview.memory_warning(&machine::Machine::detect())).flatten());
        warnings.extend(backends::software_warning(&config));
        let mut session = backends::train(&config, scene.train)?;
        let resumed = checkpoint.is_some();
        // What was read is not needed beside what it was read into.
        if let Some(checkpoint) = checkpoint {
            session.restore(&checkpoint)?;
        }

        // Nothing of an earlier run is touched before everything that can be refused was refused.
        if matches!(self.work, Work::Train { fresh: true, .. }) {
            folder.clear()?;
        }
        // Without a checkpoint the run begins at its beginning, and so do its events.
        let kept = if resumed { up_to(folder.events(), totals.step) } else { Vec::new() };
        let mut recorder = Recorder::new(folder, &kept, listeners.events)?;
        // The first event is the run's mark on its folder: it stands before every other file.
        recorder.emit(&Event::Plan { lines: overview.lines, memory_bytes: overview.memory_bytes });
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
        let last_step = self.stop_after.map_or(u64::MAX, |steps| totals.step.saturating_add(steps));
        let outcome = Run {
            config: &config,
            session: session.as_mut(),
            frames: scene.test.as_ref(),
            store: &mut store,
            events: &mut recorder,
            stop: listeners.stop,
        }
        .train_until(totals, last_step);

        recorder.emit(&Event::SessionEnded {
            backend: session.backend().to_string(),
            device: session.device_name(),
            wall_seconds: self.started.elapsed().as_secs_f64(),
            peak_memory_bytes: machine::peak_memory(),
            provenance: provenance::here_and_now(scene.test.len()),
        });
        if recorder.history.last().is_some() && !matches!(outcome, Ok(Outcome::Stopped)) {
            store.finish()?;
        }
        let (history, unwritten) = recorder.into_parts();
        let outcome = outcome.map(|outcome| match outcome {
            Outcome::Finished => Ended::Finished,
            Outcome::Stopped => Ended::Stopped,
        });
        let (folder, scene) = (folder.clone(), scene.name);
        Ok(Trained { folder, scene, config, settings, history, outcome, unwritten, _held: held })
    }
}

/// What the scene is called where its data is not opened: the data folder's name.
fn scene_name(config: &Config) -> String {
    let name = Path::new(&config.data.root).file_name();
    name.map_or_else(|| "builtin".to_string(), |name| name.to_string_lossy().into_owned())
}
