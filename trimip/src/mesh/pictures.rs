//! Pictures of a mesh, and how well they fit the photographs.

use super::samples::{Hit, Samples, around};
use super::surface::{Mesh, Texture};
use trimip_core::{Camera, Frames, Result};

/// Number of samples along each side of a pixel.
const SAMPLES: u32 = 3;

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
    let samples = Samples::of(mesh, camera, SAMPLES)?;
    let pixels = samples.width * camera.intrinsics.height as usize;
    let (mut colors, mut covered) = (vec![[0.0; 3]; pixels], vec![0.0; pixels]);
    let share = (SAMPLES as f32).powi(-2);
    for (pixel, color) in colors.iter_mut().enumerate() {
        for hit in samples.hits(mesh, pixel) {
            let own = hit.map_or(background, |hit| color_at(mesh, texture, &hit));
            covered[pixel] += if hit.is_some() { share } else { 0.0 };
            color.iter_mut().zip(own).for_each(|(sum, part)| *sum += share * part);
        }
    }
    Ok((colors, covered))
}

/// Returns the colour of a mesh at a point on it.
fn color_at(mesh: &Mesh, texture: Option<&Texture>, hit: &Hit) -> [f32; 3] {
    match texture {
        None => std::array::from_fn(|channel| {
            let own = |(&corner, weight): (&u32, f32)| {
                mesh.colors.get(corner as usize).map_or(1.0, |color| color[channel]) * weight
            };
            mesh.triangles[hit.triangle].iter().zip(hit.weights).map(own).sum()
        }),
        Some(texture) => bilinear(texture, hit.coordinates(mesh, &texture.coordinates)),
    }
}

/// Returns the colour of a texture at [u, v], interpolated between four texels.
fn bilinear(texture: &Texture, at: [f32; 2]) -> [f32; 3] {
    let bytes = texture.image.as_raw();
    let texels = around(texture.image.width(), at);
    std::array::from_fn(|channel| {
        texels.iter().map(|&(texel, weight)| f32::from(bytes[3 * texel + channel]) * weight).sum::<f32>()
            / 255.0
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
    use glam::DVec3;
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
        let texture = Texture { coordinates, image, charts: 1, used: 1.0, photographs: 0, shown: 0.0 };
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
