//! The sparse grid of a proxy: bricks of cells. Each cell has a four-bit code for its density.

/// Number of cells along each side of a brick.
pub const BRICK: u32 = 8;

/// Number of cells of a brick.
pub const BRICK_CELLS: usize = (BRICK * BRICK * BRICK) as usize;

/// Number of bytes of a brick's codes; a byte holds the codes of two cells.
pub(super) const BRICK_BYTES: usize = BRICK_CELLS / 2;

/// Number of different codes.
pub const CODES: usize = 16;

/// Optical depth of a cell with code 1. Thinner cells count as empty, because even all of them along a ray together are
/// nearly transparent.
const THINNEST: f32 = 1.0 / 65536.0;

/// Optical depth of a cell with the last code, which is as opaque as a wall.
const THICKEST: f32 = 16.0;

/// A sparse grid of densities over the unit cube. A cell has a code of four bits, 0 for empty; the logarithm of the
/// density grows with the code. This is exact enough for choosing samples.
#[derive(Clone, Debug, PartialEq)]
pub struct Proxy {
    /// Number of cells along each axis, multiples of [`BRICK`].
    pub(super) cells: [u32; 3],
    /// Width of a cell, in world units.
    pub(super) width: f32,
    /// Radius of the spheres whose densities the proxy holds, in world units.
    pub(super) radius: f32,
    /// One per brick, x fastest: 0 if the brick is empty, otherwise 1 + the position of its codes in `codes`, counted
    /// in bricks.
    pub(super) index: Vec<u32>,
    /// [`BRICK_BYTES`] bytes per brick that is not empty. Cells are ordered x fastest; the first of two cells is in the
    /// lower bits of a byte.
    pub(super) codes: Vec<u8>,
    /// Density of each code, per world unit.
    pub(super) densities: Vec<f32>,
}

impl Proxy {
    /// Creates an empty proxy with cells of about `width`, over a box of these sides.
    pub(super) fn empty(extent: [f32; 3], width: f32, radius: f32) -> Self {
        let cells = extent.map(|side| ((side / width).ceil() as u32).max(1).next_multiple_of(BRICK));
        let [x, y, z] = cells.map(|count| (count / BRICK) as usize);
        Self {
            cells,
            width,
            radius,
            index: vec![0; x * y * z],
            codes: Vec::new(),
            densities: densities(width),
        }
    }

    /// Returns the number of cells along each axis.
    pub fn cells(&self) -> [u32; 3] {
        self.cells
    }

    /// Returns the width of a cell, in world units.
    pub fn width(&self) -> f32 {
        self.width
    }

    /// Returns the radius of the spheres whose densities the proxy holds, in world units.
    pub fn radius(&self) -> f32 {
        self.radius
    }

    /// Returns the fraction of the bricks that are not empty.
    pub fn filled(&self) -> f64 {
        (self.codes.len() / BRICK_BYTES) as f64 / self.index.len() as f64
    }

    /// Returns one number per brick, x fastest: 0 if the brick is empty, otherwise 1 + the position of its codes in
    /// [`codes`](Self::codes), counted in bricks.
    pub fn index(&self) -> &[u32] {
        &self.index
    }

    /// Returns the codes of the cells in bricks that are not empty, two cells per byte. Cells are ordered x fastest;
    /// the first of two cells is in the lower bits.
    pub fn codes(&self) -> &[u8] {
        &self.codes
    }

    /// Returns the density of each code, per world unit.
    pub fn densities(&self) -> &[f32] {
        &self.densities
    }

    /// Returns the density at a position in the cube, per world unit.
    #[inline(always)]
    pub fn density(&self, position: [f32; 3]) -> f32 {
        self.densities[usize::from(self.code(position))]
    }

    /// Returns the code of the cell at a position in the cube.
    #[inline(always)]
    pub fn code(&self, position: [f32; 3]) -> u8 {
        let cell: [u32; 3] =
            std::array::from_fn(|i| ((position[i] * self.cells[i] as f32) as u32).min(self.cells[i] - 1));
        let [x, y, z] = cell.map(|c| c / BRICK);
        let [bx, by, _] = self.cells.map(|c| c / BRICK);
        let brick = self.index[(x + bx * (y + by * z)) as usize];
        if brick == 0 {
            return 0;
        }
        let [x, y, z] = cell.map(|c| c % BRICK);
        let within = (x + BRICK * (y + BRICK * z)) as usize;
        self.codes[(brick as usize - 1) * BRICK_BYTES + within / 2] >> (4 * (within % 2)) & 0xf
    }
}

/// Returns the density of each code for cells of this width.
pub(super) fn densities(width: f32) -> Vec<f32> {
    let depth = |code: usize| THINNEST * ((code - 1) as f32 / intervals() * octaves()).exp2();
    std::iter::once(0.0).chain((1..CODES).map(|code| depth(code) / width)).collect()
}

/// Returns the code of a cell with this optical depth.
pub(super) fn code(depth: f32) -> u8 {
    if !(depth >= THINNEST) {
        return 0;
    }
    (1.0 + intervals() * (depth / THINNEST).log2() / octaves()).round().min(1.0 + intervals()) as u8
}

/// Returns the number of octaves between the optical depths of the first code above 0 and the last code.
fn octaves() -> f32 {
    (THICKEST / THINNEST).log2()
}

/// Returns the number of intervals between these two codes.
fn intervals() -> f32 {
    (CODES - 2) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_near_their_densities() {
        let (width, densities) = (0.25, densities(0.25));
        assert_eq!(densities.len(), CODES);
        assert_eq!((code(0.0), code(-1.0), code(f32::NAN), code(0.9 * THINNEST)), (0, 0, 0, 0));
        assert_eq!((code(THINNEST), code(THICKEST), code(f32::INFINITY)), (1, 15, 15));
        for i in 0..1000 {
            let depth = THINNEST * (THICKEST / THINNEST).powf(i as f32 / 999.0);
            let ratio = densities[usize::from(code(depth))] * width / depth;
            // Rounding changes a depth by at most half an interval, and an interval is 20/14 octaves.
            assert!((0.6..1.65).contains(&ratio), "{depth}: {ratio}");
        }
    }
}
