//! The cones inside of a pixel: a square of `side` × `side` parts, or the quincunx.

/// Cones along a side that stand for the quincunx: five cones of the pixel's width, at its centre and at (±¼, ±¼) of a pixel
/// around it.
pub const QUINCUNX: u32 = 0x100;

/// Number of cones of a pixel with `side` cones along each side.
#[inline]
pub fn count(side: u32) -> u32 {
    if side == QUINCUNX { 5 } else { side * side }
}
