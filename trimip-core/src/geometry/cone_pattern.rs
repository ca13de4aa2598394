//! The cones inside of a pixel.

/// Arrangement of the cones of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelPattern {
    /// A grid with this many cones along each side of the pixel, one in each part.
    Grid(u32),
    /// Five cones of the pixel's width, at its centre and at (±¼, ±¼) of a pixel around it.
    Quincunx,
}

impl PixelPattern {
    /// One cone of the whole pixel.
    pub const WHOLE: Self = Self::Grid(1);

    /// Number of cones.
    #[inline]
    pub fn count(self) -> u32 {
        match self {
            Self::Grid(side) => side * side,
            Self::Quincunx => 5,
        }
    }

    /// This pattern with at most `most` parts along a side. A quincunx stays as it is.
    pub fn within(self, most: u32) -> Self {
        match self {
            Self::Grid(side) => Self::Grid(side.min(most).max(1)),
            Self::Quincunx => self,
        }
    }
}
