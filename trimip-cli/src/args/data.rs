//! The options of `data`.

use super::shared::{SettingsArguments, ending};
use clap::{Args, Subcommand};
use std::path::PathBuf;

/// Options of `data`.
#[derive(Args, Debug)]
pub struct DataArguments {
    /// The action.
    #[command(subcommand)]
    pub action: DataAction,
}

/// Actions of `data`.
#[derive(Debug, Subcommand)]
pub enum DataAction {
    /// Describe a data set and check it
    Inspect {
        /// Folder of the scene, its transforms.json or its zip archive; overrides data.root
        root: Option<PathBuf>,
        /// Also write a page, as a single file: cameras and box from three sides, thumbnails, warnings and checks
        #[arg(long, value_name = "FILE", value_parser = ending("html"))]
        html: Option<PathBuf>,
        /// Settings.
        #[command(flatten)]
        settings: SettingsArguments,
    },
    /// Write a data set at the scales 1, 1/2, 1/4, 1/8 in the public layout (metadata.json)
    Multiscale {
        /// Folder to write
        out: PathBuf,
        /// Folder of the scene or its zip archive; overrides data.root
        #[arg(long, value_name = "DIR")]
        root: Option<PathBuf>,
        /// Settings.
        #[command(flatten)]
        settings: SettingsArguments,
    },
    /// Write the built-in procedural scene as a Blender data set
    Builtin {
        /// Folder to write
        out: PathBuf,
        /// Settings.
        #[command(flatten)]
        settings: SettingsArguments,
    },
}
