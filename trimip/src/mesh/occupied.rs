//! The occupied cells of a model, and its density on a grid. World units.

use super::Grid;
use trimip_core::{
    Aabb, Camera, Crop, Error, Query, Result, Space, Viewer,
    field::model::{Model, OCCUPANCY},
    geometry::occupancy::cell_of,
    math::bits,
};

/// Maximum number of points per query of the model; bounds the memory.
pub(super) const PLACES_AT_ONCE: usize = 1 << 17;

/// The occupied cells of a model within a crop.
pub(super) struct Occupied {
    /// The box to extract.
    pub aabb: Aabb<f64>,
    crops: [Crop; 2],
    space: Space<f64>,
    resolution: u32,
    bits: Vec<u8>,
}

/// A part of a model, the grid on which its surface is looked for, and the cameras that see it.
pub(super) struct Region<'a> {
    pub field: &'a Occupied,
    pub grid: &'a Grid,
    /// The training cameras.
    pub cameras: &'a [Camera],
    /// Minimum number of cameras that see a part of the surface.
    pub least: u32,
    /// Number of threads; 0 = one per core.
    pub threads: usize,
}

impl Occupied {
    /// Reads the occupied cells of a model. Without a crop, contracted space ends at the box around its ball.
    ///
    /// # Errors
    /// When the crop does not meet the scene's box, or the model lacks its occupancy grid.
    pub fn new(model: &Model, crop: Crop) -> Result<Self> {
        let resolution = model.config.occupancy.resolution;
        let cells = (resolution as usize).pow(3);
        let bits = model.file.u8("model", OCCUPANCY, &[cells.div_ceil(8)])?.to_vec();
        let scene = &model.config.scene;
        let (space, subject) = (Space::new(scene), scene.subject());
        let aabb = match (crop.bounds(), space.ball()) {
            (None, _) => subject,
            (Some(bounds), Some(_)) => bounds,
            (Some(bounds), None) => common(&bounds, &subject).ok_or_else(|| {
                let what =
                    format!("lies outside the scene's box, {:?} to {:?}", scene.aabb_min, scene.aabb_max);
                Error::input(format!("crop {crop}"), what, "choose a part of this box, or none")
            })?,
        };
        let corners = (0..8)
            .map(|i| [0, 1, 2].map(|axis| if i >> axis & 1 == 0 { aabb.min[axis] } else { aabb.max[axis] }));
        if matches!(crop, Crop::Half { .. }) && !corners.into_iter().any(|corner| crop.contains(corner)) {
            let what =
                format!("nothing of the scene's box, {:?} to {:?}, lies on this side", aabb.min, aabb.max);
            return Err(Error::input(
                format!("crop {crop}"),
                what,
                "move the plane, or turn its direction around",
            ));
        }
        // A contracted scene goes on beyond the box; its surface is closed there.
        let end = if space.ball().is_some() { Crop::from(aabb) } else { Crop::None };
        Ok(Self { aabb, crops: [crop, end], space, resolution, bits })
    }

    /// Returns true if a point of the world is in the part to extract.
    pub fn within(&self, point: [f64; 3]) -> bool {
        self.crops.iter().all(|crop| crop.contains(point))
    }

    /// Returns true if a point of the world is in the crop and in an occupied cell, where rendering places samples.
    pub fn holds(&self, point: [f64; 3]) -> bool {
        let position = self.space.to_cube(point);
        if !self.within(point) || !position.iter().all(|p| (0.0..=1.0).contains(p)) {
            return false;
        }
        let cell = cell_of(position.map(|p| p as f32), self.resolution);
        bits::is_set(&self.bits, cell as usize)
    }

    /// Fills `layer`, the points of index `z` of the grid, x fastest, with densities per world unit; zero outside the
    /// occupied cells.
    ///
    /// # Errors
    /// When the device fails.
    pub fn sample(&self, viewer: &mut dyn Viewer, grid: &Grid, z: usize, layer: &mut [f32]) -> Result<()> {
        layer.fill(0.0);
        let radius = (0.5 * grid.spacing) as f32;
        let point = |i: usize| grid.point([i % grid.points[0], i / grid.points[0], z]);
        let places: Vec<usize> = (0..layer.len()).filter(|&i| self.holds(point(i))).collect();
        for places in places.chunks(PLACES_AT_ONCE) {
            let query = |&i: &usize| Query { point: point(i), radius, direction: [0.0, 0.0, -1.0] };
            let queries: Vec<Query> = places.iter().map(query).collect();
            for (&place, density) in places.iter().zip(viewer.densities(&queries)?) {
                layer[place] = density;
            }
        }
        Ok(())
    }
}

/// Returns the intersection of two boxes; `None` if it is empty.
fn common(a: &Aabb<f64>, b: &Aabb<f64>) -> Option<Aabb<f64>> {
    let part = Aabb {
        min: std::array::from_fn(|axis| a.min[axis].max(b.min[axis])),
        max: std::array::from_fn(|axis| a.max[axis].min(b.max[axis])),
    };
    (0..3).all(|axis| part.min[axis] < part.max[axis]).then_some(part)
}
