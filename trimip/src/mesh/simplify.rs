//! Simplification by quadric error (Garland and Heckbert 1997), with `meshopt-rs`, and repair of the edges that have
//! more than two triangles afterwards.

use super::surface::Mesh;
use glam::DVec3;
use std::collections::HashMap;

/// When simplification ends.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Goal {
    /// The mesh stays as it is.
    Everything,
    /// At most about this many triangles.
    Triangles(usize),
    /// As few triangles as possible without moving the surface by more than about this share of the mesh's largest side.
    Error(f64),
}

/// Simplifies a mesh. Vertices keep their positions; some are dropped. A closed mesh stays closed: where simplification
/// collapses two sheets onto each other, their common vertices are duplicated so that every edge has two triangles.
pub fn simplify(mesh: &mut Mesh, goal: Goal) {
    let (count, error) = match goal {
        Goal::Everything => return,
        // No bound on the error: meshopt's is relative to the mesh.
        Goal::Triangles(count) => (count, 1.0),
        Goal::Error(error) => (0, error as f32),
    };
    if mesh.triangles.len() <= count {
        return;
    }
    let mut kept = vec![0; 3 * mesh.triangles.len()];
    let indices = mesh.triangles.as_flattened();
    let length = meshopt_rs::simplify::simplify(&mut kept, indices, &mesh.positions, 3 * count, error);
    kept.truncate(length);
    mesh.triangles = kept.as_chunks().0.to_vec();
    separate(mesh);
    mesh.drop_unused();
}

/// Returns a mesh of at most about `triangles` triangles without colours, for collisions. A closed mesh stays closed.
pub fn for_collisions(mesh: &Mesh, triangles: usize) -> Mesh {
    let mut coarse = Mesh { colors: Vec::new(), ..mesh.clone() };
    simplify(&mut coarse, Goal::Triangles(triangles));
    // Normals of the fine surface do not fit the coarse triangles.
    coarse.find_normals();
    coarse
}

/// A side of a triangle: the triangle, and the corner at which the side starts.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Side {
    triangle: usize,
    corner: usize,
}

/// Makes the mesh manifold: every edge belongs to two triangles and every vertex to one fan. If an edge has more
/// triangles, pairs them so that each pair encloses solid space.
fn separate(mesh: &mut Mesh) {
    cancel(mesh);
    part_fans(mesh);
    while divide_edges(mesh) {}
    part_fans(mesh);
}

/// Removes pairs of triangles with the same vertices in opposite order: nothing lies between the two.
fn cancel(mesh: &mut Mesh) {
    // Rotated so that the least corner is first; the triangle [a, b, c] in the opposite order is then [a, c, b].
    let turned = |triangle: [u32; 3]| {
        let first = (0..3).min_by_key(|&corner| triangle[corner]).expect("three corners");
        std::array::from_fn(|i| triangle[(first + i) % 3])
    };
    let mut surplus: HashMap<[u32; 3], i64> = HashMap::new();
    for &triangle in &mesh.triangles {
        let [a, b, c] = turned(triangle);
        *surplus.entry([a, b.min(c), b.max(c)]).or_default() += if b < c { 1 } else { -1 };
    }
    mesh.triangles.retain(|&triangle| {
        let [a, b, c] = turned(triangle);
        let left = surplus.get_mut(&[a, b.min(c), b.max(c)]).expect("counted");
        let direction = if b < c { 1 } else { -1 };
        let kept = *left * direction > 0;
        *left -= if kept { direction } else { 0 };
        kept
    });
}

/// Returns the sides along each edge, sorted by edge.
fn sides(mesh: &Mesh) -> Vec<([u32; 2], Vec<Side>)> {
    let mut edges: HashMap<[u32; 2], Vec<Side>> = HashMap::with_capacity(2 * mesh.triangles.len());
    for (triangle, vertices) in mesh.triangles.iter().enumerate() {
        for corner in 0..3 {
            let (a, b) = (vertices[corner], vertices[(corner + 1) % 3]);
            edges.entry([a.min(b), a.max(b)]).or_default().push(Side { triangle, corner });
        }
    }
    let mut edges: Vec<_> = edges.into_iter().collect();
    edges.sort_unstable_by_key(|(edge, _)| *edge);
    edges
}

/// Adds the midpoint of two vertices, or a copy of the vertex if both are the same; returns the index of the new vertex.
fn middle(mesh: &mut Mesh, [a, b]: [u32; 2]) -> u32 {
    let [a, b] = [a as usize, b as usize];
    let mean = |list: &[[f32; 3]]| std::array::from_fn(|i| 0.5 * (list[a][i] + list[b][i]));
    mesh.positions.push(mean(&mesh.positions));
    if !mesh.normals.is_empty() {
        let normal = glam::Vec3::from_array(mean(&mesh.normals)).normalize_or(glam::Vec3::Z);
        mesh.normals.push(normal.to_array());
    }
    if !mesh.colors.is_empty() {
        mesh.colors.push(mean(&mesh.colors));
    }
    mesh.positions.len() as u32 - 1
}

/// Gives each fan of triangles around a vertex its own copy of the vertex.
fn part_fans(mesh: &mut Mesh) {
    // The corners of all triangles, joined where they share a vertex across an edge.
    let mut joined: Vec<usize> = (0..3 * mesh.triangles.len()).collect();
    for (edge, sides) in sides(mesh) {
        for [one, other] in pairs(mesh, edge, &sides) {
            let at = |side: Side, step: usize| 3 * side.triangle + (side.corner + step) % 3;
            // The other triangle runs along the edge in the opposite direction.
            for (a, b) in [(at(one, 0), at(other, 1)), (at(one, 1), at(other, 0))] {
                let (a, b) = (root(&mut joined, a), root(&mut joined, b));
                joined[a.max(b)] = a.min(b);
            }
        }
    }
    // The first fan of a vertex keeps it, the others get copies.
    let mut owner: Vec<Option<usize>> = vec![None; mesh.positions.len()];
    let mut copies: HashMap<usize, u32> = HashMap::new();
    for triangle in 0..mesh.triangles.len() {
        for corner in 0..3 {
            let fan = root(&mut joined, 3 * triangle + corner);
            let vertex = mesh.triangles[triangle][corner];
            if *owner[vertex as usize].get_or_insert(fan) != fan {
                let copy = *copies.entry(fan).or_insert_with(|| middle(mesh, [vertex; 2]));
                mesh.triangles[triangle][corner] = copy;
            }
        }
    }
}

/// Divides edges of more than two triangles: each pair of triangles gets a vertex of its own in the middle. Divides a triangle at
/// most once per call; returns true if it divided any.
fn divide_edges(mesh: &mut Mesh) -> bool {
    let mut divided = vec![false; mesh.triangles.len()];
    let mut any = false;
    for (edge, sides) in sides(mesh) {
        let found = pairs(mesh, edge, &sides);
        if sides.len() < 3 || found.is_empty() || sides.iter().any(|side| divided[side.triangle]) {
            continue;
        }
        any = true;
        for pair in found {
            let centre = middle(mesh, edge);
            for Side { triangle, corner } in pair {
                divided[triangle] = true;
                let mut second = mesh.triangles[triangle];
                second[corner] = centre;
                mesh.triangles[triangle][(corner + 1) % 3] = centre;
                mesh.triangles.push(second);
            }
        }
    }
    any
}

/// Returns the triangles on an edge in pairs that run along it in opposite directions.
fn pairs(mesh: &Mesh, [a, b]: [u32; 2], sides: &[Side]) -> Vec<[Side; 2]> {
    let forward = |side: &Side| mesh.triangles[side.triangle][side.corner] == a;
    let (ahead, mut back): (Vec<Side>, Vec<Side>) = sides.iter().partition(|side| forward(side));
    if let ([one], [other]) = (&ahead[..], &back[..]) {
        return vec![[*one, *other]];
    }
    let place = |vertex: u32| DVec3::from_array(mesh.positions[vertex as usize].map(f64::from));
    let axis = (place(b) - place(a)).normalize_or(DVec3::X);
    let across = axis.any_orthonormal_vector();
    // The angle of a triangle around the edge.
    let angle = |side: &Side| {
        let third = place(mesh.triangles[side.triangle][(side.corner + 2) % 3]) - place(a);
        third.dot(axis.cross(across)).atan2(third.dot(across))
    };
    // A triangle that runs along the axis has the outside at greater angles and the solid at smaller ones. Towards
    // smaller angles, the solid ends at the next triangle that runs in the opposite direction.
    let turn = |from: f64, to: f64| (to - from).rem_euclid(std::f64::consts::TAU);
    let mut found = Vec::new();
    for one in ahead {
        let nearest = (0..back.len()).min_by(|&i, &j| {
            turn(angle(&back[i]), angle(&one)).total_cmp(&turn(angle(&back[j]), angle(&one)))
        });
        if let Some(nearest) = nearest {
            found.push([one, back.swap_remove(nearest)]);
        }
    }
    found
}

/// Returns the representative of a corner's fan (union-find), and halves the path to it.
fn root(joined: &mut [usize], mut corner: usize) -> usize {
    while joined[corner] != corner {
        joined[corner] = joined[joined[corner]];
        corner = joined[corner];
    }
    corner
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{Defects, Grid, fixtures::cube, march};
    use proptest::prelude::*;

    /// Returns two cubes that touch along an edge and share the vertices on it.
    fn touching() -> Mesh {
        let mut mesh = cube();
        let second = cube();
        // The second cube is moved by (1, 1, 0): its edge from 0 to 4 lies on the first cube's edge from 3 to 7.
        mesh.positions.extend(second.positions.iter().map(|[x, y, z]| [x + 1.0, y + 1.0, *z]));
        let renamed = |vertex: u32| match vertex {
            0 => 3,
            4 => 7,
            other => other + 8,
        };
        mesh.triangles.extend(second.triangles.iter().map(|triangle| triangle.map(renamed)));
        mesh.drop_unused();
        mesh
    }

    #[test]
    fn solids_that_touch_along_an_edge_are_separated() {
        let mut mesh = touching();
        assert_eq!(mesh.defects(), Defects { crowded: 1, ..Defects::default() });
        separate(&mut mesh);
        assert_eq!(mesh.defects(), Defects::default());
        assert_eq!(mesh.positions.len(), 16, "each cube has its own eight corners");
        assert!((mesh.volume() - 2.0).abs() < 1e-12);
        // Each of the two parts is a whole cube.
        let removed = crate::mesh::clean(&mut mesh, 1.0);
        assert_eq!((removed, mesh.triangles.len()), (Default::default(), 24));
    }

    #[test]
    fn four_triangles_on_an_edge_become_two_pairs() {
        let mut mesh = touching();
        while divide_edges(&mut mesh) {}
        part_fans(&mut mesh);
        assert_eq!(mesh.defects(), Defects::default());
        assert!((mesh.volume() - 2.0).abs() < 1e-6);
    }

    #[test]
    fn triangles_back_to_back_vanish() {
        let mut mesh = cube();
        // A flap on the edge from 0 to 1, with a triangle for each of its sides.
        mesh.positions.push([0.5, -1.0, 0.0]);
        mesh.triangles.extend([[0, 8, 1], [8, 0, 1]]);
        separate(&mut mesh);
        mesh.drop_unused();
        assert_eq!(mesh, cube());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]

        /// Checks simplified noise, which has many sheets that collapse onto each other.
        #[test]
        fn simplified_noise_is_closed_and_manifold(
            values in prop::collection::vec(0.0_f32..2.0, 10 * 10 * 10),
            fraction in 0.05_f64..0.9,
        ) {
            let grid = Grid { origin: [0.0; 3], spacing: 1.0, points: [12; 3] };
            let mut mesh = march(&grid, 1.0, |z, layer| {
                layer.fill(0.0);
                for (i, value) in layer.iter_mut().enumerate() {
                    let [x, y] = [i % 12, i / 12];
                    if [x, y, z].iter().all(|c| (1..11).contains(c)) {
                        *value = values[x - 1 + 10 * (y - 1 + 10 * (z - 1))];
                    }
                }
                Ok(())
            }).unwrap();
            mesh.find_normals();
            let before = mesh.triangles.len();
            simplify(&mut mesh, Goal::Triangles((fraction * before as f64) as usize));
            prop_assert_eq!(mesh.defects(), Defects::default());
            prop_assert!(mesh.triangles.len() < before && mesh.normals.len() == mesh.positions.len());
        }
    }

    #[test]
    fn a_sound_mesh_is_not_touched() {
        let mut mesh = cube();
        separate(&mut mesh);
        assert_eq!(mesh, cube());
    }
}
