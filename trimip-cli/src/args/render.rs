//! The options of `render`.

use super::CropChoice;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// File format of rendered views.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PictureFormat {
    /// Colour as 8-bit sRGB, depth and opacity as 16-bit grey, one file per quantity; the depth file stores its range
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
    /// Output folder [default: `renders` next to the model]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Test views by number, e.g. 0,25,50 (needs the data set) [default camera: test view 0]
    #[arg(long, value_name = "N,..", value_delimiter = ',')]
    pub views: Vec<usize>,
    /// One camera-to-world matrix: 12 or 16 numbers in row-major order, or JSON, or a file with either
    #[arg(long, value_name = "NUMBERS|FILE", allow_hyphen_values = true)]
    pub pose: Option<String>,
    /// One camera by position and target, e.g. 4,0,2/0,0,0
    #[arg(long, value_name = "X,Y,Z/X,Y,Z", allow_hyphen_values = true)]
    pub look_at: Option<String>,
    /// A camera path: JSON in the format of transforms_test.json (frames with transform_matrix)
    #[arg(long, value_name = "FILE")]
    pub path: Option<PathBuf>,
    /// A circle of N cameras around the model's box
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub turntable: Option<u32>,
    /// A film of N cameras along the training cameras, without lens distortion (needs the run folder or the data set)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=100_000))]
    pub flythrough: Option<u32>,
    /// With --turntable: degrees above the horizon
    // `requires` by itself has no effect if another camera option conflicts with the turntable.
    #[arg(long, default_value_t = 30.0, requires = "turntable", conflicts_with_all = ["views", "pose", "look_at", "path", "flythrough"], allow_hyphen_values = true)]
    pub elevation: f64,
    /// With --turntable: distance from the box's centre [default: the minimum at which every picture shows the whole box]
    #[arg(long, requires = "turntable", conflicts_with_all = ["views", "pose", "look_at", "path", "flythrough"], allow_hyphen_values = true)]
    pub distance: Option<f64>,
    /// Up direction in the picture, for --look-at and --turntable [default: scene.up of the model]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub up: Option<String>,
    /// Width in pixels [default: 800; flythrough: width of the photographs]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=16_384))]
    pub width: Option<u32>,
    /// Height in pixels [default: 800; flythrough: from the width, with the aspect ratio of the photographs]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=16_384))]
    pub height: Option<u32>,
    /// Horizontal field of view in degrees [default: 39.6, as in the Blender scenes; flythrough: that of the photographs]
    #[arg(long, allow_hyphen_values = true)]
    pub fov: Option<f64>,
    /// Part of the world that the pictures show, in world units: none (everything), auto (the model's scene.crop), "box X,Y,Z,X,Y,Z" (lower
    /// and upper corner), "ball X,Y,Z,RADIUS" or "half X,Y,Z,X,Y,Z" (a point of a plane and the direction to the side that is kept). Crops
    /// follow the cells of the occupancy grid
    #[arg(long, default_value = "none", value_name = "CROP")]
    pub crop: CropChoice,
    /// Resize the pictures, e.g. 0.5 for half the width, with the same field of view
    #[arg(long, default_value_t = 1.0, allow_hyphen_values = true)]
    pub scale: f64,
    /// Render one camera at 1/1, 1/2, 1/4, 1/8 and 1/16 of the pixels in one picture, strip.png, with the original below
    #[arg(long, conflicts_with_all = ["format", "what", "crop"])]
    pub strip: bool,
    /// With --strip: another model, shown in its own row; may be given many times
    #[arg(long, value_name = "RUN", requires = "strip")]
    pub against: Vec<PathBuf>,
    /// File format
    #[arg(long, value_enum, default_value = "png")]
    pub format: PictureFormat,
    /// Quantities to write
    #[arg(
        long,
        value_enum,
        value_delimiter = ',',
        default_value = "color",
        value_name = "color,depth,opacity"
    )]
    pub what: Vec<Quantity>,
    /// With --path, --turntable or --flythrough: also encode the colours as a film: .mp4, .gif or .webp, or .mov, .mkv or .webm with the
    /// program ffmpeg
    #[arg(long, value_name = "FILE", conflicts_with_all = ["views", "pose", "look_at", "strip"])]
    pub video: Option<PathBuf>,
    /// With --video: frames per second
    #[arg(long, default_value_t = 30.0, requires = "video")]
    pub rate: f64,
    /// With --path, --turntable or --flythrough: motion blur. Every frame is the mean of pictures of N cameras
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=256), conflicts_with_all = ["views", "pose", "look_at", "strip"])]
    pub motion_blur: Option<u32>,
    /// With --motion-blur: time for which the shutter is open, as a fraction of the time between two frames
    #[arg(long, default_value_t = 0.5, value_name = "FRACTION", requires = "motion_blur")]
    pub shutter: f64,
    /// With --path, --turntable or --flythrough: render all views again; by default, the same command resumes an interrupted one
    #[arg(long)]
    pub fresh: bool,
    /// Override a setting of data, eval, renderer, hybrid, backend, threads or wgpu
    #[arg(long, value_name = "SECTION.KEY=VALUE")]
    pub set: Vec<String>,
}
