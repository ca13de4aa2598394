//! Inspection of a capture before training: describes the scene, plans its space, and checks poses, exposures and boxes. No device
//! is used.

use trimip_core::scene_plan::{self, Compute, Facts, Finding};
use trimip_core::{Config, Result, Settings, Space};
use trimip_data::checks::{self, Check, Subject};
use trimip_data::{Scene, Watch, examine};

/// An inspected capture.
#[derive(Debug)]
pub struct Inspection {
    /// The scene, in words and as data.
    pub seen: trimip_data::Inspection,
    /// The planned space, world units.
    pub space: Space<f64>,
    /// The plan's decision about the space; `None` if planning failed, which a warning reports.
    pub plan: Option<Finding>,
    /// Warnings about the plan.
    pub warnings: Vec<String>,
    /// The checks with their results.
    pub checks: Vec<Check>,
}

/// Opens the scene that the settings name, plans its space and checks it. Progress of reading goes to `watch`.
///
/// # Errors
/// When [`trimip_data::open`] refuses the scene; the error has the kind `Input`.
pub fn inspect(mut settings: Settings, watch: Watch<'_>) -> Result<Inspection> {
    let configured = Config::from_settings(&settings)?;
    let seen = examine(&configured.section()?, watch)?;
    let (test, compute): (Vec<_>, _) =
        (seen.scene.test_views.iter().map(|(_, camera)| *camera).collect(), Compute::one_thread());
    let facts = Facts {
        train: &seen.scene.train,
        test: &test,
        stated: seen.scene.stated.as_ref(),
        origin: seen.scene.origin,
        compute: &compute,
    };
    let (mut plan, mut warnings) = (None, Vec::new());
    match scene_plan::make_box(&mut settings, &facts) {
        Ok(finding) => plan = Some(finding),
        Err(error) => warnings.push(format!("the box is not planned: {error}")),
    }
    let planned = Config::from_settings(&settings)?;
    warnings.extend(scene_plan::warnings(&planned, &facts));
    let space = Space::<f64>::new(&planned.scene);
    let checks = checks::all(&subject(&seen.scene, &space));
    Ok(Inspection { seen, space, plan, warnings, checks })
}

/// Returns the parts of a scene that the checks use.
fn subject<'a>(scene: &'a Scene, space: &'a Space<f64>) -> Subject<'a> {
    Subject {
        train: &scene.train,
        test: &scene.test_views,
        points: &scene.points,
        aabb: if space.ball().is_none() { Some(space.aabb()) } else { None },
    }
}

/// Returns all warnings about a scene before training: those of the data, of the plan and of the checks.
pub fn warnings(scene: &Scene, planned: &Config, facts: &Facts<'_>) -> Vec<String> {
    let space = Space::<f64>::new(&planned.scene);
    let checks = checks::all(&subject(scene, &space));
    let suspicious = checks.iter().filter_map(|check| check.warning(&scene.train));
    scene.warnings.iter().cloned().chain(scene_plan::warnings(planned, facts)).chain(suspicious).collect()
}

impl Inspection {
    /// Returns the description as lines of text, followed by the warnings of the data, of the plan and of the checks.
    pub fn lines(&self) -> Vec<String> {
        let warnings = self.all_warnings();
        let told = warnings.iter().map(|warning| format!("warning: {warning}"));
        self.seen.lines.iter().cloned().chain(told).collect()
    }

    fn all_warnings(&self) -> Vec<String> {
        let scene = &self.seen.scene;
        let suspicious = self.checks.iter().filter_map(|check| check.warning(&scene.train));
        scene.warnings.iter().chain(&self.warnings).cloned().chain(suspicious).collect()
    }
}
