//! Marching cubes (Lorensen and Cline 1987) over a grid that is sampled layer by layer. The triangles of each case follow from one rule for
//! the faces of a cell. Both cells at a face derive the same lines from this rule, so every surface is closed and manifold.

use super::surface::Mesh;
use std::sync::LazyLock;
use trimip_core::Result;

/// A grid of points with equal spacing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// The point with the least coordinates.
    pub origin: [f64; 3],
    /// Distance between neighbouring points.
    pub spacing: f64,
    /// Number of points along x, y and z, at least 2.
    pub points: [usize; 3],
}

impl Grid {
    /// Returns the number of points of a layer of equal z.
    pub fn layer(&self) -> usize {
        self.points[0] * self.points[1]
    }

    /// Returns the point with these indices.
    pub fn point(&self, index: [usize; 3]) -> [f64; 3] {
        std::array::from_fn(|axis| self.origin[axis] + self.spacing * index[axis] as f64)
    }
}

/// No vertex on this edge yet.
const NONE: u32 = u32::MAX;

/// Smallest distance of a vertex from the ends of its edge, as a share of the edge. It keeps triangles from collapsing.
const MARGIN: f64 = 1e-3;

/// Minimum density for the placement of vertices, as a share of the level; smaller densities are raised to it.
const FLOOR: f64 = 1e-4;

/// Extracts the surface on which a positive field has the value `level`; the field is at least `level` inside. `sample` fills a layer of
/// points, x fastest; it is called once per layer, in order of z. Two layers are in memory at a time. Between two points the logarithm of
/// the field is interpolated linearly. Where points on the border of the grid are inside, the surface is open.
///
/// # Errors
/// The errors of `sample`.
pub fn march(
    grid: &Grid,
    level: f32,
    mut sample: impl FnMut(usize, &mut [f32]) -> Result<()>,
) -> Result<Mesh> {
    let [nx, ny, nz] = grid.points;
    let mut mesh = Mesh::default();
    let mut layers = [vec![0.0_f32; grid.layer()], vec![0.0_f32; grid.layer()]];
    // The vertices on edges along x and y of both layers, and on edges along z between them.
    let mut flat = [
        [vec![NONE; grid.layer()], vec![NONE; grid.layer()]],
        [vec![NONE; grid.layer()], vec![NONE; grid.layer()]],
    ];
    let mut upright = vec![NONE; grid.layer()];
    sample(0, &mut layers[0])?;
    for z in 0..nz - 1 {
        sample(z + 1, &mut layers[1])?;
        for y in 0..ny - 1 {
            for x in 0..nx - 1 {
                let at = x + nx * y;
                let corner = |c: usize| layers[c >> 2][at + (c & 1) + nx * (c >> 1 & 1)];
                let case = (0..8).filter(|&c| corner(c) >= level).fold(0_usize, |case, c| case | 1 << c);
                for triangle in &TABLE[case] {
                    let vertices = triangle.map(|edge| {
                        let [from, to] = EDGES[usize::from(edge)].map(usize::from);
                        let axis = (from ^ to).trailing_zeros() as usize;
                        let place = at + (from & 1) + nx * (from >> 1 & 1);
                        let slot = match axis {
                            2 => &mut upright[place],
                            _ => &mut flat[from >> 2][axis][place],
                        };
                        if *slot == NONE {
                            *slot = mesh.positions.len() as u32;
                            let mut point =
                                grid.point([x + (from & 1), y + (from >> 1 & 1), z + (from >> 2)]);
                            point[axis] += grid.spacing * crossing(corner(from), corner(to), level);
                            mesh.positions.push(point.map(|p| p as f32));
                        }
                        *slot
                    });
                    mesh.triangles.push(vertices);
                }
            }
        }
        layers.swap(0, 1);
        flat.swap(0, 1);
        flat[1].iter_mut().for_each(|edges| edges.fill(NONE));
        upright.fill(NONE);
    }
    Ok(mesh)
}

/// Returns the position at which the field has the value `level` on an edge between points of the values `from` and `to`, in (0, 1).
fn crossing(from: f32, to: f32, level: f32) -> f64 {
    let log = |value: f32| f64::from(value / level).max(FLOOR).ln();
    let (from, to) = (log(from), log(to));
    (from / (from - to)).clamp(MARGIN, 1.0 - MARGIN)
}

/// Corners of each edge of a cell. Corner c has the coordinates (c & 1, c >> 1 & 1, c >> 2); the second corner of an edge has one
/// more bit set.
const EDGES: [[u8; 2]; 12] =
    [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];

/// Corners of each face, counterclockwise as seen from outside of the cell.
const FACES: [[u8; 4]; 6] =
    [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];

/// The triangles of each case, as indices of edges. Bit c of a case is set if corner c is inside.
static TABLE: LazyLock<Vec<Vec<[u8; 3]>>> = LazyLock::new(|| (0..=255).map(triangles).collect());

/// Returns the edge between two corners.
fn edge(a: u8, b: u8) -> u8 {
    EDGES.iter().position(|&ends| ends == [a.min(b), a.max(b)]).unwrap_or(0) as u8
}

/// Returns true if both edges bound the same face.
fn share_a_face(a: u8, b: u8) -> bool {
    let on = |face: &[u8; 4], edge: u8| EDGES[usize::from(edge)].iter().all(|corner| face.contains(corner));
    FACES.iter().any(|face| on(face, a) && on(face, b))
}

/// Returns the triangles of a case. On every face, one line cuts off each run of inside corners: from the edge on which the border of the
/// face enters the run to the edge on which the border leaves it. The neighbouring cell sees the run from the other side, so both cells
/// draw the same line in opposite directions. The lines form closed loops.
fn triangles(case: u8) -> Vec<[u8; 3]> {
    let inside = |corner: u8| case >> corner & 1 == 1;
    let mut next = [None; 12];
    for face in FACES {
        for i in 0..4 {
            if !inside(face[i]) && inside(face[(i + 1) % 4]) {
                let enter = edge(face[i], face[(i + 1) % 4]);
                let leave =
                    (1..4).find(|k| inside(face[(i + k) % 4]) && !inside(face[(i + k + 1) % 4])).unwrap_or(1);
                next[usize::from(enter)] = Some(edge(face[(i + leave) % 4], face[(i + leave + 1) % 4]));
            }
        }
    }
    let mut triangles = Vec::new();
    for first in 0..12 {
        let mut ring = Vec::new();
        let mut at = first;
        while let Some(to) = next[usize::from(at)].take() {
            ring.push(at);
            at = to;
        }
        if ring.len() > 2 {
            fill(&ring, &mut triangles);
        }
    }
    triangles
}

/// Triangulates a loop. Diagonals within a face are avoided, because one could coincide with a line of the neighbouring cell.
fn fill(ring: &[u8], triangles: &mut Vec<[u8; 3]>) {
    let n = ring.len();
    // Minimum number of diagonals within faces between vertices i and j, and the third vertex of the triangle on (i, j).
    let mut best = vec![vec![(0_usize, 0_usize); n]; n];
    for width in 2..n {
        for i in 0..n - width {
            let j = i + width;
            let own = usize::from(width < n - 1 && share_a_face(ring[i], ring[j]));
            let (cost, third) =
                (i + 1..j).map(|k| (best[i][k].0 + best[k][j].0, k)).min().unwrap_or_default();
            best[i][j] = (own + cost, third);
        }
    }
    let mut open = vec![(0, n - 1)];
    while let Some((i, j)) = open.pop() {
        if j - i > 1 {
            let k = best[i][j].1;
            triangles.push([ring[i], ring[k], ring[j]]);
            open.extend([(i, k), (k, j)]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns a grid of `n` points along each side of the cube [-1, 1]³.
    fn cube(n: usize) -> Grid {
        Grid { origin: [-1.0; 3], spacing: 2.0 / (n - 1) as f64, points: [n; 3] }
    }

    fn surface(grid: &Grid, level: f32, field: impl Fn([f64; 3]) -> f64) -> Mesh {
        let [nx, ny, _] = grid.points;
        march(grid, level, |z, layer| {
            for (i, value) in layer.iter_mut().enumerate() {
                *value = field(grid.point([i % nx, i / nx % ny, z])) as f32;
            }
            Ok(())
        })
        .unwrap()
    }

    #[test]
    fn no_case_has_a_diagonal_within_a_face_or_an_open_loop() {
        for case in 0..=255_u8 {
            let triangles = triangles(case);
            let mut edges = std::collections::BTreeMap::new();
            for [a, b, c] in &triangles {
                for (from, to) in [(a, b), (b, c), (c, a)] {
                    *edges.entry((*from, *to)).or_insert(0) += 1;
                }
            }
            for (&(from, to), &count) in &edges {
                assert_eq!(count, 1, "case {case}");
                let back = edges.contains_key(&(to, from));
                // In this cell, a line on a face belongs to one triangle, a diagonal to two.
                assert_eq!(back, !share_a_face(from, to), "case {case}: {from} to {to}");
            }
            let crossed = EDGES.iter().filter(|[a, b]| (case >> a ^ case >> b) & 1 == 1).count();
            let used: std::collections::BTreeSet<_> = triangles.iter().flatten().collect();
            assert_eq!(used.len(), crossed, "case {case}");
        }
    }

    /// The logarithm of this field is linear in the distance from a sphere, so the vertices lie on the sphere up to the error from the
    /// curvature within a cell, h²/8r.
    #[test]
    fn a_sphere_has_its_radius_its_volume_and_normals_outward() {
        let (radius, sharpness) = (0.7_f64, 40.0);
        for n in [24, 48] {
            let grid = cube(n);
            let field = |p: [f64; 3]| {
                let length = p.iter().map(|x| x * x).sum::<f64>().sqrt();
                (sharpness * (radius - length)).exp()
            };
            let mesh = surface(&grid, 1.0, field);
            assert_eq!(mesh.defects(), Default::default());
            let most = grid.spacing * grid.spacing / (8.0 * radius) + 1e-6;
            for position in &mesh.positions {
                let length = position.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt();
                assert!((length - radius).abs() < most, "{length} at {n}");
            }
            let truth = 4.0 / 3.0 * std::f64::consts::PI * radius.powi(3);
            let (volume, bound) = (mesh.volume(), 3.0 * grid.spacing.powi(2) / radius.powi(2));
            assert!(volume < truth && volume > truth * (1.0 - bound), "{volume} of {truth} at {n}");
        }
    }

    #[test]
    fn a_torus_has_the_euler_characteristic_zero_and_its_volume() {
        let (ring, tube) = (0.6_f64, 0.25);
        let field = |[x, y, z]: [f64; 3]| {
            let across = (x * x + y * y).sqrt() - ring;
            (30.0 * (tube - (across * across + z * z).sqrt())).exp()
        };
        let mesh = surface(&cube(64), 1.0, field);
        assert_eq!(mesh.defects(), Default::default());
        assert_eq!(mesh.positions.len() as i64 - mesh.triangles.len() as i64 / 2, 0);
        let truth = 2.0 * std::f64::consts::PI.powi(2) * ring * tube * tube;
        assert!((mesh.volume() / truth - 1.0).abs() < 0.01, "{}", mesh.volume() / truth);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// Checks noise, which produces every case and every ambiguous face. With an empty border its surface is closed.
        #[test]
        fn noise_has_a_closed_manifold_surface(values in prop::collection::vec(0.0_f32..2.0, 6 * 5 * 7)) {
            let grid = Grid { origin: [0.0; 3], spacing: 1.0, points: [8, 7, 9] };
            let mesh = march(&grid, 1.0, |z, layer| {
                layer.fill(0.0);
                if (1..8).contains(&z) {
                    for (y, row) in values[(z - 1) * 30..][..30].chunks_exact(6).enumerate() {
                        layer[1 + 8 * (y + 1)..][..6].copy_from_slice(row);
                    }
                }
                Ok(())
            }).unwrap();
            prop_assert_eq!(mesh.defects(), Default::default());
            prop_assert!(mesh.volume() > 0.0);
        }
    }
}
