//! A triangle mesh: its measures, its defects as a surface, its normals, its texture.

use image::RgbImage;
use std::collections::HashMap;
use trimip_core::scene::origin::LocalOrigin;

/// A triangle mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// One per vertex, world units, relative to `origin`.
    pub positions: Vec<[f32; 3]>,
    /// Origin of these positions in the coordinates of the photographs.
    pub origin: LocalOrigin,
    /// One unit normal per vertex, outward; empty if unknown.
    pub normals: Vec<[f32; 3]>,
    /// One RGB colour per vertex, in the colour values of the photographs; empty if unknown.
    pub colors: Vec<[f32; 3]>,
    /// Vertices of each triangle, counterclockwise as seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// Defects that keep a mesh from being a closed, oriented surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Defects {
    /// Edges that belong to only one triangle.
    pub open: usize,
    /// Edges that belong to more than two triangles.
    pub crowded: usize,
    /// Edges whose two triangles run along them in the same direction.
    pub twisted: usize,
    /// Triangles that name a vertex twice.
    pub collapsed: usize,
}

impl Mesh {
    /// Returns the positions of a triangle's vertices.
    pub fn corners(&self, triangle: [u32; 3]) -> [[f64; 3]; 3] {
        triangle.map(|vertex| self.positions[vertex as usize].map(f64::from))
    }

    /// Returns the enclosed volume; negative if the normals point inward. Meaningful only for a closed mesh.
    pub fn volume(&self) -> f64 {
        self.triangles.iter().map(|&triangle| signed_volume(self.corners(triangle))).sum()
    }

    /// Returns the corners of the smallest box around all vertices; `None` without vertices.
    pub fn bounds(&self) -> Option<[[f32; 3]; 2]> {
        self.positions.iter().fold(None, |bounds, &p| {
            let [low, high] = bounds.unwrap_or([p, p]);
            let each =
                |pick: fn(f32, f32) -> f32, from: [f32; 3]| std::array::from_fn(|i| pick(from[i], p[i]));
            Some([each(f32::min, low), each(f32::max, high)])
        })
    }

    /// Counts the defects that keep the mesh from being a closed, oriented surface.
    pub fn defects(&self) -> Defects {
        // Triangles along each edge, by direction.
        let mut edges: HashMap<[u32; 2], [usize; 2]> = HashMap::with_capacity(2 * self.triangles.len());
        let mut defects = Defects::default();
        for &[a, b, c] in &self.triangles {
            defects.collapsed += usize::from(a == b || b == c || c == a);
            for [from, to] in [[a, b], [b, c], [c, a]] {
                edges.entry([from.min(to), from.max(to)]).or_default()[usize::from(from > to)] += 1;
            }
        }
        for directions in edges.into_values() {
            match directions {
                [1, 1] => {}
                [1, 0] | [0, 1] => defects.open += 1,
                [2, 0] | [0, 2] => defects.twisted += 1,
                _ => defects.crowded += 1,
            }
        }
        defects
    }

    /// Sets each normal to the mean of its triangles' normals, weighted by their areas.
    pub fn find_normals(&mut self) {
        let mut sums = vec![[0.0_f64; 3]; self.positions.len()];
        for &triangle in &self.triangles {
            let normal = area_vector(self.corners(triangle));
            for vertex in triangle {
                let sum = &mut sums[vertex as usize];
                *sum = std::array::from_fn(|i| sum[i] + normal[i]);
            }
        }
        self.normals = sums
            .into_iter()
            .map(|sum| {
                let normal = glam::DVec3::from_array(sum).normalize_or(glam::DVec3::Z);
                normal.as_vec3().to_array()
            })
            .collect();
    }

    /// Keeps the triangles for which `keep` is true, and the vertices that they use.
    pub fn retain(&mut self, keep: impl Fn(usize) -> bool) {
        let mut index = 0;
        self.triangles.retain(|_| {
            index += 1;
            keep(index - 1)
        });
        self.drop_unused();
    }

    /// Drops vertices that no triangle uses; the other vertices keep their order.
    pub fn drop_unused(&mut self) {
        let mut used = vec![false; self.positions.len()];
        self.triangles.iter().flatten().for_each(|&vertex| used[vertex as usize] = true);
        let mut next = 0;
        let places: Vec<u32> = used
            .iter()
            .map(|&used| {
                next += u32::from(used);
                next.wrapping_sub(1)
            })
            .collect();
        for triangle in &mut self.triangles {
            *triangle = triangle.map(|vertex| places[vertex as usize]);
        }
        for list in [&mut self.positions, &mut self.normals, &mut self.colors] {
            let mut vertex = 0;
            list.retain(|_| {
                vertex += 1;
                used[vertex - 1]
            });
        }
    }
}

/// Returns the signed volume of the tetrahedron between a triangle and the origin.
pub(super) fn signed_volume([a, b, c]: [[f64; 3]; 3]) -> f64 {
    let [a, b, c] = [a, b, c].map(glam::DVec3::from_array);
    a.dot(b.cross(c)) / 6.0
}

/// Returns the normal of a triangle, whose length is the triangle's area.
fn area_vector([a, b, c]: [[f64; 3]; 3]) -> [f64; 3] {
    let [a, b, c] = [a, b, c].map(glam::DVec3::from_array);
    (0.5 * (b - a).cross(c - a)).to_array()
}

/// A texture of a mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// One per vertex of the mesh: [u, v] from 0 to 1, from the upper left corner of the image to the lower right one.
    pub coordinates: Vec<[f32; 2]>,
    /// Square image, in the colour values of the photographs (sRGB).
    pub image: RgbImage,
    /// Number of charts.
    pub charts: u32,
    /// Fraction of the texels that show the surface.
    pub used: f64,
    /// Number of photographs to which the texture was fitted.
    pub photographs: usize,
    /// Fraction of the texels with surface that these photographs show.
    pub shown: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::fixtures::cube;

    #[test]
    fn a_cube_is_closed_and_its_defects_are_counted() {
        let mut mesh = cube();
        assert_eq!(mesh.defects(), Defects::default());
        assert!((mesh.volume() - 1.0).abs() < 1e-12);
        assert_eq!(mesh.bounds(), Some([[0.0; 3], [1.0; 3]]));
        mesh.find_normals();
        let diagonal = 3.0_f32.sqrt().recip();
        assert!(mesh.normals[7].iter().all(|n| *n > 0.0) && (mesh.normals[0][0] + diagonal).abs() < 0.3);
        let mut open = mesh.clone();
        open.retain(|i| i != 3);
        assert_eq!(open.defects(), Defects { open: 3, ..Defects::default() });
        let mut twisted = mesh.clone();
        twisted.triangles[0].swap(0, 1);
        assert_eq!(twisted.defects(), Defects { twisted: 3, ..Defects::default() });
        let mut crowded = mesh.clone();
        crowded.triangles.push(mesh.triangles[0]);
        assert_eq!(crowded.defects().crowded, 3);
        let mut half = mesh;
        half.retain(|i| i < 2);
        assert_eq!((half.positions.len(), half.normals.len(), half.triangles.len()), (4, 4, 2));
    }
}
