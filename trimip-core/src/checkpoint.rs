//! Everything training needs to go on with the same bits: parameters, moments, occupancy, counters. Random numbers are
//! hashes of (seed, step, index), so the step is all the random state there is.

use crate::{
    Aabb, Config, Error, Result,
    batch::StepSums,
    events::Totals,
    model::{Model, PLANES, expect_format},
    tensors::{TensorFile, Values},
    tri_mip::{Pyramid, grow},
};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Value of the metadata `format` of a checkpoint file.
pub const FORMAT: &str = "trimip-checkpoint-1";

/// Name of the tensor of the grid's running maximum of densities.
pub const OCCUPANCY_DENSITY: &str = "occupancy.density";

/// Steps whose sums may be under way.
pub const MOST_PENDING: usize = 2;

/// State beside the tensors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TrainState {
    /// Counters of the run.
    pub totals: Totals,
    /// How often the planes' side is halved.
    #[serde(default)]
    pub halvings: u32,
    /// The marching step of the last step, in uniform steps; 0 before the first.
    #[serde(default)]
    pub step_scale: f64,
    /// Sums of the last steps that the next ones will use, oldest first, each with its step's `step_scale`. The totals
    /// hold them.
    #[serde(default)]
    pub pending: [Option<(f64, StepSums)>; MOST_PENDING],
    /// Rays of the next step (dynamic batch).
    pub rays_per_step: u32,
    /// Marched samples per ray of the last step, which sizes the next step's spans.
    pub marched_per_ray: f32,
}

/// A training run, frozen.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// The configuration of the run.
    pub config: Config,
    /// Counters and batch state.
    pub state: TrainState,
    /// Parameters by name, `<name>.m` and `<name>.v` moments, `occupancy` bits and `occupancy.density`.
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

    /// The model as it stands, its planes in full size; what only training needs is left out.
    pub fn into_model(self) -> Model {
        let Self { config, state, mut file } = self;
        file.tensors
            .retain(|name, _| !(name.ends_with(".m") || name.ends_with(".v") || name == OCCUPANCY_DENSITY));
        if let Some(Values::F32(planes)) = file.tensors.get_mut(PLANES).map(|planes| &mut planes.values) {
            let whole = Pyramid::new(&config.encoder, &Aabb::new(&config.scene));
            grow(planes, &whole, state.halvings, 0);
        }
        Model::new(config, file)
    }

    /// Writes the checkpoint, atomically; returns its size in bytes.
    pub fn write(&self, path: &Path) -> Result<u64> {
        let state = serde_json::to_string(&self.state).map_err(Error::run)?;
        let metadata = [("format", FORMAT.to_string()), ("config", self.config.to_toml()), ("state", state)];
        self.file.write(path, &metadata)
    }

    /// Reads a checkpoint and checks that it is one.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let file = TensorFile::read(path)?;
        expect_format(&name, &file, FORMAT)?;
        let config = Config::from_toml(&format!("{name} (its config)"), file.text(&name, "config")?)?;
        let state = serde_json::from_str(file.text(&name, "state")?).map_err(|error| {
            Error::input(&name, format!("its state: {error}"), "use a checkpoint of this version")
        })?;
        Ok(Self { config, state, file })
    }

    /// Refuses a checkpoint that was made with other settings than `config`.
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
