//! Opens a closed mesh: removes the walls where a crop cuts a solid, and parts that few cameras see.

use super::{Grid, Mesh, seen::Sightings};
use trimip_core::Crop;

/// Coordinates within this distance of a grid point, in units of the spacing, count as the grid point's. Vertices keep at least a
/// thousandth of an edge from its ends.
const ON_POINT: f64 = 4e-4;

/// Removes the triangles on the border of the crop, and those that too few cameras see: fewer at every corner than the number in
/// `seen`. Returns the number of the latter.
pub(super) fn open(mesh: &mut Mesh, grid: &Grid, crop: Crop, seen: Option<(&Sightings, u32)>) -> usize {
    let flags = |test: &dyn Fn([f64; 3]) -> bool| -> Vec<bool> {
        mesh.positions.iter().map(|position| test(position.map(f64::from))).collect()
    };
    let cut = flags(&|position| crop != Crop::None && is_cut(position, grid, crop));
    let shown =
        flags(&|position| seen.is_none_or(|(sightings, least)| u32::from(sightings.at(position)) >= least));
    let walls = |triangle: &[u32; 3]| triangle.iter().all(|&vertex| cut[vertex as usize]);
    let unseen = |triangle: &[u32; 3]| !triangle.iter().any(|&vertex| shown[vertex as usize]);
    let keep: Vec<bool> = mesh.triangles.iter().map(|t| !walls(t) && !unseen(t)).collect();
    let count = mesh.triangles.iter().filter(|t| !walls(t) && unseen(t)).count();
    mesh.retain(|i| keep[i]);
    count
}

/// True for a vertex on an edge of the grid that the border of the crop crosses.
fn is_cut(position: [f64; 3], grid: &Grid, crop: Crop) -> bool {
    let place: [f64; 3] = std::array::from_fn(|axis| (position[axis] - grid.origin[axis]) / grid.spacing);
    let end = |round: &dyn Fn(f64) -> f64| {
        crop.contains(std::array::from_fn(|axis| grid.origin[axis] + grid.spacing * round(place[axis])))
    };
    end(&|x| (x + ON_POINT).floor()) != end(&|x| (x - ON_POINT).ceil())
}
