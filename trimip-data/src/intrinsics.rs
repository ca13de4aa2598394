//! Intrinsics of a frame of a transforms file: size, focal lengths and principal point. Frame keys override file keys.
//! Without `fl_x` the focal length follows from `camera_angle_x`, or from another key or default of the camera model.
//! Lengths are in pixels, angles in radians.

use crate::{json::Node, lens, photograph::Photograph};
use std::path::Path;
use trimip_core::{Error, Intrinsics, Result, geometry::projections::Model};

/// Image size from `w` and `h`.
#[derive(Clone, Copy, Default)]
pub(crate) struct Size {
    pub(crate) width: Option<u32>,
    pub(crate) height: Option<u32>,
}

impl Size {
    pub(crate) fn of(node: &Node<'_>) -> Result<Self> {
        Self::named(node, ["w", "h"])
    }

    /// Reads the size from these two keys.
    pub(crate) fn named(node: &Node<'_>, [width, height]: [&str; 2]) -> Result<Self> {
        let side = |key: &str| -> Result<Option<u32>> {
            let Some(value) = node.number(key)? else { return Ok(None) };
            // Some exporters write 1080.0.
            if value >= 1.0 && value <= f64::from(u32::MAX) && value.fract() == 0.0 {
                return Ok(Some(value as u32));
            }
            Err(Error::input(
                &node.place,
                format!("\"{key}\" is {value}"),
                "expected a whole number of pixels",
            ))
        };
        Ok(Self { width: side(width)?, height: side(height)? })
    }

    pub(crate) fn or(self, other: Self) -> Self {
        Self { width: self.width.or(other.width), height: self.height.or(other.height) }
    }

    /// Refuses an image of another size.
    pub(crate) fn check(self, image: &Photograph) -> Result<()> {
        let (width, height) = (self.width.unwrap_or(image.width), self.height.unwrap_or(image.height));
        if (width, height) == (image.width, image.height) {
            return Ok(());
        }
        Err(other_size(image, [width, height]))
    }
}

/// A photograph that was compared with the intrinsics that a file states for it.
pub(crate) struct Fitted {
    /// The photograph, turned if it has the stated size only when turned.
    pub(crate) image: Photograph,
    /// Intrinsics at the size of the photograph.
    pub(crate) intrinsics: Intrinsics,
    /// Pixels of the photograph per stated pixel, along x and y.
    pub(crate) factors: [f64; 2],
}

/// Compares a photograph with the intrinsics that a file states for it. If the photograph has another size but the same
/// aspect ratio, up to rounding, focal lengths and principal point are scaled to its size.
///
/// # Errors
/// Of kind `Input`: the photograph has another aspect ratio.
pub(crate) fn fitted(image: Photograph, stated: Intrinsics) -> Result<Fitted> {
    let image = image.fit(Some(stated.width), Some(stated.height));
    let (own, sizes) = ([stated.width, stated.height], [image.width, image.height]);
    if !alike(sizes, own) {
        return Err(other_size(&image, own));
    }
    let factors = [0, 1].map(|side| f64::from(sizes[side]) / f64::from(own[side]));
    let ([x, y], [width, height]) = (factors, sizes);
    let Intrinsics { fx, fy, cx, cy, lens, .. } = stated;
    let intrinsics = Intrinsics { width, height, fx: fx * x, fy: fy * y, cx: cx * x, cy: cy * y, lens };
    Ok(Fitted { image, intrinsics, factors })
}

/// Returns true if the sizes `sizes` and `own` have the same aspect ratio, up to rounding.
pub(crate) fn alike(sizes: [u32; 2], own: [u32; 2]) -> bool {
    // Range of the scale factors that round to the side.
    let range = |side: usize| [-1.0, 1.0].map(|by| (f64::from(sizes[side]) + by) / f64::from(own[side]));
    let ([low_x, high_x], [low_y, high_y]) = (range(0), range(1));
    low_x.max(low_y) < high_x.min(high_y)
}

/// Returns a warning if photographs have another size than `file` states.
pub(crate) fn scaled_along(file: &Path, factors: impl IntoIterator<Item = [f64; 2]>) -> Option<String> {
    let [x, _] = factors.into_iter().find(|factors| *factors != [1.0; 2])?;
    let file = file.display();
    Some(format!(
        "the photographs of {file} are {x:.4} times as wide as the file states: the cameras are scaled to match"
    ))
}

/// Returns the error for a photograph of another size than the stated one.
fn other_size(image: &Photograph, [width, height]: [u32; 2]) -> Error {
    let what = format!(
        "image {} is {}x{} pixels, but the file states {width}x{height}",
        image.path.display(),
        image.width,
        image.height
    );
    let advice = "use the images that the cameras were computed for, or images of the same shape";
    Error::input(&image.place, what, advice)
}

/// Reads the intrinsics of a frame whose image is `width` × `height` pixels.
pub(crate) fn intrinsics(file: &Node<'_>, frame: &Node<'_>, width: u32, height: u32) -> Result<Intrinsics> {
    let lens = lens::read(file, frame)?;
    // The focal length of a frame overrides that of the file, whichever keys state them.
    let found = match focal(lens.model, frame, width, height)? {
        Some(focal) => Some(focal),
        None => focal(lens.model, file, width, height)?,
    };
    let usual = || Some(lens.model.definition().focal?(width.into(), height.into()).into());
    let (fx, fy) = found.or_else(usual).ok_or_else(|| {
        let keys =
            format!("\"fl_x\", \"{}\"", lens.model.definition().extent_key.unwrap_or("camera_angle_x"));
        Error::input(
            &file.place,
            format!("has no focal length ({keys})"),
            format!("add one of these keys to the file, or to {}", frame.place),
        )
    })?;
    let centre = |key: &str, side: u32| -> Result<f64> {
        Ok(frame.number(key)?.or(file.number(key)?).unwrap_or(0.5 * f64::from(side)))
    };
    Ok(Intrinsics { width, height, fx, fy, cx: centre("cx", width)?, cy: centre("cy", height)?, lens })
}

/// Reads the focal lengths of one node. They are `fl_x` and `fl_y`; if absent, half the side divided by the tangent of
/// half the field of view, or the longer side divided by its width in world units, depending on the camera model.
fn focal(model: Model, node: &Node<'_>, width: u32, height: u32) -> Result<Option<(f64, f64)>> {
    let definition = model.definition();
    if let Some(key) = definition.extent_key
        && let (None, Some(extent)) = (node.number("fl_x")?, node.number(key)?)
    {
        let focal = positive(node, key, extent, f64::from(width.max(height)) / extent)?;
        return Ok(Some((focal, node.number("fl_y")?.unwrap_or(focal))));
    }
    let length = |key: &'static str, angle_key: &'static str, side: u32| -> Result<Option<f64>> {
        let angle = if definition.angles { node.number(angle_key)? } else { None };
        let (key, stated, focal) = match (node.number(key)?, angle) {
            (Some(focal), _) => (key, focal, focal),
            (None, Some(angle)) if angle > 0.0 && angle < std::f64::consts::PI => {
                (angle_key, angle, 0.5 * f64::from(side) / (0.5 * angle).tan())
            }
            (None, Some(angle)) => (angle_key, angle, f64::NAN),
            (None, None) => return Ok(None),
        };
        positive(node, key, stated, focal).map(Some)
    };
    let x = length("fl_x", "camera_angle_x", width)?;
    let y = length("fl_y", "camera_angle_y", height)?;
    Ok(x.or(y).map(|x| (x, y.unwrap_or(x))))
}

/// Refuses a focal length that is not positive and finite; `key` is the key that states it.
fn positive(node: &Node<'_>, key: &str, stated: f64, focal: f64) -> Result<f64> {
    if focal.is_finite() && focal > 0.0 {
        return Ok(focal);
    }
    Err(Error::input(
        &node.place,
        format!("\"{key}\" is {stated}, which gives no positive focal length"),
        "expected pixels above 0 for a length, radians between 0 and pi for an angle",
    ))
}
