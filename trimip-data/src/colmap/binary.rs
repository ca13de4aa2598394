//! The binary files of a COLMAP model, little-endian. Memory is allocated only after the rest of the file proves to be
//! long enough for a stated count.

use super::{
    lenses::{ADVICE, Kind, ModelCamera},
    model::{File, ModelImage, ModelPoint},
};
use trimip_core::{Error, Result};

/// Least bytes of a camera: its number, model and size, and two parameters.
const CAMERA: usize = 24 + 2 * 8;
/// Least bytes of an image: its number, pose and camera, the end of its name, and the count of its features.
const IMAGE: usize = 4 + 7 * 8 + 4 + 1 + 8;
/// Bytes of a feature: its position and the number of its point.
const FEATURE: usize = 24;
/// Least bytes of a point: its number, position, colour and error, and the length of its track.
const POINT: usize = 8 + 24 + 3 + 8 + 8;
/// Bytes of an entry of a track: an image and a feature.
const STEP: usize = 8;

pub(super) fn cameras(file: File<'_>) -> Result<Vec<ModelCamera>> {
    let mut rest = Rest { file, at: 0 };
    let count = rest.count("cameras", CAMERA)?;
    let mut cameras = Vec::with_capacity(count);
    for _ in 0..count {
        let start = rest.at;
        let id = rest.u32()?;
        let wrong = |what: String, advice: &str| {
            Error::input(place(file, start, &format!("camera {id}")), what, advice)
        };
        let kind = Kind::of_number(i32::from_le_bytes(rest.take()?)).map_err(|what| wrong(what, ADVICE))?;
        let size = [rest.u64()?, rest.u64()?];
        rest.needs(kind.parameters().len(), 8, "parameters")?;
        let parameters = (0..kind.parameters().len())
            .map(|_| rest.take().map(f64::from_le_bytes))
            .collect::<Result<_>>()?;
        cameras.push(
            ModelCamera::new(id, kind, size, parameters)
                .map_err(|what| wrong(what, "export the model again"))?,
        );
    }
    rest.end()?;
    Ok(cameras)
}

pub(super) fn images(file: File<'_>) -> Result<Vec<ModelImage>> {
    let mut rest = Rest { file, at: 0 };
    let count = rest.count("images", IMAGE)?;
    let mut images = Vec::with_capacity(count);
    for _ in 0..count {
        let start = rest.at;
        let id = rest.u32()?;
        let rotation = rest.numbers()?;
        let translation = rest.numbers()?;
        let camera = rest.u32()?;
        let name = rest.name()?;
        if rotation == [0.0; 4] {
            let entry = place(file, start, &format!("image {id} ({name})"));
            return Err(Error::input(entry, "has a rotation of length 0", "export the model again"));
        }
        let features = rest.count("features", FEATURE)?;
        let mut places = Vec::with_capacity(features);
        for _ in 0..features {
            places.push(rest.numbers()?);
            rest.u64()?;
        }
        images.push(ModelImage { id, camera, rotation, translation, name, places: places.into() });
    }
    rest.end()?;
    Ok(images)
}

pub(super) fn points(file: File<'_>) -> Result<Vec<ModelPoint>> {
    let mut rest = Rest { file, at: 0 };
    let count = rest.count("points", POINT)?;
    let mut points = Vec::with_capacity(count);
    for _ in 0..count {
        let id = rest.u64()?;
        let position = rest.numbers()?;
        let color = rest.take()?;
        let error = rest.f64()?;
        let length = rest.count("steps of a track", STEP)?;
        let mut track = Vec::with_capacity(length);
        for _ in 0..length {
            track.push([rest.u32()?, rest.u32()?]);
        }
        points.push(ModelPoint { id, position, color, error, track: track.into() });
    }
    rest.end()?;
    Ok(points)
}

/// Returns the number of images that the head of `images.bin` states.
pub(super) fn stated_images(head: [u8; 8]) -> u64 {
    u64::from_le_bytes(head)
}

fn place(file: File<'_>, at: usize, entry: &str) -> String {
    format!("{}: byte {at}: {entry}", file.name)
}

/// The unread part of a file.
struct Rest<'a> {
    file: File<'a>,
    at: usize,
}

impl<'a> Rest<'a> {
    fn left(&self) -> &'a [u8] {
        self.file.bytes.get(self.at..).unwrap_or(&[])
    }

    fn wrong(&self, what: String) -> Error {
        let advice = "copy the file again or export the model again";
        Error::input(format!("{}: byte {}", self.file.name, self.at), what, advice)
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N]> {
        match self.left().first_chunk() {
            Some(bytes) => {
                self.at += N;
                Ok(*bytes)
            }
            None => Err(self.wrong("the file ends within an entry".into())),
        }
    }

    fn u32(&mut self) -> Result<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn f64(&mut self) -> Result<f64> {
        let value = f64::from_le_bytes(self.take()?);
        if value.is_finite() {
            return Ok(value);
        }
        self.at -= 8;
        Err(self.wrong(format!("{value} is not a finite number")))
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64()?;
        }
        Ok(values)
    }

    /// Reads a count of entries, and refuses one whose entries of at least `least` bytes do not fit into the rest of the file.
    fn count(&mut self, of: &str, least: usize) -> Result<usize> {
        let count = self.u64()?;
        let fits = usize::try_from(count).ok().filter(|count| *count <= self.left().len() / least);
        fits.ok_or_else(|| {
            self.at -= 8;
            self.wrong(format!(
                "{count} {of} do not fit into the {} bytes that follow",
                self.left().len() - 8
            ))
        })
    }

    /// Refuses `count` entries of `bytes` bytes each that do not fit into the rest of the file.
    fn needs(&self, count: usize, bytes: usize, of: &str) -> Result<()> {
        if count * bytes <= self.left().len() {
            return Ok(());
        }
        Err(self.wrong(format!("the file ends within {count} {of}")))
    }

    /// Reads a text that ends with a zero byte.
    fn name(&mut self) -> Result<String> {
        let left = self.left();
        let Some(length) = left.iter().position(|&byte| byte == 0) else {
            return Err(self.wrong("the file ends within a name".into()));
        };
        if length == 0 {
            return Err(self.wrong("the name of an image is empty".into()));
        }
        self.at += length + 1;
        // Bytes that are not UTF-8, such as those of a code page, are replaced, as in the names of the files that are searched.
        Ok(String::from_utf8_lossy(&left[..length]).into_owned())
    }

    fn end(&self) -> Result<()> {
        match self.left().len() {
            0 => Ok(()),
            left => Err(self.wrong(format!("{left} bytes follow the last entry"))),
        }
    }
}
