//! The scene plan: what follows the data and the budget is decided before training begins. Each decision looks at the
//! cameras, the photographs and the machine, has a switch in `[plan]`, changes other settings, never what they mean, and
//! says why. Some find what to train, others how; the last ones leave out what the scene does not need.

mod aabb;
mod detail;
mod leave_out;
pub mod radii;
mod recipe;
pub mod silhouettes;

pub use aabb::warnings;

use crate::config::PlanChoice;
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
    /// Where the data say that the subject is.
    pub stated: Option<&'a StatedBox>,
    /// What will compute.
    pub compute: &'a Compute,
}

/// A box that comes with the data.
#[derive(Clone, Debug, PartialEq)]
pub struct StatedBox {
    /// World units.
    pub aabb: Aabb<f64>,
    /// What states it, in words.
    pub source: String,
}

/// What a run computes with.
#[derive(Clone, Debug, PartialEq)]
pub struct Compute {
    /// In words.
    pub name: String,
    /// Kept samples a second that networks of 64 units may be trained with.
    pub samples_per_second: f64,
    /// True where products of bf16 are faster than those of f32.
    pub bf16: bool,
    /// True for a device that is idle below some 100,000 samples a step.
    pub wide: bool,
}

impl Compute {
    /// One thread of a processor with wide vectors: what tests and documentation plan for.
    pub fn one_thread() -> Self {
        Self { name: "one thread".into(), samples_per_second: 3e5, bf16: false, wide: false }
    }
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
        let verdict = match (self.left_out, self.changes.is_empty()) {
            (true, _) => "left out",
            (false, false) => "set",
            (false, true) => "kept",
        };
        write!(f, "plan.{}: {verdict}: {}", self.decision, self.reason)
    }
}

/// What a decision is taken from.
struct Context<'a> {
    /// The settings with what was decided so far.
    now: &'a Config,
    /// The settings as the user gave them.
    configured: &'a Config,
    facts: &'a Facts<'a>,
    /// The settings as layers, as the user gave them.
    given: &'a Settings,
}

impl Context<'_> {
    /// True for a setting that the user gave.
    fn given(&self, path: &str) -> bool {
        *self.given.origin(path) != Origin::Default
    }
}

/// What a decision proposes.
enum Proposal {
    /// Everything stays; why.
    Keep(String),
    /// It cannot be known; why, and what to do.
    Unknown(String, &'static str),
    /// These settings follow the data or the budget.
    Set { reason: String, changes: Vec<(&'static str, Value)> },
    /// This much is not needed.
    LeaveOut { reason: String, changes: Vec<(&'static str, Value)> },
}

type Decide = fn(&Context<'_>) -> Proposal;

/// A decision: its key, the settings that are its own (`auto` leaves the decision alone where the user gave one of them),
/// and its rule.
struct Decision {
    key: &'static str,
    owns: &'static [&'static str],
    choice: fn(&Config) -> PlanChoice,
    decide: Decide,
}

/// In the order in which they are taken: each sees what those before it changed.
const DECISIONS: [Decision; 9] = [
    Decision {
        key: "aabb",
        owns: &["scene.aabb_min", "scene.aabb_max", "encoder.shape"],
        choice: |config| config.plan.aabb,
        decide: aabb::find,
    },
    Decision {
        key: "background",
        owns: &["data.background"],
        choice: |config| config.plan.background,
        decide: recipe::background,
    },
    Decision {
        key: "solids",
        owns: &["loss.opacity", "train.background"],
        choice: |config| config.plan.solids,
        decide: recipe::solids,
    },
    Decision { key: "schedule", owns: &[], choice: |config| config.plan.schedule, decide: recipe::schedule },
    Decision { key: "detail", owns: &[], choice: |config| config.plan.detail, decide: detail::decide },
    Decision {
        key: "levels",
        owns: &["encoder.levels"],
        choice: |config| config.plan.levels,
        decide: leave_out::levels,
    },
    Decision {
        key: "occupancy",
        owns: &[],
        choice: |config| config.plan.occupancy,
        decide: leave_out::occupancy,
    },
    Decision {
        key: "directions",
        owns: &["field.directions"],
        choice: |config| config.plan.directions,
        decide: leave_out::directions,
    },
    Decision {
        key: "file",
        owns: &["file.planes"],
        choice: |config| config.plan.file,
        decide: leave_out::half_precision,
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
    if configured.loss.opacity > 0.0 && !recipe::has_alpha(facts.train) {
        return Err(Error::input(
            settings.place("loss.opacity"),
            "the photographs have no alpha to compare opacity with",
            "set it to 0, or use photographs with alpha",
        ));
    }
    let given = settings.clone();
    DECISIONS.iter().map(|decision| take(decision, settings, &given, &configured, facts)).collect()
}

fn take(
    decision: &Decision,
    settings: &mut Settings,
    given: &Settings,
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
    let own = decision.owns.iter().find(|path| *given.origin(path) != Origin::Default);
    if let (PlanChoice::Auto, Some(path)) = (choice, own) {
        return Ok(finding(false, format!("{path} is set by {}", given.origin(path)), Vec::new()));
    }
    let now = Config::from_settings(settings)?;
    let proposal = (decision.decide)(&Context { now: &now, configured, facts, given });
    let left_out = matches!(proposal, Proposal::LeaveOut { .. });
    match proposal {
        Proposal::Keep(reason) => Ok(finding(false, reason, Vec::new())),
        Proposal::Unknown(reason, advice) if choice == PlanChoice::On => {
            Err(Error::input(format!("plan.{}", decision.key), reason, advice))
        }
        Proposal::Unknown(reason, _) => Ok(finding(false, reason, Vec::new())),
        Proposal::Set { reason, changes } | Proposal::LeaveOut { reason, changes } => {
            let mut told = Vec::new();
            for (path, value) in changes {
                let from = settings.value(path);
                settings.decide(path, &value.to_string())?;
                let to = settings.value(path);
                if from != to {
                    told.push(Change { path: path.into(), from, to });
                }
            }
            Ok(finding(left_out, reason, told))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::FilePrecision;
    use crate::tri_mip::Pyramid;
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
        let compute = Compute::one_thread();
        let facts = Facts { train, test: &test, stated: None, compute: &compute };
        let findings = make(&mut settings, &facts)?;
        Ok((Config::from_settings(&settings)?, findings))
    }

    /// The finding of a decision.
    fn of<'a>(findings: &'a [Finding], decision: &str) -> &'a Finding {
        findings.iter().find(|finding| finding.decision == decision).unwrap()
    }

    #[test]
    fn levels_are_sharper_where_texels_are_as_fine_as_pixels_see() {
        let bias = |set: &[&str]| planned(&views(true), set).unwrap().0.encoder.level_bias;
        assert_eq!(bias(&[]), -0.5);
        // Planes of 16 texels over the ball: each is as wide as some five pixels.
        assert_eq!(bias(&["encoder.plane_size=16", "encoder.levels=3"]), 0.0);
        assert_eq!(bias(&["encoder.level_bias=0.25"]), 0.25, "a setting that is given stays");
    }

    #[test]
    fn a_small_object_needs_a_small_box_and_given_texels_steps_and_cells_stay_as_wide() {
        let before = Config::default();
        let (config, findings) =
            planned(&views(true), &["encoder.levels=5", "plan.detail=off", "plan.schedule=off"]).unwrap();
        for decision in ["aabb", "occupancy", "file"] {
            assert!(of(&findings, decision).left_out, "{findings:?}");
        }
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

    /// The same scene in other units, somewhere else: box, texels and steps follow.
    #[test]
    fn the_box_and_its_detail_do_not_depend_on_units_or_place() {
        let near = views(true);
        let (scale, shift) = (250.0, DVec3::new(-3000.0, 500.0, 40.0));
        let mut far = near.clone();
        for view in &mut far.views {
            view.camera.origin = scale * view.camera.origin + shift;
        }
        let [(one, _), (other, findings)] = [&near, &far].map(|train| planned(train, &[]).unwrap());
        let [small, large] = [&one, &other].map(|config| Aabb::<f64>::new(&config.scene));
        for axis in 0..3 {
            let moved = scale * small.min[axis] + shift[axis];
            // Boxes are rounded to a hundredth of their size.
            assert!((large.min[axis] - moved).abs() < 0.03 * large.longest(), "{large:?} {findings:?}");
        }
        let alike = |a: u32, b: u32| (0.9..1.12).contains(&(f64::from(a) / f64::from(b)));
        assert!(alike(one.encoder.plane_size, other.encoder.plane_size), "{findings:?}");
        assert!(alike(one.renderer.steps_per_diagonal, other.renderer.steps_per_diagonal), "{findings:?}");
        assert!(warnings_of(&other, &far).is_empty());
    }

    fn warnings_of(config: &Config, train: &ViewSet) -> Vec<String> {
        let compute = Compute::one_thread();
        warnings(config, &Facts { train, test: &[], stated: None, compute: &compute })
    }

    #[test]
    fn a_box_beside_the_subject_is_told() {
        let train = views(true);
        let beside = ["scene.aabb_min=[5.0, 5.0, 5.0]", "scene.aabb_max=[6.0, 6.0, 6.0]", "plan.aabb=off"];
        let (config, _) = planned(&train, &beside).unwrap();
        let told = warnings_of(&config, &train);
        assert!(told.iter().any(|text| text.contains("covers only 0 %")), "{told:?}");
    }

    #[test]
    fn photographs_say_whether_models_are_solids_and_what_is_behind_them() {
        let (config, _) = planned(&views(true), &[]).unwrap();
        assert_eq!((config.loss.opacity, config.data.background), (0.1, [1.0; 3]));
        let (config, findings) = planned(&views(false), &[]).unwrap();
        assert_eq!((config.loss.opacity, config.data.background), (0.0, [1.0, 0.0, 0.0]), "{findings:?}");
        let error = planned(&views(false), &["loss.opacity=0.1"]).unwrap_err();
        assert!(error.exit_code() == 2 && error.message.contains("no alpha"), "{error}");
        let (config, _) = planned(&views(true), &["loss.opacity=0.0"]).unwrap();
        assert_eq!(config.loss.opacity, 0.0, "what is given stays");
    }

    #[test]
    fn texels_that_are_given_stay_given_when_the_box_shrinks() {
        let (config, findings) =
            planned(&views(true), &["encoder.plane_size=16", "encoder.levels=3"]).unwrap();
        assert!(config.encoder.plane_size <= 16 && of(&findings, "aabb").left_out, "{findings:?}");
        let changed = |f: &Finding| f.changes.iter().any(|change| change.path == "encoder.plane_size");
        assert!(!changed(of(&findings, "detail")), "{findings:?}");
    }

    #[test]
    fn networks_and_steps_follow_the_budget() {
        let of = |set: &[&str]| planned(&views(true), set).unwrap().0;
        let hidden = |seconds: &str| of(&[seconds]).field.hidden;
        assert_eq!(
            ["train.seconds=60", "train.seconds=1000", "train.seconds=10000"].map(hidden),
            [32, 64, 128]
        );
        assert_eq!(of(&["train.seconds=1000", "field.hidden=96"]).field.hidden, 96, "what is given stays");
        let steps = of(&["train.steps=100", "train.samples_per_step=4096"]);
        assert_eq!((steps.train.samples_per_step, steps.field.hidden), (4096, 32));
        let small = of(&["train.seconds=1"]).train.samples_per_step;
        assert!((4096..32_768).contains(&small), "{small}");
    }

    #[test]
    fn no_sphere_of_any_camera_reaches_a_level_that_is_left_out() {
        let train = views(true);
        for set in [
            &["plan.detail=off"][..],
            &[],
            &["plan.aabb=off", "plan.detail=off"],
            &["encoder.plane_size=4096", "encoder.levels=9", "plan.levels=on"],
        ] {
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
        assert!(findings[0].reason.contains("no silhouettes"), "{findings:?}");
        let aabb = Aabb::<f64>::new(&config.scene);
        assert!(aabb.min[0] < -4.0 && aabb.max[0] > 4.0, "the surroundings are in it: {aabb:?}");
        let given = ["scene.aabb_max=[1.0, 1.0, 1.0]", "plan.aabb=on"];
        let error = planned(&views(false), &given).unwrap_err();
        assert!(error.message.contains("plan.aabb") && error.exit_code() == 2, "{error}");
        let off: Vec<String> = keys().map(|key| format!("plan.{key}=off")).collect();
        let off: Vec<&str> = off.iter().map(String::as_str).collect();
        let (config, findings) = planned(&views(true), &off).unwrap();
        assert!(findings.iter().all(|finding| finding.changes.is_empty()));
        assert_eq!(Config { plan: Config::default().plan, ..config }, Config::default());
    }

    #[test]
    fn a_saving_is_told_where_there_is_one() {
        assert_eq!(
            leave_out::saved("planes", 10_000_000, 20_000_000),
            "; planes of 40.0 MB instead of 80.0 MB"
        );
        // Two sizes that read the same, the same size, and a larger one.
        for (after, before) in [(16_775_000, 16_777_216), (5, 5), (20_000_000, 10_000_000)] {
            assert_eq!(leave_out::saved("planes", after, before), "");
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
        assert!(!config.field.directions && of(&findings, "directions").left_out, "{findings:?}");
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
