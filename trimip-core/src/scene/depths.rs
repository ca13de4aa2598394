//! Known distances: pixels of the training views whose rays end at points that several photographs saw, or at surfaces that depth
//! images show.

use bytemuck::{Pod, Zeroable};

/// Known end of the ray of a pixel.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct KnownDepth {
    /// Index of the pixel in [`ViewSet::pixels`](crate::ViewSet::pixels).
    pub pixel: u32,
    /// Distance of the point from the camera's centre, world units.
    pub distance: f32,
    /// Standard deviation of the distance, world units; above 0.
    pub deviation: f32,
}

/// Number of pixels in a block of [`DepthIndex`].
const BLOCK: usize = 1024;

/// Index that finds the known depth of a pixel. A binary search would read memory a dozen times for each random pixel.
#[derive(Clone, Debug, Default)]
pub struct DepthIndex {
    /// For each block of pixels, the number of known depths in the blocks before it. The last entry is the number of all
    /// known depths.
    starts: Vec<u32>,
}

impl DepthIndex {
    /// Builds the index of `depths`, which must be sorted by pixel.
    pub fn new(depths: &[KnownDepth]) -> Self {
        let blocks = depths.last().map_or(0, |known| known.pixel as usize / BLOCK + 1);
        let before = |pixel: usize| depths.partition_point(|known| (known.pixel as usize) < pixel) as u32;
        Self { starts: (0..=blocks).map(|block| before(block * BLOCK)).collect() }
    }

    /// Returns the known depth of a pixel. `depths` must be those from which the index was built.
    #[inline]
    pub fn find<'a>(&self, depths: &'a [KnownDepth], pixel: usize) -> Option<&'a KnownDepth> {
        let block = pixel / BLOCK;
        let (start, end) = (*self.starts.get(block)?, *self.starts.get(block + 1)?);
        depths[start as usize..end as usize].iter().find(|known| known.pixel as usize == pixel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_are_found_by_their_index() {
        let known = |pixel: u32| KnownDepth { pixel, distance: pixel as f32, deviation: 1.0 };
        let depths: Vec<_> = [2, 3, 9, 1023, 1024, 4095, 5000].map(known).to_vec();
        let index = DepthIndex::new(&depths);
        for pixel in 0..8000 {
            let expected = depths.iter().find(|known| known.pixel as usize == pixel);
            assert_eq!(index.find(&depths, pixel), expected, "{pixel}");
        }
        assert_eq!(index.find(&depths, 1 << 33), None);
        assert_eq!(DepthIndex::new(&[]).find(&[], 3), None);
    }
}
