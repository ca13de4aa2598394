//! EXIF orientation: decides whether the camera of a photograph belongs to the pixels as stored, or to the pixels after the
//! rotation of the tag. The stated size decides; if it cannot, pixels are used as stored, as in COLMAP, nerfstudio and Instant-NGP.

use image::metadata::Orientation;

/// The orientation of a photograph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Turn {
    /// There is no tag, or the turned photograph would not have the stated size.
    Stored,
    /// There is a tag, and the stated size fits the photograph both as stored and as turned. The tag is not applied.
    Doubtful,
    /// The stated size is that of the turned photograph: the tag is applied.
    Applied(Orientation),
}

/// Decides for a photograph of `stored` pixels with a tag. `width` and `height` are the stated size; `None` if a side is not stated.
pub(crate) fn decide(stored: (u32, u32), tag: Orientation, width: Option<u32>, height: Option<u32>) -> Turn {
    let fits =
        |(w, h): (u32, u32)| width.is_none_or(|width| width == w) && height.is_none_or(|height| height == h);
    match (tag, fits(stored), fits(turned(stored, tag))) {
        (Orientation::NoTransforms, ..) | (_, true | false, false) => Turn::Stored,
        (_, true, true) => Turn::Doubtful,
        (_, false, true) => Turn::Applied(tag),
    }
}

/// Returns the size of a photograph after it is turned.
pub(crate) fn turned((width, height): (u32, u32), tag: Orientation) -> (u32, u32) {
    use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
    match tag {
        Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH => (height, width),
        _ => (width, height),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Orientation::{FlipHorizontal, NoTransforms, Rotate90, Rotate180};

    #[test]
    fn the_stated_size_decides() {
        let stored = (40, 30);
        let cases = [
            (NoTransforms, (None, None), Turn::Stored),
            (NoTransforms, (Some(30), Some(40)), Turn::Stored),
            (Rotate90, (Some(40), Some(30)), Turn::Stored),
            (Rotate90, (Some(30), Some(40)), Turn::Applied(Rotate90)),
            (Rotate90, (Some(30), None), Turn::Applied(Rotate90)),
            (Rotate90, (None, None), Turn::Doubtful),
            (Rotate90, (Some(50), Some(40)), Turn::Stored),
            (Rotate180, (Some(40), Some(30)), Turn::Doubtful),
            (FlipHorizontal, (None, None), Turn::Doubtful),
        ];
        for (tag, (width, height), expected) in cases {
            assert_eq!(decide(stored, tag, width, height), expected, "{tag:?} {width:?} {height:?}");
        }
        assert_eq!(decide((30, 30), Rotate90, Some(30), Some(30)), Turn::Doubtful, "a square tells nothing");
    }
}
