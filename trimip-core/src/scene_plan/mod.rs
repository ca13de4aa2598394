//! The scene plan: what a scene does not need is left out before training begins. Each decision looks at the cameras and
//! the silhouettes, has a setting in `[plan]`, and changes other settings, never what they mean: a texel, a step and a
//! cell stay as wide as configured.

pub mod radii;
pub mod silhouettes;

use crate::config::{FilePrecision, PlanChoice, PlaneShape};
use crate::tri_mip::{CHANNELS, Pyramid};
use crate::{Aabb, Camera, Config, Error, Origin, Result, Settings, ViewSet};
use serde::{Deserialize, Serialize};
use toml::Value;

/// What the plan looks at.
#[derive(Clone, Copy, Debug)]
pub struct Facts<'a> {
    /// The training views.
    pub train: &'a ViewSet,
    /// Cameras that will be rendered, at every scale.
    pub test: &'a [Camera],
}

/// A setting that a decision changed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Its dotted path.
    pub path: String,
    /// Value before, as TOML.
    pub from: String,
    /// Value after.
    pub to: String,
}

/// One decision.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// Key in `[plan]`.
    pub decision: String,
    /// What was asked for.
    pub choice: PlanChoice,
    /// True when something is left out.
    pub left_out: bool,
    /// What was found and what it saves.
    pub reason: String,
    /// The settings that changed.
    pub changes: Vec<Change>,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let verdict = if self.left_out { "left out" } else { "kept" };
        write!(f, "plan.{}: {verdict}: {}", self.decision, self.reason)
    }
}

/// What a decision proposes.
enum Proposal {
    /// Everything is needed; why.
    Keep(String),
    /// It cannot be known what is needed; why, and what to do.
    Unknown(String, &'static str),
    /// This much is not needed.
    LeaveOut { reason: String, changes: Vec<(&'static str, Value)> },
}

type Decide = fn(&Config, &Config, &Facts<'_>) -> Proposal;

/// A decision: its key, the settings that are its own (`auto` leaves the decision alone where the user gave one of them),
/// and its rule. Rules also lower `encoder.plane_size`, `renderer.steps_per_diagonal` and `occupancy.resolution`, given or
/// not, with the box that they divide: a texel, a step and a cell stay as wide as configured.
struct Decision {
    key: &'static str,
    owns: &'static [&'static str],
    choice: fn(&Config) -> PlanChoice,
    decide: Decide,
}

/// In the order in which they are taken: each sees what those before it changed.
const DECISIONS: [Decision; 5] = [
    Decision {
        key: "aabb",
        owns: &["scene.aabb_min", "scene.aabb_max", "encoder.shape"],
        choice: |config| config.plan.aabb,
        decide: fit_box,
    },
    Decision {
        key: "levels",
        owns: &["encoder.levels"],
        choice: |config| config.plan.levels,
        decide: reached_levels,
    },
    Decision { key: "occupancy", owns: &[], choice: |config| config.plan.occupancy, decide: cells_as_wide },
    Decision {
        key: "directions",
        owns: &["field.directions"],
        choice: |config| config.plan.directions,
        decide: view_dependence,
    },
    Decision {
        key: "file",
        owns: &["file.planes"],
        choice: |config| config.plan.file,
        decide: half_precision,
    },
];

/// Keys of all decisions, as in `[plan]`.
pub fn keys() -> impl Iterator<Item = &'static str> {
    DECISIONS.iter().map(|decision| decision.key)
}

/// Takes every decision and changes `settings` accordingly.
///
/// # Errors
/// When a decision is `on` and cannot be taken.
pub fn make(settings: &mut Settings, facts: &Facts<'_>) -> Result<Vec<Finding>> {
    let configured = Config::from_settings(settings)?;
    DECISIONS.iter().map(|decision| take(decision, settings, &configured, facts)).collect()
}

fn take(
    decision: &Decision,
    settings: &mut Settings,
    configured: &Config,
    facts: &Facts<'_>,
) -> Result<Finding> {
    let choice = (decision.choice)(configured);
    let finding = |left_out, reason, changes| Finding {
        decision: decision.key.into(),
        choice,
        left_out,
        reason,
        changes,
    };
    if choice == PlanChoice::Off {
        return Ok(finding(false, "switched off".into(), Vec::new()));
    }
    let own =
        decision.owns.iter().find(|path| !matches!(settings.origin(path), Origin::Default | Origin::Plan));
    if let (PlanChoice::Auto, Some(path)) = (choice, own) {
        return Ok(finding(false, format!("{path} is set by {}", settings.origin(path)), Vec::new()));
    }
    let now = Config::from_settings(settings)?;
    match (decision.decide)(&now, configured, facts) {
        Proposal::Keep(reason) => Ok(finding(false, reason, Vec::new())),
        Proposal::Unknown(reason, advice) if choice == PlanChoice::On => {
            Err(Error::input(format!("plan.{}", decision.key), reason, advice))
        }
        Proposal::Unknown(reason, _) => Ok(finding(false, reason, Vec::new())),
        Proposal::LeaveOut { reason, changes } => {
            let mut told = Vec::new();
            for (path, value) in changes {
                let from = settings.value(path);
                settings.decide(path, &value.to_string())?;
                let to = settings.value(path);
                if from != to {
                    told.push(Change { path: path.into(), from, to });
                }
            }
            Ok(finding(true, reason, told))
        }
    }
}

/// Takes over what a run's plan decided at its beginning: a run that goes on is not planned again. A setting that is not
/// what it was before the plan stays as it is: it makes another run.
///
/// # Errors
/// When a value does not fit.
pub fn adopt(settings: &mut Settings, findings: &[Finding]) -> Result<()> {
    let config = Config::from_settings(settings)?;
    let off = |key: &str| {
        let decision = DECISIONS.iter().find(|decision| decision.key == key);
        decision.is_none_or(|decision| (decision.choice)(&config) == PlanChoice::Off)
    };
    for change in findings.iter().filter(|finding| !off(&finding.decision)).flat_map(|f| &f.changes) {
        if settings.value(&change.path) == change.from {
            settings.decide(&change.path, &change.to)?;
        }
    }
    Ok(())
}

fn megabytes(floats: usize) -> String {
    format!("{:.1} MB", floats as f64 * 4e-6)
}

/// `; planes of 12.6 MB instead of 50.3 MB`: what is saved of f32 values; nothing where nothing is.
fn saved(what: &str, after: usize, before: usize) -> String {
    let [less, more] = [after, before].map(megabytes);
    if after >= before || less == more {
        String::new()
    } else {
        format!("; {what} of {less} instead of {more}")
    }
}

/// The smallest number of texels along the longest side that is no coarser than `texel`, at most `most`.
fn plane_size(config: &Config, texel: f64, most: u32) -> u32 {
    let unit = config.encoder.texel_unit();
    let longest = Aabb::<f64>::new(&config.scene).longest();
    // One part in a thousand less is the same texel.
    let enough = (longest / texel * 0.999).ceil() as u32;
    enough.next_multiple_of(unit).clamp(unit.max(4), most.next_multiple_of(unit))
}

/// World width of a texel of the configured planes, along the longest side.
fn texel(configured: &Config) -> f64 {
    Aabb::<f64>::new(&configured.scene).longest() / f64::from(configured.encoder.plane_size)
}

fn fit_box(now: &Config, configured: &Config, facts: &Facts<'_>) -> Proposal {
    const WORTH: f64 = 0.8;
    let whole = Aabb::<f64>::new(&now.scene);
    let Some(hull) = silhouettes::bounds(facts.train, &whole) else {
        return Proposal::Unknown(
            "the photographs have no silhouettes: the box stays as configured".into(),
            "use photographs with alpha, or set scene.aabb_min and scene.aabb_max and plan.aabb=\"off\"",
        );
    };
    // Few digits, rounded outwards.
    let quantum = 10_f64.powf(hull.longest().log10().floor() - 2.0);
    let fitted = Aabb {
        min: hull.min.map(|x| (x / quantum).floor() * quantum),
        max: hull.max.map(|x| (x / quantum).ceil() * quantum),
    };
    let fitted = Aabb {
        min: std::array::from_fn(|axis| fitted.min[axis].max(whole.min[axis])),
        max: std::array::from_fn(|axis| fitted.max[axis].min(whole.max[axis])),
    };
    let volume = |aabb: &Aabb<f64>| aabb.extent().iter().product::<f64>();
    let share = volume(&fitted) / volume(&whole);
    let percent = 100.0 * share;
    if share > WORTH {
        return Proposal::Keep(format!("the silhouettes fill {percent:.0} % of the box"));
    }
    let mut smaller = now.clone();
    (smaller.scene.aabb_min, smaller.scene.aabb_max) =
        (fitted.min.map(|x| x as f32), fitted.max.map(|x| x as f32));
    smaller.encoder.shape = PlaneShape::Box;
    smaller.encoder.plane_size = plane_size(&smaller, texel(configured), now.encoder.plane_size);
    let steps = f64::from(now.renderer.steps_per_diagonal) * fitted.longest() / whole.longest();
    let [before, after] =
        [now, &smaller].map(|config| Pyramid::new(&config.encoder, &Aabb::new(&config.scene)).base_len());
    let corner = |corner: [f32; 3]| Value::Array(corner.map(|x| Value::Float(shortest(x))).to_vec());
    Proposal::LeaveOut {
        reason: format!("the silhouettes fill {percent:.0} % of the box{}", saved("planes", after, before)),
        changes: vec![
            ("scene.aabb_min", corner(smaller.scene.aabb_min)),
            ("scene.aabb_max", corner(smaller.scene.aabb_max)),
            ("encoder.shape", Value::String("box".into())),
            ("encoder.plane_size", Value::Integer(smaller.encoder.plane_size.into())),
            ("renderer.steps_per_diagonal", Value::Integer(steps.ceil().max(16.0) as i64)),
        ],
    }
}

/// The f64 with the fewest digits that is this f32.
fn shortest(value: f32) -> f64 {
    value.to_string().parse().unwrap_or_else(|_| value.into())
}

fn reached_levels(now: &Config, configured: &Config, facts: &Facts<'_>) -> Proposal {
    if !now.encoder.mipmap || now.encoder.halvings.values().any(|halvings| halvings > 0.0) {
        return Proposal::Keep("the levels are what the configuration is about".into());
    }
    let aabb = Aabb::<f64>::new(&now.scene);
    let train = facts.train.views.iter().map(|view| &view.camera);
    let Some([least, most]) = radii::range(train.chain(facts.test), &aabb) else {
        return Proposal::Keep("there is no camera".into());
    };
    let level = |radius: f64| {
        let base = Pyramid::new(&now.encoder, &aabb).log2_base_radius;
        base.map(|base| radius.log2() - base)
    };
    let lowest = level(least).into_iter().fold(f64::INFINITY, f64::min);
    let highest = level(most).into_iter().fold(f64::NEG_INFINITY, f64::max);
    let levels = now.encoder.levels;
    // The finest levels that every sphere lies above, and one level more than any sphere reaches, for whoever steps back.
    let below = (lowest.floor().max(0.0) as u32).min(levels - 1);
    let above = (highest.ceil().max(0.0) as u32 + 2).min(levels);
    let reach = format!("spheres lie between the levels {lowest:.1} and {highest:.1} of {levels}");
    if below == 0 && above == levels {
        return Proposal::Keep(reach);
    }
    let mut smaller = now.clone();
    smaller.encoder.levels = (above - below).max(1);
    let texel = texel(configured) * f64::from(1_u32 << below);
    smaller.encoder.plane_size = plane_size(&smaller, texel, now.encoder.plane_size);
    let sizes = [now, &smaller].map(|config| {
        let pyramid = Pyramid::new(&config.encoder, &aabb);
        pyramid.base_len() + pyramid.derived_len()
    });
    Proposal::LeaveOut {
        reason: format!("{reach}{}", saved("planes and levels", sizes[1], sizes[0])),
        changes: vec![
            ("encoder.levels", Value::Integer(smaller.encoder.levels.into())),
            ("encoder.plane_size", Value::Integer(smaller.encoder.plane_size.into())),
        ],
    }
}

fn cells_as_wide(now: &Config, configured: &Config, _: &Facts<'_>) -> Proposal {
    let volume = |config: &Config| Aabb::<f64>::new(&config.scene).extent().iter().product::<f64>();
    let resolution = f64::from(configured.occupancy.resolution);
    let needed = resolution * (volume(now) / volume(configured)).cbrt();
    let needed = (needed.ceil().max(16.0) as u32).next_multiple_of(8);
    if needed >= now.occupancy.resolution {
        return Proposal::Keep(format!("cells are as wide as configured at {}³", now.occupancy.resolution));
    }
    Proposal::LeaveOut {
        reason: format!(
            "cells as large as configured are {needed}³ in the fitted box: {:.1} times fewer",
            (resolution / f64::from(needed)).powi(3)
        ),
        changes: vec![("occupancy.resolution", Value::Integer(needed.into()))],
    }
}

fn view_dependence(now: &Config, configured: &Config, _: &Facts<'_>) -> Proposal {
    if configured.plan.directions == PlanChoice::Auto || !now.field.directions {
        return Proposal::Keep(
            "the photographs alone do not tell whether colours change with the view".into(),
        );
    }
    Proposal::LeaveOut {
        reason: "colours depend on the place alone".into(),
        changes: vec![("field.directions", Value::Boolean(false))],
    }
}

fn half_precision(now: &Config, _: &Config, _: &Facts<'_>) -> Proposal {
    if now.file.planes == FilePrecision::F16 {
        return Proposal::Keep("texels are written as f16 already".into());
    }
    let floats = Pyramid::new(&now.encoder, &Aabb::new(&now.scene)).base_len();
    Proposal::LeaveOut {
        reason: format!(
            "texels are written as f16: {} instead of {} ({} texels of {CHANNELS} channels)",
            megabytes(floats / 2),
            megabytes(floats),
            floats / CHANNELS
        ),
        changes: vec![("file.planes", Value::String("f16".into()))],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Alpha, Intrinsics, Scale, View};
    use glam::DVec3;

    /// Views of a ball of radius 0.4 around (0.5, 0, 0), at two scales.
    fn views(alpha: bool) -> ViewSet {
        let mut set =
            ViewSet { views: Vec::new(), pixels: Vec::new(), alpha: Alpha::Straight, scales: Vec::new() };
        for level in 0..2_u32 {
            let k = Intrinsics::from_angle(256, 256, 0.7).reduced(level);
            let (first, first_pixel) = (set.views.len(), set.pixels.len());
            for i in 0..16 {
                let turn = f64::from(i) * 2.4;
                let origin = 4.0 * DVec3::new(turn.cos(), turn.sin(), 0.5 - f64::from(i % 3) * 0.5);
                let camera = Camera::look_at(k, origin, DVec3::ZERO, DVec3::Z);
                set.views.push(View { name: i.to_string(), camera, offset: set.pixels.len() });
                for (y, x) in (0..k.height).flat_map(|y| (0..k.width).map(move |x| (y, x))) {
                    let cone = camera.cone::<f64>(x, y);
                    let to = DVec3::new(0.5, 0.0, 0.0) - DVec3::from_array(cone.origin);
                    let along = to.dot(DVec3::from_array(cone.direction));
                    let hit = to.length_squared() - along * along < 0.16;
                    set.pixels.push([255, 0, 0, if hit || !alpha { 255 } else { 0 }]);
                }
            }
            set.scales.push(Scale {
                factor: 1 << level,
                weight: (1 << (2 * level)) as f32,
                views: first..set.views.len(),
                pixels: first_pixel..set.pixels.len(),
            });
        }
        set
    }

    fn planned(train: &ViewSet, set: &[&str]) -> Result<(Config, Vec<Finding>)> {
        let mut settings = Settings::defaults();
        set.iter().for_each(|assignment| settings.apply_assignment(assignment).unwrap());
        let test: Vec<Camera> = train.views.iter().map(|view| view.camera).collect();
        let findings = make(&mut settings, &Facts { train, test: &test })?;
        Ok((Config::from_settings(&settings)?, findings))
    }

    #[test]
    fn a_small_object_needs_a_small_box_and_texels_steps_and_cells_stay_as_wide() {
        let before = Config::default();
        let (config, findings) = planned(&views(true), &["encoder.levels=5"]).unwrap();
        let kept = ["levels", "directions"];
        assert!(findings.iter().all(|f| f.left_out != kept.contains(&f.decision.as_str())), "{findings:?}");
        let aabb = Aabb::<f64>::new(&config.scene);
        for (axis, centre) in [0.5, 0.0, 0.0].into_iter().enumerate() {
            assert!(aabb.min[axis] <= centre - 0.39 && aabb.min[axis] > centre - 0.6, "{aabb:?}");
            assert!(aabb.max[axis] >= centre + 0.39 && aabb.max[axis] < centre + 0.6, "{aabb:?}");
        }
        let texel = aabb.longest() / f64::from(config.encoder.plane_size);
        assert!((0.8..=1.002).contains(&(texel / (3.0 / 512.0))), "{texel}");
        let step = f64::from(config.step_length() / before.step_length());
        assert!((0.98..1.0001).contains(&step), "{step}");
        let cell = aabb.extent().iter().product::<f64>().cbrt() / f64::from(config.occupancy.resolution);
        assert!((0.75..=1.0).contains(&(cell / (3.0 / 128.0))), "{cell}");
        assert_eq!(config.file.planes, FilePrecision::F16);
    }

    #[test]
    fn no_sphere_of_any_camera_reaches_a_level_that_is_left_out() {
        let train = views(true);
        for set in
            [&[][..], &["plan.aabb=off"], &["encoder.plane_size=4096", "encoder.levels=9", "plan.levels=on"]]
        {
            let (config, _) = planned(&train, set).unwrap();
            let pyramid = Pyramid::new(&config.encoder, &Aabb::new(&config.scene));
            let [least, most] =
                radii::range(train.views.iter().map(|v| &v.camera), &Aabb::new(&config.scene)).unwrap();
            for plane in 0..3 {
                let top = most.log2() - pyramid.log2_base_radius[plane];
                assert!(top <= (pyramid.levels - 1) as f64, "{set:?}: level {top} of {}", pyramid.levels);
                assert!(pyramid.levels < 8, "{set:?}");
                // Whatever was left out below, spheres still lie near the base or under it.
                assert!(least.log2() - pyramid.log2_base_radius[plane] < 1.5, "{set:?}");
            }
        }
    }

    #[test]
    fn what_the_user_set_and_what_cannot_be_known_stays() {
        let (config, findings) = planned(&views(true), &["scene.aabb_min=[-1.0, -1.0, -1.0]"]).unwrap();
        assert!(!findings[0].left_out && findings[0].reason.contains("--set"), "{findings:?}");
        assert_eq!(config.scene.aabb_max, [1.5; 3]);
        let (config, findings) = planned(&views(false), &[]).unwrap();
        assert!(!findings[0].left_out && findings[0].reason.contains("no silhouettes"), "{findings:?}");
        assert!(!findings[2].left_out, "{findings:?}");
        assert_eq!(config.scene, Config::default().scene);
        let error = planned(&views(false), &["plan.aabb=on"]).unwrap_err();
        assert!(error.message.contains("plan.aabb") && error.exit_code() == 2, "{error}");
        let off: Vec<String> = keys().map(|key| format!("plan.{key}=off")).collect();
        let off: Vec<&str> = off.iter().map(String::as_str).collect();
        let (config, findings) = planned(&views(true), &off).unwrap();
        assert!(findings.iter().all(|finding| !finding.left_out && finding.changes.is_empty()));
        assert_eq!(Config { plan: Config::default().plan, ..config }, Config::default());
    }

    #[test]
    fn a_saving_is_told_where_there_is_one() {
        assert_eq!(saved("planes", 10_000_000, 20_000_000), "; planes of 40.0 MB instead of 80.0 MB");
        // Two sizes that read the same, the same size, and a larger one.
        for (after, before) in [(16_775_000, 16_777_216), (5, 5), (20_000_000, 10_000_000)] {
            assert_eq!(saved("planes", after, before), "");
        }
        for set in [&[][..], &["encoder.plane_size=16", "encoder.levels=3"]] {
            for finding in planned(&views(true), set).unwrap().1 {
                if let Some((before, after)) = finding.reason.split_once(" instead of ") {
                    assert!(!before.ends_with(after), "{}", finding.reason);
                }
            }
        }
    }

    #[test]
    fn directions_go_when_asked() {
        let (config, findings) = planned(&views(true), &["plan.directions=on"]).unwrap();
        assert!(!config.field.directions && findings[3].left_out, "{findings:?}");
        assert_eq!(crate::params::color_layers(&config)[0][0], 15);
    }

    #[test]
    fn a_run_goes_on_with_the_plan_it_began_with() {
        let (began, findings) = planned(&views(true), &["encoder.plane_size=256"]).unwrap();
        let again = |set: &[&str]| {
            let mut settings = Settings::defaults();
            set.iter().for_each(|assignment| settings.apply_assignment(assignment).unwrap());
            adopt(&mut settings, &findings).unwrap();
            Config::from_settings(&settings).unwrap()
        };
        assert_eq!(again(&["encoder.plane_size=256"]), began);
        // Other settings, or no plan, make another run.
        assert!(!again(&["encoder.plane_size=512"]).differences(&began).is_empty());
        assert!(!again(&["encoder.plane_size=256", "plan.aabb=off"]).differences(&began).is_empty());
    }
}
