//! Checks of a scene before it is trained: figures that tell wrong poses, axes, exposures, doubles and boxes. Every check is a
//! function of typed data, with its limits as constants; none decodes a photograph.

mod brightness;
mod coverage;
mod doubles;
mod focus;
mod points;
mod silhouettes;
mod sizes;

pub use brightness::{brightness, stops};
pub use coverage::coverage;
pub use doubles::{photographs, poses};
pub use focus::focus;
pub use points::{ahead, reprojection};
pub use silhouettes::silhouettes;
pub use sizes::sizes;

use crate::Point;
use trimip_core::{Aabb, Camera, Scale, ViewSet};

/// What is checked.
#[derive(Clone, Copy, Debug)]
pub struct Subject<'a> {
    /// The training views.
    pub train: &'a ViewSet,
    /// Name and camera of each test frame.
    pub test: &'a [(String, Camera)],
    /// Points of structure from motion, with the training views that saw them.
    pub points: &'a [Point],
    /// The planned box, world units; `None` for a space that has no end.
    pub aabb: Option<&'a Aabb<f64>>,
}

/// Conclusion of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Nothing is beyond a limit.
    Fine,
    /// Something is; the text says what to do.
    Suspicious(&'static str),
    /// The data do not tell.
    Unknown,
}

/// A training view beyond a limit.
#[derive(Clone, Debug, PartialEq)]
pub struct Suspect {
    /// Index among the views of the finest scale.
    pub view: usize,
    /// What was measured of it.
    pub figure: String,
}

/// Figures of the training views.
#[derive(Clone, Debug, PartialEq)]
pub struct Values {
    /// What they are, with their unit.
    pub name: &'static str,
    /// One per view of the finest scale; `None` where it is not known.
    pub of: Vec<Option<f64>>,
}

/// A check and what it found.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    /// What is checked.
    pub name: &'static str,
    /// What was measured.
    pub figure: String,
    /// What would be suspicious, and why.
    pub limit: String,
    /// The conclusion.
    pub verdict: Verdict,
    /// Views beyond a limit, the worst first.
    pub suspects: Vec<Suspect>,
    /// Figures of all views, if there are any.
    pub values: Vec<Values>,
}

/// Views named in a warning.
const NAMED: usize = 4;

impl Check {
    /// A check that the data do not allow, with the reason.
    fn unknown(name: &'static str, limit: String, reason: &str) -> Self {
        let verdict = Verdict::Unknown;
        Self { name, figure: reason.into(), limit, verdict, suspects: Vec::new(), values: Vec::new() }
    }

    /// The warning of a suspicious check, in one line; `train` holds the names of the views.
    pub fn warning(&self, train: &ViewSet) -> Option<String> {
        let Verdict::Suspicious(advice) = self.verdict else { return None };
        let named = |suspect: &Suspect| Some(format!("{} ({})", name(train, suspect.view)?, suspect.figure));
        let mut names: Vec<String> = self.suspects.iter().take(NAMED).filter_map(named).collect();
        if self.suspects.len() > NAMED {
            names.push(format!("{} more", self.suspects.len() - NAMED));
        }
        let views = if names.is_empty() { String::new() } else { format!(": {}", names.join(", ")) };
        Some(format!("{}: {}{views}; {advice}", self.name, self.figure))
    }
}

/// Makes all checks.
pub fn all(subject: &Subject<'_>) -> Vec<Check> {
    let Subject { train, test, points, aabb } = *subject;
    vec![
        silhouettes(train),
        reprojection(train, points),
        ahead(train, points),
        focus(train, points),
        brightness(train),
        poses(train, test),
        photographs(train),
        coverage(train, aabb),
        sizes(train),
    ]
}

/// Name of a view of the finest scale.
pub fn name(train: &ViewSet, view: usize) -> Option<&str> {
    let index = train.scales.first()?.views.clone().nth(view)?;
    Some(train.views[index].name.as_str())
}

/// Cameras of the finest scale.
fn cameras(train: &ViewSet) -> Vec<Camera> {
    let views = train.scales.first().map_or(0..0, |scale| scale.views.clone());
    views.map(|view| train.views[view].camera).collect()
}

/// The coarsest scale that has every frame and whose images have sides of at least `side` pixels; otherwise the finest.
pub fn coarsest(train: &ViewSet, side: u32) -> Option<&Scale> {
    let finest = train.scales.first()?;
    let fine_enough = |scale: &&Scale| {
        let sides = scale.views.clone().map(|view| train.views[view].camera.intrinsics);
        scale.views.len() == finest.views.len()
            && sides.map(|k| k.width.min(k.height)).min().is_some_and(|least| least >= side)
    };
    train.scales.iter().rev().find(fine_enough).or(Some(finest))
}

/// The middle of the finite values; `None` without any.
fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => None,
        length if length % 2 == 0 => Some(0.5 * (values[middle - 1] + values[middle])),
        _ => Some(values[middle]),
    }
}

/// "1 view", "7 of 12 views".
fn of_views(some: usize, all: usize) -> String {
    format!("{some} of {all} view{}", if all == 1 { "" } else { "s" })
}

/// Pixels of a grid of at most `side` × `side` over an image.
fn sampled(width: u32, height: u32, side: u32) -> impl Iterator<Item = (u32, u32)> {
    let stride = width.max(height).div_ceil(side).max(1);
    let along = move |length: u32| (stride / 2).min(length.saturating_sub(1))..length;
    along(height)
        .step_by(stride as usize)
        .flat_map(move |y| along(width).step_by(stride as usize).map(move |x| (x, y)))
}
