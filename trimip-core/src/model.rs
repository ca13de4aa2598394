//! A finished model: the parameters by name, the occupancy grid, and the configuration they belong to. Self-contained:
//! its file is all that rendering needs.

use crate::{Config, Error, Result, config::FilePrecision, tensors::TensorFile};
use std::path::Path;

/// Value of the metadata `format` of a model file.
const FORMAT: &str = "trimip-model-1";

/// Name of the planes' tensor.
pub(crate) const PLANES: &str = "planes";

/// Name of the occupancy grid's tensor: one bit per cell, cell order, lowest bit first.
pub const OCCUPANCY: &str = "occupancy";

/// Named tensors (see [`crate::params::Layout`]), the occupancy bits as tensor `occupancy` and the configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// The configuration the model was trained with.
    pub config: Config,
    /// Tensors and metadata as they stand in the file.
    pub file: TensorFile,
}

impl Model {
    /// Puts tensors and configuration together.
    pub fn new(config: Config, mut file: TensorFile) -> Self {
        file.metadata.insert("format".into(), FORMAT.into());
        file.metadata.insert("config".into(), config.to_toml());
        file.metadata
            .insert("aabb".into(), format!("{:?} {:?}", config.scene.aabb_min, config.scene.aabb_max));
        Self { config, file }
    }

    /// The same model with its planes rounded as its file will hold them.
    pub fn rounded(mut self) -> Self {
        if self.config.file.planes == FilePrecision::F16
            && let Some(planes) = self.file.tensors.remove(PLANES)
        {
            self.file.tensors.insert(PLANES.into(), planes.halved().widened());
        }
        self
    }

    /// Writes the model, atomically, its planes in the precision of `file.planes`; returns its size in bytes.
    pub fn write(&self, path: &Path) -> Result<u64> {
        match (self.config.file.planes, self.file.tensors.get(PLANES)) {
            (FilePrecision::F16, Some(planes)) => {
                let mut file = self.file.clone();
                file.tensors.insert(PLANES.into(), planes.halved());
                file.write(path, &[])
            }
            _ => self.file.write(path, &[]),
        }
    }

    /// Reads a model and checks that it is one.
    pub fn read(path: &Path) -> Result<Self> {
        let name = path.display().to_string();
        let mut file = TensorFile::read(path)?;
        expect_format(&name, &file, FORMAT)?;
        if let Some(planes) = file.tensors.remove(PLANES) {
            file.tensors.insert(PLANES.into(), planes.widened());
        }
        let config = Config::from_toml(&format!("{name} (its config)"), file.text(&name, "config")?)?;
        Ok(Self { config, file })
    }
}

/// Refuses a file of another kind or version.
pub(crate) fn expect_format(name: &str, file: &TensorFile, expected: &str) -> Result<()> {
    let found = file.text(name, "format")?;
    if found == expected {
        return Ok(());
    }
    Err(Error::input(
        name,
        format!("its format is `{found}`"),
        format!("expected a file of format `{expected}`"),
    ))
}
