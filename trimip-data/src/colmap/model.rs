//! A sparse model of COLMAP as its files hold it: cameras, images with poses, points with tracks. Camera axes are
//! COLMAP's: x right, y down, z forward; poses are world-to-camera.

use super::lenses::ModelCamera;

/// Encoding of the files of a model.
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
    /// Its number, by which tracks refer to it.
    pub id: u32,
    /// Number of its camera.
    pub camera: u32,
    /// Rotation from world to camera as a quaternion w, x, y, z of any length above 0.
    pub rotation: [f64; 4],
    /// Translation from world to camera.
    pub translation: [f64; 3],
    /// Path of the photograph in the folder of images.
    pub name: String,
    /// Positions of its features, pixels.
    pub places: Box<[[f64; 2]]>,
}

/// A point of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelPoint {
    /// Its number.
    pub id: u64,
    /// Position in world units.
    pub position: [f64; 3],
    /// Colour: red, green, blue.
    pub color: [u8; 3],
    /// Mean reprojection error in pixels; negative if it is unknown.
    pub error: f64,
    /// The observations of the point, as pairs of the number of an image and the index of one of its features.
    pub track: Box<[[u32; 2]]>,
}

/// A sparse model.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// Cameras in the order of the file.
    pub cameras: Vec<ModelCamera>,
    /// Images in the order of the file.
    pub images: Vec<ModelImage>,
    /// Points in the order of the file; empty if there is no such file.
    pub points: Vec<ModelPoint>,
}

impl ModelImage {
    /// Describes the entry for messages.
    pub(super) fn place(&self) -> String {
        format!("image {} ({})", self.id, self.name)
    }
}
