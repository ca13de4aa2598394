//! Textures fitted to photographs: the texels for which pictures of the mesh have the colours of the training photographs.

use super::samples::{Samples, around};
use super::surface::Mesh;
use std::collections::HashMap;
use std::ops::Range;
use trimip_core::{Camera, Frames, Result, View, ViewSet};

/// Number of samples along each side of a pixel.
const SAMPLES: u32 = 2;

/// Number of times that every photograph is compared with the texture.
const ROUNDS: usize = 3;

/// Maximum number of photographs, evenly spread over all photographs.
const MOST_PHOTOGRAPHS: usize = 128;

/// Pixels around a jump of the depth that are left out, since the surface of the model and that of the photograph may differ by as much.
const BORDER: usize = 2;

/// A jump of the depth between the samples of a pixel, in widths of the pixel on the surface.
const JUMP: f32 = 8.0;

/// Opacity of an opaque pixel.
const OPAQUE: f32 = 0.999;

/// Colour difference, in values from 0 to 1, above which a pixel counts less: it may show a highlight, or something in front of the surface.
const TYPICAL: f32 = 0.1;

/// Weight of a texel's first colour, in pixels seen from the front.
const PRIOR: f32 = 0.05;

/// Number of rows that are compared at once.
const ROWS: usize = 128;

/// Most pixels of a photograph that is compared; larger ones are compared at a coarser scale, which bounds the memory of their samples.
const MOST_PIXELS: u64 = 4_000_000;

/// Training photographs and their cameras.
#[derive(Clone, Copy)]
pub struct Photographs<'a> {
    /// The photographs. The finest scale of at most four million pixels is used, or the coarsest.
    pub frames: &'a dyn Frames,
    /// Cameras by the name of the photograph; other photographs keep the cameras of their frames.
    pub cameras: &'a HashMap<String, Camera>,
}

/// A texture that is fitted.
pub(super) struct Fit<'a> {
    pub mesh: &'a Mesh,
    pub coordinates: &'a [[f32; 2]],
    pub side: u32,
    pub threads: usize,
}

/// Sums over the pixels that show a texel: the weighted colour differences, and the weights.
type Sums = Vec<[f32; 4]>;

/// A pixel of a photograph that shows the surface: the texels with their shares of the pixel, and the pixel's colour and weight.
struct Seen {
    texels: [(u32, f32); (4 * SAMPLES * SAMPLES) as usize],
    color: [f32; 3],
    weight: f32,
}

impl Fit<'_> {
    /// Moves the `colors` of texels, from 0 to 1, towards those for which pictures of the mesh agree with the photographs, and sets `shown`
    /// for texels that a photograph shows. Returns the number of photographs that show the mesh, or `None` if `watch`, which receives the
    /// share of the work done, returns false.
    ///
    /// Each round is one of the simultaneous iterative reconstruction technique (SIRT; Gilbert 1972): a texel moves by the mean of the
    /// differences of the pixels that show it, weighted by its share of the pixel, by the squared cosine between the ray and the normal, and by
    /// 1 / (1 + (difference / 0.1)²).
    ///
    /// # Errors
    /// When a photograph cannot be read.
    pub fn run(
        &self,
        photographs: &Photographs<'_>,
        colors: &mut [[f32; 3]],
        shown: &mut [bool],
        watch: &mut dyn FnMut(f64) -> bool,
    ) -> Result<Option<usize>> {
        let stride = photographs.frames.len().div_ceil(MOST_PHOTOGRAPHS).max(1);
        let indices: Vec<usize> = (0..photographs.frames.len()).step_by(stride).collect();
        let mut used = 0;
        for round in 0..ROUNDS {
            let mut sums: Sums = vec![[0.0; 4]; colors.len()];
            used = 0;
            for (done, &index) in indices.iter().enumerate() {
                let share = (round * indices.len() + done) as f64 / (ROUNDS * indices.len()) as f64;
                if !watch(share) {
                    return Ok(None);
                }
                let set = photographs.frames.load(index)?;
                let Some(scale) = scale(&set) else { continue };
                let view = &set.views[scale];
                let camera = photographs
                    .cameras
                    .get(&view.name)
                    .map_or(view.camera, |camera| Camera { intrinsics: view.camera.intrinsics, ..*camera });
                used += usize::from(self.compare(&set, scale, &camera, colors, &mut sums)?);
            }
            for ((color, shown), [r, g, b, weight]) in colors.iter_mut().zip(&mut *shown).zip(sums) {
                if weight > 0.0 {
                    *shown = true;
                    let moves = [r, g, b].map(|sum| sum / (weight + PRIOR));
                    color.iter_mut().zip(moves).for_each(|(part, by)| *part = (*part + by).clamp(0.0, 1.0));
                }
            }
        }
        Ok(Some(used))
    }

    /// Adds the differences between view `index` of `set` and a picture of the mesh. Returns true if the photograph shows the mesh.
    fn compare(
        &self,
        set: &ViewSet,
        index: usize,
        camera: &Camera,
        colors: &[[f32; 3]],
        sums: &mut Sums,
    ) -> Result<bool> {
        let samples = Samples::of(self.mesh, camera, SAMPLES)?;
        let pixels = set.pixels_of(index);
        let usable = usable(&samples, camera, pixels.len());
        let look = |pixels_of_part: Range<usize>| -> Vec<Seen> {
            let usable = pixels_of_part.filter(|&i| usable[i] && set.alpha.opacity(pixels[i]) > OPAQUE);
            usable
                .filter_map(|i| {
                    let [r, g, b, _] = pixels[i].map(|byte| f32::from(byte) / 255.0);
                    self.seen(&samples, i, [r, g, b], set.alpha.fraction(pixels[i]))
                })
                .collect()
        };
        let mut found = false;
        for start in (0..pixels.len()).step_by(ROWS * samples.width) {
            let end = (start + ROWS * samples.width).min(pixels.len());
            let part = (end - start).div_ceil(self.threads);
            let parts: Vec<Vec<Seen>> = std::thread::scope(|scope| {
                let starts = (start..end).step_by(part);
                let look = &look;
                let parts: Vec<_> =
                    starts.map(|first| scope.spawn(move || look(first..(first + part).min(end)))).collect();
                let joined = parts.into_iter().map(|part| part.join());
                joined.map(|part| part.unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
            });
            // One thread adds, in the order of the pixels, so that the result does not depend on the number of threads.
            for seen in parts.iter().flatten() {
                seen.add(colors, sums);
                found = true;
            }
        }
        Ok(found)
    }

    /// Returns what a pixel shows; `None` unless all of its samples show the mesh.
    fn seen(&self, samples: &Samples, pixel: usize, color: [f32; 3], kept: f32) -> Option<Seen> {
        let mut texels = [(0, 0.0); (4 * SAMPLES * SAMPLES) as usize];
        let share = (SAMPLES as f32).powi(-2);
        let mut cosine = 0.0;
        for (four, hit) in texels.as_chunks_mut::<4>().0.iter_mut().zip(samples.hits(self.mesh, pixel)) {
            let hit = hit?;
            cosine += share * hit.cosine;
            *four = around(self.side, hit.coordinates(self.mesh, self.coordinates))
                .map(|(texel, weight)| (texel as u32, share * weight));
        }
        let weight = kept * cosine * cosine;
        (weight > 0.0 && weight.is_finite()).then_some(Seen { texels, color, weight })
    }
}

/// Returns the index of the view that is compared, of a set of one photograph from fine to coarse.
fn scale(set: &ViewSet) -> Option<usize> {
    let fits = |view: &View| {
        let k = &view.camera.intrinsics;
        u64::from(k.width) * u64::from(k.height) <= MOST_PIXELS
    };
    set.views.iter().position(fits).or_else(|| set.views.len().checked_sub(1))
}

impl Seen {
    /// Adds the difference between the pixel and a picture of the texture to the sums of the texels.
    fn add(&self, colors: &[[f32; 3]], sums: &mut Sums) {
        let mut difference = self.color;
        for &(texel, share) in &self.texels {
            difference.iter_mut().zip(colors[texel as usize]).for_each(|(part, own)| *part -= share * own);
        }
        let typical = difference.iter().map(|part| part * part).sum::<f32>() / (3.0 * TYPICAL * TYPICAL);
        let weight = self.weight / (1.0 + typical);
        let terms = [difference[0], difference[1], difference[2], 1.0];
        for &(texel, share) in &self.texels {
            let sum = sums[texel as usize].iter_mut();
            sum.zip(terms).for_each(|(sum, term)| *sum += weight * share * term);
        }
    }
}

/// Returns true for each pixel that shows the mesh alone, without a jump of the depth in it or within [`BORDER`] pixels.
fn usable(samples: &Samples, camera: &Camera, pixels: usize) -> Vec<bool> {
    let per_depth = JUMP / camera.intrinsics.fx.min(camera.intrinsics.fy) as f32;
    let (width, height) = (samples.width, pixels / samples.width);
    let range = |pixel: usize| {
        let fold = |[low, high]: [f32; 2], depth: f32| [low.min(depth), high.max(depth)];
        samples.depths(pixel).fold([f32::INFINITY, 0.0], fold)
    };
    let ranges: Vec<[f32; 2]> = (0..pixels).map(range).collect();
    let joined = |[a, b]: [f32; 2], [c, d]: [f32; 2]| [a.min(c), b.max(d)];
    let jumps = |[low, high]: [f32; 2]| !(high - low <= per_depth * low);
    let mut usable = vec![true; pixels];
    for y in 0..height {
        for x in 0..width {
            let own = ranges[y * width + x];
            let beside = if x + 1 < width { ranges[y * width + x + 1] } else { own };
            let below = if y + 1 < height { ranges[(y + 1) * width + x] } else { own };
            if jumps(joined(own, joined(beside, below))) {
                for row in y.saturating_sub(BORDER)..(y + BORDER + 1).min(height) {
                    usable[row * width..][x.saturating_sub(BORDER)..(x + BORDER + 1).min(width)].fill(false);
                }
            }
        }
    }
    usable
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::pictures::picture;
    use crate::mesh::surface::Texture;
    use glam::DVec3;
    use image::{Rgb, RgbImage};
    use trimip_core::{Alpha, Intrinsics, Scale};

    const SIDE: u32 = 32;

    /// Number of photographs.
    const COUNT: usize = 9;

    /// Returns the unit square y = 0, whose texture coordinates are [x, 1 − z].
    fn square() -> (Mesh, Vec<[f32; 2]>) {
        let positions = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 0.0, 1.0]];
        let coordinates = positions.iter().map(|&[x, _, z]: &[f32; 3]| [x, 1.0 - z]).collect();
        (Mesh { positions, triangles: vec![[0, 1, 2], [0, 2, 3]], ..Mesh::default() }, coordinates)
    }

    /// The texture that the photographs show.
    fn truth() -> RgbImage {
        let wave = |x: u32, length: f32| (127.0 + 90.0 * (x as f32 / length).sin()) as u8;
        RgbImage::from_fn(SIDE, SIDE, |x, y| Rgb([wave(x, 2.0), wave(y, 3.0), wave(x + y, 4.0)]))
    }

    /// Returns a camera in front of the square; each has another direction.
    fn camera(index: usize) -> Camera {
        let [right, up] = [index % 3, index / 3].map(|i| i as f64 - 1.0);
        let eye = DVec3::new(0.5 + right, -2.2, 0.5 + 0.7 * up);
        let k = Intrinsics::from_angle(48, 48, 0.6);
        Camera::look_at(k, eye, DVec3::new(0.5, 0.0, 0.5), DVec3::Z)
    }

    /// Photographs of the square with the texture [`truth`].
    struct Pictures {
        /// A square highlight of white pixels in the first photograph.
        highlight: bool,
        /// True if the frames state cameras that are far off.
        astray: bool,
    }

    impl Frames for Pictures {
        fn len(&self) -> usize {
            COUNT
        }
        fn names(&self) -> Vec<String> {
            (0..COUNT).map(|i| i.to_string()).collect()
        }
        fn cameras(&self) -> Vec<Camera> {
            (0..COUNT).map(camera).collect()
        }
        fn load(&self, index: usize) -> Result<ViewSet> {
            let (mesh, coordinates) = square();
            let texture =
                Texture { coordinates, image: truth(), charts: 1, used: 1.0, photographs: 0, shown: 0.0 };
            let (colors, covered) = picture(&mesh, Some(&texture), &camera(index), [0.0; 3])?;
            let byte = |value: f32| (255.0 * value).round() as u8;
            let mut pixels: Vec<[u8; 4]> = (colors.iter().zip(covered))
                .map(|(color, covered)| [byte(color[0]), byte(color[1]), byte(color[2]), byte(covered)])
                .collect();
            if self.highlight && index == 0 {
                (20..26).for_each(|row| pixels[row * 48 + 20..row * 48 + 26].fill([255; 4]));
            }
            let stated = if self.astray { camera((index + 4) % COUNT) } else { camera(index) };
            let (count, weight) = (pixels.len(), 1.0);
            Ok(ViewSet {
                views: vec![View { name: index.to_string(), camera: stated, offset: 0 }],
                pixels: pixels.into(),
                alpha: Alpha::Straight,
                scales: vec![Scale { factor: 1, weight, views: 0..1, pixels: 0..count }],
                depths: Vec::new(),
            })
        }
    }

    /// Fits a grey texture to the photographs. Returns the texels, and true for those that a photograph shows.
    fn fitted(
        frames: &Pictures,
        cameras: &HashMap<String, Camera>,
        threads: usize,
    ) -> (Vec<[f32; 3]>, Vec<bool>) {
        let (mesh, coordinates) = square();
        let fit = Fit { mesh: &mesh, coordinates: &coordinates, side: SIDE, threads };
        let texels = (SIDE * SIDE) as usize;
        let (mut colors, mut shown) = (vec![[0.5; 3]; texels], vec![false; texels]);
        let photographs = Photographs { frames, cameras };
        let count = fit.run(&photographs, &mut colors, &mut shown, &mut |_| true).unwrap();
        assert_eq!(count, Some(COUNT));
        (colors, shown)
    }

    /// Returns the root mean square difference from the true texture, over texels away from the border.
    fn error(colors: &[[f32; 3]]) -> f64 {
        let image = truth();
        let inner = (4..SIDE - 4).flat_map(|y| (4..SIDE - 4).map(move |x| (x, y)));
        let square = |(x, y): (u32, u32)| -> f64 {
            let own = colors[(y * SIDE + x) as usize];
            let parts = own.iter().zip(image.get_pixel(x, y).0);
            parts.map(|(a, b)| (f64::from(*a) - f64::from(b) / 255.0).powi(2)).sum::<f64>() / 3.0
        };
        let count = f64::from((SIDE - 8) * (SIDE - 8));
        (inner.map(square).sum::<f64>() / count).sqrt()
    }

    #[test]
    fn a_texture_is_found_from_photographs_of_it() {
        let none = HashMap::new();
        let start = error(&vec![[0.5; 3]; (SIDE * SIDE) as usize]);
        let frames = Pictures { highlight: false, astray: false };
        let (colors, shown) = fitted(&frames, &none, 1);
        let found = error(&colors);
        assert!(start > 0.2 && found < 0.1 * start, "{start} -> {found}");
        assert!(shown[(SIDE / 2 * SIDE + SIDE / 2) as usize]);
        // The same bits for any number of threads.
        for threads in [2, 5] {
            assert_eq!(fitted(&frames, &none, threads).0, colors, "{threads} threads");
        }
        // A white square in one of nine photographs changes little. Its mean over all photographs would be off by a ninth.
        let marred = error(&fitted(&Pictures { highlight: true, ..frames }, &none, 1).0);
        assert!(marred < 1.3 * found + 0.004, "{found} -> {marred}");
    }

    #[test]
    fn the_cameras_of_a_run_replace_those_of_the_frames() {
        let refined = (0..COUNT).map(|i| (i.to_string(), camera(i))).collect();
        let frames = Pictures { highlight: false, astray: true };
        let [astray, found] = [HashMap::new(), refined].map(|cameras| error(&fitted(&frames, &cameras, 2).0));
        assert!(found < 0.2 * astray, "{astray} -> {found}");
    }

    #[test]
    fn a_fit_can_be_stopped_and_pixels_at_jumps_of_the_depth_are_left_out() {
        let (mut mesh, coordinates) = square();
        let fit = Fit { mesh: &mesh, coordinates: &coordinates, side: SIDE, threads: 1 };
        let mut calls = 0;
        let mut watch = |_| {
            calls += 1;
            calls < 3
        };
        let photographs =
            Photographs { frames: &Pictures { highlight: false, astray: false }, cameras: &HashMap::new() };
        let texels = (SIDE * SIDE) as usize;
        let stopped =
            fit.run(&photographs, &mut vec![[0.5; 3]; texels], &mut vec![false; texels], &mut watch);
        assert!(stopped.unwrap().is_none() && calls == 3);
        // A second square in front of the left half of the first.
        mesh.positions.extend([[0.0, -0.5, 0.0], [0.4, -0.5, 0.0], [0.4, -0.5, 1.0], [0.0, -0.5, 1.0]]);
        mesh.triangles.extend([[4, 5, 6], [4, 6, 7]]);
        let middle = camera(4);
        let samples = Samples::of(&mesh, &middle, SAMPLES).unwrap();
        let usable = usable(&samples, &middle, 48 * 48);
        let row = &usable[24 * 48..25 * 48];
        let k = middle.intrinsics;
        // The right edge of the front square, at x = 0.4, is seen 1.7 ahead.
        let edge = (k.cx + k.fx * (0.4 - 0.5) / 1.7) as usize;
        assert!(!row[edge] && !row[edge - BORDER] && !row[edge + BORDER]);
        assert!(row[edge - BORDER - 2] && row[edge + BORDER + 2], "{row:?}");
        assert!(!row[0] && !row[47], "nothing is there");
    }
}
