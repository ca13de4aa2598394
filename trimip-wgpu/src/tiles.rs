//! Divides an image, or the cells of a grid, into tiles whose samples fit into the arrays of samples.

use std::ops::Range;

/// The tiles of an image or a grid. A tile has few enough rays that their samples fit into the arrays.
pub struct Tiles {
    /// Number of samples that fit into a tile.
    capacity: usize,
    chunk: u32,
    start: u32,
    count: u32,
}

impl Tiles {
    /// Divides `count` rays into tiles, initially of `chunk` rays each. A tile has room for `capacity` samples.
    pub fn new(count: u32, chunk: u32, capacity: usize) -> Self {
        Self { capacity, chunk, start: 0, count }
    }

    /// Returns the next tile. After a tile that did not fit, the next tile starts at the same ray and is smaller.
    pub fn next(&mut self) -> Option<Range<u32>> {
        (self.start < self.count)
            .then(|| self.start..self.start + self.chunk.clamp(1, self.count - self.start))
    }

    /// Returns true if the samples of a tile fit, or if the tile is a single ray; [`next`](Self::next) then goes on
    /// after it. `counts` are the tile's counts of samples, `None` if its rays were not marched: the first pair has the
    /// marched and the kept samples, the second those of each that were dropped.
    pub fn fits(&mut self, tile: &Range<u32>, counts: Option<Vec<[u32; 2]>>) -> bool {
        let length = tile.end - tile.start;
        if let Some(counts) = counts {
            let (marched, dropped) = (counts[0][0], counts[1][0] + counts[1][1]);
            if dropped > 0 && length > 1 {
                self.chunk = length / 2;
                return false;
            }
            let mean = (marched as usize / length as usize).max(1);
            // Half of the capacity is left free, because the next rows of a view may have more samples than the last
            // rows.
            self.chunk = (self.capacity / mean / 2).min(1 << 20) as u32;
        }
        self.start = tile.end;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_span_without_room_is_halved_and_all_are_covered_once() {
        // Every ray has 10 samples, and a tile has room for 100.
        let mut tiles = Tiles::new(95, 40, 100);
        let mut done = Vec::new();
        while let Some(tile) = tiles.next() {
            let marched = 10 * (tile.end - tile.start);
            let dropped = marched.saturating_sub(100);
            if tiles.fits(&tile, Some(vec![[marched, marched], [dropped, 0]])) {
                done.extend(tile);
            }
        }
        assert_eq!(done, (0..95).collect::<Vec<_>>());
        let mut whole = Tiles::new(3, 8, 100);
        assert_eq!(whole.next(), Some(0..3));
        assert!(whole.fits(&(0..3), None) && whole.next().is_none());
    }
}
