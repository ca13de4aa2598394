//! Checks silhouettes against poses: the visual hull of the training silhouettes, projected into every camera, should cover the
//! object in its photograph. Shuffled poses have no common hull; one wrong pose or mask disagrees with the hull of the others.

use super::{
    check::{Check, Suspect, Values, Verdict},
    views::{cameras, coarsest, median, of_views, sampled},
};
use glam::DVec3;
use rayon::prelude::*;
use trimip_core::{Aabb, Camera, ViewSet, scene::silhouettes::bounds_despite, scene_plan};

/// Median overlap below which the poses as a whole are doubted: correct poses reach above 0.9, shuffled ones 0.2 to 0.8.
const LEAST_MEDIAN: f64 = 0.7;

/// Median coverage below which the poses as a whole are doubted. Coverage is the share of a silhouette that the hull covers. The
/// hull of correct poses contains the object, so its coverage is above 0.95; for shuffled poses of a round object it is below 0.8.
const LEAST_MEDIAN_COVERED: f64 = 0.85;

/// A view's overlap is doubted below this share of the median, unless the hull covers more of its silhouette than
/// usual: then the hull is too large, because few other views look along a flat side.
const LEAST_SHARE: f64 = 0.8;

/// A view's coverage is doubted below this share of the median: the hull contains the object, whichever views carve it.
const LEAST_COVERED: f64 = 0.9;

/// If at least `DISSENT[0]` photographs see a cell of the hull, one in `DISSENT[1]` of them, but at least one, may show
/// background there. A single wrong view is then doubted instead of carving the hull of all views. More tolerance would
/// fill parts that only a few views along a flat side carve. If fewer photographs see the cell, all have to agree.
const DISSENT: [usize; 2] = [10, 32];

/// Least share of the views that see a place where the hull may be.
const COMMON: f64 = 0.5;

/// Cells along each side of the hull, which make its error a hundredth of the object.
const CELLS: usize = 80;

/// Largest number of silhouettes that carve the hull, evenly spread: more would change it by less than a cell.
const CARVERS: usize = 64;

/// Fewest silhouettes that give a useful hull.
const LEAST_VIEWS: usize = 4;

/// Least side of the compared images, pixels (see [`coarsest`]): it preserves thin parts of the object.
const SIDE: u32 = 128;

/// Largest number of pixels that are sampled along the longer side of a view, with one ray each.
const RAYS: u32 = 64;

/// Least alpha of a pixel that shows the object.
const OBJECT: u8 = 128;

const NAME: &str = "silhouettes and poses";

/// The silhouette of a photograph.
struct Mask<'a> {
    camera: Camera,
    pixels: &'a [[u8; 4]],
}

impl Mask<'_> {
    fn object(&self, x: u32, y: u32) -> bool {
        self.pixels[(y * self.camera.intrinsics.width + x) as usize][3] >= OBJECT
    }

    /// Returns true if the silhouette contains the projection of `point`, or `None` if that is outside of the image.
    fn at(&self, point: DVec3) -> Option<bool> {
        let k = &self.camera.intrinsics;
        let [x, y] = k.image_of(self.camera.rotation.transpose() * (point - self.camera.origin))?;
        let inside = (0.0..f64::from(k.width)).contains(&x) && (0.0..f64::from(k.height)).contains(&y);
        inside.then(|| self.object(x as u32, y as u32))
    }

    /// Returns the overlap of the silhouette and the hull as this camera sees it, or `None` if both are empty.
    fn overlap(&self, hull: &Hull) -> Option<Overlap> {
        let k = &self.camera.intrinsics;
        let (mut both, mut either, mut own) = (0_u32, 0_u32, 0_u32);
        for (x, y) in sampled(k.width, k.height, RAYS) {
            let cone = self.camera.cone::<f64>(x, y);
            // The lens has no ray for this pixel.
            if cone.is_none() {
                continue;
            }
            let (shown, met) = (self.object(x, y), hull.meets(cone.origin, cone.direction));
            both += u32::from(shown && met);
            either += u32::from(shown || met);
            own += u32::from(shown);
        }
        let fraction = |of: u32| if of == 0 { 0.0 } else { f64::from(both) / f64::from(of) };
        (either > 0).then(|| Overlap { union: fraction(either), covered: fraction(own) })
    }
}

/// The intersection of a silhouette and the projected hull.
#[derive(Clone, Copy, Default)]
struct Overlap {
    /// As a share of their union (IoU).
    union: f64,
    /// As a share of the silhouette.
    covered: f64,
}

/// The visual hull: the cells of a box, x fastest.
struct Hull {
    aabb: Aabb<f64>,
    inside: Vec<bool>,
}

impl Hull {
    fn new(aabb: Aabb<f64>, masks: &[&Mask<'_>]) -> Self {
        let side = aabb.extent().map(|side| side / CELLS as f64);
        let most = dissent(masks.len());
        let kept = |cell: usize| {
            let index = [cell % CELLS, cell / CELLS % CELLS, cell / CELLS / CELLS];
            let at: [f64; 3] = std::array::from_fn(|i| aabb.min[i] + (index[i] as f64 + 0.5) * side[i]);
            let (mut seen, mut against) = (0_usize, 0_usize);
            for shown in masks.iter().filter_map(|mask| mask.at(DVec3::from_array(at))) {
                seen += 1;
                against += usize::from(!shown);
                if against > most {
                    return false;
                }
            }
            seen >= 2 && against <= dissent(seen)
        };
        let inside = (0..CELLS.pow(3)).into_par_iter().map(kept).collect();
        Self { aabb, inside }
    }

    /// Returns true if a ray meets a cell of the hull; steps are half a cell.
    fn meets(&self, origin: [f64; 3], direction: [f64; 3]) -> bool {
        let (enter, leave) = self.aabb.intersect(origin, direction);
        let extent = self.aabb.extent();
        let step = 0.5 * extent.iter().copied().fold(f64::INFINITY, f64::min) / CELLS as f64;
        // The bound keeps the number of steps finite if the box is flat, so that steps have no length, or if the ray's
        // length is not finite.
        let steps = ((leave - enter) / step).ceil().clamp(0.0, 1e4) as usize;
        (0..steps).any(|i| {
            let t = enter + (i as f64 + 0.5) * step;
            let [x, y, z] = std::array::from_fn(|axis| {
                let fraction = (origin[axis] + t * direction[axis] - self.aabb.min[axis]) / extent[axis];
                ((fraction * CELLS as f64).max(0.0) as usize).min(CELLS - 1)
            });
            self.inside[(z * CELLS + y) * CELLS + x]
        })
    }
}

/// Returns how many of `seeing` photographs may show background at a cell of the hull.
fn dissent(seeing: usize) -> usize {
    let [least, each] = DISSENT;
    if seeing < least { 0 } else { (seeing / each).max(1) }
}

/// Checks the silhouettes of the training views against their poses.
pub fn silhouettes(train: &ViewSet) -> Check {
    let limit = format!(
        "a median overlap (intersection over union) below {LEAST_MEDIAN} or a median coverage below \
         {LEAST_MEDIAN_COVERED}: right poses have above 0.9 of both; a view whose overlap is below {LEAST_SHARE} of \
         the median and that the hull covers less than usual, or one with less than {LEAST_COVERED} of the median coverage"
    );
    let Some(scale) = coarsest(train, SIDE).filter(|_| train.alpha.is_opacity()) else {
        return Check::unknown(NAME, limit, "the photographs have no silhouettes");
    };
    let mask = |view: usize| Mask { camera: train.views[view].camera, pixels: train.pixels_of(view) };
    let all: Vec<Mask<'_>> = scale.views.clone().map(mask).collect();
    let carves = |mask: &&Mask<'_>| mask.pixels.iter().any(|pixel| pixel[3] < OBJECT);
    let masks: Vec<&Mask<'_>> = all.iter().filter(carves).collect();
    if masks.len() < LEAST_VIEWS {
        return Check::unknown(NAME, limit, "fewer than four photographs have silhouettes");
    }
    let own = cameras(train);
    let distances = |focus: DVec3| own.iter().map(move |camera| (camera.origin - focus).length());
    let found = scene_plan::focus(&own).and_then(|focus| Some((focus, median(distances(focus))?)));
    let Some((focus, half)) = found.filter(|(_, half)| half.is_normal()) else {
        return Check::unknown(NAME, limit, "the cameras look at no common place");
    };
    let cube = Aabb { min: (focus - half).to_array(), max: (focus + half).to_array() };
    let wrong = dissent(masks.len()) as f64 / masks.len() as f64;
    let region = bounds_despite(train, &cube, COMMON, wrong);
    let overlaps: Vec<Option<Overlap>> = match region {
        Some(region) => {
            let stride = masks.len().div_ceil(CARVERS);
            let carvers: Vec<&Mask<'_>> = masks.iter().step_by(stride).copied().collect();
            let hull = Hull::new(region, &carvers);
            all.par_iter().map(|mask| carves(&mask).then(|| mask.overlap(&hull)).flatten()).collect()
        }
        // No place lies in all silhouettes.
        None => all.iter().map(|mask| carves(&mask).then(Overlap::default)).collect(),
    };
    let column = |of: fn(Overlap) -> f64| overlaps.iter().map(|known| known.map(of)).collect::<Vec<_>>();
    let (unions, covered) = (column(|overlap| overlap.union), column(|overlap| overlap.covered));
    let [middle, usual] = [&unions, &covered].map(|of| median(of.iter().copied().flatten()).unwrap_or(0.0));
    let low = middle < LEAST_MEDIAN || usual < LEAST_MEDIAN_COVERED;
    let apart = |own: &Overlap| {
        let disagrees = own.union < LEAST_SHARE * middle && own.covered < usual;
        disagrees || own.covered < LEAST_COVERED * usual
    };
    let known = overlaps.iter().enumerate().filter_map(|(view, own)| Some((view, (*own)?)));
    let mut doubted: Vec<(usize, Overlap)> = known.filter(|(_, own)| !low && apart(own)).collect();
    doubted.sort_by(|a, b| a.1.union.total_cmp(&b.1.union));
    let verdict = match (low, doubted.is_empty()) {
        (true, _) => Verdict::Suspicious(
            "the poses do not belong to these photographs: compare the order of names and poses, and the axes (OpenGL: x \
             right, y up, looking along -z)",
        ),
        (false, false) => Verdict::Suspicious("look at these views: each has a wrong pose or a wrong mask"),
        (false, true) => Verdict::Fine,
    };
    let all_views = format!(
        "the silhouettes overlap with their visual hull by {middle:.2}, and the hull covers {:.0} % of them (medians)",
        100.0 * usual
    );
    let figure = match doubted.len() {
        0 => all_views,
        some => format!("{all_views}; much less in {}", of_views(some, all.len())),
    };
    let suspect = |(view, own): (usize, Overlap)| Suspect {
        view,
        figure: format!("{:.2}, {:.0} % covered", own.union, 100.0 * own.covered),
    };
    Check {
        name: NAME,
        figure,
        limit,
        verdict,
        suspects: doubted.into_iter().map(suspect).collect(),
        values: vec![
            Values { name: "overlap with the hull", of: unions },
            Values { name: "covered by the hull", of: covered },
        ],
    }
}
