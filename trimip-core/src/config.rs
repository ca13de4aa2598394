//! The typed configuration. Defaults and their meaning stand in `defaults.toml`; layers and origins in [`Settings`];
//! here are the types and the ranges in which a run makes sense.

use crate::{Aabb, Error, Result, Settings, schedule::Schedule};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Declares a section of the configuration: plain public fields, unknown keys refused.
macro_rules! section {
    ($(#[$meta:meta])* $name:ident { $($field:ident: $kind:ty),* $(,)? }) => {
        $(#[$meta])*
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        #[allow(missing_docs)] // one description per setting: the comment in defaults.toml
        pub struct $name { $(pub $field: $kind),* }
    };
}

/// Declares a named choice, written in lower case.
macro_rules! choice {
    ($(#[$meta:meta])* $name:ident { $($(#[$doc:meta])* $variant:ident),* $(,)? }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
        #[serde(rename_all = "lowercase")]
        pub enum $name { $($(#[$doc])* $variant),* }
    };
}

choice!(
    /// Layout of a scene folder.
    Format {
        /// Found out from the files in the folder.
        Auto,
        /// `transforms_{split}.json` or `transforms.json`.
        Blender,
        /// The public multi-scale set's `metadata.json`.
        Multiscale,
        /// The procedural scene, rendered on the spot.
        Builtin,
    }
);
choice!(
    /// How RGBA is averaged to coarser scales.
    Convention {
        /// Straight RGBA means truncated to 8 bits, as the public multi-scale set is made.
        Public,
        /// Means of premultiplied RGBA: right at silhouettes.
        Premultiplied,
    }
);
choice!(
    /// Texels of a plane.
    PlaneShape {
        /// `plane_size` along both sides, whatever the box: the planes are stretched over it (paper).
        Square,
        /// `plane_size` along the box's longest side, along the others as many as make the texels square.
        Box,
    }
);
choice!(
    /// Whether the scene plan leaves something out.
    PlanChoice {
        /// Where the scene does not need it.
        Auto,
        /// Where the scene does not need it, even in settings that were given; an error where that cannot be known.
        On,
        /// Never.
        Off,
    }
);
choice!(
    /// Numbers of the planes in a model file.
    FilePrecision {
        /// 32 bits: what was trained.
        F32,
        /// 16 bits.
        F16,
    }
);
choice!(
    /// Base radius in the mip level's formula (Tri-MipRF Eq. 5).
    LevelFormula {
        /// texel/√π, the radius of a disc with the texel's area.
        Paper,
        /// texel/2.
        Code,
    }
);
choice!(
    /// Numbers that the hidden layers multiply; sums and parameters are f32.
    Precision {
        /// 24 bits.
        F32,
        /// 8 bits: twice the rate where the processor has instructions for it. On a CPU.
        Bf16,
        /// 11 bits, up to 65,504: the cooperative matrices of a GPU.
        F16,
    }
);
choice!(
    /// Rays over which the loss is averaged.
    LossRays {
        /// Rays with at least one kept sample.
        Live,
        /// Every ray of the batch.
        All,
    }
);

choice!(
    /// Surfaces of the built-in scene: how their colour changes with the view.
    Finish {
        /// Some mirror or shine.
        Mixed,
        /// None does: a point has one colour, from wherever it is seen.
        Matt,
        /// All do.
        Lacquered,
    }
);
choice!(
    /// Background that training rays are composited on.
    TrainBackground {
        /// `data.background`.
        Fixed,
        /// A colour drawn for each ray.
        Random,
    }
);
choice!(
    /// Where a GPU backend keeps the training photographs.
    Photographs {
        /// On the device where one binding holds them, else on the host.
        Auto,
        /// On the device.
        Device,
        /// On the host: the pixels that a step draws are sent to the device.
        Host,
    }
);
choice!(
    /// How the learning rate falls.
    RateSchedule {
        /// By a factor at each milestone.
        Milestones,
        /// Along half a cosine.
        Cosine,
    }
);
choice!(
    /// What AdamW does with texels that a step gave no gradient.
    Untouched {
        /// As with all others: moments decay and the parameter moves on.
        Decay,
        /// Nothing.
        Skip,
    }
);

section!(
    /// Where the photographs are and how they are prepared.
    DataConfig {
        root: String, format: Format, train: Vec<String>, test: String, holdout: u32, scales: u32, convention: Convention,
        background: [f32; 3], builtin_size: u32, builtin_train: u32, builtin_test: u32, builtin_supersampling: u32,
        builtin_finish: Finish, most_pixels: f64,
    }
);
section!(
    /// The box that bounds the scene.
    SceneConfig { aabb_min: [f32; 3], aabb_max: [f32; 3] }
);
section!(
    /// What follows the data and the budget, and what is left out where the scene does not need it.
    PlanConfig {
        aabb: PlanChoice, background: PlanChoice, solids: PlanChoice, schedule: PlanChoice, detail: PlanChoice, levels: PlanChoice, occupancy: PlanChoice, directions: PlanChoice, file: PlanChoice,
    }
);
section!(
    /// The model file.
    FileConfig { planes: FilePrecision }
);
section!(
    /// The tri-mip encoding.
    EncoderConfig {
        plane_size: u32, shape: PlaneShape, channels: u32, levels: u32, mipmap: bool, level: LevelFormula,
        level_bias: f32, init_range: f32, halvings: Schedule,
    }
);
section!(
    /// The two small networks.
    FieldConfig { hidden: u32, density_layers: u32, color_layers: u32, directions: bool, precision: Precision }
);
section!(
    /// Marching and compositing.
    RendererConfig {
        steps_per_diagonal: u32, step_scale: Schedule, step_per_radius: f32, min_transmittance: f32,
        min_weight: f32,
    }
);
section!(
    /// The occupancy grid.
    OccupancyConfig {
        resolution: u32, every: u32, warmup: u32, warmup_fraction: f32, fraction: f32, decay: f32,
        threshold: f32,
    }
);
section!(
    /// The photometric loss.
    LossConfig { beta: f32, opacity: f32, rays: LossRays }
);
section!(
    /// AdamW and its schedule.
    OptimizerConfig {
        learning_rate: f64, plane_scale: f64, beta1: f64, beta2: f64, epsilon: f64, weight_decay: f64,
        schedule: RateSchedule, decay_factor: f64, milestones: Vec<f64>, final_factor: f64, untouched: Untouched,
    }
);
section!(
    /// Length of the run and size of a step.
    TrainConfig {
        steps: u64, seconds: f64, samples_per_step: u32, batch_scale: Schedule, scale_balance: Schedule, background: TrainBackground,
        background_share: Schedule,
        checkpoint_seconds: f64, log_seconds: f64,
    }
);
section!(
    /// When and on what the model is evaluated.
    EvalConfig { points: u32, stride: u32, r#final: FinalEval, share: f64, images: u32, min_psnr: f64, min_gain: f64 }
);

/// The final evaluation: a stride over the test views, or a flag.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum FinalEval {
    /// `true`: every `eval.stride`-th view; `false`: none.
    Flag(bool),
    /// Every n-th view; 0: none.
    Stride(u32),
}

impl DataConfig {
    /// Which frames a model is tested on, in words.
    pub fn tested_on(&self) -> String {
        match self.holdout {
            0 => self.test.clone(),
            every => format!("one frame in {every} of {}, kept back", self.train.join(" + ")),
        }
    }
}

/// Test views of an evaluation on the way, where `eval.stride` is 0.
const CURVE_VIEWS: usize = 4;

impl EvalConfig {
    /// Stride of the final evaluation over the test views, `None` when there is none.
    pub fn final_stride(&self, frames: usize) -> Option<usize> {
        match self.r#final {
            FinalEval::Flag(true) => Some(self.stride_of(frames)),
            FinalEval::Flag(false) | FinalEval::Stride(0) => None,
            FinalEval::Stride(stride) => Some(stride as usize),
        }
    }

    /// Stride of the evaluations on the way over `frames` test views: as given, or the one that leaves about four.
    pub fn stride_of(&self, frames: usize) -> usize {
        match self.stride {
            0 => (frames / CURVE_VIEWS).max(1),
            stride => stride as usize,
        }
    }
}

section!(
    /// The GPU.
    WgpuConfig { adapter: String, deterministic: bool, photographs: Photographs }
);
section!(
    /// Everything a run is told.
    Config {
        backend: String, seed: u64, threads: u32, data: DataConfig, scene: SceneConfig, plan: PlanConfig,
        file: FileConfig, encoder: EncoderConfig, field: FieldConfig, renderer: RendererConfig, occupancy: OccupancyConfig,
        loss: LossConfig, optimizer: OptimizerConfig, train: TrainConfig, eval: EvalConfig, wgpu: WgpuConfig,
    }
);

impl Default for Config {
    /// The values of `defaults.toml`.
    fn default() -> Self {
        Self::from_settings(&Settings::defaults())
            .unwrap_or_else(|error| unreachable!("defaults.toml is tested: {error}"))
    }
}

impl EncoderConfig {
    /// What the texels along a side of the planes are a multiple of, so that every level and halving is even.
    pub fn texel_unit(&self) -> u32 {
        let halvings = self.halvings.values().fold(0.0, f64::max) as u32;
        1 << self.levels.saturating_sub(1).max(halvings).min(31)
    }
}

impl TrainConfig {
    /// Share of the training rays at `progress` in [0, 1] that have a random background.
    pub fn random_share(&self, progress: f64) -> f32 {
        match self.background {
            TrainBackground::Fixed => 0.0,
            TrainBackground::Random => self.background_share.at(progress) as f32,
        }
    }
}

impl Config {
    /// World length of the uniform marching step: longest side · √3 / steps (code).
    pub fn step_length(&self) -> f32 {
        Aabb::<f32>::new(&self.scene).longest() * 3.0_f32.sqrt() / self.renderer.steps_per_diagonal as f32
    }

    /// The same run with its box around the origin, and where the box's centre was: far away from the origin f32 has no
    /// digits left for what happens in the box.
    pub fn centred(&self) -> (Self, DVec3) {
        let scene = Aabb::<f64>::new(&self.scene);
        let centre: [f64; 3] = std::array::from_fn(|axis| 0.5 * (scene.min[axis] + scene.max[axis]));
        let mut config = self.clone();
        let shifted = |corner: [f64; 3]| std::array::from_fn(|axis| (corner[axis] - centre[axis]) as f32);
        (config.scene.aabb_min, config.scene.aabb_max) = (shifted(scene.min), shifted(scene.max));
        (config, DVec3::from_array(centre))
    }

    /// The typed configuration of layered settings, every range checked.
    pub fn from_settings(settings: &Settings) -> Result<Self> {
        let config: Self = settings.table().try_into().map_err(|error: toml::de::Error| {
            // The error names the key in its last line; its value's origin is the place to mend.
            let text = error.to_string();
            let place = settings
                .iter()
                .map(|(path, ..)| path)
                .find(|path| text.contains(&format!("`{path}`")))
                .map_or("configuration".to_string(), |path| settings.place(path));
            Error::input(place, error.message(), "choose one of the values named in defaults.toml")
        })?;
        config.validate(|path| settings.place(path))?;
        Ok(config)
    }

    /// Parses one effective configuration as written in a run folder; `name` stands in errors.
    pub fn from_toml(name: &str, text: &str) -> Result<Self> {
        let mut settings = Settings::defaults();
        settings.apply_file(name, text)?;
        Self::from_settings(&settings)
    }

    /// The whole configuration as TOML text.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).unwrap_or_else(|error| unreachable!("plain data: {error}"))
    }

    /// Checks every range; `place` turns a dotted path into the place where its value was set.
    fn validate(&self, place: impl Fn(&str) -> String) -> Result<()> {
        let check = |ok: bool, path: &str, expected: &str| {
            if ok {
                Ok(())
            } else {
                Err(Error::input(place(path), "out of range", format!("expected {expected}")))
            }
        };
        let positive = |x: f64| x.is_finite() && x > 0.0;
        check((1..=8).contains(&self.data.scales), "data.scales", "1 to 8")?;
        check(self.data.holdout != 1, "data.holdout", "0, or 2 and more")?;
        check(!self.data.train.is_empty(), "data.train", "at least one split")?;
        check(
            self.data.background.iter().all(|c| (0.0..=1.0).contains(c)),
            "data.background",
            "three values from 0 to 1",
        )?;
        check(self.data.most_pixels >= 1.0, "data.most_pixels", "1 or more")?;
        check((8..=4096).contains(&self.data.builtin_size), "data.builtin_size", "8 to 4096")?;
        check((1..=10_000).contains(&self.data.builtin_train), "data.builtin_train", "1 to 10000")?;
        check((1..=10_000).contains(&self.data.builtin_test), "data.builtin_test", "1 to 10000")?;
        check((1..=64).contains(&self.data.builtin_supersampling), "data.builtin_supersampling", "1 to 64")?;
        let sides = (0..3).map(|axis| self.scene.aabb_max[axis] - self.scene.aabb_min[axis]);
        check(
            sides.into_iter().all(|side| side.is_finite() && side > 0.0),
            "scene.aabb_max",
            "a corner above aabb_min on every axis, all finite",
        )?;
        let encoder = &self.encoder;
        check(encoder.channels == 16, "encoder.channels", "16 (the only width built so far)")?;
        check(
            encoder.init_range.is_finite() && encoder.init_range >= 0.0,
            "encoder.init_range",
            "0 or more",
        )?;
        check(
            encoder.level_bias.is_finite() && encoder.level_bias.abs() <= 8.0,
            "encoder.level_bias",
            "-8 (sharper) to 8 (blurrier)",
        )?;
        let halvings = || encoder.halvings.values();
        check(
            encoder.halvings.is_whole()
                && halvings().all(|h| h.fract() == 0.0 && (0.0..=10.0).contains(&h))
                && halvings().is_sorted_by(|a, b| a > b)
                && halvings().last() == Some(0.0),
            "encoder.halvings",
            "[[0.0, n], ... [fraction, 0]] with rising fractions below 1 and falling whole numbers",
        )?;
        check((1..=13).contains(&encoder.levels), "encoder.levels", "1 to 13")?;
        let unit = encoder.texel_unit();
        check(
            (4..=4096).contains(&encoder.plane_size) && encoder.plane_size.is_multiple_of(unit),
            "encoder.plane_size",
            &format!("a multiple of {unit} from 4 to 4096, so that {} levels halve evenly", encoder.levels),
        )?;
        let field = &self.field;
        check(
            (16..=512).contains(&field.hidden) && field.hidden.is_multiple_of(16),
            "field.hidden",
            "a multiple of 16 from 16 to 512",
        )?;
        check((1..=8).contains(&field.density_layers), "field.density_layers", "1 to 8")?;
        check((1..=8).contains(&field.color_layers), "field.color_layers", "1 to 8")?;
        let renderer = &self.renderer;
        check(
            (16..=65_536).contains(&renderer.steps_per_diagonal),
            "renderer.steps_per_diagonal",
            "16 to 65536",
        )?;
        check(
            renderer.step_scale.is_whole()
                && renderer.step_scale.values().all(|s| (0.25..=64.0).contains(&s)),
            "renderer.step_scale",
            "[[0.0, scale], ...] with rising fractions below 1 and scales from 0.25 to 64",
        )?;
        check((0.0..=64.0).contains(&renderer.step_per_radius), "renderer.step_per_radius", "0 to 64")?;
        check(
            (0.0..1.0).contains(&renderer.min_transmittance),
            "renderer.min_transmittance",
            "0 to below 1",
        )?;
        check((0.0..1.0).contains(&renderer.min_weight), "renderer.min_weight", "0 to below 1")?;
        let occupancy = &self.occupancy;
        check(
            (4..=1024).contains(&occupancy.resolution) && occupancy.resolution.is_multiple_of(4),
            "occupancy.resolution",
            "a multiple of 4 from 4 to 1024",
        )?;
        check(occupancy.every >= 1, "occupancy.every", "1 or more")?;
        check((0.0..=1.0).contains(&occupancy.warmup_fraction), "occupancy.warmup_fraction", "0 to 1")?;
        check((0.0..=1.0).contains(&occupancy.fraction), "occupancy.fraction", "0 to 1")?;
        check((0.0..=1.0).contains(&occupancy.decay), "occupancy.decay", "0 to 1")?;
        check(occupancy.threshold >= 0.0, "occupancy.threshold", "0 or more")?;
        check(positive(self.loss.beta.into()), "loss.beta", "a number above 0")?;
        check(self.loss.opacity >= 0.0 && self.loss.opacity.is_finite(), "loss.opacity", "0 or more")?;
        let optimizer = &self.optimizer;
        check(positive(optimizer.learning_rate), "optimizer.learning_rate", "a number above 0")?;
        check(positive(optimizer.plane_scale), "optimizer.plane_scale", "a number above 0")?;
        check((0.0..1.0).contains(&optimizer.beta1), "optimizer.beta1", "0 to below 1")?;
        check((0.0..1.0).contains(&optimizer.beta2), "optimizer.beta2", "0 to below 1")?;
        check(positive(optimizer.epsilon), "optimizer.epsilon", "a number above 0")?;
        check(
            optimizer.weight_decay.is_finite() && optimizer.weight_decay >= 0.0,
            "optimizer.weight_decay",
            "0 or more",
        )?;
        check(positive(optimizer.decay_factor), "optimizer.decay_factor", "a number above 0")?;
        check(
            optimizer.milestones.iter().all(|m| (0.0..=1.0).contains(m)) && optimizer.milestones.is_sorted(),
            "optimizer.milestones",
            "rising fractions from 0 to 1",
        )?;
        check((0.0..=1.0).contains(&optimizer.final_factor), "optimizer.final_factor", "0 to 1")?;
        let train = &self.train;
        check(train.seconds.is_finite() && train.seconds >= 0.0, "train.seconds", "0 or more")?;
        check(
            train.steps > 0 || train.seconds > 0.0,
            "train.seconds",
            "a budget: train.seconds or train.steps above 0",
        )?;
        check(
            (256..=4_194_304).contains(&train.samples_per_step),
            "train.samples_per_step",
            "256 to 4194304",
        )?;
        check(
            train.batch_scale.is_whole() && train.batch_scale.values().all(|s| (0.01..=1.0).contains(&s)),
            "train.batch_scale",
            "[[0.0, scale], ...] with rising fractions below 1 and scales from 0.01 to 1",
        )?;
        check(
            train.background_share.is_whole()
                && train.background_share.values().all(|share| (0.0..=1.0).contains(&share)),
            "train.background_share",
            "[[0.0, share], ... [fraction, share]] with rising fractions below 1 and shares from 0 to 1",
        )?;
        check(
            train.scale_balance.is_whole() && train.scale_balance.values().all(|b| (0.0..=1.0).contains(&b)),
            "train.scale_balance",
            "[[0.0, balance], ...] with rising fractions below 1 and balances from 0 to 1",
        )?;
        check(train.checkpoint_seconds >= 0.0, "train.checkpoint_seconds", "0 or more")?;
        check(positive(train.log_seconds), "train.log_seconds", "a number above 0")?;
        check((0.0..=100.0).contains(&self.eval.share), "eval.share", "0 to 100")?;
        check(self.eval.min_gain.is_finite(), "eval.min_gain", "a number")?;
        check(self.eval.min_psnr.is_finite(), "eval.min_psnr", "a number")?;
        check(
            self.eval.min_psnr <= 0.0 || self.eval.final_stride(1).is_some(),
            "eval.min_psnr",
            "0, where eval.final = false measures nothing",
        )?;
        Ok(())
    }

    /// Dotted paths of settings whose change makes another model of the same run: all but the device, the threads,
    /// what is logged, what is evaluated, how it was planned and how it is written. Used to refuse a checkpoint of another configuration.
    pub fn differences(&self, other: &Self) -> Vec<String> {
        let (ours, theirs) = (self.settings(), other.settings());
        ours.iter()
            .zip(theirs.iter())
            .filter(|((path, ours), (_, theirs))| ours != theirs && !free_to_change(path))
            .map(|((path, ours), (_, theirs))| format!("{path} is {ours}, was {theirs}"))
            .collect()
    }

    /// Dotted path and value of every setting.
    fn settings(&self) -> Vec<(String, toml::Value)> {
        let mut settings = Settings::defaults();
        settings
            .apply_file("config", &self.to_toml())
            .unwrap_or_else(|error| unreachable!("our own text: {error}"));
        settings.iter().map(|(path, value, _)| (path.to_string(), value.clone())).collect()
    }
}

fn free_to_change(path: &str) -> bool {
    path == "backend"
        || path == "threads"
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
    fn ranges_and_choices_are_refused_with_their_place() {
        for (assignment, expected) in [
            ("encoder.plane_size=500", "a multiple of 128"),
            ("encoder.level=\"papers\"", "expected"),
            ("train.samples_per_step=0", "256 to"),
            ("scene.aabb_min=[2.0, 0.0, 0.0]", "a corner above"),
            ("scene.aabb_min=[0.0, 0.0]", ""),
            ("optimizer.learning_rate=nan", "a number above 0"),
        ] {
            let mut settings = Settings::defaults();
            settings.apply_assignment(assignment).unwrap();
            let error = Config::from_settings(&settings).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            assert!(error.message.contains(expected), "{assignment}: {error}");
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
