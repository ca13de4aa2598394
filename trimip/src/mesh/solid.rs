//! The surface on which the density crosses a level, with its hidden voids filled.

use super::{
    Mesh, Removed,
    clean::{clean, remove_specks},
    hidden::{Bits, directions, visible},
    march,
    occupied::Region,
    open::open,
    seen::Sightings,
};
use trimip_core::{Crop, Result, Viewer};

/// Density that fills hidden voids, relative to that of the surface.
const FILLED: f32 = 2.0;

/// The parts of a surface that are kept.
pub(super) struct Part {
    /// Region to keep. The surface is open where the border of the crop cuts it.
    pub crop: Crop,
    /// Minimum bounding-box diagonal of a connected part, world units.
    pub speck: f64,
}

/// A cleaned surface before it is smoothed and simplified.
pub(super) struct Solid {
    pub mesh: Mesh,
    /// Parts that were left out.
    pub removed: Removed,
    /// Triangles that were left out because too few cameras see them.
    pub unseen: usize,
    /// True if the surface has no border.
    pub closed: bool,
}

/// Returns the surface of density `level`. `watch` receives the share of the work done and returns false to stop; the result is then
/// `None`.
///
/// # Errors
/// When the device fails.
pub(super) fn surface(
    viewer: &mut dyn Viewer,
    region: &Region<'_>,
    level: f32,
    part: &Part,
    watch: &mut dyn FnMut(f64) -> bool,
) -> Result<Option<Solid>> {
    let &Region { field, grid, cameras, least, threads } = region;
    let layers = grid.points[2];
    // The grid is sampled twice, because densities are not kept: first for the bits of the solid, then for the surface.
    let mut solid = Bits::new(grid.points);
    let mut layer = vec![0.0; grid.layer()];
    for z in 0..layers {
        if !watch(0.5 * z as f64 / layers as f64) {
            return Ok(None);
        }
        field.sample(viewer, grid, z, &mut layer)?;
        let first = z * layer.len();
        (0..layer.len()).filter(|&i| layer[i] >= level).for_each(|i| solid.set(first + i));
    }
    let sightings = (least > 0).then(|| Sightings::of(&solid, grid, cameras, threads));
    let seen = visible(&solid, &directions(cameras), threads);
    let mut stopped = false;
    let surface = march(grid, level, |z, layer| {
        if stopped || !watch(0.5 + 0.5 * z as f64 / layers as f64) {
            stopped = true;
            layer.fill(0.0);
            return Ok(());
        }
        field.sample(viewer, grid, z, layer)?;
        let first = z * layer.len();
        for (i, value) in layer.iter_mut().enumerate() {
            if *value < level && !seen.get(first + i) {
                // Outside the occupied cells nothing is rendered, so there is no void to fill.
                if field.holds(grid.point([i % grid.points[0], i / grid.points[0], z])) {
                    *value = level * FILLED;
                }
            }
        }
        Ok(())
    });
    let mut mesh = surface?;
    if stopped {
        return Ok(None);
    }
    let mut removed = clean(&mut mesh, part.speck);
    let closed = part.crop == Crop::None && sightings.is_none();
    let mut unseen = 0;
    if !closed {
        let seen = sightings.as_ref().map(|sightings| (sightings, least));
        unseen = open(&mut mesh, grid, part.crop, seen);
        removed.specks += remove_specks(&mut mesh, part.speck);
    }
    Ok(Some(Solid { mesh, removed, unseen, closed }))
}
