//! The error map (`train.error_map`), by which a step draws its pixels. Every photograph is divided into cells, the
//! same cells at every scale. Each cell holds the mean squared error of the pixels that were drawn in it. A fraction of
//! a step's pixels is drawn with a probability proportional to the square root of this error, which minimises the
//! variance of the gradient (importance sampling); the other pixels are drawn uniformly. The loss of a pixel is divided
//! by the pixel's probability, so that the expected gradient equals that of uniform draws.

use crate::{
    Advice, Config, Error, Result, View, ViewSet,
    engine::exposure::photographs,
    field::tensors::{Tensor, TensorFile},
    math::rng::below,
};

/// Prefix of the names of the error map's tensors in checkpoints.
pub const PREFIX: &str = "error_map.";

/// Side of a cell, in pixels of the finest scale, unless this would make more than [`MOST_CELLS`] cells.
const SIDE: u32 = 32;

/// Largest number of cells of all photographs together. Probabilities are multiples of 2^−32, and the probability of an
/// average cell is at least several thousand of these units.
const MOST_CELLS: u64 = 1 << 18;

/// Factor by which the sums of a cell decay at each update. With an update every 16 steps, their half-life is about 440
/// steps.
const DECAY: f32 = 0.975;

/// Prior of every cell: this number of pixels with the mean error is added to the pixels drawn in the cell.
const PRIOR: f64 = 2.0;

/// Fixed-point value of a squared error of 1 in the sums that devices accumulate.
pub const UNIT: f32 = 16_777_216.0;

/// Bound of a pixel's squared error; larger errors count as this value.
pub const MOST_ERROR: f32 = 16.0;

/// Sum of the squared errors of a cell's drawn pixels, in multiples of 1 / [`UNIT`], and the number of these pixels.
pub type CellErrors = [u64; 2];

/// The cells of a photograph.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Grid {
    /// Index of the first cell among those of all photographs.
    pub first: u32,
    /// Number of columns and rows of cells. The cells are numbered row by row.
    pub size: [u32; 2],
}

/// A drawn pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drawn {
    /// Index of the scale.
    pub scale: usize,
    /// Index of the pixel's view among the views of the scale.
    pub view: usize,
    /// Index of the pixel among the pixels of all views.
    pub pixel: usize,
    /// Probability of the pixel under a uniform draw from its scale, divided by its actual probability.
    pub importance: f32,
}

/// The cells of all photographs, their errors and probabilities.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorMap {
    /// One grid per photograph, in the order of the views of every scale.
    grids: Vec<Grid>,
    /// Number of pixels of each cell at the finest scale.
    areas: Vec<u32>,
    /// Σ squared error and number of drawn pixels of each cell, both decaying.
    sums: Vec<[f32; 2]>,
    /// For each cell, the smallest random number that selects it: 0 for the first cell. The range of the last cell ends
    /// at 2^32.
    starts: Vec<u32>,
    guide: Guide,
}

/// Lookup table from a random number to the neighbourhood of its cell (Chen and Asau 1974). The range of random numbers
/// is divided into equal parts, about as many as there are cells.
#[derive(Clone, Debug, Default, PartialEq)]
struct Guide {
    /// For each part, the cell that its first number selects.
    cells: Vec<u32>,
    /// A random number shifted right by this number of bits is the index of its part.
    shift: u32,
}

impl Guide {
    fn new(starts: &[u32]) -> Self {
        let parts = starts.len().next_power_of_two().max(2);
        let shift = u32::BITS - parts.ilog2();
        let mut cell = 0;
        let first_of = |part: usize| {
            while starts.get(cell as usize + 1).is_some_and(|&start| start <= (part as u32) << shift) {
                cell += 1;
            }
            cell
        };
        Self { cells: (0..parts).map(first_of).collect(), shift }
    }

    /// Returns the index of the last of the `starts` that is at most `bits`.
    #[inline]
    fn find(&self, starts: &[u32], bits: u32) -> usize {
        let part = (bits >> self.shift) as usize;
        let first = self.cells[part] as usize;
        let end = self.cells.get(part + 1).map_or(starts.len(), |&next| next as usize + 1);
        first + starts[first + 1..end].partition_point(|&start| start <= bits)
    }
}

/// Returns the pixels `[begin, end]` (`end` excluded) of part number `part` when a side of `pixels` pixels is divided
/// into `parts` parts.
#[inline]
fn part(pixels: u32, part: u32, parts: u32) -> [u32; 2] {
    [part, part + 1].map(|edge| (edge * pixels).div_ceil(parts))
}

/// Returns the squared error of a pixel (mean over channels), given the gradient of the pixel's loss with respect to
/// [r, g, b, opacity] and the pixel's weight. For the usual losses and a small colour difference, the result is the
/// squared colour difference.
#[inline]
pub fn error_of(gradient: [f32; 4], weight: f32) -> f32 {
    let [r, g, b, _] = gradient.map(|by| 3.0 * by / weight);
    let error = (r * r + g * g + b * b) / 3.0;
    // NaN counts as the largest error.
    if error < MOST_ERROR { error } else { MOST_ERROR }
}

/// Returns true if all scales show the same photographs in the same order.
pub fn same_photographs(views: &ViewSet) -> bool {
    let numbers = photographs(views);
    let mut scales = views.scales.iter().map(|scale| &numbers[scale.views.clone()]);
    scales.next().is_none_or(|finest| scales.all(|scale| scale == finest))
}

impl ErrorMap {
    /// Creates a uniform map of `views`, or returns `None` if the configuration never draws pixels by their errors.
    ///
    /// # Errors
    /// When the scales do not show the same photographs in the same order.
    pub fn new(config: &Config, views: &ViewSet) -> Result<Option<Self>> {
        let used = config.train.error_map.values().any(|fraction| fraction > 0.0);
        let Some(finest) = views.scales.first().filter(|_| used) else { return Ok(None) };
        if !same_photographs(views) {
            return Err(Error::input(
                "train.error_map",
                "the scales of the data set show different photographs",
                "set train.error_map to 0, or give every photograph at every scale",
            ));
        }
        let size = |view: &View| [view.camera.intrinsics.width, view.camera.intrinsics.height];
        let count = finest.views.len();
        // A photograph gets at most as many columns and rows of cells as it has columns and rows of pixels at its
        // smallest scale, so that no cell is empty at any scale.
        let least: Vec<[u32; 2]> = (0..count)
            .map(|i| {
                let sizes = views.scales.iter().map(|scale| size(&views.views[scale.views.start + i]));
                sizes.fold([u32::MAX; 2], |[w, h], [x, y]| [w.min(x), h.min(y)])
            })
            .collect();
        let divided = |side: u32| -> Vec<[u32; 2]> {
            let sizes = views.views[finest.views.clone()].iter().map(size).zip(&least);
            sizes.map(|(size, least)| [0, 1].map(|i| size[i].div_ceil(side).min(least[i]))).collect()
        };
        let cells = |sizes: &[[u32; 2]]| sizes.iter().map(|[x, y]| u64::from(x * y)).sum::<u64>();
        let mut side = SIDE;
        while cells(&divided(side)) > MOST_CELLS.max(count as u64) {
            side *= 2;
        }
        let mut map = Self {
            grids: Vec::new(),
            areas: Vec::new(),
            sums: Vec::new(),
            starts: Vec::new(),
            guide: Guide::default(),
        };
        for (view, [columns, rows]) in views.views[finest.views.clone()].iter().zip(divided(side)) {
            map.grids.push(Grid { first: map.areas.len() as u32, size: [columns, rows] });
            let [width, height] = size(view);
            let along = |pixels, parts| move |i| part(pixels, i, parts);
            for [top, bottom] in (0..rows).map(along(height, rows)) {
                let widths = (0..columns).map(along(width, columns));
                map.areas.extend(widths.map(|[left, right]| (right - left) * (bottom - top)));
            }
        }
        map.sums = vec![[0.0; 2]; map.areas.len()];
        map.follow(0.0);
        Ok(Some(map))
    }

    /// Returns the number of cells.
    pub fn len(&self) -> usize {
        self.areas.len()
    }

    /// Returns true if the map has no cells.
    pub fn is_empty(&self) -> bool {
        self.areas.is_empty()
    }

    /// Returns the cells of each photograph, in the order of the views of every scale.
    pub fn grids(&self) -> &[Grid] {
        &self.grids
    }

    /// Returns the smallest random number that selects each cell, rising from 0.
    pub fn starts(&self) -> &[u32] {
        &self.starts
    }

    /// Adds the errors of the last steps, one entry per cell, to the decayed sums, and updates the probabilities. The
    /// fraction `fraction` of later pixels is drawn by the errors, the others uniformly.
    pub fn update(&mut self, errors: &[CellErrors], fraction: f64) {
        for (sums, &[error, count]) in self.sums.iter_mut().zip(errors) {
            *sums = [DECAY * sums[0] + error as f32 / UNIT, DECAY * sums[1] + count as f32];
        }
        self.follow(fraction);
    }

    /// Sets the probabilities of the cells from their errors.
    fn follow(&mut self, fraction: f64) {
        let sum = |i: usize| self.sums.iter().map(|sums| f64::from(sums[i])).sum::<f64>();
        let mean = sum(0) / sum(1).max(1.0);
        let by_error = |(&area, &[error, count]): (&u32, &[f32; 2])| {
            f64::from(area) * ((f64::from(error) + PRIOR * mean) / (f64::from(count) + PRIOR)).sqrt()
        };
        let weights: Vec<f64> = self.areas.iter().zip(&self.sums).map(by_error).collect();
        let all: f64 = weights.iter().sum();
        let area = self.areas.iter().map(|&area| f64::from(area)).sum::<f64>();
        // Without errors, the probabilities are uniform.
        let fraction = if all > 0.0 { fraction } else { 0.0 };
        let (mut before, range) = (0.0, f64::from(u32::MAX) + 1.0);
        self.starts.clear();
        let cells = self.areas.len() as u32;
        for ((i, &own), weight) in (0..).zip(&self.areas).zip(weights) {
            // At least one random number selects each cell, so that even a tiny cell can be drawn.
            let least = self.starts.last().map_or(0, |last| last + 1);
            let most = u32::MAX - (cells - 1 - i);
            self.starts.push(((range * before).round() as u32).max(least).min(most));
            before +=
                (1.0 - fraction) * f64::from(own) / area + fraction * weight / all.max(f64::MIN_POSITIVE);
        }
        self.guide = Guide::new(&self.starts);
    }

    /// Returns the cell that a random number selects.
    #[inline]
    pub fn cell(&self, bits: u32) -> usize {
        self.guide.find(&self.starts, bits)
    }

    /// Draws a pixel from the views of a scale with `count` pixels, given random numbers. Returns the pixel's view, its
    /// index among all pixels, and its importance.
    #[inline]
    pub fn draw(&self, views: &[View], count: usize, bits: [u32; 4]) -> (usize, usize, f32) {
        let cell = self.cell(bits[0]);
        let photograph = self.grids.partition_point(|grid| grid.first as usize <= cell) - 1;
        let (grid, view) = (self.grids[photograph], &views[photograph]);
        let within = cell as u32 - grid.first;
        let at = [within % grid.size[0], within / grid.size[0]];
        let size = [view.camera.intrinsics.width, view.camera.intrinsics.height];
        let [[left, right], [top, bottom]] = [0, 1].map(|i| part(size[i], at[i], grid.size[i]));
        let x = left + below(bits[1], right - left);
        let y = top + below(bits[2], bottom - top);
        // If there is only one cell, the width is 2^32.
        let width = match self.starts.get(cell + 1) {
            Some(&next) => (next - self.starts[cell]) as f32,
            None => (u64::from(u32::MAX) + 1 - u64::from(self.starts[cell])) as f32,
        };
        let area = ((right - left) * (bottom - top)) as f32;
        (photograph, view.offset + (y * size[0] + x) as usize, area / width * per_pixel(count))
    }

    /// Adds the tensors from which training resumes to `file`; `pending` holds the errors since the last update.
    pub(crate) fn to_tensors(&self, pending: &[CellErrors], file: &mut TensorFile) {
        let words = |values: &[u32]| Tensor::u8(&[values.len(), 4], bytemuck::cast_slice(values).to_vec());
        let sums = Tensor::f32(&[self.len(), 2], self.sums.as_flattened().to_vec());
        let pending: Vec<u8> = pending.as_flattened().iter().flat_map(|value| value.to_le_bytes()).collect();
        file.tensors.insert(format!("{PREFIX}sums"), sums);
        file.tensors.insert(format!("{PREFIX}starts"), words(&self.starts));
        file.tensors.insert(format!("{PREFIX}pending"), Tensor::u8(&[self.len(), 16], pending));
    }

    /// Reads the map, with the errors since its last update, from a checkpoint of a run on the same photographs; `name`
    /// names the checkpoint in errors.
    pub(crate) fn restored(&self, file: &TensorFile, name: &str) -> Result<(Self, Vec<CellErrors>)> {
        let tensor = |of: &str| format!("{PREFIX}{of}");
        let sums = file.f32(name, &tensor("sums"), &[self.len(), 2])?.as_chunks().0.to_vec();
        let starts = file.u8(name, &tensor("starts"), &[self.len(), 4])?;
        let starts: Vec<u32> = starts.as_chunks().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect();
        let pending = file.u8(name, &tensor("pending"), &[self.len(), 16])?;
        let pending: Vec<u64> =
            pending.as_chunks().0.iter().map(|bytes| u64::from_le_bytes(*bytes)).collect();
        let rising = starts.first() == Some(&0) && starts.is_sorted_by(|a, b| a < b);
        let finite =
            |sums: &Vec<[f32; 2]>| sums.as_flattened().iter().all(|sum| sum.is_finite() && *sum >= 0.0);
        if !rising || !finite(&sums) {
            return Err(Error::input(
                name,
                "its error map is invalid: the file is damaged",
                Advice::StartOver,
            ));
        }
        let guide = Guide::new(&starts);
        Ok((Self { sums, starts, guide, ..self.clone() }, pending.as_chunks().0.to_vec()))
    }
}

/// Returns 2^32 / `count`: a uniform draw assigns a range of this many random numbers to each of the `count` pixels of
/// a scale.
#[inline]
pub fn per_pixel(count: usize) -> f32 {
    4_294_967_300.0 / count as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Alpha, Camera, Intrinsics, Scale,
        config::schedule::Schedule,
        math::rng::{Random, Sequence},
    };
    use glam::DVec3;

    /// Returns photographs of these sizes at two scales; sides at the coarse scale are rounded-up halves.
    fn views(sizes: &[[u32; 2]]) -> ViewSet {
        let (mut views, mut scales, mut offset) = (Vec::new(), Vec::new(), 0);
        for factor in [1, 2] {
            let before = (views.len(), offset);
            for (i, size) in sizes.iter().enumerate() {
                let [width, height] = size.map(|side| side.div_ceil(factor));
                let intrinsics = Intrinsics::from_angle(width, height, 0.7);
                let camera = Camera::look_at(intrinsics, DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z);
                views.push(View { name: i.to_string(), camera, offset });
                offset += (width * height) as usize;
            }
            let weight = (factor * factor) as f32;
            scales.push(Scale { factor, weight, views: before.0..views.len(), pixels: before.1..offset });
        }
        let pixels = vec![[0; 4]; offset].into();
        ViewSet { views, pixels, alpha: Alpha::Straight, scales, depths: Vec::new() }
    }

    fn map(views: &ViewSet) -> ErrorMap {
        let mut config = Config::default();
        config.train.error_map = Schedule::new(vec![[0.0, 0.5]]);
        ErrorMap::new(&config, views).unwrap().unwrap()
    }

    /// Returns errors that rise with the square of the cell's number.
    fn errors(map: &ErrorMap) -> Vec<CellErrors> {
        (0..map.len() as u64).map(|i| [(i * i + 1) * UNIT as u64, 1000]).collect()
    }

    #[test]
    fn no_map_is_made_where_none_is_used() {
        assert_eq!(ErrorMap::new(&Config::default(), &views(&[[8, 8]])).unwrap(), None);
    }

    /// Checks that pixels are drawn with a frequency inversely proportional to their importance, so that weighted draws
    /// count all pixels equally.
    #[test]
    fn pixels_are_drawn_by_their_importance() {
        let views = views(&[[70, 40], [33, 5], [1, 1]]);
        let mut map = map(&views);
        assert_eq!(map.len(), 3 * 2 + 2 + 1);
        map.update(&errors(&map), 0.8);
        for scale in &views.scales {
            let (count, draws) = (scale.pixels.len(), 2_000_000);
            let (mut found, mut importances) = (vec![0; count], vec![0.0; count]);
            let random = Random::new(3).at(Sequence::Pixel, 5);
            for index in 0..draws {
                let (view, pixel, importance) =
                    map.draw(&views.views[scale.views.clone()], count, random.bits(index));
                assert_eq!(views.views[scale.views.clone()].partition_point(|v| v.offset <= pixel) - 1, view);
                let own = pixel - scale.pixels.start;
                found[own] += 1;
                importances[own] = f64::from(importance);
            }
            for (pixel, (&found, importance)) in found.iter().zip(importances).enumerate() {
                let expected = f64::from(draws) / count as f64 / importance;
                assert!(
                    (f64::from(found) - expected).abs() < 5.5 * expected.sqrt(),
                    "{pixel}: {found}, not {expected}"
                );
            }
        }
    }

    #[test]
    fn a_cell_is_the_last_that_starts_before_its_number() {
        let random = Random::new(4).at(Sequence::Pixel, 1);
        for count in [1, 2, 3, 64, 1000] {
            // Gaps between starts range from one number to many parts.
            let mut starts: Vec<u32> = (0..count).map(|i| random.bits(i)[0] >> (i % 29)).collect();
            starts[0] = 0;
            starts.sort_unstable();
            starts.dedup();
            let guide = Guide::new(&starts);
            let near =
                starts.iter().flat_map(|&start| [start.saturating_sub(1), start, start.saturating_add(1)]);
            for bits in near.chain((0..500).map(|i| random.bits(i)[1])).chain([0, u32::MAX]) {
                let expected = starts.iter().rposition(|&start| start <= bits).unwrap();
                assert_eq!(guide.find(&starts, bits), expected, "{bits} among {count}");
            }
        }
    }

    /// Checks the probabilities against the rule written out: a fraction of the pixels is drawn uniformly, the others
    /// in proportion to area times root mean squared error.
    #[test]
    fn cells_have_the_probabilities_of_their_errors() {
        let views = views(&[[70, 40], [33, 5], [1, 1]]);
        let mut map = map(&views);
        let even = map.clone();
        map.update(&errors(&map), 0.0);
        assert_eq!(map.starts(), even.starts());
        map.update(&vec![[0; 2]; map.len()], 0.8);
        let areas: Vec<f64> = map.areas.iter().map(|&area| f64::from(area)).collect();
        assert_eq!(areas.iter().sum::<f64>(), views.scales[0].pixels.len() as f64);
        let mean = (0..9).map(|i| f64::from(i * i + 1)).sum::<f64>() / 9000.0;
        let root = |i: usize| (((0.975 * (i * i + 1) as f64) + 2.0 * mean) / 977.0).sqrt();
        let all: f64 = (0..9).map(|i| areas[i] * root(i)).sum();
        let ends = map.starts().iter().skip(1).map(|&start| f64::from(start)).chain([4_294_967_296.0]);
        for (i, (&start, end)) in map.starts().iter().zip(ends).enumerate() {
            let found = (end - f64::from(start)) / 4_294_967_296.0;
            let even = areas[i] / areas.iter().sum::<f64>();
            let expected = 0.2 * even + 0.8 * areas[i] * root(i) / all;
            assert!((found / expected - 1.0).abs() < 1e-5, "cell {i}: {found}, not {expected}");
        }
    }

    #[test]
    fn scales_of_other_photographs_are_refused() {
        let mut views = views(&[[8, 8], [8, 8]]);
        views.views[3].name = "another".into();
        let mut config = Config::default();
        config.train.error_map = Schedule::new(vec![[0.0, 0.0], [0.5, 0.5]]);
        let error = ErrorMap::new(&config, &views).unwrap_err().to_string();
        assert!(error.contains("train.error_map"), "{error}");
    }

    /// Checks that cells can be drawn whose probability is below 2^−32, at both ends of the range of random numbers.
    #[test]
    fn tiny_cells_can_be_drawn() {
        let views = views(&[[1, 1], [1, 1], [1, 1], [9, 9], [1, 1], [1, 1], [1, 1]]);
        let mut map = map(&views);
        let errors: Vec<CellErrors> = (0..7).map(|i| [u64::from(i == 3) << 63, 1 << 60]).collect();
        map.update(&errors, 1.0);
        let starts = map.starts();
        assert!(starts[0] == 0 && starts.is_sorted_by(|a, b| a < b), "{starts:?}");
        assert_eq!((map.cell(2), map.cell(1 << 31), map.cell(u32::MAX)), (2, 3, 6));
    }

    #[test]
    fn large_sets_have_larger_cells() {
        let many = views(&vec![[640, 480]; 1000]);
        let map = map(&many);
        assert!(map.len() as u64 <= MOST_CELLS && map.len() >= 1000 * 20, "{}", map.len());
    }

    #[test]
    fn a_checkpoint_has_the_whole_state() {
        let views = views(&[[70, 40], [33, 5]]);
        let (mut map, new) = (map(&views), map(&views));
        map.update(&errors(&map), 0.7);
        let pending: Vec<CellErrors> = (0..map.len() as u64).map(|i| [u64::MAX - i, i << 40]).collect();
        let mut file = TensorFile::default();
        map.to_tensors(&pending, &mut file);
        assert_eq!(new.restored(&file, "checkpoint").unwrap(), (map, pending));
        let starts = file.tensors.get_mut("error_map.starts").unwrap();
        *starts = Tensor::u8(&starts.shape.clone(), vec![0; 4 * new.len()]);
        assert!(new.restored(&file, "checkpoint").is_err());
    }

    #[test]
    fn errors_are_those_of_colours() {
        assert!((error_of([0.2, -0.1, 0.4, 9.0], 2.0) - 2.25 * (0.04 + 0.01 + 0.16) / 3.0).abs() < 1e-6);
        for gradient in [[f32::NAN; 4], [f32::INFINITY; 4], [1e30; 4]] {
            assert_eq!(error_of(gradient, 1.0), MOST_ERROR);
        }
    }
}
