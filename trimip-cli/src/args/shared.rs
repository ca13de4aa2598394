//! Options that several verbs share.

use clap::Args;
use std::path::PathBuf;
use std::str::FromStr;
use trimip::{Config, Crop};
use trimip_core::scene::origin::LocalOrigin;

/// Sources of settings.
#[derive(Args, Clone, Debug, Default)]
pub struct SettingsArguments {
    /// A system, by its name in `paper --list`; its settings override the defaults, and all other settings override the system's
    #[arg(long, value_name = "NAME")]
    pub system: Option<String>,
    /// Configuration file (TOML); missing settings keep their defaults
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override one setting; may be given many times
    #[arg(long, value_name = "SECTION.KEY=VALUE")]
    pub set: Vec<String>,
}

/// The scene and the duration of training.
#[derive(Args, Clone, Debug, Default)]
pub struct SceneArguments {
    /// Folder of the scene: photographs with transforms*.json, metadata.json or a COLMAP model; or its zip archive (data.root)
    #[arg(value_name = "FOLDER")]
    pub folder: Option<PathBuf>,
    /// Minutes of training; evaluation takes extra time (train.seconds) [default: 5]
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub minutes: Option<f64>,
}

/// Returns a parser for the name of a file to write. It refuses other extensions, so that a mistyped name does not overwrite a file of
/// another kind.
pub fn ending(ending: &'static str) -> impl Fn(&str) -> Result<PathBuf, String> + Clone {
    move |name| {
        let path = PathBuf::from(name);
        let fits = path.extension().is_some_and(|own| own.eq_ignore_ascii_case(ending));
        if fits { Ok(path) } else { Err(format!("expected a file name that ends in .{ending}")) }
    }
}

/// The crop that an option selects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CropChoice {
    /// The model's crop, `scene.crop`.
    Auto,
    /// The given crop.
    Given(Crop),
}

impl CropChoice {
    /// Returns the crop in the coordinates of a model with this configuration. A given crop is in the coordinates of the photographs.
    pub fn of(self, config: &Config) -> Crop {
        match self {
            Self::Auto => config.scene.crop,
            Self::Given(crop) => LocalOrigin::of(&config.data).local(crop),
        }
    }

    /// Sets the crop in the configuration, from which pages read it, unless the crop is none. Returns true if a page should initially show
    /// the crop.
    pub fn opens(self, config: &mut Config) -> bool {
        let crop = self.of(config);
        let any = crop != Crop::None;
        if any {
            config.scene.crop = crop;
        }
        any
    }
}

impl FromStr for CropChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.trim() {
            "auto" => Ok(Self::Auto),
            text => text
                .parse()
                .map(Self::Given)
                .map_err(|error| format!("{error}, or auto (scene.crop of the model)")),
        }
    }
}
