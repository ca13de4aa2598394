//! The options of `paper`.

use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// End of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Schedule {
    /// After --seconds of training: equal time on this machine
    #[default]
    Equal,
    /// At the end of the system's own schedule, however long that takes
    Own,
}

/// The splits that are trained on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Split {
    /// The split train
    #[default]
    Train,
    /// The splits train and val
    Trainval,
}

/// The scales of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TableScales {
    /// 1/1, 1/2, 1/4 and 1/8
    Four,
    /// 1/1 only
    One,
}

/// Options of `paper`.
#[derive(Args, Debug)]
pub struct PaperArguments {
    /// Folders of scenes, or a folder that holds some of the Blender scenes: chair, drums, ficus, hotdog, lego, materials, mic, ship
    #[arg(required_unless_present = "list", value_name = "SCENE")]
    pub scenes: Vec<PathBuf>,
    /// List the systems and exit
    #[arg(long)]
    pub list: bool,
    /// Systems to train, by name [default: all]
    #[arg(long, value_name = "NAME,..", value_delimiter = ',')]
    pub systems: Vec<String>,
    /// Seconds of training per run [default: 300]
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub seconds: Option<f64>,
    /// End of a run
    #[arg(long, value_enum, default_value_t)]
    pub schedule: Schedule,
    /// Number of seeds of each system on each scene; their spread shows the random variation
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100))]
    pub seeds: u32,
    /// Tables to make: the multi-scale one, the single-scale one, or both
    #[arg(long, value_enum, value_delimiter = ',', default_value = "four", value_name = "four,one")]
    pub scales: Vec<TableScales>,
    /// Splits to train on
    #[arg(long, value_enum, default_value_t)]
    pub split: Split,
    /// Measure every n-th test view at the end; 1 = all, like the published figures
    #[arg(long, default_value_t = 10, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub stride: u32,
    /// Configuration file (TOML) that overrides the settings of every system
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override one setting of every system or, for a setting of an encoder, of the systems that have this encoder; may be given many times
    #[arg(long, value_name = "SECTION.KEY=VALUE")]
    pub set: Vec<String>,
    /// Folder of paper.html, paper.json, paper.md, paper.tex and the runs (SCENE/SYSTEM/SEED); the same command resumes an interrupted
    /// comparison
    #[arg(long, default_value = "runs/paper", value_name = "DIR")]
    pub out: PathBuf,
}
