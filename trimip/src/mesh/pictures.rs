//! Pictures of a mesh, and how well they fit the photographs.

use super::silhouettes::rasterise_triangles;
use super::surface::Mesh;
use super::texture::Texture;
use crate::view::cameras::resized;
use glam::DVec3;
use trimip_core::{Camera, Cone, Frames, Result};

/// Number of samples along each side of a pixel.
const SAMPLES: u32 = 3;

/// No triangle.
const NONE: u32 = u32::MAX;

/// Returns the colours of a picture of a mesh and the fraction of each pixel that the mesh covers, both row by row. Colours come from
/// `texture` or, without one, from the vertices; a mesh without colours is white. Each pixel is the mean of 3×3 samples.
///
/// # Errors
/// When the picture is larger than pictures may be.
pub fn picture(
    mesh: &Mesh,
    texture: Option<&Texture>,
    camera: &Camera,
    background: [f32; 3],
) -> Result<(Vec<[f32; 3]>, Vec<f32>)> {
    let (width, height) = (camera.intrinsics.width as usize, camera.intrinsics.height as usize);
    let fine = Camera { intrinsics: resized(camera.intrinsics, SAMPLES.into())?, ..*camera };
    let columns = fine.intrinsics.width as usize;
    let mut nearest = vec![(f32::INFINITY, NONE); columns * fine.intrinsics.height as usize];
    rasterise_triangles(mesh, &fine, |pixel, depth, triangle| {
        if depth < nearest[pixel].0 {
            nearest[pixel] = (depth, triangle);
        }
    });
    let (mut colors, mut covered) = (vec![[0.0; 3]; width * height], vec![0.0; width * height]);
    let share = (SAMPLES as f32).powi(-2);
    for (index, &(depth, triangle)) in nearest.iter().enumerate() {
        let (column, row) = (index % columns, index / columns);
        let pixel = row / SAMPLES as usize * width + column / SAMPLES as usize;
        let color = match triangle {
            NONE => background,
            _ => {
                covered[pixel] += share;
                let cone: Cone<f64> = fine.cone(column as u32, row as u32);
                let ahead = -fine.rotation.z_axis;
                let direction = DVec3::from_array(cone.direction);
                let point = fine.origin + direction * (f64::from(depth) / direction.dot(ahead));
                color_at(mesh, texture, triangle as usize, point)
            }
        };
        colors[pixel].iter_mut().zip(color).for_each(|(sum, part)| *sum += share * part);
    }
    Ok((colors, covered))
}

/// Returns the colour of a triangle at a point on it.
fn color_at(mesh: &Mesh, texture: Option<&Texture>, triangle: usize, point: DVec3) -> [f32; 3] {
    let corners = mesh.triangles[triangle];
    let [a, b, c] = mesh.corners(corners).map(DVec3::from_array);
    let normal = (b - a).cross(c - a);
    let part = |from: DVec3, to: DVec3| (to - from).cross(point - from).dot(normal) / normal.length_squared();
    let weights = [part(b, c), part(c, a), part(a, b)].map(|weight| weight.clamp(0.0, 1.0) as f32);
    match texture {
        None => std::array::from_fn(|channel| {
            let own = |(&corner, weight): (&u32, f32)| {
                mesh.colors.get(corner as usize).map_or(1.0, |color| color[channel]) * weight
            };
            corners.iter().zip(weights).map(own).sum()
        }),
        Some(texture) => {
            let at = |axis: usize| {
                let own =
                    |(&corner, weight): (&u32, f32)| texture.coordinates[corner as usize][axis] * weight;
                corners.iter().zip(weights).map(own).sum::<f32>()
            };
            bilinear(texture, [at(0), at(1)])
        }
    }
}

/// Returns the colour of a texture at [u, v], interpolated between four texels.
fn bilinear(texture: &Texture, at: [f32; 2]) -> [f32; 3] {
    let side = texture.image.width();
    let place = at.map(|part| (part * side as f32 - 0.5).clamp(0.0, side as f32 - 1.0));
    let low = place.map(|part| part as u32);
    let high = low.map(|part| (part + 1).min(side - 1));
    let [x, y] = [place[0] - low[0] as f32, place[1] - low[1] as f32];
    let texel =
        |column: u32, row: u32, channel: usize| f32::from(texture.image.get_pixel(column, row).0[channel]);
    std::array::from_fn(|channel| {
        let row = |row: u32| (1.0 - x) * texel(low[0], row, channel) + x * texel(high[0], row, channel);
        ((1.0 - y) * row(low[1]) + y * row(high[1])) / 255.0
    })
}

/// PSNR of pictures of a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Likeness {
    /// Views compared.
    pub views: usize,
    /// Mean over the views of the PSNR over all pixels, dB.
    pub whole: f64,
    /// Mean over the views of the PSNR over the pixels that the mesh covers completely, dB.
    pub covered: f64,
}

/// Compares pictures of a mesh with every `stride`-th photograph over `background`, at the finest scale. `None` without views that show
/// the mesh.
///
/// # Errors
/// When a photograph cannot be read.
pub fn psnr(
    mesh: &Mesh,
    texture: Option<&Texture>,
    frames: &dyn Frames,
    stride: usize,
    background: [f32; 3],
) -> Result<Option<Likeness>> {
    let (mut whole, mut within) = (Vec::new(), Vec::new());
    for index in (0..frames.len()).step_by(stride.max(1)) {
        let set = frames.load(index)?;
        let Some(view) = set.views.first() else { continue };
        let (colors, covered) = picture(mesh, texture, &view.camera, background)?;
        let photograph = set.composited(0, background);
        let error = |pixel: usize| -> f64 {
            let parts = colors[pixel].iter().zip(photograph[pixel]);
            parts.map(|(a, b)| f64::from(a.clamp(0.0, 1.0) - b).powi(2)).sum::<f64>() / 3.0
        };
        let mean = |pixels: &[usize]| {
            -10.0 * (pixels.iter().map(|&i| error(i)).sum::<f64>() / pixels.len() as f64).log10()
        };
        let inside: Vec<usize> = (0..covered.len()).filter(|&pixel| covered[pixel] > 0.999).collect();
        if !inside.is_empty() {
            whole.push(mean(&(0..covered.len()).collect::<Vec<_>>()));
            within.push(mean(&inside));
        }
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let likeness = Likeness { views: whole.len(), whole: mean(&whole), covered: mean(&within) };
    Ok((!whole.is_empty()).then_some(likeness))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::fixtures::cube;
    use image::{Rgb, RgbImage};
    use trimip_core::Intrinsics;

    /// Returns a camera two units in front of the face y = 0 of the unit cube, which is 30 pixels wide in its picture.
    fn in_front() -> Camera {
        let k = Intrinsics {
            width: 40,
            height: 40,
            fx: 60.0,
            fy: 60.0,
            cx: 20.0,
            cy: 20.0,
            ..Intrinsics::default()
        };
        let eye = DVec3::new(0.5, -2.0, 0.5);
        Camera::look_at(k, eye, DVec3::new(0.5, 0.0, 0.5), DVec3::Z)
    }

    #[test]
    fn vertex_colours_are_linear_on_a_face() {
        let mut mesh = cube();
        // Red grows along x, blue along z.
        mesh.colors = mesh.positions.iter().map(|&[x, _, z]| [x, 0.25, z]).collect();
        let (colors, covered) = picture(&mesh, None, &in_front(), [1.0; 3]).unwrap();
        for row in 0..40 {
            for column in 0..40 {
                let inside = (5..35).contains(&row) && (5..35).contains(&column);
                let pixel = row * 40 + column;
                assert!((covered[pixel] - f32::from(u8::from(inside))).abs() < 1e-6);
                let [x, z] = [(column as f32 - 4.5) / 30.0, (34.5 - row as f32) / 30.0];
                let expected = if inside { [x, 0.25, z] } else { [1.0; 3] };
                let found = colors[pixel];
                assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 1e-5), "{found:?}, not {expected:?}");
            }
        }
    }

    #[test]
    fn a_texture_is_shown_by_its_coordinates() {
        let mesh = cube();
        // The face y = 0 shows the whole texture: u along x, v downward.
        let coordinates = mesh.positions.iter().map(|&[x, _, z]| [x, 1.0 - z]).collect();
        let image = RgbImage::from_fn(30, 30, |column, row| Rgb([(8 * column) as u8, (8 * row) as u8, 0]));
        let texture = Texture { coordinates, image, charts: 1, used: 1.0 };
        let (colors, _) = picture(&mesh, Some(&texture), &in_front(), [1.0; 3]).unwrap();
        for row in 6..34 {
            for column in 6..34 {
                let expected = [8.0 * (column - 5) as f32 / 255.0, 8.0 * (row - 5) as f32 / 255.0];
                let found = colors[row * 40 + column];
                assert!((0..2).all(|c| (found[c] - expected[c]).abs() < 1e-4), "{found:?}, not {expected:?}");
            }
        }
    }
}
