//! Silhouettes of a mesh from cameras, and how well they fit the photographs' masks.

use super::surface::Mesh;
use glam::DVec3;
use trimip_core::{Camera, Frames, Result};

/// Distance of the near plane along the optical axis, relative to that of the farthest vertex.
const NEAR: f64 = 1e-4;

/// Returns the distance along the optical axis to the nearest triangle at the centre of each pixel, row by row, world
/// units; infinite where there is no triangle. Both sides of a triangle are drawn. A pixel centre on the edge of two
/// triangles belongs to both.
pub fn rasterise(mesh: &Mesh, camera: &Camera) -> Vec<f32> {
    let mut depths =
        vec![f32::INFINITY; camera.intrinsics.width as usize * camera.intrinsics.height as usize];
    rasterise_triangles(mesh, camera, |pixel, drawn| depths[pixel] = depths[pixel].min(drawn.depth));
    depths
}

/// A point of a triangle that a pixel shows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drawn {
    /// Distance along the optical axis, world units.
    pub depth: f32,
    /// Index of the triangle.
    pub triangle: u32,
    /// Weights of the triangle's corners at the point.
    pub weights: [f32; 3],
}

/// A corner of a triangle that is drawn: column, row and reciprocal distance, and the weights of the mesh's triangle there.
type Corner = ([f64; 3], [f64; 3]);

/// Calls `visit` with each pixel whose centre a triangle covers, and the point of the triangle there.
pub(super) fn rasterise_triangles(mesh: &Mesh, camera: &Camera, mut visit: impl FnMut(usize, Drawn)) {
    let k = camera.intrinsics;
    let (width, height) = (k.width as usize, k.height as usize);
    let to_camera = camera.rotation.transpose();
    let seen: Vec<DVec3> = mesh
        .positions
        .iter()
        .map(|&p| {
            let [x, y, z] = (to_camera * (DVec3::from_array(p.map(f64::from)) - camera.origin)).to_array();
            DVec3::new(x, y, -z)
        })
        .collect();
    let near = NEAR * seen.iter().map(|p| p.z).fold(0.0, f64::max);
    for (index, triangle) in mesh.triangles.iter().enumerate() {
        let corners = triangle.map(|vertex| seen[vertex as usize]);
        let mut ring = Vec::with_capacity(4);
        for (i, &from) in corners.iter().enumerate() {
            let next = (i + 1) % 3;
            let to = corners[next];
            let weights = |part: f64| {
                let mut weights = [0.0; 3];
                (weights[i], weights[next]) = (1.0 - part, part);
                weights
            };
            if from.z >= near {
                ring.push((from, weights(0.0)));
            }
            if (from.z >= near) != (to.z >= near) {
                let part = (near - from.z) / (to.z - from.z);
                ring.push((from + (to - from) * part, weights(part)));
            }
        }
        // Position in pixels, and the reciprocal of the distance, which is linear in the picture.
        let place = |&(p, weights): &(DVec3, [f64; 3])| {
            let [x, y] = k.image_of(DVec3::new(p.x, p.y, -p.z))?;
            Some(([x, y, p.z.recip()], weights))
        };
        // Edges that a lens bends are drawn straight; triangles outside the domain of the lens are skipped.
        let Some(drawn) = ring.iter().map(place).collect::<Option<Vec<Corner>>>() else { continue };
        for i in 2..drawn.len() {
            draw([drawn[0], drawn[i - 1], drawn[i]], width, height, &mut |pixel, depth, weights| {
                let triangle = index as u32;
                visit(pixel, Drawn { depth, triangle, weights });
            });
        }
    }
}

/// Draws one triangle. `visit` receives the index of a pixel, the distance, and the weights of the mesh's triangle.
fn draw(corners: [Corner; 3], width: usize, height: usize, visit: &mut impl FnMut(usize, f32, [f32; 3])) {
    let of_mesh = corners.map(|(_, weights)| weights);
    let corners = corners.map(|(place, _)| place);
    let cross =
        |a: [f64; 3], b: [f64; 3], x: f64, y: f64| (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]);
    let [a, b, c] = corners;
    let area = cross(a, b, c[0], c[1]);
    if !(area.abs() > 0.0) {
        return;
    }
    // Pixel centres between the least and the greatest coordinate.
    let span = |axis: usize, most: usize| {
        let values = corners.map(|corner| corner[axis] - 0.5);
        let low = values.into_iter().fold(f64::INFINITY, f64::min).ceil().max(0.0);
        let high = values.into_iter().fold(f64::NEG_INFINITY, f64::max).floor().min(most as f64 - 1.0);
        if low <= high { low as usize..high as usize + 1 } else { 0..0 }
    };
    let columns = span(0, width);
    for row in span(1, height) {
        for column in columns.clone() {
            let (x, y) = (column as f64 + 0.5, row as f64 + 0.5);
            let weights = [cross(b, c, x, y), cross(c, a, x, y), cross(a, b, x, y)].map(|w| w / area);
            if weights.iter().all(|&w| w >= 0.0) {
                // In the picture, weights divided by distances are linear.
                let parts: [f64; 3] = std::array::from_fn(|i| weights[i] * corners[i][2]);
                let depth = parts.iter().sum::<f64>().recip();
                let weight = |corner: usize| -> f64 {
                    parts.iter().zip(&of_mesh).map(|(part, weights)| part * depth * weights[corner]).sum()
                };
                visit(
                    row * width + column,
                    depth as f32,
                    [weight(0), weight(1), weight(2)].map(|w| w as f32),
                );
            }
        }
    }
}

/// Agreement of silhouettes with masks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overlap {
    /// Views compared.
    pub views: usize,
    /// Mean intersection over union (IoU) of silhouette and mask over the views.
    pub mean: f64,
    /// Smallest IoU of a view.
    pub least: f64,
}

/// Compares the silhouettes of a mesh with the masks of every `stride`-th frame, by the intersection over union of the
/// pixels that the mesh covers and the pixels with an alpha of at least a half. `None` if no photograph has an alpha
/// channel that means opacity, with both opaque and transparent pixels.
///
/// # Errors
/// When a photograph cannot be read.
pub fn overlap(mesh: &Mesh, frames: &dyn Frames, stride: usize) -> Result<Option<Overlap>> {
    let mut fractions = Vec::new();
    for index in (0..frames.len()).step_by(stride.max(1)) {
        let set = frames.load(index)?;
        let Some(view) = set.views.first().filter(|_| set.alpha.is_opacity()) else { continue };
        let camera = &view.camera;
        let count = camera.intrinsics.width as usize * camera.intrinsics.height as usize;
        let mask: Vec<bool> =
            set.pixels[view.offset..][..count].iter().map(|pixel| pixel[3] >= 128).collect();
        if mask.iter().all(|&inside| inside) || !mask.contains(&true) {
            continue;
        }
        let covered = rasterise(mesh, camera);
        let count = |pick: fn(bool, bool) -> bool| {
            covered.iter().zip(&mask).filter(|&(depth, &inside)| pick(depth.is_finite(), inside)).count()
                as f64
        };
        fractions.push(count(|a, b| a && b) / count(|a, b| a || b));
    }
    let least = fractions.iter().copied().fold(f64::INFINITY, f64::min);
    let mean = fractions.iter().sum::<f64>() / fractions.len() as f64;
    Ok((!fractions.is_empty()).then_some(Overlap { views: fractions.len(), mean, least }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::fixtures::cube;
    use trimip_core::Intrinsics;

    #[test]
    fn a_cube_seen_from_the_front_is_a_square_at_its_distance() {
        // The face y = 0 of the unit cube lies two units in front of the camera, so it is fx / 2 = 50 pixels wide.
        let k = Intrinsics {
            width: 80,
            height: 70,
            fx: 100.0,
            fy: 100.0,
            cx: 40.0,
            cy: 35.0,
            ..Intrinsics::default()
        };
        let eye = DVec3::new(0.5, -2.0, 0.5);
        let camera = Camera::look_at(k, eye, DVec3::splat(0.5), DVec3::Z);
        let depths = rasterise(&cube(), &camera);
        for (i, depth) in depths.iter().enumerate() {
            let (x, y) = ((i % 80) as f64 + 0.5, (i / 80) as f64 + 0.5);
            let inside = (x - 40.0).abs() < 25.0 && (y - 35.0).abs() < 25.0;
            assert_eq!(depth.is_finite(), inside, "{x}, {y}");
            assert!(!inside || (depth - 2.0).abs() < 1e-6);
        }
    }

    #[test]
    fn a_slanted_triangle_has_the_distance_of_its_plane_even_where_it_passes_the_eye() {
        // A triangle in the plane z = -1 below the camera, with one corner behind the camera.
        let positions = vec![[-50.0, -50.0, -1.0], [50.0, -50.0, -1.0], [0.0, 100.0, -1.0]];
        let mesh = Mesh { positions, triangles: vec![[0, 1, 2]], ..Mesh::default() };
        let k = Intrinsics {
            width: 20,
            height: 20,
            fx: 20.0,
            fy: 20.0,
            cx: 10.0,
            cy: 10.0,
            ..Intrinsics::default()
        };
        let camera = Camera::look_at(k, DVec3::ZERO, DVec3::Y, DVec3::Z);
        let depths = rasterise(&mesh, &camera);
        for (i, &depth) in depths.iter().enumerate() {
            let row = (i / 20) as f64 + 0.5;
            // A row below the middle sees the plane at the distance f / (row - cy).
            let expected = 20.0 / (row - 10.0);
            let seen = row > 10.0 && expected < 50.0;
            assert!(
                if seen { (f64::from(depth) / expected - 1.0).abs() < 1e-6 } else { depth.is_infinite() },
                "{row}: {depth}"
            );
        }
    }
}
