//! Training into a run folder: plan, train or resume, evaluate. All input is validated before any long work begins, and
//! an earlier run stays untouched until then.

use super::{
    begin::Beginning,
    cameras,
    folder::{RunFolder, read_model},
    history::{History, up_to},
    lock::Lock,
    memory,
    nearest::TrainingCameras,
    overview::{Overview, Subject},
    provenance,
    recorder::Recorder,
    store::FileStore,
};
use crate::{
    backends, inspect, machine, ranks,
    view::{PerceptualMetrics, write_cameras},
};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;
use trimip_core::{
    Advice, Config, Error, Result, Settings,
    atomic::write_atomically,
    engine::{
        events::{Event, EventSink, Totals},
        exchange::{Rank, Ranks},
    },
    field::model::Model,
    measures::quality::mean_quality,
    run::{self, Observer, Run},
    scene::{fingerprint::Fingerprint, origin::LocalOrigin},
    scene_plan::{self, Facts},
};
use trimip_data::{Watch, settings::DataConfig};

/// Observers of a training and its stop flag.
pub struct Listeners<'a> {
    /// Receives every event of the run.
    pub events: &'a mut dyn EventSink,
    /// Receives the number of photograph rows that have been read, and the total number.
    pub reading: Watch<'a>,
    /// Observes the model between steps, and may pause the run.
    pub observer: &'a mut dyn Observer,
    /// When set to true, the run stops after the current step and saves.
    pub stop: &'a AtomicBool,
}

/// A training, ready to run.
#[derive(Clone)]
pub struct Training {
    folder: RunFolder,
    work: Work,
    stop_after: Option<u64>,
    started: Instant,
    ranks: Option<Arc<dyn Ranks>>,
    /// Rank of this process among those on its machine that train at the same time.
    near: Rank,
}

#[derive(Clone, Debug)]
enum Work {
    /// Trains with these settings; with `fresh`, replaces an earlier run.
    Train { settings: Box<Settings>, fresh: bool },
    /// Trains a finished run for `seconds` longer, with `assignments` applied to its settings.
    Extend { seconds: f64, assignments: Vec<String> },
}

/// How a training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The schedule and the final evaluation are complete.
    Finished,
    /// Stopped on request; the checkpoint is written.
    Stopped,
    /// The folder already held this run, trained and evaluated; nothing was done.
    AlreadyComplete,
}

/// Result of a training. This process holds the lock on the folder until the value is dropped.
#[derive(Debug)]
pub struct Trained {
    /// The run's folder.
    pub folder: RunFolder,
    /// Name of the scene.
    pub scene: String,
    /// The effective configuration, scene plan included.
    pub config: Config,
    /// The effective configuration with the origin of each value.
    pub settings: Settings,
    /// The run's event history.
    pub history: History,
    /// How the training ended, or why it failed. Progress before a failure is saved.
    pub outcome: Result<Outcome>,
    /// Reason why the folder lacks the last events.
    pub unwritten: Option<Error>,
    /// Fingerprint of the training views; `None` if nothing was done.
    pub data: Option<Fingerprint>,
    _held: Lock,
}

impl Trained {
    /// Reads the model from the folder: the finished one, or the one in the last checkpoint.
    ///
    /// # Errors
    /// When the training failed before it wrote a model.
    pub fn model(&self) -> Result<Model> {
        read_model(self.folder.root())
    }

    /// Returns the size of the model file in bytes; `None` if the run is not finished.
    pub fn model_bytes(&self) -> Option<u64> {
        std::fs::metadata(self.folder.model()).ok().map(|metadata| metadata.len())
    }

    /// Checks the final evaluation against `eval.min_psnr` and `eval.min_gain`.
    ///
    /// # Errors
    /// When the quality is below one of them.
    pub fn judge(&self) -> Result<()> {
        let last = self.history.last();
        last.map_or(Ok(()), |e| mean_quality(&e.scales).judge(&self.config.eval))
    }
}

/// Refuses the finished run of a folder if its photographs differ from those that the settings name. Skips the check if the photographs are
/// missing.
fn expect_photographs(
    folder: &RunFolder,
    config: &Config,
    trained_on: Option<Fingerprint>,
    reading: Watch<'_>,
) -> Result<()> {
    let data: DataConfig = config.section()?;
    // Without a data folder, the settings define the photographs.
    let Some(theirs) = trained_on.filter(|_| !data.root.is_empty()) else { return Ok(()) };
    let Ok(scene) = trimip_data::open_watched(&data, reading) else { return Ok(()) };
    let Some(difference) = Fingerprint::of(&scene.train).difference(&theirs) else { return Ok(()) };
    Err(Error::input(
        folder.root().display(),
        format!("holds a run of other photographs: {difference}"),
        Advice::AnyOf(vec![Advice::OtherFolder, Advice::StartOver]),
    ))
}

impl Training {
    /// Trains `settings` into a folder. Resumes an existing run with the same settings; does nothing if that run is
    /// finished.
    pub fn new(settings: Settings, folder: &Path) -> Self {
        Self::of(folder, Work::Train { settings: Box::new(settings), fresh: false })
    }

    /// Continues the finished run of a folder for `seconds` longer. `assignments`, each `section.key=value`, change
    /// settings that do not belong to the model.
    pub fn extend(folder: &Path, seconds: f64, assignments: Vec<String>) -> Self {
        Self::of(folder, Work::Extend { seconds, assignments })
    }

    fn of(folder: &Path, work: Work) -> Self {
        Self {
            folder: RunFolder::new(folder),
            work,
            stop_after: None,
            started: Instant::now(),
            ranks: None,
            near: Rank::ONLY,
        }
    }

    /// Returns the folder that the training writes into.
    pub fn folder(&self) -> &RunFolder {
        &self.folder
    }

    /// Sets whether an existing run in the folder is replaced.
    #[must_use]
    pub fn overwrite(mut self, wanted: bool) -> Self {
        if let Work::Train { fresh, .. } = &mut self.work {
            *fresh = wanted;
        }
        self
    }

    /// Stops after this many steps and saves, as on a stop request; the same training resumes from there.
    #[must_use]
    pub fn max_steps(mut self, steps: Option<u64>) -> Self {
        self.stop_after = steps;
        self
    }

    /// Trains on all of these ranks. This process is rank 0; the others [`follow`](crate::ranks::follow).
    #[must_use]
    pub fn with_ranks(mut self, ranks: Option<Arc<dyn Ranks>>) -> Self {
        self.near = ranks.as_ref().map_or(Rank::ONLY, |ranks| ranks.on_machine());
        self.ranks = ranks;
        self
    }

    /// Sets the rank of this process among those on its machine that train at the same time. The memory check counts each of them, and if
    /// several devices are equally good, each process uses a different one.
    #[must_use]
    pub fn with_machine_rank(mut self, near: Rank) -> Self {
        self.near = near;
        self
    }

    /// Counts the run's wall time from `started`; the default is the creation of the `Training`.
    #[must_use]
    pub fn since(mut self, started: Instant) -> Self {
        self.started = started;
        self
    }

    /// Trains; `events` receives every event of the run.
    ///
    /// # Errors
    /// When the settings, the data, the folder or the device are refused, or the training fails.
    pub fn run(self, events: &mut dyn EventSink) -> Result<Trained> {
        let stop = AtomicBool::new(false);
        let reading = &trimip_data::unwatched;
        let trained = self.run_with(Listeners { events, reading, observer: &mut (), stop: &stop })?;
        trained.outcome.clone()?;
        Ok(trained)
    }

    /// Trains with listeners. A failure during training is returned in [`Trained::outcome`].
    ///
    /// # Errors
    /// When the settings, the data, the folder or the device are refused.
    pub fn run_with(self, listeners: Listeners<'_>) -> Result<Trained> {
        let root = self.folder.root().to_path_buf();
        let absent: Vec<PathBuf> =
            root.ancestors().take_while(|folder| !folder.exists()).map(Path::to_path_buf).collect();
        let trained = self.begun_with(listeners);
        if trained.is_err() {
            // A refused training removes the folders that it created, except for folders with files.
            let _ = absent.iter().try_for_each(std::fs::remove_dir);
        }
        trained
    }

    fn begun_with(self, listeners: Listeners<'_>) -> Result<Trained> {
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
                        "holds no run to continue",
                        Advice::Argument(
                            "name the folder of the run with {out}, or leave {continue-for} out to train one"
                                .into(),
                        ),
                    ));
                }
                let held = folder.lock()?;
                (Beginning::extend(folder, *seconds, assignments)?, held)
            }
        };
        folder.sweep();
        if let Some(history) = begin.finished(folder)? {
            let config = Config::from_settings(&begin.settings)?;
            let trained_on = begin.checkpoint.as_ref().and_then(|checkpoint| checkpoint.state.data);
            expect_photographs(folder, &config, trained_on, listeners.reading)?;
            return Ok(Trained {
                folder: folder.clone(),
                scene: scene_name(&config),
                config,
                settings: begin.settings,
                history,
                outcome: Ok(Outcome::AlreadyComplete),
                unwritten: None,
                data: None,
                _held: held,
            });
        }
        self.go(begin, held, listeners)
    }

    /// Opens the scene, plans unless a plan exists, and trains.
    fn go(&self, begin: Beginning, held: Lock, listeners: Listeners<'_>) -> Result<Trained> {
        let Beginning { mut settings, mut findings, checkpoint, extended } = begin;
        let folder = &self.folder;
        let mut config = Config::from_settings(&settings)?;
        let mut perceptual = PerceptualMetrics::open(&config.eval)?;
        folder.prepare()?;
        let scene = trimip_data::open_watched(&config.section()?, listeners.reading)?;
        let (mut compute, test) = (backends::compute(&config, self.near)?, scene.test.cameras());
        if let Some(ranks) = &self.ranks {
            compute = ranks::together(compute, &**ranks);
        }
        let facts = Facts {
            train: &scene.train,
            test: &test,
            stated: scene.stated.as_ref(),
            origin: scene.origin,
            compute: &compute,
        };
        if checkpoint.is_none() {
            findings = scene_plan::make(&mut settings, &facts)?;
            config = Config::from_settings(&settings)?;
        }
        let mut warnings = inspect::warnings(&scene, &config, &facts);
        let totals = checkpoint.as_ref().map_or_else(Totals::default, |checkpoint| checkpoint.state.totals);
        let subject = Subject {
            name: &scene.name,
            description: &scene.description,
            train: &scene.train,
            test: scene.test.as_ref(),
        };
        let predicted = backends::predict_memory(&config, &scene.train);
        let overview = Overview::new(&config, &subject, &findings, &predicted, folder.root(), totals.step);
        // A GPU has its own memory, and its backend reports an error if the run does not fit.
        let on_host = config.backend == "cpu";
        if on_host {
            warnings.extend(memory::check(&config, &predicted, self.near.size)?);
        }
        warnings.extend(backends::software_warning(&config));
        warnings.extend(held.warning.clone());
        let data = Some(Fingerprint::of(&scene.train));
        let photographed = cameras::finest(&scene.train);
        let mut session = match &self.ranks {
            Some(ranks) => ranks::train(&config, scene.train, ranks)?,
            None => backends::train_beside(&config, scene.train, self.near)?,
        };
        let resumed = checkpoint.is_some();
        // Drop the checkpoint once it is restored, so that it does not stay in memory next to the session.
        if let Some(checkpoint) = checkpoint {
            session.restore(&checkpoint)?;
        }

        // All input is valid from here on; only now is an earlier run removed.
        if matches!(self.work, Work::Train { fresh: true, .. }) {
            folder.clear()?;
        }
        // Without a checkpoint the run and its events start from the beginning.
        let kept = if resumed { up_to(folder.events(), totals.step) } else { Vec::new() };
        let mut recorder = Recorder::new(folder, &kept, listeners.events)?;
        // The first event marks the folder as a run's: it is written before every other file.
        recorder.emit(&overview.event());
        if !resumed {
            folder.write_findings(&findings)?;
        }
        write_cameras(&folder.cameras(), &photographed, LocalOrigin::of(&config.data), None)?;
        folder.prepare_images()?;
        // The turntable picture shows an earlier model; a new folder has none.
        let _ = std::fs::remove_file(folder.turntable());
        write_atomically(&folder.config(), config.to_toml().as_bytes())?;
        for message in warnings {
            recorder.emit(&Event::Warning { message });
        }
        match extended {
            Some(message) => recorder.emit(&Event::Extended { totals, message }),
            None if resumed => recorder.emit(&Event::Resumed { totals }),
            None => {}
        }
        let training = TrainingCameras::new(photographed.iter().map(|(_, camera)| camera));
        let mut store = FileStore::new(folder, &config, training);
        let evaluated = recorder.history.last_evaluated();
        let last_step = self.stop_after.map_or(u64::MAX, |steps| totals.step.saturating_add(steps));
        let outcome = Run {
            config: &config,
            session: session.as_mut(),
            frames: scene.test.as_ref(),
            perception: &mut perceptual,
            store: &mut store,
            events: &mut recorder,
            observer: listeners.observer,
            stop: listeners.stop,
            evaluated,
        }
        .train_until(totals, last_step);

        recorder.emit(&Event::SessionEnded {
            backend: session.backend().to_string(),
            device: session.device_name(),
            wall_seconds: self.started.elapsed().as_secs_f64(),
            peak_memory_bytes: machine::peak_memory(),
            provenance: provenance::here_and_now(scene.test.len()),
        });
        let (history, unwritten) = recorder.into_parts();
        let outcome = outcome.map(|outcome| match outcome {
            run::Outcome::Finished => Outcome::Finished,
            run::Outcome::Stopped => Outcome::Stopped,
        });
        let (folder, scene) = (folder.clone(), scene.name);
        Ok(Trained { folder, scene, config, settings, history, outcome, unwritten, data, _held: held })
    }
}

/// Returns the name of the scene without opening its data: the name of the data folder.
pub(super) fn scene_name(config: &Config) -> String {
    let name = Path::new(&config.data.root).file_name();
    name.map_or_else(|| "builtin".to_string(), |name| name.to_string_lossy().into_owned())
}
