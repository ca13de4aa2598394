//! Checkpoints: everything that training needs to continue with the same bits (parameters, moments, occupancy,
//! counters). Random numbers are hashes of (seed, step, index), so the step number is the whole random state.

pub use crate::{engine::batch::MOST_PENDING, field::tensor_names::OCCUPANCY_DENSITY};

use crate::{
    Advice, Config, Error, Result,
    engine::{batch::StepSums, error_map, events::Totals, exposure, poses, trainer::rays::most_rays},
    field::{
        encoders,
        model::{Model, expect_format, expect_tensors},
        tensors::{TensorFile, Values},
    },
    scene::{fingerprint::Fingerprint, known_space::Confinement},
};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Value of the metadata `format` of a checkpoint file.
pub const FORMAT: &str = "trimip-checkpoint-1";

/// State that is not in tensors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TrainState {
    /// Counters of the run.
    pub totals: Totals,
    /// Stage of growth of the encoder's parameters, see [`crate::field::encoders::Definition::stage`].
    #[serde(default, rename = "halvings")]
    pub stage: u32,
    /// Ray marching step of the last training step, in units of the uniform step and divided by the number of cones per
    /// pixel; 0 before the first training step. The number of samples per pixel is inversely proportional to this
    /// value.
    #[serde(default, rename = "step_scale")]
    pub spacing: f64,
    /// Sums of the last steps, which later steps will use (oldest first), each with the `spacing` of its step. The
    /// totals already include these sums.
    #[serde(default)]
    pub pending: [Option<(f64, StepSums)>; MOST_PENDING],
    /// Pixels of the next step (dynamic batch).
    pub rays_per_step: u32,
    /// Number of marched samples per pixel in the last step. It determines the size of the next step's tiles.
    pub marched_per_ray: f32,
    /// Smallest norm of a sample's gradient at which the sample is certain to have a backward pass, see
    /// [`SampleDraw`](crate::engine::batch::SampleDraw); 0 while all samples have a backward pass.
    #[serde(default)]
    pub draw_threshold: f64,
    /// The step after which the optimiser's moments last started from zero.
    #[serde(default)]
    pub moments_since: u64,
    /// Which cells of the occupancy grid can be occupied.
    #[serde(default)]
    pub confinement: Confinement,
    /// The views that the run is trained on.
    #[serde(default)]
    pub data: Option<Fingerprint>,
}

/// Upper bound of the counts of a run. An f64 holds every count up to this bound exactly, and sums of a few counts do
/// not overflow.
const MOST_COUNTED: u64 = 1 << 53;

/// Upper bound of [`TrainState::spacing`]; its inverse is the lower bound. The largest marching step is 64 uniform
/// steps. The smallest spacing is a quarter of a uniform step with 64 cones per pixel (1/256).
const MOST_SPACING: f64 = 256.0;

impl TrainState {
    /// Rejects a state that no run of `config` can have; `place` names the checkpoint in errors.
    fn expect_possible(&self, place: &str, config: &Config) -> Result<()> {
        let check = |possible: bool, name: &str, value: &dyn std::fmt::Display, expected: &str| match possible
        {
            true => Ok(()),
            false => Err(Error::input(
                place,
                format!("its state: {name} is {value}, expected {expected}: the file is damaged"),
                Advice::StartOver,
            )),
        };
        let Totals { step, seconds, samples, marched, rays, empty_batches, non_finite, left_out } =
            self.totals;
        for (name, count) in [
            ("step", step),
            ("samples", samples),
            ("marched", marched),
            ("rays", rays),
            ("empty_batches", empty_batches),
            ("left_out", left_out),
            ("non_finite", non_finite),
        ] {
            check(count <= MOST_COUNTED, name, &count, "0 to 2^53")?;
        }
        check(seconds.is_finite() && seconds >= 0.0, "seconds", &seconds, "0 or more")?;
        check(
            self.moments_since <= step,
            "moments_since",
            &self.moments_since,
            &format!("0 to {step}, the step that it has reached"),
        )?;
        let stage = encoders::of(config).stage(config, 0.0);
        check(self.stage <= stage, "halvings", &self.stage, &format!("0 to {stage}"))?;
        let spacing = |value: f64| (1.0 / MOST_SPACING..=MOST_SPACING).contains(&value);
        check(
            self.spacing == 0.0 || spacing(self.spacing),
            "step_scale",
            &self.spacing,
            "0, or 1/256 to 256",
        )?;
        check(
            self.draw_threshold.is_finite() && self.draw_threshold >= 0.0,
            "draw_threshold",
            &self.draw_threshold,
            "0 or more",
        )?;
        for (spaced, sums) in self.pending.iter().flatten() {
            check(spacing(*spaced), "step_scale of a pending step", spaced, "1/256 to 256")?;
            for value in [sums.loss, sums.weight, sums.squared_error] {
                check(value.is_finite() && value >= 0.0, "a pending sum", &value, "0 or more")?;
            }
            for count in [sums.rays, sums.marched, sums.kept, sums.drawn, sums.non_finite] {
                check(count <= MOST_COUNTED, "a pending count", &count, "0 to 2^53")?;
            }
        }
        let most = most_rays(config, rays);
        check(
            (1..=most).contains(&self.rays_per_step.into()),
            "rays_per_step",
            &self.rays_per_step,
            &format!("1 to {most}"),
        )?;
        check(
            (0.0..=1e9).contains(&self.marched_per_ray),
            "marched_per_ray",
            &self.marched_per_ray,
            "0 to 1e9",
        )
    }
}

/// Returns true for the tensors, other than moments, that only training needs.
fn of_training(name: &str) -> bool {
    name == OCCUPANCY_DENSITY
        || [exposure::PREFIX, poses::PREFIX, error_map::PREFIX].iter().any(|prefix| name.starts_with(prefix))
}

/// The state of a training run.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// The configuration of the run.
    pub config: Config,
    /// Counters and batch state.
    pub state: TrainState,
    /// Parameters by name, their moments `<name>.m` and `<name>.v`, `occupancy` bits and `occupancy.density`. With
    /// `loss.exposure` also the log-gains of the photographs, `exposure.*`; with refined poses the corrections of the
    /// poses, `poses.*`; with `train.error_map` the state of the error map, `error_map.*`.
    pub file: TensorFile,
}

impl Checkpoint {
    /// Returns the name, index and value of the first number that is not finite.
    pub fn not_finite(&self) -> Option<(&str, usize, f32)> {
        self.file.tensors.iter().find_map(|(name, tensor)| {
            let (index, value) = tensor.not_finite()?;
            Some((name.as_str(), index, value))
        })
    }

    /// Returns the current model at full size, without the state that only training needs.
    pub fn into_model(self) -> Model {
        let Self { config, state, mut file } = self;
        file.tensors.retain(|name, _| !(name.ends_with(".m") || name.ends_with(".v") || of_training(name)));
        let encoder = encoders::of(&config);
        for slot in encoder.slots(&config).iter().filter(|slot| slot.grows) {
            if let Some(Values::F32(values)) =
                file.tensors.get_mut(&slot.name).map(|tensor| &mut tensor.values)
            {
                encoder.grow(&config, slot, values, state.stage, 0);
            }
        }
        Model::new(config, file)
    }

    /// Writes the checkpoint, atomically; returns its size in bytes.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<u64> {
        self.file.write(path, &self.metadata()?)
    }

    /// Returns the bytes of the file that [`write`](Self::write) writes.
    ///
    /// # Errors
    /// When the state cannot be written as JSON.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        self.file.to_bytes(&self.metadata()?)
    }

    fn metadata(&self) -> Result<[(&'static str, String); 3]> {
        let state = serde_json::to_string(&self.state).map_err(Error::run)?;
        Ok([("format", FORMAT.to_string()), ("config", self.config.to_toml()), ("state", state)])
    }

    /// Reads a checkpoint and checks it: its format, its settings, its state, and every tensor's shape and numbers.
    ///
    /// # Errors
    /// When the file cannot be read, is not a checkpoint that this build understands, or has tensors or a state that
    /// its configuration does not allow.
    pub fn read(path: &Path) -> Result<Self> {
        Self::of(&path.display().to_string(), TensorFile::read(path)?)
    }

    /// Reads a checkpoint from the bytes of its file; `name` names the file in errors.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<Self> {
        Self::of(name, TensorFile::from_bytes(name, bytes)?)
    }

    fn of(name: &str, file: TensorFile) -> Result<Self> {
        expect_format(name, &file, FORMAT)?;
        let config = Config::from_toml(&format!("{name} (its config)"), file.text(name, "config")?)?;
        let state: TrainState = serde_json::from_str(file.text(name, "state")?).map_err(|error| {
            Error::input(name, format!("its state: {error}"), "use a checkpoint of this version")
        })?;
        state.expect_possible(name, &config)?;
        expect_tensors(name, &file, &config, &["", ".m", ".v"])?;
        file.f32(name, OCCUPANCY_DENSITY, &[config.occupancy.cells()])?;
        Ok(Self { config, state, file })
    }

    /// Refuses a checkpoint whose settings differ from `config`.
    ///
    /// # Errors
    /// When a setting differs; the error names every such setting.
    pub fn expect_config(&self, place: &str, config: &Config) -> Result<()> {
        let differences = config.differences(&self.config);
        if differences.is_empty() {
            return Ok(());
        }
        Err(Error::input(
            place,
            format!("checkpoint of another configuration ({})", differences.join(", ")),
            "use the same settings to resume, or another folder to start afresh",
        ))
    }
}
