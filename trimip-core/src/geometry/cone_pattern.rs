//! Patterns of the cones within a pixel.

/// Arrangement of the cones of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelPattern {
    /// A grid with this many cones along each side of the pixel, one in each part.
    Grid(u32),
    /// Five cones as wide as the pixel: one at the pixel's centre and four displaced by (±¼, ±¼) of a pixel.
    Quincunx,
}

impl PixelPattern {
    /// One cone for the whole pixel.
    pub const WHOLE: Self = Self::Grid(1);

    /// Returns the number of cones.
    #[inline]
    pub fn count(self) -> u32 {
        match self {
            Self::Grid(side) => side * side,
            Self::Quincunx => 5,
        }
    }

    /// Returns this pattern with at most `most` parts along a side. A quincunx stays as it is.
    pub fn within(self, most: u32) -> Self {
        match self {
            Self::Grid(side) => Self::Grid(side.min(most).max(1)),
            Self::Quincunx => self,
        }
    }
}
