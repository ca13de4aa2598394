//! Local origin of a scene that is far from zero. It is chosen when the scene is opened; this module writes it into the settings,
//! and converts the box and the crop that the user gave in the coordinates of the photographs.

use super::facts::Facts;
use super::finding::{Change, Finding};
use crate::config::{Crop, PlanChoice};
use crate::scene::origin::LocalOrigin;
use crate::{Origin, Result, Settings};
use toml::Value;

/// The finding's key. The decision has no switch: `data.origin = [0, 0, 0]` keeps coordinates as they are.
pub(super) const KEY: &str = "origin";

const SETTING: &str = "data.origin";

/// Writes the scene's origin into the settings, and converts the places in them to local coordinates. Returns `None` if the
/// coordinates are those of the photographs, or if `data.origin` is given.
///
/// # Errors
/// When a value has the wrong type.
pub(super) fn settle(settings: &mut Settings, facts: &Facts<'_>) -> Result<Option<Finding>> {
    let origin = facts.origin;
    if origin.is_zero() || *settings.origin(SETTING) != Origin::Default {
        return Ok(None);
    }
    let numbers = |place: [f64; 3]| Value::Array(place.map(Value::Float).to_vec());
    let mut changes = vec![(SETTING, numbers(origin.numbers()))];
    let given = |path: &str| *settings.origin(path) != Origin::Default;
    for corner in ["scene.aabb_min", "scene.aabb_max"].into_iter().filter(|path| given(path)) {
        if let Some(place) = place(settings, corner) {
            changes.push((corner, numbers(origin.local(place))));
        }
    }
    if given("scene.crop")
        && let Some(crop) = crop(settings)
    {
        changes.push(("scene.crop", Value::String(origin.local(crop).to_string())));
    }
    let changes: Result<Vec<Change>> = changes
        .into_iter()
        .map(|(path, value)| {
            let from = settings.value(path);
            settings.decide(path, &value.to_string())?;
            Ok(Change { path: path.into(), from, to: settings.value(path) })
        })
        .collect();
    Ok(Some(Finding {
        decision: KEY.into(),
        choice: PlanChoice::Auto,
        left_out: false,
        reason: reason(origin),
        changes: changes?,
    }))
}

fn reason(origin: LocalOrigin) -> String {
    format!(
        "the cameras are far from the origin of their coordinates: this program uses coordinates relative to {origin}; cameras \
         and meshes are written in the coordinates of the photographs"
    )
}

/// Returns the place in a setting as f64; a typed configuration holds it as f32.
fn place(settings: &Settings, path: &str) -> Option<[f64; 3]> {
    let numbers: Option<Vec<f64>> = settings.get(path)?.as_array()?.iter().map(Value::as_float).collect();
    numbers?.try_into().ok()
}

fn crop(settings: &Settings) -> Option<Crop> {
    settings.get("scene.crop")?.as_str()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::super::{Compute, adopt, make, make_box, tests::views};
    use super::*;
    use crate::Config;

    /// Checks that places that the user gives are taken in the coordinates of the photographs, even if the plan's
    /// coordinates differ.
    #[test]
    fn given_places_of_a_far_scene_follow_its_origin() {
        let (train, compute) = (views(true), Compute::one_thread());
        let origin = LocalOrigin::at(&[4_075_539.0, 931_735.0, 4_801_629.0]);
        let facts = Facts { train: &train, test: &[], stated: None, origin, compute: &compute };
        let of = |set: &[&str]| {
            let mut settings = Settings::defaults();
            set.iter().for_each(|assignment| settings.apply_assignment(assignment).unwrap());
            settings
        };
        let made = |set: &[&str]| {
            let mut settings = of(set);
            let findings = make(&mut settings, &facts).unwrap();
            (Config::from_settings(&settings).unwrap(), findings)
        };
        let set = [
            "scene.aabb_min=[4075538.25, 931734.125, 4801628.5]",
            "scene.aabb_max=[4075540.25, 931736.125, 4801630]",
            "scene.crop=\"ball 4075539.5,931735,4801629,0.75\"",
        ];
        let (config, findings) = made(&set);
        assert_eq!(config.data.origin, origin.numbers());
        assert_eq!(config.scene.aabb_min, [-0.75, -0.875, -0.5]);
        assert_eq!(config.scene.aabb_max, [1.25, 1.125, 1.0]);
        assert_eq!(config.scene.crop.to_string(), "ball 0.5,0,0,0.75");
        assert_eq!(findings[0].changes.len(), 4, "{:?}", findings[0]);
        // A resumed run has the same configuration.
        let mut again = of(&set);
        adopt(&mut again, &findings).unwrap();
        assert_eq!(Config::from_settings(&again).unwrap(), config);
        let mut inspected = of(&set);
        make_box(&mut inspected, &facts).unwrap();
        assert_eq!(Config::from_settings(&inspected).unwrap().scene, config.scene);
        // If the origin is given too, as in the configuration that a run writes, places are relative to it.
        let whole = of(&[
            "data.origin=[4075539, 931735, 4801629]",
            "scene.aabb_min=[-0.75, -0.875, -0.5]",
            "scene.aabb_max=[1.25, 1.125, 1]",
        ]);
        let mut settings = whole.clone();
        let findings = make(&mut settings, &facts).unwrap();
        assert_eq!(Config::from_settings(&settings).unwrap().scene.aabb_min, [-0.75, -0.875, -0.5]);
        assert!(findings.iter().all(|finding| finding.decision != KEY));
        let near = Facts { origin: LocalOrigin::default(), ..facts };
        let findings = make(&mut Settings::defaults(), &near).unwrap();
        assert!(findings.iter().all(|finding| finding.decision != KEY));
    }
}
