//! A sparse model of COLMAP as its files hold it: cameras, images with poses, points with tracks. Axes of COLMAP: x right,
//! y down, z forward; poses are world-to-camera.

use super::lenses::ModelCamera;

/// How the files of a model are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// `cameras.txt`, `images.txt`, `points3D.txt`.
    Text,
    /// `cameras.bin`, `images.bin`, `points3D.bin`.
    Binary,
}

/// A file in memory.
#[derive(Clone, Copy, Debug)]
pub struct File<'a> {
    /// Its path for messages.
    pub name: &'a str,
    /// Its content.
    pub bytes: &'a [u8],
}

/// An image of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelImage {
    /// Its number, which tracks name.
    pub id: u32,
    /// Number of its camera.
    pub camera: u32,
    /// Rotation from world to camera as a quaternion w, x, y, z of any length above 0.
    pub rotation: [f64; 4],
    /// Translation from world to camera.
    pub translation: [f64; 3],
    /// Path of the photograph in the folder of images.
    pub name: String,
    /// Places of its features, pixels.
    pub places: Box<[[f64; 2]]>,
}

/// A point of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelPoint {
    /// Its number.
    pub id: u64,
    /// World units.
    pub position: [f64; 3],
    /// Red, green, blue.
    pub color: [u8; 3],
    /// Mean reprojection error in pixels; negative if it is unknown.
    pub error: f64,
    /// Pairs of the number of an image and the index of one of its features.
    pub track: Box<[[u32; 2]]>,
}

/// A sparse model.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// In the order of the file.
    pub cameras: Vec<ModelCamera>,
    /// In the order of the file.
    pub images: Vec<ModelImage>,
    /// In the order of the file; empty without the file.
    pub points: Vec<ModelPoint>,
}

impl ModelImage {
    /// The entry in words.
    pub(super) fn place(&self) -> String {
        format!("image {} ({})", self.id, self.name)
    }
}
