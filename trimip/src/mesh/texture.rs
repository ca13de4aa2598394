//! Textures of meshes: the surface is cut into charts, which are laid out in a square image. The field is asked for the colour of every
//! texel; photographs correct it where they show the surface.

use super::colors::{Sight, colors, eight_bits};
use super::fit::{Fit, Photographs};
use super::samples::shown;
use super::smooth::shrunk;
use super::surface::{Mesh, Texture};
use super::threads;
use glam::Vec3;
use image::{Rgb, RgbImage};
use trimip_core::{Camera, Error, Result, Viewer, memory::available_memory};
use uvunwrap::{Density, MeshInput, Options, Packing};

/// Texels between a chart and the border of its neighbour's padding. They get the colours of the chart, so that filtering and the
/// first two mip levels do not mix charts.
const PADDING: u32 = 4;

/// Memory that a texel takes while the texture is made and written, bytes: without photographs, and with them.
const BYTES_OF_A_TEXEL: [u64; 2] = [12, 36];

/// Number of texels whose colours are computed at once.
const TEXELS_AT_ONCE: usize = 1 << 16;

/// Rounds of smoothing before the surface is cut into charts.
const SMOOTHING: u32 = 6;

/// Texels along a length of surface that no camera sees, relative to the other surface.
const DENSITY_UNSEEN: f32 = 0.25;

/// Smallest and largest side of a texture, texels. The largest is what every WebGPU and most WebGL devices accept, doubled.
pub const SIDES: [u32; 2] = [64, 16_384];

/// Settings of a texture.
pub struct Texturing<'a> {
    /// Number of texels along each side.
    pub side: u32,
    /// Width of a cell of the grid from which the mesh was extracted, world units.
    pub spacing: f64,
    /// Photographs to which the texture is fitted; without them, all colours are those of the field.
    pub photographs: Option<Photographs<'a>>,
    /// Training cameras. Triangles that none of them sees get a quarter of the texels along each side.
    pub cameras: &'a [Camera],
    /// Number of threads; 0 = one per core.
    pub threads: usize,
}

/// Cuts a mesh into charts and computes the colours of a texture. Returns the mesh, whose vertices on the borders of charts are
/// duplicated, and its texture. `watch` receives the share of the work done and returns false to stop; the result is then `None`.
///
/// # Errors
/// When the side is out of range, the memory or the image is too small for the texture, a photograph cannot be read, or the device
/// fails.
pub fn texture(
    viewer: &mut dyn Viewer,
    mesh: &Mesh,
    what: &Texturing<'_>,
    watch: &mut dyn FnMut(f64) -> bool,
) -> Result<Option<(Mesh, Texture)>> {
    let &Texturing { side, spacing, .. } = what;
    let [least, most] = SIDES;
    if !(least..=most).contains(&side) {
        let found = format!("a texture of {side} texels along each side");
        return Err(Error::input(found, "out of range", format!("choose {least} to {most}")));
    }
    let of_texel = BYTES_OF_A_TEXEL[usize::from(what.photographs.is_some())];
    let needed = of_texel * u64::from(side) * u64::from(side);
    if let Some(available) = available_memory().filter(|&available| available < needed) {
        let [needed, available] = [needed, available].map(|bytes| 1e-9 * bytes as f64);
        let found = format!("takes {needed:.1} GB, but only {available:.1} GB are available");
        return Err(Error::input(
            format!("a texture of {side} texels along each side"),
            found,
            "choose a smaller one",
        ));
    }
    if !watch(0.0) {
        return Ok(None);
    }
    let threads = threads::count(what.threads);
    let Unwrapped { mesh, coordinates, charts } = unwrap(mesh, side, &shown(mesh, what.cameras, threads)?)?;
    let texels = Texels::of(&mesh, &coordinates, side);
    let mut image = RgbImage::new(side, side);
    let mut covered = vec![false; (side * side) as usize];
    let mut done = 0;
    // The share of the work that ends with the colours of the field.
    let asked = if what.photographs.is_some() { 0.3 } else { 1.0 };
    // A query shows detail of the width of a texel, unless the cells of the grid are finer.
    let texel = texels.width(&mesh, &coordinates);
    let sight = Sight { reach: 2.0 * spacing, radius: 0.5 * texel.min(spacing) };
    let mut batch: Vec<(usize, [[f32; 3]; 2])> = Vec::with_capacity(TEXELS_AT_ONCE);
    let mut paint = |batch: &mut Vec<(usize, [[f32; 3]; 2])>| {
        let points: Vec<_> = batch.iter().map(|&(_, point)| point).collect();
        for (&(index, _), color) in batch.iter().zip(colors(viewer, &points, sight)?) {
            image.put_pixel(index as u32 % side, index as u32 / side, Rgb(eight_bits(color)));
        }
        batch.clear();
        Ok::<(), Error>(())
    };
    for triangle in 0..mesh.triangles.len() {
        texels.of_triangle(triangle, |index, weights| {
            if !std::mem::replace(&mut covered[index], true) {
                batch.push((index, place(&mesh, triangle, weights)));
            }
        });
        if batch.len() >= TEXELS_AT_ONCE {
            done += batch.len();
            paint(&mut batch)?;
            if !watch(asked * (done as f64 / (0.7 * f64::from(side * side))).min(0.99)) {
                return Ok(None);
            }
        }
    }
    paint(&mut batch)?;
    let used = covered.iter().filter(|&&covered| covered).count() as f64 / covered.len() as f64;
    let on_surface = covered.clone();
    spread(&mut image, &mut covered.clone());
    let (mut photographs, mut seen_share) = (0, 0.0);
    if let Some(given) = &what.photographs {
        let fit = Fit { mesh: &mesh, coordinates: &coordinates, side, threads };
        let mut colors: Vec<[f32; 3]> =
            image.pixels().map(|pixel| pixel.0.map(|byte| f32::from(byte) / 255.0)).collect();
        let mut seen = vec![false; covered.len()];
        let fitted =
            fit.run(given, &mut colors, &mut seen, &mut |share| watch(asked + (1.0 - asked) * share))?;
        let Some(count) = fitted else { return Ok(None) };
        photographs = count;
        let both = on_surface.iter().zip(&seen).filter(|&(&surface, &seen)| surface && seen).count();
        seen_share = both as f64 / on_surface.iter().filter(|&&surface| surface).count().max(1) as f64;
        image.pixels_mut().zip(&colors).for_each(|(pixel, &color)| pixel.0 = eight_bits(color));
        covered.iter_mut().zip(seen).for_each(|(covered, seen)| *covered |= seen);
        spread(&mut image, &mut covered);
    }
    Ok(watch(1.0)
        .then_some((mesh, Texture { coordinates, image, charts, used, photographs, shown: seen_share })))
}

/// A mesh whose vertices on the borders of charts are duplicated, with the texture coordinates of its vertices.
struct Unwrapped {
    mesh: Mesh,
    coordinates: Vec<[f32; 2]>,
    charts: u32,
}

/// Cuts a mesh into charts, on a smoothed surface. Triangles that are not `shown` follow the others in the returned mesh.
fn unwrap(mesh: &Mesh, side: u32, shown: &[bool]) -> Result<Unwrapped> {
    let part = |wanted: bool| -> Vec<u32> {
        let triangles = mesh.triangles.iter().zip(shown).filter(|&(_, &shown)| shown == wanted);
        triangles.flat_map(|(triangle, _)| *triangle).collect()
    };
    let parts = [part(true), part(false)];
    // Noise of the surface would cut it into charts of a few triangles.
    let smooth = shrunk(mesh, SMOOTHING);
    let inputs: Vec<MeshInput<'_>> = parts
        .iter()
        .zip([1.0, DENSITY_UNSEEN])
        .filter(|(indices, _)| !indices.is_empty())
        .map(|(indices, scale)| MeshInput { scale, ..MeshInput::new(&smooth, indices) })
        .collect();
    let packing = if mesh.triangles.len() > 20_000 { Packing::Fast } else { Packing::Shape };
    let options = Options {
        density: Density::Auto { page_size: side },
        padding: PADDING / 2,
        packing,
        ..Options::default()
    };
    let failed = |what: &dyn std::fmt::Display| {
        let place = format!("a texture of {side} texels along each side");
        Error::input(place, what, "choose a larger texture, or a mesh of fewer triangles")
    };
    let atlas = uvunwrap::generate(&inputs, &options).map_err(|error| failed(&error))?;
    if atlas.page_count != 1 {
        return Err(failed(&format!("{} charts do not fit", atlas.chart_count)));
    }
    // The page is cropped to the rows in use; the image is square.
    let scale = [atlas.width, atlas.height].map(|part| part as f32 / side as f32);
    let mut cut = Mesh { origin: mesh.origin, ..Mesh::default() };
    let mut coordinates = Vec::new();
    for output in &atlas.meshes {
        let first = coordinates.len() as u32;
        for vertex in &output.vertices {
            coordinates.push([vertex.uv[0] * scale[0], vertex.uv[1] * scale[1]]);
            cut.positions.push(mesh.positions[vertex.xref as usize]);
            cut.normals.extend(mesh.normals.get(vertex.xref as usize));
        }
        let (triangles, _) = output.indices.as_chunks::<3>();
        cut.triangles.extend(triangles.iter().map(|triangle| triangle.map(|vertex| first + vertex)));
    }
    Ok(Unwrapped { mesh: cut, coordinates, charts: atlas.chart_count })
}

/// The triangles of a mesh in its texture, in texels.
struct Texels {
    corners: Vec<[[f64; 2]; 3]>,
    side: u32,
}

impl Texels {
    fn of(mesh: &Mesh, coordinates: &[[f32; 2]], side: u32) -> Self {
        let corner = |vertex: u32| coordinates[vertex as usize].map(|part| f64::from(part) * f64::from(side));
        Self { corners: mesh.triangles.iter().map(|triangle| triangle.map(corner)).collect(), side }
    }

    /// Calls `visit` with the index of each texel whose centre lies in the triangle, and the weights of the triangle's corners there.
    fn of_triangle(&self, triangle: usize, mut visit: impl FnMut(usize, [f64; 3])) {
        let corners = self.corners[triangle];
        let cross = |a: [f64; 2], b: [f64; 2], at: [f64; 2]| {
            (b[0] - a[0]) * (at[1] - a[1]) - (b[1] - a[1]) * (at[0] - a[0])
        };
        let [a, b, c] = corners;
        let area = cross(a, b, c);
        if !(area.abs() > 0.0) {
            return;
        }
        let span = |axis: usize| {
            let values = corners.map(|corner| corner[axis] - 0.5);
            let low = values.into_iter().fold(f64::INFINITY, f64::min).ceil().max(0.0) as usize;
            let high = values.into_iter().fold(f64::NEG_INFINITY, f64::max).floor();
            low..(high + 1.0).clamp(0.0, self.side.into()) as usize
        };
        for row in span(1) {
            for column in span(0) {
                let at = [column as f64 + 0.5, row as f64 + 0.5];
                let weights = [cross(b, c, at), cross(c, a, at), cross(a, b, at)].map(|weight| weight / area);
                if weights.iter().all(|&weight| weight >= 0.0) {
                    visit(row * self.side as usize + column, weights);
                }
            }
        }
    }

    /// Returns the mean width of a texel on the surface, world units.
    fn width(&self, mesh: &Mesh, coordinates: &[[f32; 2]]) -> f64 {
        debug_assert_eq!(mesh.positions.len(), coordinates.len());
        let on_surface: f64 = mesh.triangles.iter().map(|&triangle| area(mesh.corners(triangle))).sum();
        let in_texels: f64 = self.corners.iter().map(|corners| area(corners.map(|[x, y]| [x, y, 0.0]))).sum();
        (on_surface / in_texels.max(1.0)).sqrt()
    }
}

/// Returns the area of a triangle.
fn area(corners: [[f64; 3]; 3]) -> f64 {
    let [a, b, c] = corners.map(glam::DVec3::from_array);
    0.5 * (b - a).cross(c - a).length()
}

/// Returns position and unit normal at a point of a triangle.
fn place(mesh: &Mesh, triangle: usize, weights: [f64; 3]) -> [[f32; 3]; 2] {
    let corners = mesh.triangles[triangle];
    let mean = |list: &[[f32; 3]]| -> [f32; 3] {
        std::array::from_fn(|axis| {
            let terms = corners.iter().zip(weights);
            terms.map(|(&corner, weight)| f64::from(list[corner as usize][axis]) * weight).sum::<f64>() as f32
        })
    };
    let normal = Vec3::from_array(mean(&mesh.normals)).normalize_or(Vec3::Z);
    [mean(&mesh.positions), normal.to_array()]
}

/// Gives a colour to the texels beside charts: first the mean of the neighbours that have one, [`PADDING`] times, then that of coarser
/// and coarser squares, so that no mip level mixes a chart with another colour.
fn spread(image: &mut RgbImage, covered: &mut [bool]) {
    let side = image.width() as usize;
    let mut border: Vec<usize> = Vec::new();
    for _ in 0..PADDING {
        border.clear();
        border
            .extend((0..covered.len()).filter(|&i| !covered[i] && near(side, i).any(|other| covered[other])));
        let colors: Vec<[u8; 3]> = border
            .iter()
            .map(|&i| mean(near(side, i).filter(|&other| covered[other]).map(|other| texel(image, other))))
            .collect();
        for (&i, color) in border.iter().zip(colors) {
            image.put_pixel((i % side) as u32, (i / side) as u32, Rgb(color));
        }
        border.iter().for_each(|&i| covered[i] = true);
    }
    let squares = coarser(side, |i| covered[i].then(|| texel(image, i)));
    for i in 0..covered.len() {
        if !covered[i] {
            let (mut x, mut y, mut width) = (i % side, i / side, side);
            let found = squares.iter().find_map(|square| {
                (x, y, width) = (x / 2, y / 2, width.div_ceil(2));
                square[y * width + x]
            });
            image.put_pixel((i % side) as u32, (i / side) as u32, Rgb(found.unwrap_or_default()));
        }
    }
}

/// Returns the means of the colours in squares of 2, 4, 8, … texels, up to one square; `None` for squares without a colour.
fn coarser(side: usize, color: impl Fn(usize) -> Option<[u8; 3]>) -> Vec<Vec<Option<[u8; 3]>>> {
    let mut levels: Vec<Vec<Option<[u8; 3]>>> = Vec::new();
    let mut width = side;
    while width > 1 {
        let (finer, half) = (width, width.div_ceil(2));
        let of = |index: usize| match levels.last() {
            Some(level) => level[index],
            None => color(index),
        };
        let square = |index: usize| {
            let (x, y) = (2 * (index % half), 2 * (index / half));
            let parts = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)].into_iter();
            let inside = parts.filter(|&(x, y)| x < finer && y < finer);
            let colors: Vec<[u8; 3]> = inside.filter_map(|(x, y)| of(y * finer + x)).collect();
            (!colors.is_empty()).then(|| mean(colors.into_iter()))
        };
        let level = (0..half * half).map(square).collect();
        levels.push(level);
        width = half;
    }
    levels
}

/// Returns the indices of the eight texels around texel `i`.
fn near(side: usize, i: usize) -> impl Iterator<Item = usize> {
    let (x, y) = ((i % side) as isize, (i / side) as isize);
    let places = (-1..=1).flat_map(move |dy| (-1..=1).map(move |dx| (x + dx, y + dy)));
    let inside = move |part: isize| (0..side as isize).contains(&part);
    places
        .filter(move |&(column, row)| inside(column) && inside(row) && (column, row) != (x, y))
        .map(move |(column, row)| row as usize * side + column as usize)
}

fn texel(image: &RgbImage, i: usize) -> [u8; 3] {
    image.get_pixel(i as u32 % image.width(), i as u32 / image.width()).0
}

/// Returns the mean of colours, rounded; black if there is none.
fn mean(colors: impl Iterator<Item = [u8; 3]>) -> [u8; 3] {
    let (mut sums, mut count) = ([0_u32; 3], 0);
    for color in colors {
        sums.iter_mut().zip(color).for_each(|(sum, part)| *sum += u32::from(part));
        count += 1;
    }
    sums.map(|sum| ((sum + count / 2) / count.max(1)) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::fixtures::cube;

    #[test]
    fn charts_cover_the_mesh_once_and_have_room_around_them() {
        let mut mesh = cube();
        mesh.find_normals();
        let side = 128;
        let Unwrapped { mesh: cut, coordinates, charts } = unwrap(&mesh, side, &[true; 12]).unwrap();
        assert!(charts >= 1 && cut.triangles.len() == mesh.triangles.len());
        for (own, cut_triangle) in mesh.triangles.iter().zip(&cut.triangles) {
            assert_eq!(mesh.corners(*own), cut.corners(*cut_triangle));
        }
        assert!(coordinates.iter().flatten().all(|part| (0.0..=1.0).contains(part)));
        // No texel belongs to two triangles, except along their common edges.
        let texels = Texels::of(&cut, &coordinates, side);
        let mut times = vec![0_u32; (side * side) as usize];
        let edge = 1e-6;
        for triangle in 0..cut.triangles.len() {
            texels.of_triangle(triangle, |index, weights| {
                times[index] += u32::from(weights.iter().all(|&weight| weight > edge));
            });
        }
        assert!(times.iter().all(|&count| count <= 1));
        let covered = f64::from(times.iter().sum::<u32>());
        assert!(covered > 0.3 * f64::from(side * side), "{covered} texels");
        // The cube has a surface of 6, so a texel is sqrt(6 / covered) wide.
        assert!((texels.width(&cut, &coordinates) / (6.0 / covered).sqrt() - 1.0).abs() < 0.05);
    }

    #[test]
    fn surface_that_no_camera_sees_gets_fewer_texels() {
        let mut mesh = cube();
        mesh.find_normals();
        let side = 256;
        let eye = glam::DVec3::new(4.0, 0.5, 0.5);
        let k = trimip_core::Intrinsics::from_angle(64, 64, 0.5);
        let camera = Camera::look_at(k, eye, glam::DVec3::splat(0.5), glam::DVec3::Z);
        let seen = shown(&mesh, &[camera], 1).unwrap();
        // The face x = 1, and the triangles that share an edge with it.
        assert_eq!(mesh.triangles.iter().zip(&seen).filter(|(_, seen)| **seen).count(), 6, "{seen:?}");
        let Unwrapped { mesh: cut, coordinates, .. } = unwrap(&mesh, side, &seen).unwrap();
        let texels = Texels::of(&cut, &coordinates, side);
        // Texels per area of the smoothed surface, on which charts are cut.
        let smooth = shrunk(&mesh, SMOOTHING);
        let moved = |corner: [f64; 3]| {
            let own = mesh.positions.iter().position(|position| position.map(f64::from) == corner);
            smooth[own.unwrap()].map(f64::from)
        };
        let density = |triangles: std::ops::Range<usize>| {
            let texels: f64 =
                triangles.clone().map(|i| area(texels.corners[i].map(|[x, y]| [x, y, 0.0]))).sum();
            let surface: f64 = triangles.map(|i| area(cut.corners(cut.triangles[i]).map(moved))).sum();
            texels / surface
        };
        let ratio = density(0..6) / density(6..12);
        assert!((ratio - 16.0).abs() < 1.0, "{ratio}");
        assert_eq!(shown(&mesh, &[], 1).unwrap(), [true; 12], "no camera is known");
    }

    #[test]
    fn positions_in_the_texture_are_those_of_the_surface() {
        let mut mesh = cube();
        mesh.find_normals();
        let Unwrapped { mesh, coordinates, .. } = unwrap(&mesh, 64, &[true; 12]).unwrap();
        let texels = Texels::of(&mesh, &coordinates, 64);
        for triangle in 0..mesh.triangles.len() {
            texels.of_triangle(triangle, |_, weights| {
                let [position, normal] = place(&mesh, triangle, weights);
                // A point of the unit cube's surface has a coordinate of 0 or 1.
                assert!(position.iter().any(|x| x.abs() < 1e-6 || (x - 1.0).abs() < 1e-6), "{position:?}");
                assert!((Vec3::from_array(normal).length() - 1.0).abs() < 1e-6);
            });
        }
    }

    #[test]
    fn colours_spread_to_every_texel_and_keep_those_of_charts() {
        let mut image = RgbImage::new(64, 64);
        let mut covered = vec![false; 64 * 64];
        for (x, color) in [(10, [200, 0, 0]), (50, [0, 100, 0])] {
            image.put_pixel(x, 20, Rgb(color));
            covered[20 * 64 + x as usize] = true;
        }
        spread(&mut image, &mut covered);
        assert_eq!((image.get_pixel(10, 20).0, image.get_pixel(50, 20).0), ([200, 0, 0], [0, 100, 0]));
        for distance in 1..=PADDING {
            assert_eq!(image.get_pixel(10 + distance, 20).0, [200, 0, 0], "{distance} texels away");
        }
        assert!(image.pixels().all(|pixel| pixel.0 != [0; 3]));
        assert_eq!(mean([[1, 2, 3], [2, 2, 4]].into_iter()), [2, 2, 4]);
    }
}
