//! Bounding box of the subject, in world units: the box that the data state, or one around the common view of the cameras.
//! The box is then shrunk to the silhouettes, if the photographs have any.

use super::common_view::{COMMON, cameras, common_view, focus, is_ahead};
use super::decision::{Context, Proposal};
use super::facing::Facing;
use super::facts::{Facts, StatedBox};
use super::fineness::significant;
use super::up::{self, Up};
use super::{hash_grid, leave_out::saved, tri_mip};
use crate::config::{Contraction, PlaneShape};
use crate::field::encoders::tri_mip::Pyramid;
use crate::{
    Aabb, Camera, Config,
    scene::{plain, silhouettes},
};
use glam::DVec3;
use toml::Value;

/// A fitted box with more than this share of the initial volume is not worth the change.
const WORTH: f64 = 0.8;

/// Radius of the uncontracted ball, as a multiple of the median distance from the cameras to what they look at.
const BALL: f64 = 1.0;

/// Half the side of the box for photographs without masks, as a multiple of the median distance from the cameras to their
/// common focus: this box holds the surroundings and keeps texels small.
const SURROUNDINGS: f64 = 1.2;

/// Fewest and most steps along the diagonal: the limits of `renderer.steps_per_diagonal`.
const STEPS: [f64; 2] = [16.0, 65_536.0];

/// Initial box, which the silhouettes then shrink, and its source.
struct Start {
    aabb: Aabb<f64>,
    source: String,
}

pub(super) fn find(context: &Context<'_>) -> Proposal {
    let Context { now, configured, facts, .. } = *context;
    if let Some(proposal) = unbounded(context) {
        return proposal;
    }
    let given = ["scene.aabb_min", "scene.aabb_max"].iter().any(|path| context.given(path));
    let whole = Aabb::<f64>::new(&now.scene);
    let start = if given { None } else { start(facts) };
    let found = start.is_some();
    let start = start.unwrap_or_else(|| Start { aabb: whole, source: "as configured".into() });
    let fraction = if found && stated(facts).is_none() { COMMON } else { 0.0 };
    let hull = silhouettes::bounds(facts.train, &start.aabb, fraction);
    let (aabb, reason) = match &hull {
        Some(hull) => {
            let fitted = within(&rounded(hull), &start.aabb);
            let percent = 100.0 * volume(&fitted) / volume(&start.aabb);
            if !found && percent > 100.0 * WORTH {
                return Proposal::Keep(format!("the silhouettes fill {percent:.0} % of the box"));
            }
            (fitted, format!("the silhouettes fill {percent:.0} % of the box {}", start.source))
        }
        None if found => (
            rounded(&start.aabb),
            format!("the photographs have no silhouettes; the box is the one {}", start.source),
        ),
        None => {
            return Proposal::Unknown(
                "the photographs have no silhouettes, and the cameras no common view: the box stays as configured"
                    .into(),
                "use photographs with alpha, or set scene.aabb_min and scene.aabb_max and plan.aabb=\"off\"",
            );
        }
    };
    let smaller = sized(context, &aabb);
    let [x, y, z] = aabb.extent().map(|side| format!("{side:.3}"));
    let sizes =
        [now, &smaller].map(|config| Pyramid::new(&config.encoder, &Aabb::new(&config.scene)).base_len());
    let saved = match sizes {
        [before, after] if !tri_mip::sets_planes(context) => saved("planes", after, before),
        _ => String::new(),
    };
    let reason = format!("{reason}; {x} by {y} by {z} units{saved}");
    let longest = Aabb::<f64>::new(&configured.scene).longest();
    let steps = f64::from(now.renderer.steps_per_diagonal) * aabb.longest() / longest;
    let corner = |corner: [f32; 3]| Value::Array(corner.map(|x| Value::Float(shortest(x))).to_vec());
    let changes = vec![
        ("scene.aabb_min", corner(smaller.scene.aabb_min)),
        ("scene.aabb_max", corner(smaller.scene.aabb_max)),
        ("encoder.shape", Value::String("box".into())),
        ("encoder.plane_size", Value::Integer(smaller.encoder.plane_size.into())),
        ("renderer.steps_per_diagonal", Value::Integer(steps.ceil().clamp(STEPS[0], STEPS[1]) as i64)),
    ];
    if volume(&aabb) <= WORTH * volume(&whole) {
        Proposal::LeaveOut { reason, changes }
    } else {
        Proposal::Set { reason, changes }
    }
}

/// Proposes the box of contracted space for photographs that show their surroundings, unless the user sets
/// `scene.contraction` to "none". Returns `None` if space stays bounded.
fn unbounded(context: &Context<'_>) -> Option<Proposal> {
    let Context { now, configured, facts, .. } = *context;
    let boxed = ["scene.aabb_min", "scene.aabb_max"].iter().any(|path| context.given(path));
    let wanted = if context.given("scene.contraction") {
        now.scene.contraction == Contraction::Ball
    } else {
        !silhouettes::any(facts.train) && plain::colour(facts.train).is_none()
    };
    if !wanted || boxed {
        return None;
    }
    let facing = Facing::of(facts.train);
    let (centre, radius, source) = surroundings(facts, facing.as_ref())?;
    let cube = |half: f64| Aabb { min: (centre - half).to_array(), max: (centre + half).to_array() };
    let aabb = cube(2.0 * radius);
    let sized = sized(context, &aabb);
    let steps = f64::from(now.renderer.steps_per_diagonal) * aabb.longest()
        / Aabb::<f64>::new(&configured.scene).longest();
    let corner = |corner: [f32; 3]| Value::Array(corner.map(|x| Value::Float(shortest(x))).to_vec());
    let mut changes = vec![
        ("scene.contraction", Value::String("ball".into())),
        ("scene.aabb_min", corner(sized.scene.aabb_min)),
        ("scene.aabb_max", corner(sized.scene.aabb_max)),
        ("renderer.steps_per_diagonal", Value::Integer(steps.ceil().clamp(STEPS[0], STEPS[1]) as i64)),
    ];
    if !hash_grid::encodes_places(context) {
        changes.push(("encoder.shape", Value::String("box".into())));
        changes.push(("encoder.plane_size", Value::Integer(sized.encoder.plane_size.into())));
    }
    let mut told = None;
    if !context.given("scene.up") {
        let Up { direction, reason } = up::find(facts.train, facing.as_ref());
        changes.extend(direction.map(|up| ("scene.up", corner(up.to_array().map(|x| x as f32)))));
        told = reason;
    }
    Some(Proposal::Set {
        reason: format!(
            "the photographs show their surroundings: space keeps its shape within {} units of {source}, and is \
             contracted beyond{}",
            significant(radius),
            told.map_or_else(String::new, |told| format!("; {told}"))
        ),
        changes,
    })
}

/// Returns the centre and radius of the uncontracted ball, and a description of the centre. The centre is the middle of what the
/// cameras see if all look along one direction, otherwise the point that they look at, or the mean of their positions if they
/// look at no common point.
fn surroundings(facts: &Facts<'_>, facing: Option<&Facing>) -> Option<(DVec3, f64, &'static str)> {
    if let Some((centre, radius)) = facing.and_then(Facing::ball) {
        return Some((
            centre,
            radius,
            "the middle of what the cameras see in their common viewing direction",
        ));
    }
    let cameras = cameras(facts.train);
    let midst = cameras.iter().map(|camera| camera.origin).sum::<DVec3>() / cameras.len() as f64;
    let median = |centre: DVec3| {
        let mut distances: Vec<f64> = cameras.iter().map(|camera| distance(camera, centre)).collect();
        distances.sort_by(f64::total_cmp);
        distances.get(distances.len() / 2).copied().filter(|distance| distance.is_finite() && *distance > 0.0)
    };
    match focus(&cameras).filter(|focus| is_ahead(&cameras, *focus)) {
        Some(focus) => Some((focus, BALL * median(focus)?, "the point that the cameras look at")),
        None => Some((midst, BALL * median(midst)?, "the mean of the camera positions")),
    }
}

/// Returns the distance from a camera to its subject, or the longer side of the camera's picture in world units if its rays
/// are parallel.
fn distance(camera: &Camera, subject: DVec3) -> f64 {
    camera.intrinsics.scale((camera.origin - subject).length())
}

/// Returns the settings with the box `aabb`, and with planes of square texels that keep their configured width.
fn sized(context: &Context<'_>, aabb: &Aabb<f64>) -> Config {
    let mut config = context.now.clone();
    (config.scene.aabb_min, config.scene.aabb_max) = (aabb.min.map(|x| x as f32), aabb.max.map(|x| x as f32));
    config.encoder.shape = PlaneShape::Box;
    let size = tri_mip::plane_size(&config, tri_mip::configured_texel(context.configured));
    config.encoder.plane_size = size.min(context.now.encoder.plane_size);
    config
}

/// Returns the box that the data state. Instant-NGP's cube counts only if there are no silhouettes: exporters write the cube for
/// any scene, and silhouettes bound the scene better.
fn stated<'a>(facts: &Facts<'a>) -> Option<&'a StatedBox> {
    facts.stated.filter(|stated| stated.around_points || !silhouettes::any(facts.train))
}

/// Returns the box that the data state, otherwise a box around the cameras' common focus, otherwise Instant-NGP's cube.
fn start(facts: &Facts<'_>) -> Option<Start> {
    let of = |stated: &StatedBox| Start { aabb: stated.aabb, source: stated.source.clone() };
    stated(facts).map(of).or_else(|| around_focus(facts)).or_else(|| facts.stated.map(of))
}

/// Returns the box around the cameras' common focus.
fn around_focus(facts: &Facts<'_>) -> Option<Start> {
    let cameras = cameras(facts.train);
    let focus = focus(&cameras)?;
    let mut distances: Vec<f64> = cameras.iter().map(|camera| distance(camera, focus)).collect();
    distances.sort_by(f64::total_cmp);
    let middle = *distances.get(distances.len() / 2)?;
    let cube = |half: f64| Aabb { min: (focus - half).to_array(), max: (focus + half).to_array() };
    if silhouettes::any(facts.train) {
        let aabb = common_view(&cameras, &cube(middle))?;
        return Some(Start { aabb, source: "that half of the cameras see".into() });
    }
    let aabb = cube(SURROUNDINGS * middle);
    Some(Start { aabb, source: "around what the cameras look at and its surroundings".into() })
}

fn volume(aabb: &Aabb<f64>) -> f64 {
    aabb.extent().iter().product()
}

/// Rounds the box outwards to few digits.
fn rounded(aabb: &Aabb<f64>) -> Aabb<f64> {
    let quantum = 10_f64.powf(aabb.longest().log10().floor() - 2.0);
    Aabb {
        min: aabb.min.map(|x| (x / quantum).floor() * quantum),
        max: aabb.max.map(|x| (x / quantum).ceil() * quantum),
    }
}

fn within(aabb: &Aabb<f64>, whole: &Aabb<f64>) -> Aabb<f64> {
    Aabb {
        min: std::array::from_fn(|axis| aabb.min[axis].max(whole.min[axis])),
        max: std::array::from_fn(|axis| aabb.max[axis].min(whole.max[axis])),
    }
}

/// Returns the f64 with the fewest digits that rounds to this f32.
fn shortest(value: f32) -> f64 {
    value.to_string().parse().unwrap_or_else(|_| value.into())
}
