//! The proxy as assets of a model file. The bytes of these assets are compressed (DEFLATE, RFC 1951).

use super::grid::{BRICK, BRICK_BYTES, BRICK_CELLS, Proxy, densities};
use crate::{
    Error, Result,
    field::{
        deflate::{deflated, inflated},
        model::{ASSET, Assets},
        tensors::{Tensor, Values},
    },
    math::bits,
};
use flate2::Compression;

/// Number of cells along each axis, width of a cell, radius of the spheres.
const SHAPE: &str = "proxy.shape";

/// One bit per brick, lowest bit first: 1 if the brick has codes. Compressed.
const BRICKS: &str = "proxy.bricks";

/// Codes of the bricks that have codes. Compressed.
const CODES: &str = "proxy.codes";

/// Largest number of cells of a proxy.
const MOST_CELLS: u64 = 1 << 34;

fn name(part: &str) -> String {
    format!("{ASSET}{part}")
}

fn broken(what: impl std::fmt::Display) -> Error {
    Error::input("the model's proxy", what, "compute it again: `trimip-cli bake RUN`")
}

/// Decompresses the tensor `part` to `expected` bytes.
fn part(assets: &Assets, part: &str, expected: usize) -> Result<Vec<u8>> {
    let full = name(part);
    let Some(tensor) = assets.get(&full) else { return Err(broken(format!("has no tensor `{full}`"))) };
    inflated(tensor, expected).map_err(|what| broken(format!("`{full}` {what}")))
}

impl Proxy {
    /// Returns true if a model's assets hold a proxy.
    pub fn is_in(assets: &Assets) -> bool {
        assets.contains_key(&name(SHAPE))
    }

    /// Returns the assets that hold the proxy.
    ///
    /// # Errors
    /// When there is not enough memory for the compressed bytes.
    pub fn to_assets(&self) -> Result<Assets> {
        let [x, y, z] = self.cells.map(|count| count as f32);
        let bits = bits::of(self.index.len(), |brick| self.index[brick] > 0);
        // Bricks with codes are numbered in grid order, so that one bit per brick restores the index.
        Ok([
            (name(SHAPE), Tensor::f32(&[5], vec![x, y, z, self.width, self.radius])),
            (name(BRICKS), deflated(&bits, Compression::default())?),
            (name(CODES), deflated(&self.codes, Compression::default())?),
        ]
        .into())
    }

    /// Reads the proxy from a model's assets; returns `None` if the assets hold no proxy.
    ///
    /// # Errors
    /// When the proxy is broken.
    pub fn from_assets(assets: &Assets) -> Result<Option<Self>> {
        let Some(shape) = assets.get(&name(SHAPE)) else { return Ok(None) };
        let Tensor { values: Values::F32(shape), .. } = shape else {
            return Err(broken(format!("`{}` is not f32", name(SHAPE))));
        };
        let &[x, y, z, width, radius] = &shape[..] else {
            return Err(broken(format!("`{}` has {} values instead of 5", name(SHAPE), shape.len())));
        };
        let cells = [x, y, z].map(|count| count as u32);
        let sides = cells.iter().zip([x, y, z]).all(|(&count, side)| {
            count > 0 && count <= 1 << 14 && count.is_multiple_of(BRICK) && count as f32 == side
        });
        let all: u64 = cells.iter().map(|&count| u64::from(count)).product();
        let positive = |value: f32| value > 0.0 && value.is_finite();
        if !(sides && all <= MOST_CELLS && positive(width) && positive(radius)) {
            return Err(broken(format!(
                "has an impossible shape: {x} x {y} x {z} cells of width {width}, spheres of radius {radius}"
            )));
        }
        let bricks = all as usize / BRICK_CELLS;
        let bits = part(assets, BRICKS, bricks.div_ceil(8))?;
        let mut count = 0;
        let index = (0..bricks)
            .map(|brick| {
                let filled = u32::from(bits::is_set(&bits, brick));
                count += filled;
                filled * count
            })
            .collect();
        let codes = part(assets, CODES, count as usize * BRICK_BYTES)?;
        Ok(Some(Self { cells, width, radius, index, codes, densities: densities(width) }))
    }
}
