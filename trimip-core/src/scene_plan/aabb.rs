//! The box that holds the subject: what the data state, or what the cameras look at together, shrunk to the silhouettes
//! where the photographs have any. World units.

use super::{Context, Facts, Proposal, detail, leave_out::saved, silhouettes};
use crate::config::PlaneShape;
use crate::tri_mip::Pyramid;
use crate::{Aabb, Camera, Config, ViewSet};
use glam::{DMat3, DVec3};
use toml::Value;

/// Part of the start's volume above which a fitted box leaves nothing out that is worth it.
const WORTH: f64 = 0.8;

/// Cells along each side of the grid on which the common view is looked for.
const CELLS: usize = 40;

/// Cameras looked at, at most, evenly spread.
const MOST_CAMERAS: usize = 128;

/// Share of the cameras that see the subject.
const COMMON: f64 = 0.5;

/// Half the side of the box around photographs without masks, in distances from the middle camera to what all look at:
/// large enough for the surroundings, small enough for texels.
const SURROUNDINGS: f64 = 1.2;

/// Smallest eigenvalue of the mean of I − d·dᵀ over the viewing directions d below which they are parallel: cameras
/// within about 3° of one direction look at no common place.
const PARALLEL: f64 = 3e-3;

/// Pixels looked at along each side of a photograph to tell how much of it the box covers.
const PROBES: u32 = 24;

/// Share of what the photographs show that a box covers without a word.
const ENOUGH: f64 = 0.5;

/// Where the search for the silhouettes begins, and why there.
struct Start {
    aabb: Aabb<f64>,
    source: String,
}

pub(super) fn find(context: &Context<'_>) -> Proposal {
    let Context { now, configured, facts, .. } = *context;
    let given = ["scene.aabb_min", "scene.aabb_max"].iter().any(|path| context.given(path));
    let whole = Aabb::<f64>::new(&now.scene);
    let start = if given { None } else { start(facts) };
    let found = start.is_some();
    let start = start.unwrap_or_else(|| Start { aabb: whole, source: "as configured".into() });
    let share = if found && facts.stated.is_none() { COMMON } else { 0.0 };
    let hull = silhouettes::bounds(facts.train, &start.aabb, share);
    let (aabb, reason) = match &hull {
        Some(hull) => {
            let fitted = within(&rounded(hull), &start.aabb);
            let percent = 100.0 * volume(&fitted) / volume(&start.aabb);
            if !found && percent > 100.0 * WORTH {
                return Proposal::Keep(format!("the silhouettes fill {percent:.0} % of the box"));
            }
            (fitted, format!("the silhouettes fill {percent:.0} % of the box {}", start.source))
        }
        None if found => {
            (rounded(&start.aabb), format!("the photographs have no silhouettes; the box {}", start.source))
        }
        None => {
            return Proposal::Unknown(
                "the photographs have no silhouettes, and the cameras no common view: the box stays as configured"
                    .into(),
                "use photographs with alpha, or set scene.aabb_min and scene.aabb_max and plan.aabb=\"off\"",
            );
        }
    };
    let smaller = sized(context, &aabb);
    let [x, y, z] = aabb.extent().map(|side| format!("{:.3}", side));
    let sizes =
        [now, &smaller].map(|config| Pyramid::new(&config.encoder, &Aabb::new(&config.scene)).base_len());
    let saved = match sizes {
        [before, after] if !detail::sets_planes(context) => saved("planes", after, before),
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
        ("renderer.steps_per_diagonal", Value::Integer(steps.ceil().clamp(16.0, 65_536.0) as i64)),
    ];
    if volume(&aabb) <= WORTH * volume(&whole) {
        Proposal::LeaveOut { reason, changes }
    } else {
        Proposal::Set { reason, changes }
    }
}

/// The settings with another box, planes of square texels that are as wide as before.
fn sized(context: &Context<'_>, aabb: &Aabb<f64>) -> Config {
    let mut config = context.now.clone();
    (config.scene.aabb_min, config.scene.aabb_max) = (aabb.min.map(|x| x as f32), aabb.max.map(|x| x as f32));
    config.encoder.shape = PlaneShape::Box;
    let size = detail::plane_size(&config, detail::configured_texel(context.configured));
    config.encoder.plane_size = size.min(context.now.encoder.plane_size);
    config
}

/// The box that the data state, else one around what the cameras look at.
fn start(facts: &Facts<'_>) -> Option<Start> {
    if let Some(stated) = facts.stated {
        return Some(Start { aabb: stated.aabb, source: stated.source.clone() });
    }
    let cameras = cameras(facts.train);
    let focus = focus(&cameras)?;
    let mut distances: Vec<f64> = cameras.iter().map(|camera| (camera.origin - focus).length()).collect();
    distances.sort_by(f64::total_cmp);
    let middle = *distances.get(distances.len() / 2)?;
    let cube = |half: f64| Aabb { min: (focus - half).to_array(), max: (focus + half).to_array() };
    if silhouettes::any(facts.train) {
        let aabb = common_view(&cameras, &cube(middle))?;
        return Some(Start { aabb, source: "that half of the cameras see".into() });
    }
    let aabb = cube(SURROUNDINGS * middle);
    Some(Start { aabb, source: "lies around what the cameras look at, with its surroundings".into() })
}

/// Cameras of the finest photographs, at most [`MOST_CAMERAS`].
fn cameras(views: &ViewSet) -> Vec<Camera> {
    let Some(finest) = views.scales.first() else { return Vec::new() };
    let stride = finest.views.len().div_ceil(MOST_CAMERAS).max(1);
    finest.views.clone().step_by(stride).map(|view| views.views[view].camera).collect()
}

/// The point nearest to all optical axes, by least squares; `None` where they are parallel.
fn focus(cameras: &[Camera]) -> Option<DVec3> {
    let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for camera in cameras {
        let axis = camera.rotation.z_axis;
        let across = DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        matrix += across;
        right += across * camera.origin;
    }
    // Of a mean of projections the determinant is the product of eigenvalues in [0, 1]: it is at most the smallest.
    let mean = matrix * (1.0 / cameras.len().max(1) as f64);
    (mean.determinant() > PARALLEL * 0.5).then(|| matrix.inverse() * right).filter(|focus| focus.is_finite())
}

/// Bounds of what at least [`COMMON`] of the cameras see within `aabb`; `None` where there is no such place.
fn common_view(cameras: &[Camera], aabb: &Aabb<f64>) -> Option<Aabb<f64>> {
    let cell = aabb.extent().map(|side| side / CELLS as f64);
    let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
    for i in 0..CELLS.pow(3) {
        let index = [i % CELLS, i / CELLS % CELLS, i / CELLS / CELLS];
        let at = DVec3::from_array(std::array::from_fn(|axis| {
            aabb.min[axis] + (index[axis] as f64 + 0.5) * cell[axis]
        }));
        let seeing = cameras.iter().filter(|camera| sees(camera, at)).count();
        if seeing as f64 >= COMMON * cameras.len() as f64 {
            for axis in 0..3 {
                low[axis] = low[axis].min(index[axis]);
                high[axis] = high[axis].max(index[axis] + 1);
            }
        }
    }
    let corner = |at: [usize; 3]| std::array::from_fn(|axis| aabb.min[axis] + at[axis] as f64 * cell[axis]);
    (high[0] > 0).then(|| Aabb { min: corner(low), max: corner(high) })
}

/// True where a point lies in the picture of a camera.
fn sees(camera: &Camera, at: DVec3) -> bool {
    let k = &camera.intrinsics;
    let at = camera.rotation.transpose() * (at - camera.origin);
    let (x, y) = (k.cx - k.fx * at.x / at.z, k.cy + k.fy * at.y / at.z);
    at.z < 0.0 && (0.0..f64::from(k.width)).contains(&x) && (0.0..f64::from(k.height)).contains(&y)
}

fn volume(aabb: &Aabb<f64>) -> f64 {
    aabb.extent().iter().product()
}

/// The box with few digits, rounded outwards.
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

/// The f64 with the fewest digits that is this f32.
fn shortest(value: f32) -> f64 {
    value.to_string().parse().unwrap_or_else(|_| value.into())
}

/// Share of the pixels that show something (alpha above one half) whose rays meet the box; `None` where none does.
pub(super) fn coverage(config: &Config, views: &ViewSet) -> Option<f64> {
    let aabb = Aabb::<f64>::new(&config.scene);
    let finest = views.scales.first()?;
    let stride = finest.views.len().div_ceil(MOST_CAMERAS).max(1);
    let (mut shown, mut met) = (0_u64, 0_u64);
    for view in finest.views.clone().step_by(stride) {
        let (camera, pixels) = (&views.views[view].camera, views.pixels_of(view));
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        for i in 0..PROBES * PROBES {
            let at =
                |place: u32, side: u32| (2 * u64::from(place) + 1) * u64::from(side) / u64::from(2 * PROBES);
            let (x, y) = (at(i % PROBES, width) as u32, at(i / PROBES, height) as u32);
            if pixels[(y * width + x) as usize][3] < 128 {
                continue;
            }
            let cone = camera.cone::<f64>(x, y);
            let (enter, leave) = aabb.intersect(cone.origin, cone.direction);
            shown += 1;
            met += u64::from(enter < leave);
        }
    }
    (shown > 0).then(|| met as f64 / shown as f64)
}

/// What a user should know of the planned box before training, one line each.
pub fn warnings(config: &Config, facts: &Facts<'_>) -> Vec<String> {
    let mut warnings = Vec::new();
    let alone = focus(&cameras(facts.train)).is_none() && facts.stated.is_none();
    if alone && config.scene == Config::default().scene {
        warnings.push(
            "the cameras look in parallel, at no common place: the box stays at ±1.5 units around the origin; set \
             scene.aabb_min and scene.aabb_max to where the subject is"
                .into(),
        );
    }
    match coverage(config, facts.train) {
        Some(share) if share < ENOUGH => warnings.push(format!(
            "the box covers only {:.0} % of what the photographs show: the rest is taken for the background colour; set \
             scene.aabb_min and scene.aabb_max around what you want, or mask the rest (alpha)",
            100.0 * share
        )),
        Some(_) => {}
        None => warnings.push(
            "the photographs show nothing at all: every pixel that was looked at is clear; see trimip-cli data inspect".into(),
        ),
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intrinsics;

    fn ring(centre: DVec3, radius: f64, count: usize) -> Vec<Camera> {
        let k = Intrinsics::from_angle(64, 64, 0.7);
        (0..count)
            .map(|i| {
                let turn = i as f64 * 2.4;
                let origin = centre + radius * DVec3::new(turn.cos(), turn.sin(), 0.3 * (i % 3) as f64);
                Camera::look_at(k, origin, centre, DVec3::Z)
            })
            .collect()
    }

    #[test]
    fn cameras_look_at_one_place_wherever_it_is() {
        for (centre, radius) in [(DVec3::ZERO, 4.0), (DVec3::new(500.0, -200.0, 70.0), 0.02)] {
            let found = focus(&ring(centre, radius, 20)).unwrap();
            assert!((found - centre).length() < 1e-6 * radius.max(centre.length()), "{found}");
        }
        let first = ring(DVec3::ZERO, 4.0, 1)[0];
        let aside = |i: i32| Camera { origin: DVec3::new(0.1 * f64::from(i), 0.0, 0.0), ..first };
        let parallel: Vec<Camera> = (0..10).map(aside).collect();
        assert_eq!(focus(&parallel), None);
        assert_eq!(focus(&[]), None);
    }

    #[test]
    fn the_common_view_holds_what_all_see_and_is_no_larger_than_their_view() {
        let cameras = ring(DVec3::new(3.0, 0.0, 0.0), 4.0, 24);
        let cube = Aabb { min: [-1.0, -4.0, -4.0], max: [7.0, 4.0, 4.0] };
        let view = common_view(&cameras, &cube).unwrap();
        // Half the picture's width at the centre's distance is 4·tan(0.35) = 1.46, and a cell 0.2.
        for axis in 0..3 {
            let centre = [3.0, 0.0, 0.0][axis];
            assert!(view.min[axis] < centre - 1.0 && view.max[axis] > centre + 1.0, "{view:?}");
            assert!(view.min[axis] > centre - 3.0 && view.max[axis] < centre + 3.0, "{view:?}");
        }
        let away: Vec<_> = cameras
            .iter()
            .map(|c| {
                Camera::look_at(c.intrinsics, c.origin, 2.0 * c.origin - DVec3::new(3.0, 0.0, 0.0), DVec3::Z)
            })
            .collect();
        assert_eq!(common_view(&away, &cube), None, "cameras that look outwards");
    }
}
