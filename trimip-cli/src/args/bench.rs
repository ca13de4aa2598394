//! The options of `bench`.

use super::shared::SettingsArguments;
use clap::Args;
use std::path::PathBuf;

/// Options of `bench`.
#[derive(Args, Debug)]
pub struct BenchArguments {
    /// Benchmark rendering instead of training: plot the error of this model's pictures (a run folder or model file) against the time per
    /// frame
    #[arg(long, value_name = "RUN", conflicts_with_all = ["vary", "no_base", "seeds", "config", "system"])]
    pub render: Option<PathBuf>,
    /// With --render: compare 1, 2x2, 4x4 and 8x8 cones per pixel, at every scale of the test views, with the photographs and with each
    /// other
    #[arg(long, requires = "render", conflicts_with = "variants")]
    pub cones: bool,
    /// With --render: compare ways to render with few samples, at every scale of the test views, with the photographs and with converged
    /// volume rendering; --try replaces the ways of the catalogue
    #[arg(long, requires = "render", conflicts_with = "cones")]
    pub ways: bool,
    /// With --cones or --ways: number of test views
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..))]
    pub views: u32,
    /// With --render: width of the picture in pixels (the f64 reference is slow)
    #[arg(long, default_value_t = 48, value_parser = clap::value_parser!(u32).range(4..=800))]
    pub width: u32,
    /// Settings shared by all variants.
    #[command(flatten)]
    pub settings: SettingsArguments,
    /// A variant: its name and its settings, e.g. 'no mipmap: encoder.mipmap=false; train.seconds=60'
    #[arg(long = "try", value_name = "NAME: KEY=VALUE; ..")]
    pub variants: Vec<String>,
    /// A setting of which each value is a variant, e.g. 'field.hidden=32|64|128'
    #[arg(long, value_name = "KEY=VALUE|..")]
    pub vary: Vec<String>,
    /// Do not run the shared settings as a separate variant
    #[arg(long)]
    pub no_base: bool,
    /// Number of seeds per variant; their spread shows the random variation
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub seeds: u32,
    /// PSNR levels in dB; the time at which each run reaches them is reported
    #[arg(long, value_name = "DB,..", value_delimiter = ',', default_value = "25,28,30,32,34")]
    pub reach: Vec<f64>,
    /// Folder of the runs, bench.csv, bench.tex, bench.json, bench.svg and bench.html
    #[arg(long, default_value = "runs/bench", value_name = "DIR")]
    pub out: PathBuf,
}
