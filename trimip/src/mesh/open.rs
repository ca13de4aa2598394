//! Opens a closed mesh: removes the walls where a crop cuts a solid, and parts that few cameras see.

use super::{Grid, Mesh, seen::Sightings};
use trimip_core::Crop;

/// Coordinates closer than this to a grid point, in units of the spacing, count as on the point. Vertices between two points are at least a
/// thousandth of the edge away from both.
const ON_POINT: f64 = 4e-4;

/// Removes the triangles on the border of the crop and those that too few cameras see: at every corner fewer than the number in `seen`.
/// Returns the number of triangles with too few cameras.
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

/// Keeps the triangles of a mesh whose vertices lie between points of the grid for which `shown` is true.
pub(super) fn retain_between(mesh: &mut Mesh, grid: &Grid, shown: impl Fn([usize; 3]) -> bool) {
    let between: Vec<bool> =
        mesh.positions.iter().map(|p| ends(p.map(f64::from), grid).into_iter().all(&shown)).collect();
    let keep: Vec<bool> =
        mesh.triangles.iter().map(|t| t.iter().all(|&vertex| between[vertex as usize])).collect();
    mesh.retain(|i| keep[i]);
}

/// Returns true for a vertex on an edge of the grid that the border of the crop crosses.
fn is_cut(position: [f64; 3], grid: &Grid, crop: Crop) -> bool {
    let [from, to] = ends(position, grid).map(|point| crop.contains(grid.point(point)));
    from != to
}

/// Returns the two points of the grid between which a vertex lies.
fn ends(position: [f64; 3], grid: &Grid) -> [[usize; 3]; 2] {
    let place: [f64; 3] = std::array::from_fn(|axis| (position[axis] - grid.origin[axis]) / grid.spacing);
    [
        std::array::from_fn(|axis| (place[axis] + ON_POINT).floor() as usize),
        std::array::from_fn(|axis| ((place[axis] - ON_POINT).ceil() as usize).min(grid.points[axis] - 1)),
    ]
}
