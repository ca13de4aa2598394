//! Readers of single files of a scene from bytes in memory, for programs without a file system and for tests with
//! arbitrary bytes. COLMAP models have [`Model::parse`](crate::colmap::Model::parse). `name` names the file in errors,
//! which are of kind `Input` and state the place.

use crate::{
    mask, photograph, ply,
    points::Point,
    readers::{READERS, blender, multiscale},
    zip::{Limits, Zip},
};
use std::path::Path;
use trimip_core::{Camera, Result};

pub use crate::readers::reader::{CameraFile, NamedCameras};

/// Returns the files of cameras of all scene readers.
pub fn camera_files() -> impl Iterator<Item = &'static CameraFile> {
    READERS.iter().flat_map(|reader| reader.camera_files)
}

/// Returns the short names and cameras of all frames of a transforms file, in the order of the file. Photographs without
/// a stated size have `size`: width and height in pixels.
///
/// # Errors
/// Invalid syntax, and values that are missing or out of range.
pub fn transforms(name: &str, bytes: &[u8], size: [u32; 2]) -> Result<Vec<(String, Camera)>> {
    blender::cameras(Path::new(name), bytes, size)
}

/// Returns the short names and cameras of all entries of a multi-scale set's `metadata.json`, split by split.
///
/// # Errors
/// As [`transforms`].
pub fn metadata(name: &str, bytes: &[u8]) -> Result<Vec<(String, Camera)>> {
    multiscale::cameras(Path::new(name), bytes)
}

/// Returns the vertices of a PLY file, ASCII or binary, in the order of the file. Vertices whose position is not finite
/// are left out.
///
/// # Errors
/// A header without vertices or format, and numbers that are missing or malformed.
pub fn ply(name: &str, bytes: &[u8]) -> Result<Vec<Point>> {
    ply::points(name, bytes)
}

/// Returns width, height and RGBA pixels of a photograph: PNG, JPEG, WebP, TIFF or BMP. The pixels are bytes, [height,
/// width, 4], row by row.
///
/// # Errors
/// If it cannot be decoded to its end, or has no pixels or more than 2^28.
pub fn photograph(name: &str, bytes: &[u8]) -> Result<(u32, u32, Vec<u8>)> {
    let image = photograph::of_bytes(Path::new(name), bytes)?;
    Ok((image.width(), image.height(), image.into_rgba8().into_raw()))
}

/// Returns width, height and the kept share of each pixel of a mask, in the formats of [`photograph`]. White is kept.
/// The shares are bytes, row by row.
///
/// # Errors
/// As [`photograph`].
pub fn mask(name: &str, bytes: &[u8]) -> Result<(u32, u32, Vec<u8>)> {
    let image = photograph::of_bytes(Path::new(name), bytes)?;
    Ok((image.width(), image.height(), mask::kept(image)))
}

/// Returns the paths and sizes of the files of a zip archive, after reading each file to its end. At most 64 MiB are unpacked.
///
/// # Errors
/// An archive that is broken or unsafe.
pub fn archive(name: &str, bytes: &[u8]) -> Result<Vec<(String, u64)>> {
    let limits = Limits { bytes: 64 << 20, ratio: 0, ..Limits::USUAL };
    let zip = Zip::open(&name.into(), bytes, bytes.len() as u64, &limits)?;
    let read = |file: &crate::zip::File| {
        let mut length = 0;
        zip.read(file, |part| {
            length += part.len() as u64;
            Ok(())
        })?;
        Ok((file.path.clone(), length))
    };
    zip.files.iter().map(read).collect()
}
