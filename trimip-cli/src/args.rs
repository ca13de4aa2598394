//! The command line: verbs, their options and help.

mod paper;

use clap::{Args, Parser, Subcommand, ValueEnum};
pub use paper::{PaperArguments, Schedule, Split, TableScales};
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
    /// What to do; trains without one.
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
    /// Show what the scene does not need, and measure the cost and savings of leaving it out
    Plan(PlanArguments),
    /// Measure a model on its test set: PSNR, SSIM, MS-SSIM, FLIP and LPIPS per scale
    #[command(
        after_help = "LPIPS needs a build with --features lpips and weights: tools/lpips_onnx.py FILE.onnx makes \
                            them, --set eval.lpips=FILE.onnx names them."
    )]
    Eval(EvalArguments),
    /// Render views of a model as PNG or EXR
    Render(RenderArguments),
    /// Show a model in a browser: turn, zoom, compare with the photographs
    View(ViewArguments),
    /// Compute the proxy of a model, by which pictures need few samples, and keep it in the model file
    Bake(BakeArguments),
    /// Write a model for other programs: a triangle mesh, or a page for any web server
    Export(ExportArguments),
    /// Inspect a data set or write one
    Data(DataArguments),
    /// Show the effective settings and their origins
    Config(ConfigArguments),
    /// Compare curves of error against time: runs, or CSV files of other programs
    Compare(CompareArguments),
    /// Error against time: training over a set of configurations and seeds, or rendering a model in many ways
    Bench(BenchArguments),
    /// Train the systems of the paper's tables on the same scenes, splits and seeds, at equal time, and lay them beside
    /// each other and the published figures: tables, curves and crops on one page
    Paper(PaperArguments),
    /// Run the catalogue of stiff and extreme cases; exit code 1 if a law is violated
    Check(CheckArguments),
    /// Show what this machine and this build support
    Doctor,
}

/// Sources of settings.
#[derive(Args, Clone, Debug, Default)]
pub struct SettingsArguments {
    /// A system, by the name that `paper --list` shows: its settings lie over the defaults and under all others
    #[arg(long, value_name = "NAME")]
    pub system: Option<String>,
    /// Configuration file (TOML); missing settings have their defaults
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override one setting; may be given many times
    #[arg(long, value_name = "SECTION.KEY=VALUE")]
    pub set: Vec<String>,
}

/// The scene and the duration of training.
#[derive(Args, Clone, Debug, Default)]
pub struct SceneArguments {
    /// Folder of the scene: photographs with transforms*.json, metadata.json or a COLMAP model (data.root)
    #[arg(value_name = "FOLDER")]
    pub folder: Option<PathBuf>,
    /// Minutes of training; evaluation takes extra time (train.seconds) [default: 5]
    #[arg(long, value_name = "N")]
    pub minutes: Option<f64>,
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
    /// Run folder [default: runs/ and the name of the configuration file, or of FOLDER, and of the system]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Start over: replaces the run in the folder
    #[arg(long)]
    pub fresh: bool,
    /// Continue a finished run for this time, e.g. 90s, 5m, 1h: its schedule stretches to the new length
    #[arg(long, value_name = "TIME", conflicts_with_all = ["fresh", "minutes", "config", "system"])]
    pub continue_for: Option<String>,
    /// Stop and save after this many steps, as if interrupted; the same command resumes from there
    #[arg(long, value_name = "STEPS")]
    pub stop_after: Option<u64>,
    /// How progress is shown
    #[arg(long, value_enum, default_value_t, value_name = "STYLE")]
    pub progress: ProgressStyle,
    /// Show the model in a browser as it is learned, with the curve of its error; prints the address
    #[arg(long)]
    pub view: bool,
    /// Port of --view on this machine; 0 takes a free one
    #[arg(long, default_value_t = 0, value_name = "N", requires = "view")]
    pub port: u16,
}

impl TrainArguments {
    /// True if no argument names data to train on.
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
    /// Train with and without each decision, briefly and at equal samples, measured on held-out training views: dB,
    /// seconds and bytes
    #[arg(long)]
    pub measure: bool,
    /// Million samples of each of these runs
    #[arg(long, default_value_t = 16.0, value_name = "MILLION")]
    pub samples: f64,
    /// Seeds of each run
    #[arg(long, default_value_t = 1, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100))]
    pub seeds: u32,
    /// Folder of these runs
    #[arg(long, default_value = "runs/plan", value_name = "DIR")]
    pub out: PathBuf,
    /// Also write the decisions as JSON
    #[arg(long, value_name = "FILE", value_parser = ending("json"))]
    pub json: Option<PathBuf>,
}

/// Parser of the name of a file to write. A name of another kind is a slip, and would cost the file that has it.
fn ending(ending: &'static str) -> impl Fn(&str) -> Result<PathBuf, String> + Clone {
    move |name| {
        let path = PathBuf::from(name);
        let fits = path.extension().is_some_and(|own| own.eq_ignore_ascii_case(ending));
        if fits { Ok(path) } else { Err(format!("the name of such a file ends in .{ending}")) }
    }
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
    /// Address to listen at; others than loopback let everybody in who knows the token
    #[arg(long, default_value = "127.0.0.1", value_name = "ADDRESS")]
    pub bind: IpAddr,
    /// Port; 0 takes a free one
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub port: u16,
    /// Override a setting of data, renderer, hybrid, backend, threads or wgpu (data.root=.. for a moved data set)
    #[arg(long, value_name = "SECTION.KEY=VALUE")]
    pub set: Vec<String>,
}

/// File format of rendered views.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PictureFormat {
    /// Colour as 8-bit sRGB, depth (the file stores its range) and opacity as 16-bit grey, one file each
    Png,
    /// One file per view with 32-bit float channels: linear R G B, Z (world units), opacity
    Exr,
}

/// A quantity of a view that can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Quantity {
    /// Colour on the configured background
    Color,
    /// Distance along the optical axis
    Depth,
    /// 1 - transmittance
    Opacity,
}

impl From<Quantity> for trimip::view::Quantity {
    fn from(quantity: Quantity) -> Self {
        match quantity {
            Quantity::Color => Self::Color,
            Quantity::Depth => Self::Depth,
            Quantity::Opacity => Self::Opacity,
        }
    }
}

/// Options of `render`.
#[derive(Args, Debug)]
#[command(group(clap::ArgGroup::new("cameras").args(["views", "pose", "look_at", "path", "turntable", "flythrough"])))]
pub struct RenderArguments {
    /// Run folder or model file
    pub model: PathBuf,
    /// Output folder [default: `renders` beside the model]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Test views by number, e.g. 0,25,50 (needs the data set) [default cameras: view 0]
    #[arg(long, value_name = "N,..", value_delimiter = ',')]
    pub views: Vec<usize>,
    /// One camera-to-world matrix: 12 or 16 numbers in row-major order, or JSON, or a file with either
    #[arg(long, value_name = "NUMBERS|FILE", allow_hyphen_values = true)]
    pub pose: Option<String>,
    /// One camera by position and target, e.g. 4,0,2/0,0,0
    #[arg(long, value_name = "X,Y,Z/X,Y,Z", allow_hyphen_values = true)]
    pub look_at: Option<String>,
    /// A camera path: JSON like transforms_test.json (frames with transform_matrix)
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// A circle of N cameras around the model's box
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub turntable: Option<u32>,
    /// A film of N cameras along the training cameras, through their lens without its distortion (needs the data set)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=100_000))]
    pub flythrough: Option<u32>,
    /// Turntable: degrees above the horizon
    // `requires` alone is waived if another camera option conflicts with the turntable.
    #[arg(long, default_value_t = 30.0, requires = "turntable", conflicts_with_all = ["views", "pose", "look_at", "path", "flythrough"], allow_hyphen_values = true)]
    pub elevation: f64,
    /// Turntable: distance from the box's centre [default: the minimum at which every picture shows the whole box]
    #[arg(long, requires = "turntable", conflicts_with_all = ["views", "pose", "look_at", "path", "flythrough"], allow_hyphen_values = true)]
    pub distance: Option<f64>,
    /// Up direction in the picture, for --look-at and --turntable [default: scene.up of the model]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub up: Option<String>,
    /// Width in pixels, for cameras without one
    #[arg(long, default_value_t = 800, value_parser = clap::value_parser!(u32).range(1..=16_384))]
    pub width: u32,
    /// Height in pixels, for cameras without one
    #[arg(long, default_value_t = 800, value_parser = clap::value_parser!(u32).range(1..=16_384))]
    pub height: u32,
    /// Horizontal field of view in degrees, for cameras without one (39.6: the Blender scenes')
    #[arg(long, default_value_t = 39.597_758_2, allow_hyphen_values = true)]
    pub fov: f64,
    /// Resize the pictures, e.g. 0.5 for half the width, with the same field of view
    #[arg(long, default_value_t = 1.0, allow_hyphen_values = true)]
    pub scale: f64,
    /// One camera at 1/1, 1/2, 1/4, 1/8 and 1/16 of the pixels in one picture, strip.png, the original below
    #[arg(long, conflicts_with_all = ["format", "what"])]
    pub strip: bool,
    /// Strip: another model, in a separate row; may be given many times
    #[arg(long, value_name = "RUN", requires = "strip")]
    pub against: Vec<PathBuf>,
    /// File format
    #[arg(long, value_enum, default_value = "png")]
    pub format: PictureFormat,
    /// What to write
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        default_value = "color",
        value_name = "color,depth,opacity"
    )]
    pub what: Vec<Quantity>,
    /// Path, turntable and flythrough: also encode the colours as a video (.mp4, .mov, .mkv, .webm), by the program ffmpeg
    #[arg(long, value_name = "FILE", conflicts_with_all = ["views", "pose", "look_at", "strip"])]
    pub video: Option<PathBuf>,
    /// Video: pictures a second
    #[arg(long, default_value_t = 30.0, requires = "video")]
    pub rate: f64,
    /// Path, turntable and flythrough: render all views again; otherwise the same command goes on where it was interrupted
    #[arg(long)]
    pub fresh: bool,
    /// Override a setting of data, eval, renderer, hybrid, backend, threads or wgpu
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

/// Options of `export`.
#[derive(Args, Debug)]
pub struct ExportArguments {
    /// What to write.
    #[command(subcommand)]
    pub what: ExportWhat,
}

/// What `export` writes.
#[derive(Subcommand, Debug)]
pub enum ExportWhat {
    /// The surface as triangles with normals and colours, in the units and axes of the cameras: PLY, OBJ or GLB
    Mesh(MeshArguments),
    /// A folder for any static web server: the model, and a page that renders it with the visitor's own GPU (WebGPU)
    Web(WebArguments),
}

/// Options of `export web`.
#[derive(Args, Debug)]
pub struct WebArguments {
    /// Run folder or model file
    pub model: PathBuf,
    /// Folder [default: web beside the model]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Folder with the page's program, as tools/web.sh builds it
    #[arg(long, value_name = "DIR", default_value = "target/web")]
    pub viewer: PathBuf,
}

/// Options of `export mesh`.
#[derive(Args, Debug)]
pub struct MeshArguments {
    /// Run folder or model file
    pub model: PathBuf,
    /// File; its name ends in .ply, .obj or .glb [default: mesh.ply beside the model]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Cells of the grid along the longest side of the box
    #[arg(long, default_value_t = 512, value_name = "N", value_parser = clap::value_parser!(u32).range(8..=2048))]
    pub resolution: u32,
    /// Density of the surface, per world unit [default: that of which a marching step has an optical depth of 0.2]
    #[arg(long, value_name = "DENSITY")]
    pub level: Option<f64>,
    /// Leave out connected parts with a smaller diagonal, as a share of the longest side of the box
    #[arg(long, default_value_t = 0.02, value_name = "SHARE")]
    pub specks: f64,
    /// Simplify to about this many triangles; 0 = keep all
    #[arg(long, default_value_t = 100_000, value_name = "N")]
    pub triangles: usize,
    /// Simplify as far as the surface moves by less than this share of the mesh's largest side, instead of to a number of
    /// triangles
    #[arg(long, value_name = "SHARE", conflicts_with = "triangles")]
    pub error: Option<f64>,
    /// Leave out the colours of the vertices
    #[arg(long)]
    pub no_colors: bool,
    /// Compare the silhouettes with the masks of every N-th test view (needs the data set)
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "1", value_parser = clap::value_parser!(u32).range(1..))]
    pub silhouettes: Option<u32>,
    /// Override a setting of data, backend, threads or wgpu
    #[arg(long, value_name = "SECTION.KEY=VALUE")]
    pub set: Vec<String>,
}

/// Options of `bench`.
#[derive(Args, Debug)]
pub struct BenchArguments {
    /// Benchmark rendering instead of training: error of this model's pictures against time per frame (run folder or
    /// model file)
    #[arg(long, value_name = "RUN", conflicts_with_all = ["vary", "no_base", "seeds", "config", "system"])]
    pub render: Option<PathBuf>,
    /// Rendering: 1, 2x2, 4x4 and 8x8 cones a pixel at every scale of the test views, against the photographs and
    /// against each other
    #[arg(long, requires = "render", conflicts_with = "variants")]
    pub cones: bool,
    /// Rendering: ways to few samples at every scale of the test views, against the photographs and against converged
    /// volume rendering; --try names other ways than those of the catalogue
    #[arg(long, requires = "render", conflicts_with = "cones")]
    pub ways: bool,
    /// Rendering of test views (--cones, --ways): their number
    #[arg(long, default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..))]
    pub views: u32,
    /// Rendering: width of the picture (the f64 reference is slow)
    #[arg(long, default_value_t = 48, value_parser = clap::value_parser!(u32).range(4..=800))]
    pub width: u32,
    /// Settings shared by all variants.
    #[command(flatten)]
    pub settings: SettingsArguments,
    /// A variant: its name and its settings, e.g. 'no mipmap: encoder.mipmap=false; train.seconds=60'
    #[arg(long = "try", value_name = "NAME: KEY=VALUE; ..")]
    pub variants: Vec<String>,
    /// One variant for each value of a setting, e.g. 'field.hidden=32|64|128'
    #[arg(long, value_name = "KEY=VALUE|..")]
    pub vary: Vec<String>,
    /// Do not run the shared settings as a separate variant
    #[arg(long)]
    pub no_base: bool,
    /// Seeds of each variant: their spread is the random variation
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100))]
    pub seeds: u32,
    /// PSNR levels in dB whose times are reported
    #[arg(long, value_name = "DB,..", value_delimiter = ',', default_value = "25,28,30,32,34")]
    pub reach: Vec<f64>,
    /// Folder of the runs and of bench.csv, bench.json, bench.svg and bench.html
    #[arg(long, default_value = "runs/bench", value_name = "DIR")]
    pub out: PathBuf,
}

/// Options of `check`.
#[derive(Args, Debug)]
pub struct CheckArguments {
    /// Backends to test [default: all that this machine has]
    #[arg(long, value_name = "NAME,..", value_delimiter = ',')]
    pub backend: Vec<String>,
    /// Part of the adapter's name for the wgpu backend
    #[arg(long, default_value = "", hide_default_value = true)]
    pub adapter: String,
    /// Include the cases that take minutes: 100,000 steps of training
    #[arg(long)]
    pub long: bool,
    /// Threads of the CPU backend; 0 = all
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
    /// PSNR levels in dB whose times are reported
    #[arg(long, value_name = "DB,..", value_delimiter = ',', default_value = "25,28,30,32,33,34,35,36")]
    pub reach: Vec<f64>,
    /// Write the plot as SVG
    #[arg(long, value_name = "FILE", value_parser = ending("svg"))]
    pub svg: Option<PathBuf>,
    /// Write a page with the table, the plot and the runs' pictures
    #[arg(long, value_name = "FILE", value_parser = ending("html"))]
    pub html: Option<PathBuf>,
    /// Write the table as JSON
    #[arg(long, value_name = "FILE", value_parser = ending("json"))]
    pub json: Option<PathBuf>,
}

/// Options of `data`.
#[derive(Args, Debug)]
pub struct DataArguments {
    /// What to do with the data.
    #[command(subcommand)]
    pub action: DataAction,
}

/// Actions of `data`.
#[derive(Debug, Subcommand)]
pub enum DataAction {
    /// Describe a data set and check it
    Inspect {
        /// Folder of the scene; overrides data.root
        root: Option<PathBuf>,
        /// Also write a page: cameras and box from three sides, thumbnails, warnings and checks, in one file
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
        /// Folder of the scene; overrides data.root
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
