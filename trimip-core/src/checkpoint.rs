//! Everything that training needs to continue with the same bits: parameters, moments, occupancy, counters. Random
//! numbers are hashes of (seed, step, index), so the step is the whole random state.

use crate::{
    Config, Error, Layout, Result,
    batch::StepSums,
    encoders,
    events::Totals,
    exposure,
    model::{Model, cells, expect_format, expect_tensors},
    tensors::{TensorFile, Values},
};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Value of the metadata `format` of a checkpoint file.
pub const FORMAT: &str = "trimip-checkpoint-1";

/// Name of the tensor of the grid's running maximum of densities.
pub const OCCUPANCY_DENSITY: &str = "occupancy.density";

/// Largest number of steps whose sums are not read back yet.
pub const MOST_PENDING: usize = 2;

/// State that is not in tensors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TrainState {
    /// Counters of the run.
    pub totals: Totals,
    /// Stage of growth of the encoder's parameters, see [`crate::encoders::Definition::stage`].
    #[serde(default, rename = "halvings")]
    pub stage: u32,
    /// The marching step of the last step in uniform steps, divided by the cones of a pixel; 0 before the first. A
    /// pixel's samples are inversely proportional to it.
    #[serde(default, rename = "step_scale")]
    pub spacing: f64,
    /// Sums of the last steps that the next ones will use, oldest first, each with its step's `spacing`. The totals
    /// hold them.
    #[serde(default)]
    pub pending: [Option<(f64, StepSums)>; MOST_PENDING],
    /// Pixels of the next step (dynamic batch).
    pub rays_per_step: u32,
    /// Marched samples per pixel of the last step, which sizes the next step's spans.
    pub marched_per_ray: f32,
}

impl TrainState {
    /// The first number that no training with that configuration has.
    fn impossible(&self, config: &Config) -> Option<String> {
        let is_size = |value: f64| value.is_finite() && value >= 0.0;
        let last_stage = encoders::of(config).stage(config, 0.0);
        if self.stage > last_stage {
            return Some(format!("`halvings` is {}, at most {last_stage} are configured", self.stage));
        }
        let sizes = [
            ("totals.seconds", self.totals.seconds),
            ("step_scale", self.spacing),
            ("marched_per_ray", self.marched_per_ray.into()),
        ];
        let wrong = sizes.into_iter().find(|(_, value)| !is_size(*value));
        wrong.map(|(name, value)| format!("`{name}` is {value}, not a finite number from 0"))
    }
}

/// True for tensors, beside moments, that only training needs.
fn of_training(name: &str) -> bool {
    name == OCCUPANCY_DENSITY || name.starts_with(exposure::PREFIX)
}

/// The state of a training run.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// The configuration of the run.
    pub config: Config,
    /// Counters and batch state.
    pub state: TrainState,
    /// Parameters by name, `<name>.m` and `<name>.v` moments, `occupancy` bits and `occupancy.density`; with
    /// `loss.exposure` the log-gains of the photographs, `exposure.*`.
    pub file: TensorFile,
}

impl Checkpoint {
    /// Name, index and value of the first number that is not finite.
    pub fn not_finite(&self) -> Option<(&str, usize, f32)> {
        self.file.tensors.iter().find_map(|(name, tensor)| match &tensor.values {
            Values::F32(values) => {
                let index = values.iter().position(|value| !value.is_finite())?;
                Some((name.as_str(), index, values[index]))
            }
            Values::F16(_) | Values::U8(_) => None,
        })
    }

    /// The current model at full size, without the state that only training needs.
    pub fn into_model(self) -> Model {
        let Self { config, state, mut file } = self;
        file.tensors.retain(|name, _| !(name.ends_with(".m") || name.ends_with(".v") || of_training(name)));
        let encoder = encoders::of(&config);
        for slot in encoder.slots(&config).iter().filter(|slot| slot.grows) {
            if let Some(Values::F32(values)) =
                file.tensors.get_mut(&slot.name).map(|tensor| &mut tensor.values)
            {
                encoder.grow(&config, values, state.stage, 0);
            }
        }
        Model::new(config, file)
    }

    /// Writes the checkpoint, atomically; returns its size in bytes.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<u64> {
        let state = serde_json::to_string(&self.state).map_err(Error::run)?;
        let metadata = [("format", FORMAT.to_string()), ("config", self.config.to_toml()), ("state", state)];
        self.file.write(path, &metadata)
    }

    /// Reads a checkpoint and checks that its tensors and its state are those of its configuration.
    ///
    /// # Errors
    /// When the file cannot be read, is not a checkpoint that this build understands, or has other tensors or an impossible
    /// state.
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
        let wrong = |what: String| Error::input(name, what, "use a checkpoint of this version");
        let state: TrainState = serde_json::from_str(file.text(name, "state")?)
            .map_err(|error| wrong(format!("its state: {error}")))?;
        if let Some(what) = state.impossible(&config) {
            return Err(wrong(format!("its state: {what}")));
        }
        expect_tensors(name, &config, &file)?;
        let layout = Layout::new(&config);
        [".m", ".v"].into_iter().try_for_each(|moment| layout.expect(&file, name, moment))?;
        file.f32(name, OCCUPANCY_DENSITY, &[cells(&config)])?;
        Ok(Self { config, state, file })
    }

    /// Refuses a checkpoint whose settings differ from `config`.
    ///
    /// # Errors
    /// When a setting differs; names each.
    pub fn expect_config(&self, place: &str, config: &Config) -> Result<()> {
        let differences = config.differences(&self.config);
        if differences.is_empty() {
            return Ok(());
        }
        Err(Error::input(
            place,
            format!("checkpoint of another configuration ({})", differences.join(", ")),
            "use the same settings to resume, or another --out folder to start afresh",
        ))
    }
}
