//! The sections of the configuration, and values derived from the settings of a single section.

use super::choices::{
    CameraPoses, ConePattern, Contraction, Convention, DensityFunction, FilePrecision, FinalEval, HybridRule,
    PlanChoice, Precision, RateSchedule, RendererKind, TrainBackground, Untouched, ViewEncoding,
};
use super::crop::Crop;
use crate::config::schedule::Schedule;
use serde::{Deserialize, Serialize};

/// Declares a section of the configuration: a struct with public fields, whose deserialisation refuses unknown keys. The
/// meaning of each field is in the table of defaults, from which `tables/` is generated.
macro_rules! section {
    ($(#[$meta:meta])* $name:ident, $table:literal { $($field:ident: $kind:ty),* $(,)? }) => {
        $(#[$meta])*
        #[doc = ""]
        #[doc = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/config/tables/", $table, ".md"))]
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            $(
                #[doc = concat!("The setting `", stringify!($field), "` of the table above.")]
                pub $field: $kind,
            )*
        }
    };
}

pub(crate) use section;

section!(
    /// Core's settings of the photographs: their folder, their scales and the meaning of their pixels. `trimip-data` adds
    /// settings for reading photographs.
    PhotographsConfig, "data" {
        root: String, origin: Vec<f64>, scales: u32, convention: Convention, edge_exponents: Vec<f32>, background: [f32; 3],
    }
);
section!(
    /// The bounding box of the scene.
    SceneConfig, "scene" { aabb_min: [f32; 3], aabb_max: [f32; 3], contraction: Contraction, up: [f32; 3], crop: Crop }
);
section!(
    /// Decisions of the scene plan: settings that it may derive from the data and the budget, and parts that it may leave
    /// out.
    PlanConfig, "plan" {
        aabb: PlanChoice, encoder: PlanChoice, background: PlanChoice, edges: PlanChoice, hull: PlanChoice, solids: PlanChoice, direction_delay: PlanChoice, surfaces: PlanChoice, density: PlanChoice, error_map: PlanChoice, coarse_to_fine: PlanChoice, depth: PlanChoice, crop: PlanChoice, schedule: PlanChoice, detail: PlanChoice, cones: PlanChoice, levels: PlanChoice, occupancy: PlanChoice, directions: PlanChoice, file: PlanChoice,
    }
);
section!(
    /// The model file.
    FileConfig, "file" { planes: FilePrecision }
);
section!(
    /// The density and colour networks.
    FieldConfig, "field" {
        hidden: u32, density_layers: u32, joined: u32, color_layers: u32, color_hidden: u32, biases: bool, geometry: u32, geometry_frequencies: u32, deferred: bool,
        directions: bool, direction_delay: f64, view: ViewEncoding, harmonics: u32, view_frequencies: u32, view_sharpness: f32,
        density: DensityFunction, density_shift: f32, density_scale: f32, precision: Precision,
    }
);
section!(
    /// Ray marching and compositing.
    RendererConfig, "renderer" {
        kind: RendererKind, pattern: ConePattern, cones: u32, cone_width: f32, steps_per_diagonal: u32, step_scale: Schedule, step_per_radius: f32, min_transmittance: f32,
        min_weight: f32, color_weight: Schedule,
    }
);
section!(
    /// Where the hybrid renderer places samples.
    HybridConfig, "hybrid" {
        resolution: u32, step: f32, rule: HybridRule, least: f32, opaque: f32, delta: f32, samples: u32, layers: u32, surface: f32,
        shared_weight: f32, reach: f32, widest: f32,
    }
);
section!(
    /// The occupancy grid.
    OccupancyConfig, "occupancy" {
        resolution: u32, every: u32, warmup: u32, warmup_fraction: f32, fraction: f32, decay: f32,
        hull: bool, seeded: f64, cleared: f64, threshold: f32,
    }
);
section!(
    /// AdamW and its learning rate.
    OptimizerConfig, "optimizer" {
        learning_rate: f64, plane_scale: f64, exposure_rate: f64, camera_rate: f64, camera_delay: f64, beta1: f64, beta2: f64, epsilon: f64, weight_decay: f64,
        schedule: RateSchedule, decay_factor: f64, milestones: Vec<f64>, final_factor: f64, untouched: Untouched,
    }
);
section!(
    /// Length of the run and size of a step.
    TrainConfig, "train" {
        steps: u64, seconds: f64, samples_per_step: u32, leaves: u32, batch_scale: Schedule, backward_fraction: Schedule, error_map: Schedule, scale_weighting: Schedule, finest_scale: Schedule, cones: Schedule, background: TrainBackground,
        background_fraction: Schedule, cameras: CameraPoses,
        checkpoint_seconds: f64, log_seconds: f64,
    }
);
section!(
    /// When and on which views the model is evaluated.
    EvalConfig, "eval" { points: u32, stride: u32, r#final: FinalEval, time_fraction: f64, images: u32, perceptual_views: u32, lpips: String, min_psnr: f64, min_gain: f64 }
);

impl PhotographsConfig {
    /// Returns the edge exponent of photographs reduced by `factor`, see [`edge_exponents`](crate::scene::edge_exponents).
    pub fn edge_exponent(&self, factor: u32) -> f32 {
        self.edge_exponents.get(factor.trailing_zeros() as usize).copied().unwrap_or(0.0)
    }
}

/// Number of test views of an evaluation during training, for `eval.stride = 0`.
const CURVE_VIEWS: usize = 4;

impl EvalConfig {
    /// Returns the stride of the final evaluation over the test views; `None` if there is no final evaluation.
    pub fn final_stride(&self, frames: usize) -> Option<usize> {
        match self.r#final {
            FinalEval::Flag(true) => Some(self.stride_of(frames)),
            FinalEval::Flag(false) | FinalEval::Stride(0) => None,
            FinalEval::Stride(stride) => Some(stride as usize),
        }
    }

    /// Returns the stride of the evaluations during training over `frames` test views: the configured stride, or one that
    /// gives about four views.
    pub fn stride_of(&self, frames: usize) -> usize {
        match self.stride {
            0 => (frames / CURVE_VIEWS).max(1),
            stride => stride as usize,
        }
    }
}

impl TrainConfig {
    /// Returns the fraction of the training rays that have a random background at `progress` in [0, 1].
    pub fn random_background(&self, progress: f64) -> f32 {
        match self.background {
            TrainBackground::Fixed => 0.0,
            TrainBackground::Random => self.background_fraction.at(progress) as f32,
        }
    }
}
