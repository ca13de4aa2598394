//! The proxy of a trained model: a sparse grid of its densities, fine enough to tell where along a ray the surfaces
//! are. A renderer places its few samples by it (hybrid rendering, Tri-MipRF Section 3.4); colour and density of a
//! picture come from the model. The proxy is an asset: it travels in the model file.

mod bake;
mod choose;
mod guide;
mod pack;

pub use bake::{Baking, bake};
pub use choose::{BEHIND, Chooser, Chosen, Rule, Shaded, share_colors};
pub use guide::Guide;

/// Cells along each side of a brick.
pub const BRICK: u32 = 8;

/// Cells of a brick.
pub const BRICK_CELLS: usize = (BRICK * BRICK * BRICK) as usize;

/// Optical depth of a cell with code 1; below it a cell is empty.
const THINNEST: f32 = 1.0 / 512.0;

/// Optical depth of a cell with code 255, which is the opacity of a wall.
const THICKEST: f32 = 64.0;

/// A sparse grid of densities over the unit cube. A cell holds one byte, 0 for empty; the logarithm of the density grows
/// with it.
#[derive(Clone, Debug, PartialEq)]
pub struct Proxy {
    /// Cells along each axis, multiples of [`BRICK`].
    cells: [u32; 3],
    /// Width of a cell, world units.
    width: f32,
    /// Radius of the spheres whose densities it holds, world units.
    radius: f32,
    /// One per brick, x fastest: 0 if the brick is empty, otherwise 1 + its place in `codes`.
    index: Vec<u32>,
    /// [`BRICK_CELLS`] bytes per brick that is not empty, x fastest.
    codes: Vec<u8>,
    /// Density of each code, per world unit.
    densities: Vec<f32>,
}

impl Proxy {
    /// An empty proxy of cells of about `width`, over a box of these sides.
    fn empty(extent: [f32; 3], width: f32, radius: f32) -> Self {
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

    /// Cells along each axis.
    pub fn cells(&self) -> [u32; 3] {
        self.cells
    }

    /// Width of a cell, world units.
    pub fn width(&self) -> f32 {
        self.width
    }

    /// Radius of the spheres whose densities it holds, world units.
    pub fn radius(&self) -> f32 {
        self.radius
    }

    /// Share of the bricks that are not empty.
    pub fn filled(&self) -> f64 {
        (self.codes.len() / BRICK_CELLS) as f64 / self.index.len() as f64
    }

    /// One per brick, x fastest: 0 if the brick is empty, otherwise 1 + its place in [`codes`](Self::codes).
    pub fn index(&self) -> &[u32] {
        &self.index
    }

    /// Codes of the cells of the bricks that are not empty.
    pub fn codes(&self) -> &[u8] {
        &self.codes
    }

    /// Density of each code, per world unit.
    pub fn densities(&self) -> &[f32] {
        &self.densities
    }

    /// Density at a position in the cube, per world unit.
    #[inline(always)]
    pub fn density(&self, position: [f32; 3]) -> f32 {
        self.densities[usize::from(self.code(position))]
    }

    /// Code of the cell at a position in the cube.
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
        self.codes[(brick as usize - 1) * BRICK_CELLS + (x + BRICK * (y + BRICK * z)) as usize]
    }
}

/// Density of each code for cells of this width.
fn densities(width: f32) -> Vec<f32> {
    let octaves = (THICKEST / THINNEST).log2();
    let depth = |code: u32| THINNEST * ((code - 1) as f32 / 254.0 * octaves).exp2();
    std::iter::once(0.0).chain((1..256).map(|code| depth(code) / width)).collect()
}

/// Code of a cell of this optical depth.
fn code(depth: f32) -> u8 {
    if !(depth >= THINNEST) {
        return 0;
    }
    let octaves = (THICKEST / THINNEST).log2();
    (1.0 + 254.0 * ((depth / THINNEST).log2() / octaves)).round().min(255.0) as u8
}
