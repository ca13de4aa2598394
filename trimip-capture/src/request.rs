//! What is captured, and how: everything that a user may decide.

use serde::Deserialize;
use std::path::PathBuf;

/// What finds the poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum PosesProgram {
    /// The program colmap
    Colmap,
    /// The Python package pycolmap, of any python3 that has it
    Pycolmap,
    /// The program glomap, after features and matches by one of the others
    Glomap,
}

/// A camera model, by COLMAP's names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Lens {
    /// Two focal lengths and four terms of distortion: for many pictures
    Opencv,
    /// Lenses that see 120° and more
    OpencvFisheye,
    /// Eight terms of distortion
    FullOpencv,
    /// One focal length and two terms: ordinary lenses
    Radial,
    /// One focal length and one term
    SimpleRadial,
    /// No distortion
    Pinhole,
}

impl Lens {
    /// Its name in COLMAP.
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

/// Which pictures are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Matcher {
    /// Each with each
    Exhaustive,
    /// Each with those after it, and some with all others, which closes loops
    Sequential,
    /// Each with those that look alike by a vocabulary tree (--vocab-tree)
    Vocabulary,
}

/// How cameras are placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Mapper {
    /// One after the other
    Incremental,
    /// All at once: COLMAP 4 or glomap
    Global,
}

/// A capture to make: its input and its options. The program chooses the value of an option that is `None`.
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// A film, a folder of photographs, or a zip archive of either.
    pub input: PathBuf,
    /// Folder of the capture; by default `captures/` and the name of the input.
    pub out: Option<PathBuf>,
    /// Number of frames of a film.
    pub frames: Option<u32>,
    /// What finds the poses.
    pub poses: Option<PosesProgram>,
    /// Camera model.
    pub camera: Option<Lens>,
    /// Which pictures are compared.
    pub matcher: Option<Matcher>,
    /// A vocabulary tree for the version of COLMAP that is there.
    pub vocab_tree: Option<PathBuf>,
    /// How cameras are placed.
    pub mapper: Option<Mapper>,
    /// Longest side of the pictures in which features are looked for, pixels.
    pub size: Option<u32>,
    /// Threads of the programs; 0 is all.
    pub threads: u32,
    /// Whether what an earlier call did is done again.
    pub fresh: bool,
}
