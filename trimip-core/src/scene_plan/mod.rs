//! The scene plan: settings that follow the data and the budget, decided before training begins. Each decision looks at the
//! cameras, the photographs and the machine, has a switch in `[plan]`, changes the values of other settings, and states the
//! reason. The first decisions choose what to train, the next ones how, and the last ones leave out what the scene does not
//! need.

mod aabb;
mod common_view;
mod cones;
mod crop;
mod decision;
mod decisions;
mod depth;
mod detail;
mod facing;
mod facts;
mod finding;
mod fineness;
mod hash_grid;
mod leave_out;
mod origin;
pub mod radii;
mod recipe;
mod rip_map;
mod sweep;
#[cfg(test)]
mod tests;
mod tri_mip;
mod up;
mod warnings;

pub use common_view::focus;
pub use facts::{Compute, Facts, StatedBox};
pub use finding::{Change, Finding};
pub use warnings::warnings;

use crate::config::{PlanChoice, settings::checker::Checker};
use crate::{Config, Error, Origin, Result, Settings};
use common_view::{at_one_place, cameras};
use decision::{Context, Decision, Proposal};
use decisions::DECISIONS;

/// Returns the keys of all decisions, as in `[plan]`.
pub fn keys() -> impl Iterator<Item = &'static str> {
    DECISIONS.iter().map(|decision| decision.key)
}

/// Takes every decision and changes `settings` accordingly.
///
/// # Errors
/// When a decision is `on` and cannot be taken.
pub fn make(settings: &mut Settings, facts: &Facts<'_>) -> Result<Vec<Finding>> {
    let settled = origin::settle(settings, facts)?;
    let configured = Config::from_settings(settings)?;
    let given = settings.clone();
    expect_depth(settings, &configured, facts)?;
    let decided: Result<Vec<_>> =
        DECISIONS.iter().map(|decision| take(decision, settings, &given, &configured, facts)).collect();
    // All decisions are needed to know whether space is contracted, and which encoder is in use.
    let planned = Config::from_settings(settings)?;
    let place = |path: &str| settings.place(path);
    planned.refuse_settings_of_other_encoders(&Checker::new(&place, &|_| true), |_| false)?;
    if planned.loss.opacity > 0.0 && !recipe::knows_opacity(&planned, facts.train) {
        return Err(Error::input(
            settings.place("loss.opacity"),
            "the photographs have no alpha to compare opacity with",
            "set it to 0, or use photographs with alpha",
        ));
    }
    if let Some(setting) = depth::without_points(&planned, facts.train) {
        return Err(Error::input(
            settings.place(setting),
            "the data set has no points that training photographs show, and no depth images",
            "set it to 0, or use photographs with a COLMAP model or with depth images",
        ));
    }
    Ok(settled.into_iter().chain(decided?).collect())
}

/// Takes only the decision on the box, which does not depend on the device, and changes `settings` accordingly.
///
/// # Errors
/// When the decision is `on` and cannot be taken.
pub fn make_box(settings: &mut Settings, facts: &Facts<'_>) -> Result<Finding> {
    origin::settle(settings, facts)?;
    let (configured, given) = (Config::from_settings(settings)?, settings.clone());
    expect_depth(settings, &configured, facts)?;
    take(&DECISIONS[0], settings, &given, &configured, facts)
}

/// Refuses cameras that only rotate at one place, unless the user gives the box. A box that the data state is no sign of
/// depth: exporters write `aabb_scale` for any poses.
fn expect_depth(settings: &Settings, configured: &Config, facts: &Facts<'_>) -> Result<()> {
    let given =
        ["scene.aabb_min", "scene.aabb_max"].iter().any(|path| *settings.origin(path) != Origin::Default);
    let cameras = cameras(facts.train);
    if given || configured.plan.aabb == PlanChoice::Off || !at_one_place(&cameras, facts.origin) {
        return Ok(());
    }
    Err(Error::input(
        "training photographs",
        format!("all {} cameras stand at one place, from which no depth can be learned", cameras.len()),
        "walk around the subject; or are the matrices world-to-camera? Poses are camera-to-world",
    ))
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
        return Ok(finding(false, format!("{path} is given: {}", given.origin(path)), Vec::new()));
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
            let mut kind = now.encoder.kind;
            let mut told = Vec::new();
            // Settings of other encoders are not changed. A decision that changes only such settings leaves nothing out.
            let left_out = left_out && changes.iter().any(|(path, _)| kind.takes(path));
            for (path, value) in changes {
                if !kind.takes(path) {
                    continue;
                }
                let from = settings.value(path);
                settings.decide(path, &value.to_string())?;
                let to = settings.value(path);
                if path == "encoder.kind" {
                    kind = Config::from_settings(settings)?.encoder.kind;
                }
                if from != to {
                    told.push(Change { path: path.into(), from, to });
                }
            }
            Ok(finding(left_out, reason, told))
        }
    }
}

/// Applies the decisions that a run made at its start, because a resumed run is not planned again. Settings that differ
/// from their values before the plan are kept; with them, the run is a different one.
///
/// # Errors
/// When a value has the wrong type.
pub fn adopt(settings: &mut Settings, findings: &[Finding]) -> Result<()> {
    let config = Config::from_settings(settings)?;
    let off = |key: &str| {
        if key == origin::KEY {
            return false;
        }
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
