//! The typed configuration. `defaults.toml` holds the defaults, ranges and meanings of settings, and [`Settings`] their
//! layers and origins. The submodules define the sections and their choices, and `checks.rs` the constraints between
//! settings. `foreign.rs` carries the sections that other crates own; [`Config::section`] returns their typed form.

mod checks;
mod choices;
mod crop;
pub(crate) mod defaults;
mod encoders;
mod foreign;
mod loss;
pub(crate) mod origin;
mod range;
pub mod schedule;
mod sections;
pub(crate) mod settings;

pub use choices::{
    CameraPoses, ConePattern, Contraction, Convention, Decomposition, DensityFunction, Exposure,
    FilePrecision, FinalEval, HybridRule, LevelFormula, LossRays, MemoryChoice, PlanChoice, PlaneShape,
    Precision, RateSchedule, RendererKind, TrainBackground, Untouched, ViewEncoding,
};
pub use crop::Crop;
pub use encoders::{
    EncoderConfig, EncoderKind, FrequenciesConfig, HashGridConfig, RipMapConfig, TensorConfig, VoxelsConfig,
};
pub use foreign::Foreign;
pub use sections::{
    EvalConfig, FieldConfig, FileConfig, HybridConfig, OccupancyConfig, OptimizerConfig, PhotographsConfig,
    PlanConfig, RendererConfig, SceneConfig, TrainConfig,
};

pub use loss::{LossConfig, Photometric};
pub(crate) use sections::section;

use crate::config::defaults::Definitions;
use crate::config::settings::{checker::Checker, section::typed, text::section_begun};
use crate::{Error, Origin, Result, Settings};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// Every setting of a run: core's settings as fields, the settings of other crates in [`foreign`](Self::foreign).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name of the backend.
    pub backend: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Number of CPU threads; 0 means all cores.
    pub threads: u32,
    /// Action for a run that is predicted to need more memory than is available.
    pub memory: MemoryChoice,
    /// The photographs.
    pub data: PhotographsConfig,
    /// The box around the scene.
    pub scene: SceneConfig,
    /// The decisions that the scene plan may take.
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
    /// Sample placement of the hybrid renderer.
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
    /// The settings that other crates own.
    #[serde(skip)]
    pub foreign: Foreign,
}

impl Default for Config {
    /// Returns the values of `defaults.toml`.
    fn default() -> Self {
        Self::from_settings(&Settings::defaults())
            .unwrap_or_else(|error| unreachable!("defaults.toml is tested: {error}"))
    }
}

impl OccupancyConfig {
    /// Returns the number of cells of the grid.
    pub fn cells(&self) -> usize {
        (self.resolution as usize).pow(3)
    }
}

impl Config {
    /// Converts layered settings to a typed configuration, and checks every range.
    ///
    /// # Errors
    /// When a value has the wrong type, is out of range, contradicts another setting or belongs to another encoder. The
    /// error names the first such setting and where it was set.
    pub fn from_settings(settings: &Settings) -> Result<Self> {
        let given = |path: &str| *settings.origin(path) != Origin::Default;
        let place = |path: &str| settings.place(path);
        let checker = Checker::new(&place, &given);
        settings.check_ranges(&checker)?;
        let config = Self::of_settings(settings, &checker)?;
        config.check_all(settings, &checker)?;
        Ok(config)
    }

    /// Converts settings to their typed form, without checks.
    fn of_settings(settings: &Settings, to: &Checker<'_>) -> Result<Self> {
        let core = Definitions::core();
        let own = || core.defaults().map(|(path, _)| path);
        let mut config: Self = typed(settings.table_of(own()), to)?;
        config.foreign = Foreign::of(settings);
        Ok(config)
    }

    /// Parses one effective configuration as written in a run folder or a model; `name` names the text in errors.
    /// Settings of other crates than core are carried along; [`section`](Self::section) checks them.
    ///
    /// # Errors
    /// When the text is not TOML, or as [`from_settings`](Self::from_settings).
    pub fn from_toml(name: &str, text: &str) -> Result<Self> {
        expect_encoder(name, text)?;
        let mut settings = Settings::carrying(Definitions::core());
        settings.apply_file(name, text)?;
        Self::from_settings(&settings)
    }

    /// Returns the configuration as TOML text. Settings of unused encoders are left out, because a later version may
    /// have other defaults for them.
    pub fn to_toml(&self) -> String {
        let text = self.whole_text();
        let (mut section, mut head, mut own) = (String::new(), String::new(), String::new());
        for line in text.lines().filter(|line| !line.is_empty()) {
            if let Some(name) = section_begun(line) {
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

    /// Returns the differences in settings that affect the model: all settings except those that their definitions mark
    /// as free, such as device, threads, evaluation, scene plan and model file. A checkpoint with such a difference is
    /// rejected. Settings without a definition on either side have no effect here and are skipped.
    pub fn differences(&self, other: &Self) -> Vec<String> {
        let (ours, theirs) = (&self.foreign, &other.foreign);
        let definitions = [ours.definitions(), theirs.definitions()];
        let (own, before) = (self.as_settings(), other.as_settings());
        let core = Definitions::core();
        let paths = core
            .defaults()
            .map(|(path, _)| path)
            .chain(ours.paths().chain(theirs.paths()).map(String::as_str));
        let mut differences = Vec::new();
        for path in BTreeSet::from_iter(paths) {
            let [own, before] = match core.default(path) {
                Some(_) => [own.get(path), before.get(path)],
                None => [ours.value(path, theirs), theirs.value(path, ours)],
            };
            let is_free = definitions.iter().any(|known| known.is_free(path));
            if let (Some(own), Some(before)) = (own, before)
                && own != before
                && !is_free
                && definitions.iter().any(|known| known.default(path).is_some())
            {
                differences.push(format!("{path} is {own}, was {before}"));
            }
        }
        differences
    }

    /// Returns the configuration as settings.
    fn as_settings(&self) -> Settings {
        let mut settings = Settings::carrying(self.foreign.definitions().clone());
        settings
            .apply_file("config", &self.whole_text())
            .unwrap_or_else(|error| unreachable!("our own text: {error}"));
        settings
    }

    /// Returns every setting as TOML text.
    fn whole_text(&self) -> String {
        let own = toml::to_string(self).unwrap_or_else(|error| unreachable!("plain data: {error}"));
        self.foreign.put_into(&own)
    }
}

/// Rejects the configuration of a model or run with an encoder that this build does not have. This check comes first,
/// because the settings of such an encoder are unknown here.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ForeignSection, Fragment, Section};

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
        assert!(Config::from_settings(&settings).unwrap_err().message().contains("eval.min_psnr"));
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
            assert_eq!((built.kind(), read.kind()), (crate::ErrorKind::Input, crate::ErrorKind::Input));
            // Both errors name the setting and its value; only the place where it was set differs.
            let told = |error: &Error| error.message().split_once(": ").map(|(_, told)| told.to_string());
            assert_eq!(told(&built), told(&read));
            assert!(built.message().starts_with("configuration: "), "{built}");
        }
    }

    #[test]
    fn ranges_and_choices_are_refused_with_their_place() {
        for (assignment, expected) in [
            ("encoder.plane_size=500", "a multiple of 128"),
            ("encoder.level=\"papers\"", "expected"),
            ("train.samples_per_step=0", "256 to"),
            ("scene.aabb_min=[2.0, 0.0, 0.0]", "scene.aabb_max above"),
            ("scene.aabb_min=[0.0, 0.0]", ""),
            ("optimizer.learning_rate=nan", "1e-9 to 10"),
            ("threads=100000", "0 to 1024"),
            ("seed=-1", "0 to 9223372036854775807"),
            ("eval.final=-1", "0 to 1e6"),
            ("train.steps=true", "a whole number"),
            ("data.background=[1e308, 0.0, 0.0]", "0 to 1 for each value"),
            ("encoder.halvings=[[0.0, 64]]", "0 to 10 for each value"),
        ] {
            let mut settings = Settings::defaults();
            let given = settings.apply_assignment(assignment);
            let error = given.and_then(|()| Config::from_settings(&settings)).unwrap_err();
            assert_eq!(error.kind(), crate::ErrorKind::Input);
            assert!(error.message().contains(expected), "{assignment}: {error}");
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
            assert!(
                error.message().starts_with(&format!("command line: {path} = ")),
                "{assignment}: {error}"
            );
        }
    }

    #[test]
    fn a_number_is_a_schedule_of_one_value() {
        let mut settings = Settings::defaults();
        settings.apply_file("run.toml", "[renderer]\ncolor_weight = 0.5\n").unwrap();
        settings.apply_assignment("renderer.step_scale=2").unwrap();
        let config = Config::from_settings(&settings).unwrap();
        assert_eq!(config.renderer.color_weight.values().collect::<Vec<_>>(), [0.5]);
        assert_eq!(config.renderer.step_scale.at(0.3), 2.0);
        assert!(settings.apply_assignment("optimizer.milestones=0.5").is_err(), "a list of numbers is none");
    }

    #[test]
    fn numbers_that_no_file_holds_are_refused() {
        for change in [|c: &mut Config| c.seed = u64::MAX, |c: &mut Config| c.train.steps = 1 << 63] {
            let mut config = Config::default();
            change(&mut config);
            let error = config.validate().unwrap_err();
            assert!(error.kind() == crate::ErrorKind::Input && error.message().contains("2^63"), "{error}");
        }
    }

    #[test]
    fn a_model_of_an_encoder_that_this_build_lacks_says_so() {
        let text = Config::default().to_toml().replace("\"tri-mip\"", "\"k-planes\"");
        for text in [text.clone(), format!("{text}\n[k_planes]\nsize = 3\n")] {
            let error = Config::from_toml("old.safetensors", &text).unwrap_err();
            assert_eq!(error.kind(), crate::ErrorKind::Input);
            for part in
                ["old.safetensors", "`k-planes`", "`tri-mip`", "`hash-grid`", "use a build that has it"]
            {
                assert!(error.message().contains(part), "{part}: {error}");
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
            (&["hash_grid.levels=8", "plan.encoder=off"][..], "encoder.kind = \"hash-grid\""),
            (&["rip_map.planes=3"], "encoder.kind = \"rip-map\""),
            (&["encoder.kind=hash-grid", "encoder.levels=5"], "encoder.kind = \"tri-mip\""),
            (&["encoder.kind=plenoxels"], "expected"),
        ] {
            let mut settings = Settings::defaults();
            assignments.iter().for_each(|assignment| settings.apply_assignment(assignment).unwrap());
            let error = Config::from_settings(&settings).unwrap_err();
            assert!(error.kind() == crate::ErrorKind::Input && error.message().contains(expected), "{error}");
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

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Lamp {
        watts: f64,
        tint: String,
    }

    impl Section for Lamp {
        const NAME: &'static str = "lamp";
        const FRAGMENTS: &'static [Fragment] = &[Fragment {
            after: "",
            table: r#"
[lamp]
section = { meaning = "a lamp" }
watts = { default = 60.0, range = [0, 100], meaning = "its power" }
tint = { default = "warm", free = true, meaning = "its colour" }
"#,
        }];
    }

    fn lit() -> Settings {
        Settings::of(Definitions::new(&[ForeignSection::of::<Lamp>()], &[]).into())
    }

    #[test]
    fn a_section_of_another_crate_is_carried_in_text_as_it_is() {
        let mut settings = lit();
        settings.apply_file("run.toml", "[lamp]\nwatts = 5\n").unwrap();
        let config = Config::from_settings(&settings).unwrap();
        assert_eq!(config.section::<Lamp>().unwrap(), Lamp { watts: 5.0, tint: "warm".into() });
        let text = config.to_toml();
        assert!(text.ends_with("\n[lamp]\nwatts = 5.0\ntint = \"warm\"\n"), "{text}");
        // Settings without the section's definition keep its text, and the typed section can still be read from it.
        let kept = Config::from_toml("model", &text).unwrap();
        assert_eq!((kept.to_toml(), kept.section::<Lamp>().unwrap().watts), (text, 5.0));
        assert_eq!(kept, config);
        assert_eq!(Config::default().section::<Lamp>().unwrap().watts, 60.0);
    }

    #[test]
    fn a_section_of_another_crate_is_checked_where_it_is_known() {
        let refused = |assignment: &str| {
            let mut settings = lit();
            let applied = settings.apply_assignment(assignment);
            applied.and_then(|()| Config::from_settings(&settings)).unwrap_err().message()
        };
        assert!(
            refused("lamp.watts=101")
                .starts_with("command line: lamp.watts = 101.0: out of range; expected 0 to 100")
        );
        assert!(
            refused("lamp.tint=3").contains("a string")
                && refused("lamp.volts=3").contains("unknown setting")
        );
        let text = format!("{}\n[lamp]\nwatts = 101\n", Config::default().to_toml());
        let error = Config::from_toml("model", &text).unwrap().section::<Lamp>().unwrap_err();
        assert!(
            error.kind() == crate::ErrorKind::Input && error.message().contains("lamp.watts = 101"),
            "{error}"
        );
        // Other crates cannot add settings to a section of core, and a nested table is not a setting.
        for text in ["[train]\nlamps = 3\n", "[lamp]\nwatts = { a = 3 }\n", "lamps = 3\n"] {
            assert!(Config::from_toml("model", text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_section_of_another_crate_says_what_is_free_to_change() {
        let config = |assignment: &str| {
            let mut settings = lit();
            settings.apply_assignment(assignment).unwrap();
            Config::from_settings(&settings).unwrap()
        };
        let before = Config::from_toml("run", &config("lamp.watts=5").to_toml()).unwrap();
        assert!(config("lamp.watts=5").differences(&before).is_empty());
        assert_eq!(config("lamp.watts=6").differences(&before), ["lamp.watts is 6.0, was 5.0"]);
        assert_eq!(config("lamp.tint=cold").differences(&before), ["lamp.watts is 60.0, was 5.0"]);
        assert!(Config::default().differences(&before).is_empty(), "nothing here reads it");
    }

    #[test]
    fn a_section_of_another_crate_is_changed_in_code() {
        let mut config = Config { seed: 7, ..Config::default() };
        config.change(|lamp: &mut Lamp| lamp.watts = 9.0).unwrap();
        assert_eq!((config.seed, config.section::<Lamp>().unwrap().watts), (7, 9.0));
        assert!(config.change(|lamp: &mut Lamp| lamp.watts = 900.0).is_ok() && config.validate().is_err());
    }
}
