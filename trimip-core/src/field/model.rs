//! A finished model: the parameters by name, the occupancy grid, and the configuration. Rendering needs only the file
//! of a model.

pub use crate::field::tensor_names::{ASSET, OCCUPANCY};

use crate::{
    Config, Error, Layout, Result,
    config::{FilePrecision, RendererKind},
    field::{
        packed,
        tensors::{Tensor, TensorFile},
    },
    scene::fingerprint,
};
use std::{collections::BTreeMap, path::Path};

/// Value of the metadata `format` of a model file.
const FORMAT: &str = "trimip-model-1";

/// Assets of a scene by their names in the file.
pub type Assets = BTreeMap<String, Tensor>;

/// Returns the assets of a model or checkpoint.
pub fn assets(file: &TensorFile) -> Assets {
    let own = file.tensors.iter().filter(|(name, _)| name.starts_with(ASSET));
    own.map(|(name, tensor)| (name.clone(), tensor.clone())).collect()
}

/// Named tensors (see [`crate::field::params::Layout`]), the occupancy bits as tensor `occupancy` and the configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// The configuration. `file` does not contain it; every written file does.
    pub config: Config,
    /// The tensors, and metadata of the file other than format, configuration and box.
    pub file: TensorFile,
}

/// Returns the metadata of a model file of this format and configuration.
fn metadata(format: &str, config: &Config) -> [(&'static str, String); 3] {
    let aabb = format!("{:?} {:?}", config.scene.aabb_min, config.scene.aabb_max);
    [("format", format.into()), ("config", config.to_toml()), ("aabb", aabb)]
}

impl Model {
    /// Creates a model from a configuration and tensors.
    pub fn new(config: Config, mut file: TensorFile) -> Self {
        for (key, _) in metadata(FORMAT, &config) {
            file.metadata.remove(key);
        }
        Self { config, file }
    }

    /// Returns the same model, rounded as its file is.
    pub fn rounded(mut self) -> Self {
        for name in in_f16(&self.config) {
            if let Some(tensor) = self.file.tensors.get_mut(&name) {
                *tensor = tensor.to_f16();
                tensor.widen();
            }
        }
        self
    }

    /// Writes the model with its configuration, atomically, each tensor in the precision that its slot declares; returns its size
    /// in bytes.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<u64> {
        let metadata = metadata(FORMAT, &self.config);
        let mut names = in_f16(&self.config).peekable();
        if names.peek().is_none() {
            return self.file.write(path, &metadata);
        }
        let mut file = self.file.clone();
        for name in names {
            if let Some(tensor) = file.tensors.get_mut(&name) {
                *tensor = tensor.to_f16();
            }
        }
        file.write(path, &metadata)
    }

    /// Writes the model in few bytes, rounded to 8 bits per value, without assets ([`packed`]); returns its size in
    /// bytes. Hybrid rendering needs an asset, so the written model uses volume rendering. [`read`](Self::read) reads
    /// it too.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write_packed(&self, path: &Path) -> Result<u64> {
        let mut coarse = self.config.clone();
        coarse.file.planes = FilePrecision::F16;
        let names: Vec<String> = in_f16(&coarse).collect();
        let mut config = self.config.clone();
        config.renderer.kind = RendererKind::Volume;
        packed::pack(&self.file, &names)?.write(path, &metadata(packed::FORMAT, &config))
    }

    /// Returns a hash of all tensors and settings, the same on every machine.
    ///
    /// # Errors
    /// When the metadata cannot be written as JSON.
    pub fn hash(&self) -> Result<u64> {
        Ok(fingerprint::hash(&self.file.to_bytes(&metadata(FORMAT, &self.config))?))
    }

    /// Reads a model and checks it: its format, its settings, and every tensor's shape and numbers.
    ///
    /// # Errors
    /// When the file cannot be read, is not a model that this build understands, or has tensors that do not fit its
    /// configuration.
    pub fn read(path: &Path) -> Result<Self> {
        Self::of(&path.display().to_string(), TensorFile::read(path)?)
    }

    /// Reads a model from the bytes of its file; `name` names the file in errors.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<Self> {
        Self::of(name, TensorFile::from_bytes(name, bytes)?)
    }

    fn of(name: &str, mut file: TensorFile) -> Result<Self> {
        let is_packed = file.text(name, "format")? == packed::FORMAT;
        if !is_packed {
            expect_format(name, &file, FORMAT)?;
        }
        for tensor in file.tensors.values_mut() {
            tensor.widen();
        }
        let config = Config::from_toml(&format!("{name} (its config)"), file.text(name, "config")?)?;
        if is_packed {
            file = packed::unpack(name, &file, &config)?;
        }
        expect_tensors(name, &file, &config, &[""])?;
        Ok(Self::new(config, file))
    }
}

/// Returns the names of the tensors that a model file of this configuration holds as f16.
fn in_f16(config: &Config) -> impl Iterator<Item = String> + use<> {
    let slots = Layout::new(config).slots.into_iter();
    slots.filter(|slot| slot.precision == FilePrecision::F16).map(|slot| slot.name)
}

/// Rejects a file whose tensors do not fit its configuration or hold numbers that are not finite, before memory of the
/// stated sizes is allocated. `suffixes` are the suffixes of the names of tensors that have the parameters' shapes.
pub(crate) fn expect_tensors(
    name: &str,
    file: &TensorFile,
    config: &Config,
    suffixes: &[&str],
) -> Result<()> {
    let layout = Layout::new(&config.centred().0);
    suffixes.iter().try_for_each(|suffix| layout.expect(file, name, suffix))?;
    file.u8(name, OCCUPANCY, &[config.occupancy.cells().div_ceil(8)])?;
    file.expect_finite(name)
}

/// Rejects a file of another kind or version.
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
