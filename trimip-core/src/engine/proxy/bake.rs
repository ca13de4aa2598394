//! Computes the proxy of a model from the model itself, cell by cell.

use super::grid::{BRICK, BRICK_BYTES, BRICK_CELLS, Proxy, code};
use crate::{
    Aabb, Config, Error, Query, Result, Space, Viewer,
    config::Contraction,
    field::model::{Model, OCCUPANCY},
    geometry::occupancy::cell_of,
    math::bits,
};

/// Number of bricks whose densities are computed at once; it bounds the memory use.
const BRICKS_AT_ONCE: usize = 256;

/// Radius of the spheres, in marching steps, for a model without a set cone width. The scene plan makes a step 1.4
/// pixels long, so the radius is half a pixel.
const RADIUS_PER_STEP: f32 = 0.36;

/// Resolution of a proxy, and the radius of its spheres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Baking {
    /// Number of cells along the longest side of the box.
    pub resolution: u32,
    /// Radius of the spheres, in world units.
    pub radius: f32,
}

impl Baking {
    /// Returns the resolution for a configuration. The spheres are as wide as the cones into which pixels are divided.
    pub fn of(config: &Config) -> Self {
        let width = config.renderer.cone_width;
        let radius = if width > 0.0 { 0.5 * width } else { RADIUS_PER_STEP * config.step_length() };
        Self { resolution: config.hybrid.resolution, radius }
    }
}

/// Computes the proxy of a model: for each occupied cell, the density of a sphere at the cell's centre. `watch`
/// receives the fraction that is done and returns false to stop; the result is then `None`.
///
/// # Errors
/// When space is contracted, and when the device fails.
pub fn bake(
    viewer: &mut dyn Viewer,
    model: &Model,
    how: &Baking,
    watch: &mut dyn FnMut(f64) -> bool,
) -> Result<Option<Proxy>> {
    if model.config.scene.contraction != Contraction::None {
        return Err(Error::input(
            "scene.contraction",
            "space is contracted, and a proxy covers a box",
            "render it without a proxy, or train with scene.contraction = \"none\"",
        ));
    }
    let resolution = model.config.occupancy.resolution;
    let bits = model.file.u8("model", OCCUPANCY, &[(resolution as usize).pow(3).div_ceil(8)])?;
    let aabb = Aabb::<f64>::new(&model.config.scene);
    let space = Space::of(aabb);
    let width = aabb.longest() / f64::from(how.resolution);
    let mut proxy = Proxy::empty(aabb.extent().map(|side| side as f32), width as f32, how.radius);
    let cells = proxy.cells;
    let bricks = cells.map(|count| count / BRICK);
    let occupied = |position: [f64; 3]| {
        let cell = cell_of(position.map(|p| p as f32), resolution);
        bits::is_set(bits, cell as usize)
    };
    let centre = |brick: usize, cell: usize| -> [f64; 3] {
        let (brick, cell) = (brick as u32, cell as u32);
        let corner = [brick % bricks[0], brick / bricks[0] % bricks[1], brick / bricks[0] / bricks[1]];
        let within = [cell % BRICK, cell / BRICK % BRICK, cell / BRICK / BRICK];
        std::array::from_fn(|i| (f64::from(corner[i] * BRICK + within[i]) + 0.5) / f64::from(cells[i]))
    };
    let total = proxy.index.len();
    for first in (0..total).step_by(BRICKS_AT_ONCE) {
        if !watch(first as f64 / total as f64) {
            return Ok(None);
        }
        let last = (first + BRICKS_AT_ONCE).min(total);
        let places: Vec<(usize, usize)> = (first..last)
            .flat_map(|brick| (0..BRICK_CELLS).map(move |cell| (brick, cell)))
            .filter(|&(brick, cell)| occupied(centre(brick, cell)))
            .collect();
        if places.is_empty() {
            continue;
        }
        let query = |&(brick, cell): &(usize, usize)| Query {
            point: space.to_world(centre(brick, cell)),
            radius: how.radius,
            direction: [0.0, 0.0, -1.0],
        };
        let queries: Vec<Query> = places.iter().map(query).collect();
        let densities = viewer.densities(&queries)?;
        for (&(brick, cell), density) in places.iter().zip(densities) {
            let code = code(density * proxy.width);
            if code == 0 {
                continue;
            }
            if proxy.index[brick] == 0 {
                proxy.codes.resize(proxy.codes.len() + BRICK_BYTES, 0);
                proxy.index[brick] = (proxy.codes.len() / BRICK_BYTES) as u32;
            }
            let at = (proxy.index[brick] as usize - 1) * BRICK_BYTES + cell / 2;
            proxy.codes[at] |= code << (4 * (cell % 2));
        }
    }
    Ok(Some(proxy))
}
