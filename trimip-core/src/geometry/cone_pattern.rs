//! The cones inside of a pixel.

/// Where the cones of a pixel are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelPattern {
    /// One cone in each of so many × so many parts of the pixel.
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

    /// The same with at most `most` parts along a side. A quincunx has no other size.
    pub fn within(self, most: u32) -> Self {
        match self {
            Self::Grid(side) => Self::Grid(side.min(most).max(1)),
            Self::Quincunx => self,
        }
    }
}
