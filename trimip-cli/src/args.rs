//! The command line: verbs, their options and help.

mod bench;
mod capture;
mod data;
mod export;
mod paper;
mod render;
mod shared;

pub use bench::BenchArguments;
pub use capture::CaptureArguments;
use clap::{Args, Parser, Subcommand, ValueEnum};
pub use data::{DataAction, DataArguments};
pub use export::{
    CameraSet, CamerasArguments, ExportArguments, ExportWhat, MeshArguments, SurfaceSource, TextureSource,
    WebArguments,
};
pub use paper::{PaperArguments, Schedule, Split, TableScales};
pub use render::{PictureFormat, RenderArguments};
use shared::ending;
pub use shared::{CropChoice, SceneArguments, SettingsArguments};
use std::net::IpAddr;
use std::path::PathBuf;

/// Anti-aliased radiance fields from photographs (Tri-MipRF): plan, train, evaluate, render and report.
///
/// Without a verb it trains: `trimip-cli FOLDER`.
#[derive(Debug, Parser)]
#[command(
    version,
    args_conflicts_with_subcommands = true,
    after_help = "Exit codes: 0 done (also after --stop-after), 1 the run failed or missed eval.min_psnr, \
                  2 wrong input, 3 the device or the system failed, 130 stopped by Ctrl-C (saved; the same command resumes)."
)]
pub struct Arguments {
    /// The verb; without one, the program trains.
    #[command(subcommand)]
    pub verb: Option<Verb>,
    /// Options of training.
    #[command(flatten)]
    pub train: TrainArguments,
}

/// The verbs.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Plan, train, evaluate and report; resumes the run in the run folder
    Train(TrainArguments),
    /// Make a scene from a film or from photographs without cameras: frames, poses by COLMAP, pictures without a pose; then train
    #[command(
        after_help = "External programs do the work: ffmpeg extracts frames from films, COLMAP (the program, the \
                            Python package pycolmap, or glomap) finds the cameras. The same command resumes an interrupted capture."
    )]
    Capture(Box<CaptureArguments>),
    /// Show which parts of the training the scene does not need, and measure what leaving them out costs and saves
    Plan(PlanArguments),
    /// Measure a model on its test set: PSNR, SSIM, MS-SSIM, FLIP and LPIPS per scale
    #[command(
        after_help = "LPIPS needs a build with --features lpips and weights: tools/lpips_onnx.py FILE.onnx makes \
                            them, --set eval.lpips=FILE.onnx names them."
    )]
    Eval(EvalArguments),
    /// Render views of a model as PNG or EXR
    Render(Box<RenderArguments>),
    /// Show a model in a browser: turn, zoom, compare with the photographs
    View(ViewArguments),
    /// Compute the proxy of a model, which lets hybrid rendering use few samples, and store it in the model file
    Bake(BakeArguments),
    /// Export a model for other programs: a triangle mesh, or a page for any web server
    Export(ExportArguments),
    /// Inspect a data set or write one
    Data(DataArguments),
    /// Show the effective settings and their origins
    Config(ConfigArguments),
    /// Compare curves of error against time, from runs or from CSV files of other programs
    Compare(CompareArguments),
    /// Measure error against time: of training over configurations and seeds, or of rendering a model in many ways
    Bench(BenchArguments),
    /// Train the systems of the paper's tables on the same scenes, splits and seeds, for equal time, and compare them with each other and
    /// with the published figures: tables, curves and crops on one page
    Paper(PaperArguments),
    /// Run the catalogue of stiff and extreme cases; the exit code is 1 if a case violates its law
    Check(CheckArguments),
    /// Show what this machine and this build support
    Doctor,
}

/// How progress is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum ProgressStyle {
    /// A bar on a terminal, JSON lines otherwise
    #[default]
    Auto,
    /// A bar and tables
    Bar,
    /// One JSON object per event, one per line, on standard output
    Json,
}

/// Options of `train`.
#[derive(Args, Clone, Debug, Default)]
pub struct TrainArguments {
    /// Scene.
    #[command(flatten)]
    pub scene: SceneArguments,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArguments,
    /// Run folder [default: runs/NAME, where NAME is the name of the configuration file or of FOLDER, followed by that of the system]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Start over and replace the run in the folder
    #[arg(long)]
    pub fresh: bool,
    /// Continue a finished run for this time, e.g. 90s, 5m, 1h; the schedule is stretched to the new length
    #[arg(long, value_name = "TIME", conflicts_with_all = ["fresh", "minutes", "config", "system"])]
    pub continue_for: Option<String>,
    /// Stop and save after this many steps, as if interrupted; the same command resumes the run
    #[arg(long, value_name = "STEPS")]
    pub stop_after: Option<u64>,
    /// How progress is shown
    #[arg(long, value_enum, default_value_t, value_name = "STYLE")]
    pub progress: ProgressStyle,
    /// Show every decision of the plan with its reason, and the use of memory
    #[arg(short, long)]
    pub verbose: bool,
    /// Show the model and the curve of its error in a browser during training; prints the address
    #[arg(long)]
    pub view: bool,
    /// Port of --view on this machine; 0 selects a free port
    #[arg(long, default_value_t = 0, value_name = "N", requires = "view")]
    pub port: u16,
}

impl TrainArguments {
    /// Returns true if no argument names data to train on.
    pub fn is_bare(&self) -> bool {
        let named =
            self.scene.folder.is_some() || self.settings.config.is_some() || self.continue_for.is_some();
        !named && self.settings.set.is_empty()
    }
}

/// Options of `plan`.
#[derive(Args, Debug)]
pub struct PlanArguments {
    /// Scene.
    #[command(flatten)]
    pub scene: SceneArguments,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArguments,
    /// Train briefly with and without each part that the plan leaves out, with equally many samples, and compare the PSNR on held-out
    /// training views, seconds and bytes
    #[arg(long)]
    pub measure: bool,
    /// Millions of samples per run of --measure
    #[arg(long, default_value_t = 16.0, value_name = "MILLION")]
    pub samples: f64,
    /// Seeds per run of --measure
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100))]
    pub seeds: u32,
    /// Folder of the runs of --measure
    #[arg(long, default_value = "runs/plan", value_name = "DIR")]
    pub out: PathBuf,
    /// Also write the decisions as JSON
    #[arg(long, value_name = "FILE", value_parser = ending("json"))]
    pub json: Option<PathBuf>,
}

/// Options of `eval`.
#[derive(Args, Debug)]
pub struct EvalArguments {
    /// Run folder or model file
    pub model: PathBuf,
    /// Use every n-th test view
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub stride: u32,
    /// Override a setting of data, eval, renderer, hybrid, backend, threads or wgpu (data.root=.. for a moved data set)
    #[arg(long, value_name = "SECTION.KEY=VALUE")]
    pub set: Vec<String>,
    /// Also write the result as JSON
    #[arg(long, value_name = "FILE", value_parser = ending("json"))]
    pub json: Option<PathBuf>,
}

/// Options of `view`.
#[derive(Args, Debug)]
pub struct ViewArguments {
    /// Run folder or model file
    pub model: PathBuf,
    /// Address to listen on; on addresses other than loopback, everybody who knows the token has access
    #[arg(long, default_value = "127.0.0.1", value_name = "ADDRESS")]
    pub bind: IpAddr,
    /// Port; 0 selects a free port
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub port: u16,
    /// Part of the world that the page initially shows, in world units: none (everything), auto (the model's scene.crop), "box X,Y,Z,X,Y,Z"
    /// (lower and upper corner), "ball X,Y,Z,RADIUS" or "half X,Y,Z,X,Y,Z" (a point of a plane and the direction to the side that is kept).
    /// Crops follow the cells of the occupancy grid. A switch on the page toggles between the crop and everything
    #[arg(long, default_value = "none", value_name = "CROP")]
    pub crop: CropChoice,
    /// Override a setting of data, renderer, hybrid, backend, threads or wgpu (data.root=.. for a moved data set)
    #[arg(long, value_name = "SECTION.KEY=VALUE")]
    pub set: Vec<String>,
}

/// Options of `bake`.
#[derive(Args, Debug)]
pub struct BakeArguments {
    /// Run folder or model file
    pub model: PathBuf,
    /// Model file to write [default: the same file]
    #[arg(long, value_name = "FILE", value_parser = ending("safetensors"))]
    pub out: Option<PathBuf>,
    /// Override a setting of hybrid, renderer, backend, threads or wgpu
    #[arg(long, value_name = "SECTION.KEY=VALUE")]
    pub set: Vec<String>,
}

/// Options of `check`.
#[derive(Args, Debug)]
pub struct CheckArguments {
    /// Backends to test [default: all that this machine supports]
    #[arg(long, value_name = "NAME,..", value_delimiter = ',')]
    pub backend: Vec<String>,
    /// Part of the name of the wgpu backend's adapter
    #[arg(long, default_value = "", hide_default_value = true)]
    pub adapter: String,
    /// Include the cases that take minutes: 100,000 training steps
    #[arg(long)]
    pub long: bool,
    /// Number of threads of the CPU backend; 0 = all
    #[arg(long, default_value_t = 0)]
    pub threads: u32,
    /// Write the table as JSON
    #[arg(long, value_name = "FILE", value_parser = ending("json"))]
    pub json: Option<PathBuf>,
}

/// Options of `compare`.
#[derive(Args, Debug)]
pub struct CompareArguments {
    /// Run folders or CSV files with the columns `seconds` and `psnr_mean`, each with an optional name
    #[arg(required = true, value_name = "[NAME=]RUN|FILE")]
    pub curves: Vec<String>,
    /// PSNR levels in dB; the time at which each curve reaches them is reported
    #[arg(long, value_name = "DB,..", value_delimiter = ',', default_value = "25,28,30,32,33,34,35,36")]
    pub reach: Vec<f64>,
    /// Write the plot as SVG
    #[arg(long, value_name = "FILE", value_parser = ending("svg"))]
    pub svg: Option<PathBuf>,
    /// Write a page with the table, the plot and the pictures of the runs
    #[arg(long, value_name = "FILE", value_parser = ending("html"))]
    pub html: Option<PathBuf>,
    /// Write the table as JSON
    #[arg(long, value_name = "FILE", value_parser = ending("json"))]
    pub json: Option<PathBuf>,
}

/// Options of `config`.
#[derive(Args, Debug)]
pub struct ConfigArguments {
    /// Scene.
    #[command(flatten)]
    pub scene: SceneArguments,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArguments,
    /// Print the documented table of defaults instead
    #[arg(long, conflicts_with_all = ["config", "system", "set", "folder", "minutes"])]
    pub defaults: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_sound() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn options_without_a_verb_are_those_of_training() {
        let bare = Arguments::try_parse_from(["x", "--config", "a.toml", "--set", "seed=1"]).unwrap();
        assert!(bare.verb.is_none());
        assert_eq!(bare.train.settings.config, Some("a.toml".into()));
        let folder = Arguments::try_parse_from(["x", "some/folder", "--minutes", "1.5"]).unwrap();
        assert!(folder.verb.is_none() && folder.train.scene.minutes == Some(1.5));
        assert_eq!(folder.train.scene.folder, Some("some/folder".into()));
        let verb = Arguments::try_parse_from(["x", "train", "--stop-after", "5"]).unwrap();
        assert!(matches!(verb.verb, Some(Verb::Train(TrainArguments { stop_after: Some(5), .. }))));
    }

    #[test]
    fn cameras_exclude_each_other_and_may_be_negative() {
        let parse = |args: &[&str]| Arguments::try_parse_from([&["x", "render", "m"], args].concat());
        assert!(parse(&["--turntable", "8", "--views", "1,2"]).is_err());
        assert!(parse(&["--look-at", "-4,0,2/0,0,0", "--what", "color,depth"]).is_ok());
        assert!(parse(&["--turntable", "8", "--distance", "2"]).is_ok());
        assert!(
            parse(&["--distance", "2"]).is_err() && parse(&["--views", "1", "--elevation", "2"]).is_err()
        );
    }
}
