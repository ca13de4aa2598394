//! A plane sweep (Collins, A space-sweep approach to true multi-image matching, 1996) over planes perpendicular to the cameras'
//! viewing direction. The plane that the cameras see is the one on which neighbouring photographs have the same colours.

use crate::scene::strays::strays;
use crate::{Camera, Scale, ViewSet};
use glam::DVec3;

/// Largest side of the pictures that are compared, pixels.
const SIDE: u32 = 96;

/// Number of pictures, and number of neighbours that each picture is compared with.
const PICTURES: usize = 8;
const NEIGHBOURS: usize = 4;

/// Number of places along each side of a picture whose colours are compared.
const PLACES: u32 = 16;

/// Ratio of the distance of each plane to that of the plane before.
const STEP: f64 = 1.05;

/// Share of a picture's part of the nearest plane that a neighbouring picture shows too, and number of pixels by which the
/// farthest plane shifts between neighbours.
const LEAST_SHARED: f64 = 0.2;
const LEAST_PIXELS: f64 = 1.0;

/// A plane counts as seen if the difference of its colours is less than this share of the median over all planes.
const AGREES: f64 = 0.6;

/// A camera and its picture: mean colours of blocks of pixels.
struct Picture {
    camera: Camera,
    colors: Vec<[f64; 4]>,
}

impl Picture {
    /// Reduces view `index` so that its longer side has at most [`SIDE`] pixels.
    fn of(views: &ViewSet, index: usize) -> Self {
        let camera = views.views[index].camera;
        let longer = camera.intrinsics.width.max(camera.intrinsics.height);
        let level = (0..u32::BITS).find(|level| longer >> level <= SIDE).unwrap_or(0);
        let camera = Camera { intrinsics: camera.intrinsics.reduced(level), ..camera };
        Self { camera, colors: views.means(index, 1 << level) }
    }

    /// Returns the colour of a place of the world; `None` if the place is not in the picture.
    fn color(&self, place: DVec3) -> Option<[f64; 4]> {
        let k = &self.camera.intrinsics;
        let [x, y] = k.image_of(self.camera.rotation.transpose() * (place - self.camera.origin))?;
        let inside = (0.0..f64::from(k.width)).contains(&x) && (0.0..f64::from(k.height)).contains(&y);
        inside.then(|| self.colors.get(y as usize * k.width as usize + x as usize).copied())?
    }
}

/// Two pictures of neighbouring cameras.
type Pair<'a> = (&'a Picture, &'a Picture);

/// Returns the distance from `midst` along `direction` of the plane that the cameras see; `None` if the photographs agree
/// on none.
pub(super) fn distance(views: &ViewSet, midst: DVec3, direction: DVec3) -> Option<f64> {
    let enough = |scale: &&Scale| {
        let first = views.views.get(scale.views.start).map(|view| view.camera.intrinsics);
        first.is_some_and(|k| k.width.max(k.height) >= SIDE)
    };
    // Coarse scales have fewer pixels to average.
    let compared = views.scales.iter().rev().find(enough).or(views.scales.first())?.views.clone();
    let cameras: Vec<Camera> = compared.clone().map(|view| views.views[view].camera).collect();
    let strays = strays(&cameras);
    let near: Vec<usize> =
        (0..cameras.len()).filter(|view| strays.iter().all(|(stray, _)| stray != view)).collect();
    let apart = |a: usize, b: usize| {
        (cameras[a].origin - cameras[b].origin).reject_from_normalized(direction).length()
    };
    let first = *near.first()?;
    let least = 1e-6 * near.iter().map(|&view| apart(view, first)).fold(0.0, f64::max);
    let pairs: Vec<(usize, usize)> = near
        .iter()
        .step_by(near.len().div_ceil(PICTURES).max(1))
        .flat_map(|&view| {
            let mut others: Vec<usize> =
                near.iter().copied().filter(|&other| apart(view, other) > least).collect();
            others.sort_by(|&a, &b| apart(view, a).total_cmp(&apart(view, b)));
            others.truncate(NEIGHBOURS);
            others.into_iter().map(move |other| (view, other))
        })
        .collect();
    let mut spacings: Vec<f64> = pairs.iter().map(|&(a, b)| apart(a, b)).collect();
    spacings.sort_by(f64::total_cmp);
    let spacing = *spacings.get(spacings.len() / 2)?;
    let pictures: std::collections::BTreeMap<usize, Picture> = pairs
        .iter()
        .flat_map(|&(a, b)| [a, b])
        .map(|view| (view, Picture::of(views, compared.start + view)))
        .collect();
    let pairs: Vec<Pair<'_>> = pairs.iter().map(|(a, b)| (&pictures[a], &pictures[b])).collect();
    let k = pairs.first()?.0.camera.intrinsics;
    let (nearest, farthest) =
        (spacing * k.fx / (f64::from(k.width) * (1.0 - LEAST_SHARED)), spacing * k.fx / LEAST_PIXELS);
    let planes =
        std::iter::successors(Some(nearest), |plane| Some(plane * STEP)).take_while(|p| *p <= farthest);
    let mut tried: Vec<(f64, f64)> = planes
        .filter_map(|plane| difference(&pairs, midst + plane * direction, direction).map(|own| (own, plane)))
        .collect();
    tried.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (median, _) = *tried.get(tried.len() / 2)?;
    tried.first().filter(|(least, _)| *least < AGREES * median).map(|(_, plane)| *plane)
}

/// Returns the mean difference of the colours on the plane through `at` perpendicular to `direction`; `None` if the
/// pictures share too little of the plane.
fn difference(pairs: &[Pair<'_>], at: DVec3, direction: DVec3) -> Option<f64> {
    let (mut sum, mut shared, mut all) = (0.0, 0_u32, 0_u32);
    for (own, other) in pairs {
        let k = own.camera.intrinsics;
        for i in 0..PLACES * PLACES {
            let place = |along: u32, side: u32| {
                ((2 * u64::from(along) + 1) * u64::from(side) / u64::from(2 * PLACES)) as u32
            };
            let (x, y) = (place(i % PLACES, k.width), place(i / PLACES, k.height));
            let cone = own.camera.cone::<f64>(x, y);
            let (origin, ray) = (DVec3::from(cone.origin), DVec3::from(cone.direction));
            let distance = (at - origin).dot(direction) / ray.dot(direction);
            all += 1;
            // The negated comparison also leaves out rays parallel to the plane.
            if !(distance > 0.0 && distance.is_finite()) {
                continue;
            }
            let Some(theirs) = other.color(origin + distance * ray) else { continue };
            let Some(ours) = own.colors.get((y * k.width + x) as usize) else { continue };
            sum += (0..3).map(|channel| (ours[channel] - theirs[channel]).abs()).sum::<f64>();
            shared += 1;
        }
    }
    (f64::from(shared) >= LEAST_SHARED * f64::from(all) && shared > 0).then(|| sum / f64::from(shared))
}
