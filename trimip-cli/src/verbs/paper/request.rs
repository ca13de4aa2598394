//! The list of runs that the command line requests: scenes, systems, seeds and scales. All errors of the input are found here, before the
//! first run starts.

use crate::args::{PaperArguments, Schedule, Split, TableScales};
use crate::settings::scene_root;
use std::path::{Path, PathBuf};
use trimip::data::{Collection, has_split, is_scene, settings::DataConfig};
use trimip::run::expect_same;
use trimip::systems::{self, SYSTEMS, System};
use trimip::{Config, Error, Result, RunFolder, Settings, backends};
use trimip_core::text;
use trimip_report::comparison::Scales;

/// Default training time per run, seconds: the time of the paper on its GPU.
const SECONDS: f64 = 300.0;

/// Folder of the single-scale runs within the output folder.
const SINGLE: &str = "single-scale";

/// A scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Scene {
    /// Name of the scene's folder.
    pub name: String,
    /// Value of `data.root`.
    pub root: String,
}

/// One run.
pub struct PaperRun {
    pub scales: Scales,
    pub scene: String,
    pub system: &'static System,
    pub seed: u64,
    /// Settings of the training. The time of its evaluations is limited, because early models are foggy and would take hours to evaluate.
    pub training: Settings,
    /// Settings of the final evaluation, which has no time limit.
    pub measuring: Settings,
    /// The configuration of `measuring`.
    pub config: Config,
    pub folder: RunFolder,
}

impl PaperRun {
    /// Describes the run in words.
    pub fn name(&self) -> String {
        let scales = if self.scales == Scales::One { ", single-scale" } else { "" };
        format!("{}, {}, seed {}{scales}", self.scene, self.system.name, self.seed)
    }
}

/// All runs of a command.
pub struct Request {
    pub systems: Vec<&'static System>,
    pub scenes: Vec<Scene>,
    /// Blender scenes that are not in the named folders.
    pub missing: Vec<&'static str>,
    pub scales: Vec<Scales>,
    pub split: Vec<&'static str>,
    pub stride: u32,
    /// All runs, ordered by seed, then table, scene and system, so that even an early page has every system.
    pub jobs: Vec<PaperRun>,
    pub out: PathBuf,
}

impl Request {
    /// Reads the arguments and checks scenes, splits, settings and run folders.
    ///
    /// # Errors
    /// Of kind `Input`, when an argument is wrong or a run folder holds a run with other settings.
    pub fn new(arguments: &PaperArguments) -> Result<Self> {
        let (scenes, missing) = scenes(&arguments.scenes)?;
        let mut request = Self {
            systems: chosen(&arguments.systems)?,
            scenes,
            missing,
            scales: tables(&arguments.scales),
            split: match arguments.split {
                Split::Train => vec!["train"],
                Split::Trainval => vec!["train", "val"],
            },
            stride: arguments.stride,
            jobs: Vec::new(),
            out: arguments.out.clone(),
        };
        let layers = Layers::new(arguments, &request)?;
        for seed in 0..arguments.seeds {
            for &scales in &request.scales {
                for scene in &request.scenes {
                    for system in &request.systems {
                        request.jobs.push(layers.job(system, scene, scales, seed, &request.out)?);
                    }
                }
            }
        }
        for assignment in &arguments.set {
            if !request.jobs.iter().any(|job| job.config.encoder.kind.takes(path(assignment))) {
                return Err(Error::input(
                    format!("--set {assignment}"),
                    "is a setting of an encoder that none of these systems has",
                    "leave it out, or name a system with this encoder in --systems",
                ));
            }
        }
        request.check()?;
        Ok(request)
    }

    /// Returns the path of the page.
    pub fn page(&self) -> PathBuf {
        self.out.join("paper.html")
    }

    /// Describes the budget of a run in words, from the settings of all runs.
    pub fn budget(&self) -> String {
        let train = || self.jobs.iter().map(|job| &job.config.train);
        let first = train().next().map_or((0.0, 0), |train| (train.seconds, train.steps));
        let equal = train().all(|train| (train.seconds, train.steps) == first);
        match (equal, first) {
            (true, (seconds, 0)) => format!("Equal time: {seconds} s of training each, evaluation excluded"),
            (true, (_, steps)) => format!("Equal steps: {steps} each"),
            _ => "Each by its own schedule".into(),
        }
    }

    fn check(&self) -> Result<()> {
        let mut sets = Vec::new();
        for job in &self.jobs {
            backends::check(&job.config.backend)?;
            let data: DataConfig = job.config.section()?;
            // Several systems share the data of a scene, so each data set is checked only once.
            if sets.contains(&data) {
                continue;
            }
            for split in &data.train {
                if !has_split(&data, split)? {
                    return Err(Error::input(
                        &data.root,
                        format!("has no split \"{split}\""),
                        "add its transforms file and photographs, or give --split train",
                    ));
                }
            }
            sets.push(data);
        }
        self.jobs.iter().try_for_each(|job| expect_same(&job.measuring, &job.folder))
    }
}

/// Returns the scenes of the named folders, and the Blender scenes that collections of scenes lack.
fn scenes(folders: &[PathBuf]) -> Result<(Vec<Scene>, Vec<&'static str>)> {
    let (mut roots, mut missing) = (Vec::new(), Vec::new());
    for folder in folders {
        if !folder.is_dir() || is_scene(folder) {
            roots.push(scene_root(folder)?);
            continue;
        }
        let collection = Collection::open(folder)?;
        for root in &collection.found {
            roots.push(scene_root(root)?);
        }
        missing.extend(collection.missing);
    }
    let mut scenes: Vec<Scene> = Vec::new();
    for root in roots {
        let whole = std::fs::canonicalize(&root).unwrap_or_else(|_| PathBuf::from(&root));
        let name =
            whole.file_name().map_or_else(|| "scene".into(), |name| name.to_string_lossy().into_owned());
        if name == SINGLE || scenes.iter().any(|scene| scene.name == name) {
            return Err(Error::input(
                &root,
                format!("is a second scene `{name}`, or has the name of a folder that this command writes"),
                "give the folders of the scenes different names",
            ));
        }
        scenes.push(Scene { name, root });
    }
    Ok((scenes, missing))
}

/// Returns the systems with these names, in the order of the tables; all systems if no names are given.
fn chosen(names: &[String]) -> Result<Vec<&'static System>> {
    let named: Vec<&System> = names.iter().map(|name| systems::find(name.trim())).collect::<Result<_>>()?;
    let wanted = |system: &&System| names.is_empty() || named.iter().any(|other| other.name == system.name);
    Ok(SYSTEMS.iter().filter(wanted).collect())
}

/// Returns the requested tables, without repetitions.
fn tables(wanted: &[TableScales]) -> Vec<Scales> {
    let has = |scales| wanted.contains(&scales);
    let all = [(TableScales::Four, Scales::Four), (TableScales::One, Scales::One)];
    all.into_iter().filter(|(own, _)| has(*own)).map(|(_, scales)| scales).collect()
}

/// Returns the setting that an assignment names, as a dotted path.
fn path(assignment: &str) -> &str {
    assignment.split('=').next().unwrap_or_default().trim()
}

/// The layers of settings that override those of a system.
struct Layers {
    /// Name and text of the configuration file.
    file: Option<(String, String)>,
    /// Assignments that make systems comparable: equal data, views and budget.
    shared: Vec<String>,
    /// The user's assignments.
    set: Vec<String>,
    /// Stride of the final evaluation: every n-th test view is measured.
    stride: u32,
}

impl Layers {
    fn new(arguments: &PaperArguments, request: &Request) -> Result<Self> {
        let file = match &arguments.config {
            Some(path) => {
                let text = text::read(path, "name an existing configuration file")?;
                Some((path.display().to_string(), text))
            }
            None => None,
        };
        let mut shared = vec![format!("data.train={:?}", request.split)];
        match (arguments.schedule, arguments.seconds) {
            (Schedule::Own, Some(_)) => {
                return Err(Error::input(
                    "--schedule own",
                    "cannot be used with --seconds",
                    "give one of the two",
                ));
            }
            (Schedule::Own, None) => {}
            (Schedule::Equal, seconds) => {
                let seconds = seconds.unwrap_or(SECONDS);
                if !(seconds.is_finite() && seconds > 0.0) {
                    return Err(Error::input(
                        format!("--seconds {seconds}"),
                        "is not a duration",
                        "give a number above 0",
                    ));
                }
                shared.push(format!("train.seconds={seconds:?}"));
            }
        }
        Ok(Self { file, shared, set: arguments.set.clone(), stride: request.stride })
    }

    /// Returns the run of a system on a scene; `seed` is added to the configured seed.
    fn job(
        &self,
        system: &'static System,
        scene: &Scene,
        scales: Scales,
        seed: u32,
        out: &Path,
    ) -> Result<PaperRun> {
        let mut settings = trimip::settings::defaults();
        system.apply(&mut settings)?;
        if let Some((name, text)) = &self.file {
            settings.apply_file(name, text)?;
        }
        let data = [
            format!("data.root={}", trimip::SettingValue::from(scene.root.clone())),
            format!("data.scales={}", scales.count()),
        ];
        for assignment in data.iter().chain(&self.shared) {
            settings.apply_assignment(assignment)?;
        }
        // Settings of one encoder apply only to systems that have this encoder.
        let encoder = Config::from_settings(&settings)?.encoder.kind;
        for assignment in self.set.iter().filter(|assignment| encoder.takes(path(assignment))) {
            settings.apply_assignment(assignment)?;
        }
        let seed = Config::from_settings(&settings)?.seed + u64::from(seed);
        let settings = settings.with("seed", seed.cast_signed())?;
        // All systems are measured on the same views, however long that takes.
        let measuring =
            settings.clone().with("eval.final", i64::from(self.stride))?.with("eval.time_fraction", 0)?;
        let training = settings.with("eval.final", false)?;
        let config = Config::from_settings(&measuring)?;
        let root = if scales == Scales::One { out.join(SINGLE) } else { out.to_path_buf() };
        let folder = RunFolder::new(&root.join(&scene.name).join(system.name).join(seed.to_string()));
        Ok(PaperRun { scales, scene: scene.name.clone(), system, seed, training, measuring, config, folder })
    }
}
