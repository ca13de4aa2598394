//! Known depths of the training views from their depth images. A dense image contributes only the pixels of a grid: the
//! rays of the other pixels would hit the same surfaces again.

use crate::{
    depth_image::{DepthImage, Depths},
    depths::{nearest, pixel},
    points::Observation,
    settings::DataConfig,
    source::{Source, map_in_order},
};
use glam::DVec3;
use std::ops::RangeInclusive;
use trimip_core::{
    Error, Result, Scale, ViewSet, geometry::projections::Model, plural::count, scene::depths::KnownDepth,
};

/// Most known pixels of a view at each scale, 64 × 64: the occupancy grid has no more cells across a picture, so these
/// rays reach the surfaces in all of its cells.
const MOST_OF_VIEW: usize = 1 << 12;

/// Most known pixels of a scene; their depths take 24 MB.
const MOST_OF_SCENE: usize = 1 << 21;

/// Least standard deviation of a depth, as a share of the distance: an assumption for the sensors of phones, whose files state no accuracy.
const DEVIATION: f64 = 0.02;

/// Largest relative difference between neighbouring depths of one surface. At an edge between two surfaces, a depth may lie on neither.
const EDGE: f64 = 0.03;

/// Most samples of a pixel's neighbourhood on each side of the pixel, along each axis.
const MOST_PLACES: u32 = 4;

/// Usual range of the ratio of the median depth to the extent of the cameras. Outside of this range, the unit of the depths is in doubt.
const USUAL: RangeInclusive<f64> = 0.01..=100.0;

/// The depth images of the training views, before they are decoded.
#[derive(Debug, Default)]
pub(crate) struct DepthImages {
    /// One per training frame; `None` for a frame without a depth image.
    images: Vec<Option<DepthImage>>,
    warnings: Vec<String>,
}

/// The result of reading all depth images.
#[derive(Debug, Default)]
pub(crate) struct Known {
    /// Known depths, sorted by pixel.
    pub(crate) depths: Vec<KnownDepth>,
    /// A line of the description about the images; `None` if there are none.
    pub(crate) note: Option<String>,
    pub(crate) warnings: Vec<String>,
}

impl DepthImages {
    /// Reads the headers of the depth images of all training frames.
    ///
    /// # Errors
    /// Of kind `Input`: more than half of the files are missing, or a file is not a depth image of its photograph.
    pub(crate) fn find(config: &DataConfig, sources: &[Source]) -> Result<Self> {
        let mut warnings = Vec::new();
        let stated = sources.iter().filter(|source| source.depth.is_some()).count();
        if !config.depths || stated == 0 {
            return Ok(Self::default());
        }
        let missing: Vec<&Source> = sources.iter().filter(|source| is_missing(source)).collect();
        if let [first, ..] = missing[..]
            && let (Some(file), [photograph, ..]) = (&first.depth, first.files())
        {
            let of = count(stated, "depth image");
            if 2 * missing.len() > stated {
                let path = file.path().display();
                let what =
                    format!("depth image {path} does not exist ({} of {of} are missing)", missing.len());
                let advice = "copy them there, or set data.depths = false";
                return Err(Error::input(&photograph.place, what, advice));
            }
            warnings.push(format!(
                "{} of {of} are missing, the first is {}",
                missing.len(),
                file.path().display()
            ));
        }
        let fisheyes = sources.iter().filter(|source| source.depth.is_some() && is_fisheye(source)).count();
        if fisheyes > 0 {
            warnings.push(format!(
                "{} of fisheye lenses are not read: nothing states whether they hold depths or distances",
                count(fisheyes, "depth image")
            ));
        }
        let images = map_in_order(sources, |_, source| match (&source.depth, source.files()) {
            (Some(file), [photograph, ..]) if !is_missing(source) && !is_fisheye(source) => {
                DepthImage::open(file, photograph).map(Some)
            }
            _ => Ok(None),
        })?;
        Ok(Self { images, warnings })
    }

    /// Reads the depth images in parallel, and finds the known depths at all scales of `train`, whose views are those of `sources`.
    ///
    /// # Errors
    /// Of kind `Input`, if a depth image cannot be decoded.
    pub(crate) fn known(&self, sources: &[Source], train: &ViewSet) -> Result<Known> {
        let images = self.images.iter().flatten().count();
        if images == 0 {
            return Ok(Known { warnings: self.warnings.clone(), ..Known::default() });
        }
        let scales: Vec<&Scale> =
            train.scales.iter().filter(|scale| scale.views.len() == sources.len()).collect();
        let most = MOST_OF_VIEW.min(MOST_OF_SCENE / (images * scales.len().max(1))).max(1);
        let found = map_in_order(&self.images, |view, image| match image {
            Some(image) => {
                Ok(Some(Seen { train, scales: &scales, view, source: &sources[view] }.of(image, most)?))
            }
            None => Ok(None),
        })?;
        let mut warnings = self.warnings.clone();
        let empty = |(_, found): &(&Source, &Option<OfImage>)| {
            found.as_ref().is_some_and(|found| found.known.is_empty())
        };
        let empty: Vec<&Source> =
            sources.iter().zip(&found).filter(empty).map(|(source, _)| source).collect();
        if let [first, ..] = empty[..] {
            warnings.push(format!(
                "{} of {} hold no depth, the first that of {}: 0 marks an unknown depth",
                empty.len(),
                count(images, "depth image"),
                first.name
            ));
        }
        let depths: Vec<f64> = found.iter().flatten().flat_map(|found| &found.depths).copied().collect();
        warnings.extend(other_unit(depths, sources));
        let depths = nearest(found.into_iter().flatten().flat_map(|found| found.known).collect());
        let mut sizes: Vec<[u32; 2]> = self.images.iter().flatten().map(|image| image.size).collect();
        sizes.sort_unstable();
        sizes.dedup();
        let size = match sizes[..] {
            [[width, height]] => format!("{width}x{height}"),
            _ => format!("of {} sizes", sizes.len()),
        };
        let note = format!(
            "depth images of {images} of {}, {size}: the rays of {} end at known distances",
            count(sources.len(), "training view"),
            count(depths.len(), "pixel"),
        );
        Ok(Known { depths, note: Some(note), warnings })
    }
}

fn is_missing(source: &Source) -> bool {
    source.depth.as_ref().is_some_and(|file| !file.path().is_file())
}

/// Returns true for a fisheye lens, whose depth images nerfstudio reads as distances along the ray, other programs as
/// depths along the optical axis.
fn is_fisheye(source: &Source) -> bool {
    source.views.iter().any(|(_, camera)| camera.intrinsics.lens.model == Model::Fisheye)
}

/// A training view at all scales.
struct Seen<'a> {
    train: &'a ViewSet,
    scales: &'a [&'a Scale],
    /// Index of the view among those of a scale.
    view: usize,
    source: &'a Source,
}

/// The result of reading one depth image.
struct OfImage {
    known: Vec<KnownDepth>,
    /// Depths along the optical axis of the chosen pixels, world units.
    depths: Vec<f64>,
}

impl Seen<'_> {
    /// Finds the known depths of a view at each scale, from at most `most` pixels of its image.
    fn of(&self, image: &DepthImage, most: usize) -> Result<OfImage> {
        let depths = image.decode()?;
        let mut found = OfImage { known: Vec::new(), depths: Vec::new() };
        let [photograph, ..] = self.source.files() else { return Ok(found) };
        // Pixels of the photograph per pixel of the depth image, along x and y.
        let [width, height] = depths.size;
        let steps = [
            f64::from(photograph.width) / f64::from(width),
            f64::from(photograph.height) / f64::from(height),
        ];
        let finest = f64::from(1_u32 << self.source.halvings);
        let reach = |scale: &Scale| {
            steps.map(|step| {
                let half = 0.5 * f64::from(scale.factor) * finest / step;
                half.ceil().clamp(1.0, f64::from(u16::MAX)) as u32
            })
        };
        let reaches: Vec<[u32; 2]> = self.scales.iter().map(|scale| reach(scale)).collect();
        let Some(least) = reaches.first() else { return Ok(found) };
        for [x, y] in chosen(&depths, *least, most) {
            let Some(depth) = depths.at([x, y]) else { continue };
            found.depths.push(depth);
            let place = |at: u32, step: f64| (f64::from(at) + 0.5) * step / finest;
            let at = [place(x, steps[0]), place(y, steps[1])];
            let seen = Observation { view: self.view as u32, at };
            for (scale, reach) in self.scales.iter().zip(&reaches) {
                let smooth = reach == least || is_smooth(&depths, [x, y], *reach);
                found.known.extend(smooth.then(|| self.known(scale, &seen, depth)).flatten());
            }
        }
        Ok(found)
    }

    /// Returns the known depth of the pixel of `scale` that contains the observation `seen`, whose depth along the optical axis is `depth`.
    fn known(&self, scale: &Scale, seen: &Observation, depth: f64) -> Option<KnownDepth> {
        let pixel = pixel(self.train, scale, seen)?;
        let view = &self.train.views[scale.views.start + self.view];
        let (within, width) = (pixel - view.offset as u32, view.camera.intrinsics.width);
        let cone = view.camera.cone::<f64>(within % width, within / width);
        if cone.is_none() || cone.cosine <= 0.0 {
            return None;
        }
        let distance = depth / cone.cosine;
        Some(KnownDepth { pixel, distance: distance as f32, deviation: (DEVIATION * distance) as f32 })
    }
}

/// Chooses pixels of a depth image, one in each cell of a grid of at most `most` cells: the first pixel whose depth is
/// known and that lies on one surface. The search runs in row order from the middle of the cell and wraps around.
fn chosen(depths: &Depths, reach: [u32; 2], most: usize) -> Vec<[u32; 2]> {
    let [width, height] = depths.size;
    let cells = |side: u32| [width.div_ceil(side), height.div_ceil(side)];
    let fits = |side: &u32| cells(*side).iter().map(|&count| count as usize).product::<usize>() <= most;
    let side = (1..=width.max(height)).find(fits).unwrap_or(width.max(height));
    let [columns, rows] = cells(side);
    let of_cell = |cell: u32| {
        let [left, top] = [cell % columns * side, cell / columns * side];
        let [across, down] = [side.min(width - left), side.min(height - top)];
        let (all, middle) = (across * down, down / 2 * across + across / 2);
        let place = |i: u32| {
            let i = (middle + i) % all;
            [left + i % across, top + i / across]
        };
        (0..all).map(place).find(|at| is_smooth(depths, *at, reach))
    };
    (0..columns * rows).filter_map(of_cell).collect()
}

/// Returns true if the depth in a pixel is known, and no known depth within `reach` along each axis differs much from it.
fn is_smooth(depths: &Depths, [x, y]: [u32; 2], [across, down]: [u32; 2]) -> bool {
    let Some(own) = depths.at([x, y]) else { return false };
    let near = |at: u32, reach: u32, side: u32| {
        let step = reach.div_ceil(MOST_PLACES);
        (at.saturating_sub(reach)..=(at + reach).min(side - 1)).step_by(step as usize)
    };
    let [width, height] = depths.size;
    let differs = |other: f64| (other - own).abs() > EDGE * own.min(other);
    !near(y, down, height).any(|y| near(x, across, width).any(|x| depths.at([x, y]).is_some_and(differs)))
}

/// Returns a warning if depths are far smaller or larger than the extent of the cameras: they then probably have
/// another unit than the poses.
fn other_unit(mut depths: Vec<f64>, sources: &[Source]) -> Option<String> {
    let places = || sources.iter().filter_map(|source| source.views.first()).map(|(_, camera)| camera.origin);
    let (low, high) = places()
        .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), place| (low.min(place), high.max(place)));
    let extent = (high - low).length();
    if depths.is_empty() || !(extent > 0.0 && extent.is_finite()) {
        return None;
    }
    let middle = depths.len() / 2;
    let median = *depths.select_nth_unstable_by(middle, f64::total_cmp).1;
    let times = median / extent;
    if USUAL.contains(&times) {
        return None;
    }
    // The usual mistake is metres for millimetres or the reverse, so the factor is a power of 1000.
    let likely = 1e3_f64.powi(-(times.log10() / 3.0).round() as i32);
    Some(format!(
        "the median of the depth images is {median:.3e}, which is {times:.1e} times the extent of the cameras: \
         should depth_unit_scale_factor be {likely:e} times as large?"
    ))
}
