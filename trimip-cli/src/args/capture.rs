//! The options of `capture`.

use super::ProgressStyle;
use clap::Args;
use std::path::PathBuf;
use trimip_capture::{Lens, Mapper, Matcher, PosesProgram, Request};

/// Options of `capture`.
#[derive(Args, Debug)]
pub struct CaptureArguments {
    /// A film, a folder of photographs (JPEG, PNG, HEIC, …), or a zip archive of either; it is never changed
    #[arg(value_name = "FILM|FOLDER|ARCHIVE")]
    pub input: PathBuf,
    /// Folder of the capture [default: captures/ and the name of the film, folder or archive]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Number of frames to take from a film [default: 2 per second, at least 50 and at most 300; fewer if the camera hardly moves]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=10_000))]
    pub frames: Option<u32>,
    /// Program that finds the poses [default: the first of these that is installed; pycolmap 4 precedes an older colmap]
    #[arg(long, value_enum)]
    pub poses: Option<PosesProgram>,
    /// Camera model [default: radial; simple-radial if each picture has its own camera]
    #[arg(long, value_enum)]
    pub camera: Option<Lens>,
    /// Which pairs of pictures are compared [default: sequential for films, exhaustive for up to 200 photographs]
    #[arg(long, value_enum)]
    pub matcher: Option<Matcher>,
    /// A vocabulary tree in the format of the installed COLMAP, which finds pictures that look alike
    #[arg(long, value_name = "FILE")]
    pub vocab_tree: Option<PathBuf>,
    /// How cameras are placed [default: incremental; global for more than 300 pictures if COLMAP 4 or glomap is installed]
    #[arg(long, value_enum)]
    pub mapper: Option<Mapper>,
    /// Longest side of the pictures for feature detection, pixels [default: 1600; 3200 on a GPU]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(200..=20_000))]
    pub size: Option<u32>,
    /// Number of threads of the external programs; 0 = all
    #[arg(long, default_value_t = 0, value_name = "N")]
    pub threads: u32,
    /// Do all stages again
    #[arg(long)]
    pub fresh: bool,
    /// Then train on the scene, as `trimip-cli FOLDER` does, and write a video and a page of the model
    #[arg(long)]
    pub train: bool,
    /// Minutes of training [default: 5]
    #[arg(long, value_name = "N", requires = "train", allow_negative_numbers = true)]
    pub minutes: Option<f64>,
    /// Override one setting of training; may be given many times
    #[arg(long, value_name = "SECTION.KEY=VALUE", requires = "train")]
    pub set: Vec<String>,
    /// How progress is shown
    #[arg(long, value_enum, default_value_t, value_name = "STYLE")]
    pub progress: ProgressStyle,
}

impl CaptureArguments {
    /// Returns the capture that these options describe.
    pub fn request(&self) -> Request {
        Request {
            input: self.input.clone(),
            out: self.out.clone(),
            frames: self.frames,
            poses: self.poses,
            camera: self.camera,
            matcher: self.matcher,
            vocab_tree: self.vocab_tree.clone(),
            mapper: self.mapper,
            size: self.size,
            threads: self.threads,
            fresh: self.fresh,
        }
    }
}
