//! Samples of pictures of a mesh: the triangle that each shows, and the texels there.

use super::silhouettes::{Drawn, rasterise_triangles};
use super::surface::Mesh;
use crate::view::cameras::resized;
use glam::DVec3;
use std::collections::HashSet;
use trimip_core::{Camera, Result};

/// Maximum number of cameras that are asked which triangles they see, evenly spread over all cameras.
const MOST_CAMERAS: usize = 128;

/// Longest side of the pictures in which these triangles are looked for, pixels.
const LONGEST: f64 = 1600.0;

/// No triangle.
const NONE: u32 = u32::MAX;

/// The triangles that the samples of a picture show.
pub(super) struct Samples {
    /// Position of the camera.
    eye: DVec3,
    /// Number of samples along each side of a pixel.
    pub per_side: usize,
    /// Width of the picture, in pixels.
    pub width: usize,
    /// The nearest point of the mesh, row by row; at infinity where there is none.
    nearest: Vec<Drawn>,
}

/// A point of a mesh that a sample shows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// Index of the triangle.
    pub triangle: usize,
    /// Weights of the triangle's corners.
    pub weights: [f32; 3],
    /// Cosine of the angle between the ray and the triangle's normal, without sign.
    pub cosine: f32,
}

impl Samples {
    /// Draws a mesh with `per_side` samples along each side of a pixel.
    ///
    /// # Errors
    /// When the picture is larger than pictures may be.
    pub fn of(mesh: &Mesh, camera: &Camera, per_side: u32) -> Result<Self> {
        let fine = Camera { intrinsics: resized(camera.intrinsics, per_side.into())?, ..*camera };
        let none = Drawn { depth: f32::INFINITY, triangle: NONE, weights: [0.0; 3] };
        let mut nearest = vec![none; fine.intrinsics.width as usize * fine.intrinsics.height as usize];
        rasterise_triangles(mesh, &fine, |pixel, drawn| {
            if drawn.depth < nearest[pixel].depth {
                nearest[pixel] = drawn;
            }
        });
        let (per_side, width) = (per_side as usize, camera.intrinsics.width as usize);
        Ok(Self { eye: camera.origin, per_side, width, nearest })
    }

    /// Returns the distances along the optical axis that the samples of a pixel have; infinite where they show no triangle.
    pub fn depths(&self, pixel: usize) -> impl Iterator<Item = f32> + '_ {
        self.of_pixel(pixel).map(|sample| self.nearest[sample].depth)
    }

    /// Returns what the samples of a pixel show; `None` where there is no triangle.
    pub fn hits<'a>(&'a self, mesh: &'a Mesh, pixel: usize) -> impl Iterator<Item = Option<Hit>> + 'a {
        self.of_pixel(pixel).map(|sample| self.hit(mesh, sample))
    }

    fn of_pixel(&self, pixel: usize) -> impl Iterator<Item = usize> + use<> {
        let (row, column) = (pixel / self.width, pixel % self.width);
        let (side, columns) = (self.per_side, self.width * self.per_side);
        (0..side * side).map(move |i| (row * side + i / side) * columns + column * side + i % side)
    }

    fn hit(&self, mesh: &Mesh, sample: usize) -> Option<Hit> {
        let Drawn { triangle, weights, .. } = self.nearest[sample];
        if triangle == NONE {
            return None;
        }
        let triangle = triangle as usize;
        let [a, b, c] = mesh.corners(mesh.triangles[triangle]).map(DVec3::from_array);
        let normal = (b - a).cross(c - a);
        let [u, v, w] = weights.map(f64::from);
        let ray = u * a + v * b + w * c - self.eye;
        let cosine = (ray.dot(normal) / (ray.length() * normal.length())).abs() as f32;
        Some(Hit { triangle, weights, cosine })
    }
}

impl Hit {
    /// Returns the texture coordinates [u, v] of the point, from those of the vertices.
    pub fn coordinates(&self, mesh: &Mesh, of_vertices: &[[f32; 2]]) -> [f32; 2] {
        std::array::from_fn(|axis| {
            let corners = mesh.triangles[self.triangle].iter().zip(self.weights);
            corners.map(|(&corner, weight)| of_vertices[corner as usize][axis] * weight).sum()
        })
    }
}

/// Returns the four texels around [u, v] of a texture with `side` texels along each side, and their weights in bilinear interpolation.
pub(super) fn around(side: u32, at: [f32; 2]) -> [(usize, f32); 4] {
    let place = at.map(|part| (part * side as f32 - 0.5).clamp(0.0, side as f32 - 1.0));
    let low = place.map(|part| part as u32);
    let high = low.map(|part| (part + 1).min(side - 1));
    let [x, y] = [place[0] - low[0] as f32, place[1] - low[1] as f32];
    let texel = |column: u32, row: u32| row as usize * side as usize + column as usize;
    [
        (texel(low[0], low[1]), (1.0 - x) * (1.0 - y)),
        (texel(high[0], low[1]), x * (1.0 - y)),
        (texel(low[0], high[1]), (1.0 - x) * y),
        (texel(high[0], high[1]), x * y),
    ]
}

/// Returns true for each triangle that a camera sees and for the triangles that share an edge with one of these; true for all without
/// cameras. At most [`MOST_CAMERAS`] cameras are used.
///
/// # Errors
/// When a camera's picture is larger than pictures may be.
pub(super) fn shown(mesh: &Mesh, cameras: &[Camera], threads: usize) -> Result<Vec<bool>> {
    if cameras.is_empty() {
        return Ok(vec![true; mesh.triangles.len()]);
    }
    let used: Vec<&Camera> = cameras.iter().step_by(cameras.len().div_ceil(MOST_CAMERAS).max(1)).collect();
    let seen_by = |cameras: &[&Camera]| -> Result<Vec<bool>> {
        let mut seen = vec![false; mesh.triangles.len()];
        for camera in cameras {
            let k = camera.intrinsics;
            let small = (LONGEST / f64::from(k.width.max(k.height))).min(1.0);
            let camera = Camera { intrinsics: resized(k, small)?, ..**camera };
            Samples::of(mesh, &camera, 1)?
                .nearest
                .iter()
                .filter(|drawn| drawn.triangle != NONE)
                .for_each(|drawn| seen[drawn.triangle as usize] = true);
        }
        Ok(seen)
    };
    let parts: Vec<Result<Vec<bool>>> = std::thread::scope(|scope| {
        let seen_by = &seen_by;
        let parts: Vec<_> = used
            .chunks(used.len().div_ceil(threads))
            .map(|cameras| scope.spawn(move || seen_by(cameras)))
            .collect();
        let joined = parts.into_iter().map(|part| part.join());
        joined.map(|part| part.unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
    });
    let mut seen = vec![false; mesh.triangles.len()];
    for part in parts {
        seen.iter_mut().zip(part?).for_each(|(seen, part)| *seen |= part);
    }
    let edge = |triangle: [u32; 3], i: usize| {
        let (a, b) = (triangle[i], triangle[(i + 1) % 3]);
        (a.min(b), a.max(b))
    };
    let edges: HashSet<(u32, u32)> = (mesh.triangles.iter().zip(&seen))
        .filter(|&(_, &seen)| seen)
        .flat_map(|(&triangle, _)| (0..3).map(move |i| edge(triangle, i)))
        .collect();
    let beside = |&triangle: &[u32; 3]| (0..3).any(|i| edges.contains(&edge(triangle, i)));
    Ok(mesh.triangles.iter().map(beside).collect())
}
