//! The input of a capture and all options that the user can set.

use serde::Deserialize;
use std::path::PathBuf;

/// The program that estimates the poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum PosesProgram {
    /// The program colmap
    Colmap,
    /// The Python package pycolmap, in the first python3 that has it
    Pycolmap,
    /// The program glomap, after features and matches by colmap or pycolmap
    Glomap,
}

/// A camera model of COLMAP.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Lens {
    /// Two focal lengths and four distortion terms: for many pictures
    Opencv,
    /// Fisheye lenses that see 120° and more
    OpencvFisheye,
    /// Eight distortion terms
    FullOpencv,
    /// One focal length and two distortion terms: ordinary lenses
    Radial,
    /// One focal length and one distortion term
    SimpleRadial,
    /// No distortion
    Pinhole,
}

impl Lens {
    /// Returns COLMAP's name of the model.
    pub fn name(self) -> &'static str {
        match self {
            Self::Opencv => "OPENCV",
            Self::OpencvFisheye => "OPENCV_FISHEYE",
            Self::FullOpencv => "FULL_OPENCV",
            Self::Radial => "RADIAL",
            Self::SimpleRadial => "SIMPLE_RADIAL",
            Self::Pinhole => "PINHOLE",
        }
    }
}

/// Which pairs of pictures are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Matcher {
    /// Each picture with every other
    Exhaustive,
    /// Each picture with the next ones, and some with all others to close loops
    Sequential,
    /// Each picture with those that look alike by a vocabulary tree (--vocab-tree)
    Vocabulary,
}

/// How cameras are placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Mapper {
    /// One after the other (incremental mapper)
    Incremental,
    /// All at once (global mapper): COLMAP 4 or glomap
    Global,
}

/// A capture to make: its input and its options. The program chooses a value for each option that is `None`.
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// A film, a folder of photographs, or a zip archive of either.
    pub input: PathBuf,
    /// Folder of the capture; the default is `captures/` and the name of the input.
    pub out: Option<PathBuf>,
    /// Number of frames of a film.
    pub frames: Option<u32>,
    /// The program that estimates the poses.
    pub poses: Option<PosesProgram>,
    /// Camera model.
    pub camera: Option<Lens>,
    /// Which pairs of pictures are compared.
    pub matcher: Option<Matcher>,
    /// A vocabulary tree in the format of the installed COLMAP.
    pub vocab_tree: Option<PathBuf>,
    /// How cameras are placed.
    pub mapper: Option<Mapper>,
    /// Longest side of the pictures for feature detection, pixels.
    pub size: Option<u32>,
    /// Number of threads of the programs; 0 = all.
    pub threads: u32,
    /// True to do all stages again.
    pub fresh: bool,
}
