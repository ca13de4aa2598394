//! A depth image: a 16-bit grey picture or a NumPy array. Its numbers are depths along the optical axis, not distances
//! along the ray, in a unit that [`DepthFile`] holds; 0 means unknown (nerfstudio, ARKit).

use crate::{
    files,
    intrinsics::alike,
    npy::{self, Table},
    photograph::Photograph,
};
use image::{ColorType, DynamicImage, GrayImage, ImageBuffer, Luma};
use std::{
    io::Read,
    path::{Path, PathBuf},
};
use trimip_core::{Error, Result, plain_file};

/// A millimetre in metres, ARKit's unit.
const MILLIMETRE: f64 = 1e-3;

/// Range of the sensor of a phone or tablet, metres. Depths beyond it are guesses from the photograph (Polycam's polyform, README).
const RANGE_OF_ARKIT: f64 = 5.0;

/// Advice for a file that is not a depth image.
const ADVICE: &str = "export it as a PNG of 16-bit grey or as .npy of f4 or f8, or set data.depths = false";

/// Path of the depth image of a photograph, and the meaning of its numbers.
#[derive(Clone, Debug)]
pub(crate) struct DepthFile {
    path: PathBuf,
    /// World units per unit of the stored numbers.
    unit: f64,
    /// Greatest depth that was measured, world units.
    farthest: f64,
    /// An 8-bit grey picture that is 0 where a depth is unreliable.
    confidence: Option<PathBuf>,
}

impl DepthFile {
    /// Creates the entry of a depth image whose numbers are multiples of `unit` world units.
    pub(crate) fn new(path: &str, unit: f64) -> Self {
        Self { path: path.into(), unit, farthest: f64::INFINITY, confidence: None }
    }

    /// Returns ARKit's depth image of a photograph with its confidence image, or `None` if there is no depth image.
    /// They lie in two `folders` below `root`, and both are named like the photograph.
    pub(crate) fn of_arkit(root: &Path, folders: [&str; 2], photograph: &Path) -> Option<Self> {
        let name = format!("{}.png", photograph.file_stem()?.to_string_lossy());
        let [path, confidence] = folders.map(|folder| root.join(folder).join(&name));
        let confidence = Some(confidence).filter(|path| path.is_file());
        path.is_file().then_some(Self { path, unit: MILLIMETRE, farthest: RANGE_OF_ARKIT, confidence })
    }

    /// Returns the same entry with its path resolved relative to `root`.
    pub(crate) fn below(&self, root: &Path) -> Self {
        let written = root.join(&self.path);
        let turned = || root.join(self.path.to_string_lossy().replace('\\', "/"));
        let path = if written.is_file() { written } else { turned() };
        Self { path, ..self.clone() }
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    fn is_table(&self) -> bool {
        self.path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("npy"))
    }
}

/// A depth image and its header.
#[derive(Debug)]
pub(crate) struct DepthImage {
    file: DepthFile,
    /// The picture; `None` for a table.
    picture: Option<Photograph>,
    confidence: Option<Photograph>,
    /// Width and height.
    pub(crate) size: [u32; 2],
}

impl DepthImage {
    /// Reads the header of the depth image of a photograph.
    ///
    /// # Errors
    /// Of kind `Input`: the file is no depth image, or has another aspect ratio than the photograph.
    pub(crate) fn open(file: &DepthFile, photograph: &Photograph) -> Result<Self> {
        let wrong = |path: &Path, what: &str| {
            Error::input(&photograph.place, format!("depth image {} {what}", path.display()), ADVICE)
        };
        let open = |path: &Path| Photograph::open(path.into(), photograph.place.clone());
        let (picture, size) = if file.is_table() {
            let name = file.path.display().to_string();
            let [height, width] = Table::sides(&name, &head(&file.path)?, ADVICE)?
                .map(|side| u32::try_from(side).ok().filter(|side| *side > 0));
            let [Some(width), Some(height)] = [width, height] else {
                return Err(wrong(&file.path, "has no pixels or too many"));
            };
            (None, [width, height])
        } else {
            let picture = open(&file.path)?;
            match picture.color {
                ColorType::L16 => {}
                ColorType::L8 | ColorType::La8 | ColorType::Rgb8 | ColorType::Rgba8 => {
                    return Err(wrong(&file.path, "has 8 bits: it visualises depths and does not hold them"));
                }
                _ => return Err(wrong(&file.path, "has colours: it holds no depths")),
            }
            let size = [picture.width, picture.height];
            (Some(picture), size)
        };
        let [width, height] = size;
        let own = [photograph.width, photograph.height];
        if !alike(size, own) {
            let what = format!(
                "is {width}x{height} pixels, but image {} is {}x{}",
                photograph.path.display(),
                own[0],
                own[1]
            );
            let what = format!("depth image {} {what}", file.path.display());
            let advice = "use a depth image of the photograph's shape, or set data.depths = false";
            return Err(Error::input(&photograph.place, what, advice));
        }
        let confidence = file.confidence.as_deref().map(open).transpose()?;
        if let Some(own) = confidence.as_ref().filter(|own| [own.width, own.height] != size) {
            let what = format!(
                "is {width}x{height} pixels, but {} is {}x{}",
                own.path.display(),
                own.width,
                own.height
            );
            return Err(wrong(&file.path, &what));
        }
        Ok(Self { file: file.clone(), picture, confidence, size })
    }

    /// Decodes the depths.
    ///
    /// # Errors
    /// Of kind `Input`, if the file cannot be decoded.
    pub(crate) fn decode(&self) -> Result<Depths> {
        let numbers = match &self.picture {
            None => {
                let name = self.file.path.display().to_string();
                Numbers::Table(Table::new(&name, files::read(&self.file.path)?, ADVICE)?)
            }
            Some(picture) => match picture.image()? {
                DynamicImage::ImageLuma16(image) => Numbers::Grey(image),
                _ => return Err(Error::input(self.file.path.display(), "changed while it was read", ADVICE)),
            },
        };
        let trusted =
            self.confidence.as_ref().map(|picture| Ok(picture.image()?.into_luma8())).transpose()?;
        Ok(Depths { numbers, trusted, unit: self.file.unit, farthest: self.file.farthest, size: self.size })
    }
}

/// Reads the first bytes of a file.
fn head(path: &Path) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let read = plain_file::open(path).and_then(|file| file.take(npy::HEAD).read_to_end(&mut bytes));
    read.map_err(|error| Error::input(path.display(), format!("cannot be read: {error}"), ADVICE))?;
    Ok(bytes)
}

/// The numbers of a depth image as they are stored.
#[derive(Debug)]
enum Numbers {
    Grey(ImageBuffer<Luma<u16>, Vec<u16>>),
    Table(Table),
}

/// The depths of a depth image.
#[derive(Debug)]
pub(crate) struct Depths {
    numbers: Numbers,
    /// The confidence image: not 0 where a depth is reliable.
    trusted: Option<GrayImage>,
    unit: f64,
    farthest: f64,
    /// Width and height.
    pub(crate) size: [u32; 2],
}

impl Depths {
    /// Returns the depth along the optical axis in a pixel, world units, or `None` where it is unknown.
    pub(crate) fn at(&self, [x, y]: [u32; 2]) -> Option<f64> {
        let number = match &self.numbers {
            // The largest number means that the depth is out of range.
            Numbers::Grey(image) => match image.get_pixel(x, y).0[0] {
                u16::MAX => return None,
                number => number.into(),
            },
            Numbers::Table(table) => table.number(y as usize, x as usize),
        };
        let depth = number * self.unit;
        let sure = self.trusted.as_ref().is_none_or(|trusted| trusted.get_pixel(x, y).0[0] > 0);
        (sure && depth > 0.0 && depth.is_finite() && depth <= self.farthest).then_some(depth)
    }
}
