//! Known distances: pixels of the training views whose rays end at points that several photographs saw.

use bytemuck::{Pod, Zeroable};

/// Where the ray of a pixel ends.
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

/// The known depth of a pixel among `depths`, which are sorted by pixel.
#[inline]
pub fn of_pixel(depths: &[KnownDepth], pixel: usize) -> Option<&KnownDepth> {
    let pixel = u32::try_from(pixel).ok()?;
    depths.binary_search_by_key(&pixel, |known| known.pixel).ok().map(|index| &depths[index])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_are_found_by_their_index() {
        let known = |pixel: u32| KnownDepth { pixel, distance: pixel as f32, deviation: 1.0 };
        let depths: Vec<_> = [2, 3, 9, 40].map(known).to_vec();
        for pixel in 0..50 {
            let expected = depths.iter().find(|known| known.pixel as usize == pixel);
            assert_eq!(of_pixel(&depths, pixel), expected, "{pixel}");
        }
        assert_eq!(of_pixel(&[], 3), None);
        assert_eq!(of_pixel(&depths, 1 << 33), None);
    }
}
