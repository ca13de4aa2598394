//! The typed configuration. Defaults and their meaning are in `defaults.toml`, layers and origins in [`Settings`], the
//! sections and their choices in the files beside this one, and the accepted ranges in `checks.rs`.

mod checks;
mod choices;
mod encoders;
mod sections;

pub use choices::{
    ConePattern, Contraction, Convention, Decomposition, DensityFunction, Exposure, FilePrecision, FinalEval,
    Finish, HybridRule, LevelFormula, LossRays, MaskKeeps, MaskRole, MemoryChoice, Photographs, PixelStore,
    PlanChoice, PlaneShape, Precision, RateSchedule, RendererKind, TrainBackground, Untouched, ViewEncoding,
};
pub use encoders::{
    EncoderConfig, EncoderKind, FrequenciesConfig, HashGridConfig, RipMapConfig, TensorConfig, VoxelsConfig,
};
pub use sections::{
    DataConfig, EvalConfig, FieldConfig, FileConfig, HybridConfig, OccupancyConfig, OptimizerConfig,
    PlanConfig, RendererConfig, SceneConfig, TrainConfig, WgpuConfig,
};

pub use crate::losses::{LossConfig, Photometric};
pub(crate) use sections::section;

use crate::{Aabb, Error, Origin, Result, Settings, range};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Every setting of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name of the backend.
    pub backend: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// CPU threads; 0: all cores.
    pub threads: u32,
    /// What becomes of a run that is predicted to need more memory than there is.
    pub memory: MemoryChoice,
    /// The photographs.
    pub data: DataConfig,
    /// The box around the scene.
    pub scene: SceneConfig,
    /// What the scene plan may decide.
    pub plan: PlanConfig,
    /// The model file.
    pub file: FileConfig,
    /// The encoder, and the planes of the tri-mip encoder.
    pub encoder: EncoderConfig,
    /// The hash grid.
    pub hash_grid: HashGridConfig,
    /// The planes of several directions with ripmaps.
    pub rip_map: RipMapConfig,
    /// Factored tensors.
    pub tensor: TensorConfig,
    /// The positional encoding.
    pub frequencies: FrequenciesConfig,
    /// The grid of voxels.
    pub voxels: VoxelsConfig,
    /// The networks.
    pub field: FieldConfig,
    /// Marching and compositing.
    pub renderer: RendererConfig,
    /// Where the hybrid renderer places samples.
    pub hybrid: HybridConfig,
    /// The occupancy grid.
    pub occupancy: OccupancyConfig,
    /// The loss.
    pub loss: LossConfig,
    /// The optimiser.
    pub optimizer: OptimizerConfig,
    /// Length of the run and size of a step.
    pub train: TrainConfig,
    /// The evaluations.
    pub eval: EvalConfig,
    /// The GPU.
    pub wgpu: WgpuConfig,
}

impl Default for Config {
    /// The values of `defaults.toml`.
    fn default() -> Self {
        Self::from_settings(&Settings::defaults())
            .unwrap_or_else(|error| unreachable!("defaults.toml is tested: {error}"))
    }
}

impl OccupancyConfig {
    /// Number of cells of the grid.
    pub fn cells(&self) -> usize {
        (self.resolution as usize).pow(3)
    }
}

impl SceneConfig {
    /// The box within which space keeps its shape: the scene's, or its middle half if space is contracted. World units.
    pub fn subject(&self) -> Aabb<f64> {
        let aabb = Aabb::<f64>::new(self);
        let share = match self.contraction {
            Contraction::None => 1.0,
            Contraction::Ball => 0.5,
        };
        let corner = |sign: f64| {
            std::array::from_fn(|i| {
                0.5 * (aabb.min[i] + aabb.max[i]) + sign * 0.5 * share * (aabb.max[i] - aabb.min[i])
            })
        };
        Aabb { min: corner(-1.0), max: corner(1.0) }
    }
}

impl Config {
    /// World length of the uniform marching step: longest side · √3 / steps (code).
    pub fn step_length(&self) -> f32 {
        Aabb::<f32>::new(&self.scene).longest() * 3.0_f32.sqrt() / self.renderer.steps_per_diagonal as f32
    }

    /// The same run with its box centred at the origin, and the former centre of the box. Far from the origin, f32 is too
    /// coarse for positions within the box.
    pub fn centred(&self) -> (Self, DVec3) {
        let scene = Aabb::<f64>::new(&self.scene);
        let centre: [f64; 3] = std::array::from_fn(|axis| 0.5 * (scene.min[axis] + scene.max[axis]));
        let mut config = self.clone();
        let shifted = |corner: [f64; 3]| std::array::from_fn(|axis| (corner[axis] - centre[axis]) as f32);
        (config.scene.aabb_min, config.scene.aabb_max) = (shifted(scene.min), shifted(scene.max));
        (config, DVec3::from_array(centre))
    }

    /// The typed configuration of layered settings, with every range checked.
    ///
    /// # Errors
    /// Names the first setting that has no such value, is out of range, or belongs to another encoder, and where it was
    /// set.
    pub fn from_settings(settings: &Settings) -> Result<Self> {
        range::check(settings, &|path| settings.place(path))?;
        let config: Self = settings.table().try_into().map_err(|error: toml::de::Error| {
            // The error names the key; the origin of its value is the place to correct.
            let text = error.to_string();
            let place = settings
                .iter()
                .map(|(path, ..)| path)
                .find(|path| text.contains(&format!("`{path}`")))
                .map_or("configuration".to_string(), |path| settings.place(path));
            Error::input(place, error.message(), "see its meaning in `trimip-cli config --defaults`")
        })?;
        let given = |path: &str| *settings.origin(path) != Origin::Default;
        config.check_together(&|path| settings.place(path), &given)?;
        Ok(config)
    }

    /// Parses one effective configuration as written in a run folder; `name` is used in errors.
    ///
    /// # Errors
    /// When the text is no TOML, or as [`from_settings`](Self::from_settings).
    pub fn from_toml(name: &str, text: &str) -> Result<Self> {
        expect_encoder(name, text)?;
        let mut settings = Settings::defaults();
        settings.apply_file(name, text)?;
        Self::from_settings(&settings)
    }

    /// The configuration as TOML text. Settings of encoders that are not at work are left out: a later version may have
    /// other defaults for them.
    pub fn to_toml(&self) -> String {
        let text = self.whole_text();
        let (mut section, mut head, mut own) = (String::new(), String::new(), String::new());
        for line in text.lines().filter(|line| !line.is_empty()) {
            if let Some(name) = line.strip_prefix('[').and_then(|line| line.strip_suffix(']')) {
                (section, head) = (format!("{name}."), format!("\n{line}\n"));
                continue;
            }
            let key = line.split(" = ").next().unwrap_or_default();
            if self.encoder.kind.takes(&format!("{section}{key}")) {
                own += &std::mem::take(&mut head);
                own += line;
                own.push('\n');
            }
        }
        own
    }

    /// Differences in settings that affect the model: all settings except device, threads, logging, evaluation, scene plan
    /// and model file. A checkpoint of a different configuration is refused by them.
    pub fn differences(&self, other: &Self) -> Vec<String> {
        let (ours, theirs) = (self.settings(), other.settings());
        ours.iter()
            .zip(theirs.iter())
            .filter(|((path, ours), (_, theirs))| ours != theirs && !free_to_change(path))
            .map(|((path, ours), (_, theirs))| format!("{path} is {ours}, was {theirs}"))
            .collect()
    }

    /// The configuration as settings.
    fn as_settings(&self) -> Settings {
        let mut settings = Settings::defaults();
        settings
            .apply_file("config", &self.whole_text())
            .unwrap_or_else(|error| unreachable!("our own text: {error}"));
        settings
    }

    /// Every setting as TOML text.
    fn whole_text(&self) -> String {
        toml::to_string(self).unwrap_or_else(|error| unreachable!("plain data: {error}"))
    }

    /// Dotted path and value of every setting.
    fn settings(&self) -> Vec<(String, toml::Value)> {
        self.as_settings().iter().map(|(path, value, _)| (path.to_string(), value.clone())).collect()
    }
}

/// Refuses the configuration of a model or run with an encoder that this build does not have. Its settings are unknown
/// here, so this comes first.
fn expect_encoder(name: &str, text: &str) -> Result<()> {
    let table = toml::from_str::<toml::Table>(text).unwrap_or_default();
    let kind = table.get("encoder").and_then(|encoder| encoder.get("kind")).cloned();
    match kind.map(toml::Value::try_into::<EncoderKind>) {
        Some(Err(error)) => Err(Error::input(
            name,
            format!("this build does not have its encoder: {}", error.message()),
            "use a build that has it",
        )),
        Some(Ok(_)) | None => Ok(()),
    }
}

fn free_to_change(path: &str) -> bool {
    path == "backend"
        || path == "threads"
        || path == "memory"
        || path == "data.root"
        || path.starts_with("eval.")
        || path.starts_with("plan.")
        || path.starts_with("file.")
        || path.starts_with("wgpu.")
        || path == "train.checkpoint_seconds"
        || path == "train.log_seconds"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_whole_and_survive_a_round_trip() {
        let config = Config::default();
        assert_eq!(Config::from_toml("text", &config.to_toml()).unwrap(), config);
    }

    #[test]
    fn a_floor_that_nothing_measures_is_refused() {
        let mut settings = Settings::defaults();
        settings.apply_assignment("eval.min_psnr=20").unwrap();
        assert!(Config::from_settings(&settings).is_ok());
        settings.apply_assignment("eval.final=false").unwrap();
        assert!(Config::from_settings(&settings).unwrap_err().message.contains("eval.min_psnr"));
    }

    #[test]
    fn a_configuration_built_in_code_is_refused_as_one_read_from_text() {
        Config::default().validate().unwrap();
        type Change = fn(&mut Config);
        let refused: [(&str, Change); 4] = [
            ("encoder.plane_size=500", |c| c.encoder.plane_size = 500),
            ("optimizer.learning_rate=nan", |c| c.optimizer.learning_rate = f64::NAN),
            ("scene.aabb_min=[2.0, 0.0, 0.0]", |c| c.scene.aabb_min = [2.0, 0.0, 0.0]),
            ("field.hidden=24", |c| c.field.hidden = 24),
        ];
        for (assignment, change) in refused {
            let mut settings = Settings::defaults();
            settings.apply_assignment(assignment).unwrap();
            let read = Config::from_settings(&settings).unwrap_err();
            let mut config = Config::default();
            change(&mut config);
            let built = config.validate().unwrap_err();
            assert_eq!((built.exit_code(), read.exit_code()), (2, 2));
            // Both name the setting and its value; only where it was set differs.
            let told = |error: &Error| error.message.split_once(": ").map(|(_, told)| told.to_string());
            assert_eq!(told(&built), told(&read));
            assert!(built.message.starts_with("configuration: "), "{built}");
        }
    }

    #[test]
    fn ranges_and_choices_are_refused_with_their_place() {
        for (assignment, expected) in [
            ("encoder.plane_size=500", "a multiple of 128"),
            ("encoder.level=\"papers\"", "expected"),
            ("train.samples_per_step=0", "256 to"),
            ("scene.aabb_min=[2.0, 0.0, 0.0]", "a corner above"),
            ("scene.aabb_min=[0.0, 0.0]", ""),
            ("optimizer.learning_rate=nan", "1e-9 to 10"),
            ("threads=100000", "0 to 1024"),
            ("seed=-1", "0 to 9223372036854775807"),
            ("eval.final=-1", "0 to 1e6"),
            ("train.steps=true", "a whole number"),
            ("data.background=[1e308, 0.0, 0.0]", "0 to 1 for each value"),
            ("encoder.halvings=[[0.0, 64]]", "0 to 10 for each value"),
            ("data.train=[\"train\", \"train\"]", "each split once"),
        ] {
            let mut settings = Settings::defaults();
            let given = settings.apply_assignment(assignment);
            let error = given.and_then(|()| Config::from_settings(&settings)).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            assert!(error.message.contains(expected), "{assignment}: {error}");
        }
    }

    #[test]
    fn what_settings_must_be_together_names_the_one_that_was_given() {
        for assignment in [
            "scene.aabb_min=[-1.0, 2.0, -1.0]",
            "scene.aabb_max=[1.0, -2.0, 1.0]",
            "encoder.levels=13",
            "train.seconds=0",
        ] {
            let mut settings = Settings::defaults();
            settings.apply_assignment(assignment).unwrap();
            let error = Config::from_settings(&settings).unwrap_err();
            let (path, _) = assignment.split_once('=').unwrap();
            assert!(error.message.starts_with(&format!("--set: {path} = ")), "{assignment}: {error}");
        }
    }

    #[test]
    fn numbers_that_no_file_holds_are_refused() {
        for change in [|c: &mut Config| c.seed = u64::MAX, |c: &mut Config| c.train.steps = 1 << 63] {
            let mut config = Config::default();
            change(&mut config);
            let error = config.validate().unwrap_err();
            assert!(error.exit_code() == 2 && error.message.contains("2^63"), "{error}");
        }
    }

    #[test]
    fn a_model_of_an_encoder_that_this_build_lacks_says_so() {
        let text = Config::default().to_toml().replace("\"tri-mip\"", "\"k-planes\"");
        for text in [text.clone(), format!("{text}\n[k_planes]\nsize = 3\n")] {
            let error = Config::from_toml("old.safetensors", &text).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            for part in
                ["old.safetensors", "`k-planes`", "`tri-mip`", "`hash-grid`", "use a build that has it"]
            {
                assert!(error.message.contains(part), "{part}: {error}");
            }
        }
    }

    #[test]
    fn text_holds_the_settings_of_the_encoder_at_work() {
        let mut config = Config::default();
        assert!(config.to_toml().contains("plane_size") && !config.to_toml().contains("log2_entries"));
        config.encoder.kind = EncoderKind::HashGrid;
        config.hash_grid.levels = 7;
        let text = config.to_toml();
        assert!(text.contains("log2_entries") && !text.contains("plane_size"), "{text}");
        assert_eq!(Config::from_toml("text", &text).unwrap(), config);
    }

    #[test]
    fn settings_of_another_encoder_are_refused_by_name() {
        for (assignments, expected) in [
            (&["hash_grid.levels=8"][..], "encoder.kind = \"hash-grid\""),
            (&["encoder.kind=hash-grid", "encoder.levels=5"], "encoder.kind = \"tri-mip\""),
            (&["encoder.kind=plenoxels"], "expected"),
        ] {
            let mut settings = Settings::defaults();
            assignments.iter().for_each(|assignment| settings.apply_assignment(assignment).unwrap());
            let error = Config::from_settings(&settings).unwrap_err();
            assert!(error.exit_code() == 2 && error.message.contains(expected), "{error}");
        }
    }

    #[test]
    fn only_what_changes_the_model_counts_as_a_difference() {
        let (ours, mut other) = (Config::default(), Config::default());
        other.eval.stride = 3;
        other.threads = 1;
        assert!(ours.differences(&other).is_empty());
        other.seed = 1;
        assert_eq!(ours.differences(&other), ["seed is 42, was 1"]);
    }
}
