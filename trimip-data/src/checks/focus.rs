//! Checks the axes of cameras: a camera has its subject in front of it. If the axes of a file are not those of its
//! layout, the cameras look away from the place where their optical axes meet.

use super::{
    check::{Check, Suspect, Verdict},
    views::{cameras, of_views},
};
use crate::Point;
use trimip_core::{Camera, ViewSet, scene_plan};

/// Axes are doubted if fewer than this share of the cameras have the common focus in front of them. With wrong axes no
/// camera has, on a walk through rooms about one half.
const LEAST_AHEAD: f64 = 0.2;

/// If more than this share of the cameras look at the focus, they surround a subject, and the few that look away are doubted.
const SURROUNDING: f64 = 0.9;

const NAME: &str = "axes of cameras";

/// Checks that the cameras look towards the place where their optical axes meet. Points with tracks are better
/// evidence: if there are any, only single views that look away are doubted.
pub fn focus(train: &ViewSet, points: &[Point]) -> Check {
    let limit = format!(
        "less than {:.0} % of the cameras look towards the place where their axes meet, or single cameras look away although {:.0} % \
         look towards it: with turned axes 0 % do, around a subject all do",
        100.0 * LEAST_AHEAD,
        100.0 * SURROUNDING
    );
    let cameras = cameras(train);
    let Some(focus) = scene_plan::focus(&cameras) else {
        return Check::unknown(NAME, limit, "the cameras look in parallel, at no common place");
    };
    let ahead = |camera: &Camera| camera.rotation.z_axis.dot(focus - camera.origin) < 0.0;
    let away: Vec<usize> = (0..cameras.len()).filter(|&view| !ahead(&cameras[view])).collect();
    let fraction = 1.0 - away.len() as f64 / cameras.len().max(1) as f64;
    let tracked = points.iter().any(|point| !point.track.is_empty());
    let figure = format!(
        "{} look towards the place where their axes meet",
        of_views(cameras.len() - away.len(), cameras.len())
    );
    let (verdict, suspects) = if fraction < LEAST_AHEAD && !tracked {
        let advice = "are the axes those of OpenCV? poses are camera-to-world with OpenGL axes (x right, y up, looking along \
                      -z): change the signs of the second and third column, unless the photographs were taken outwards";
        (Verdict::Suspicious(advice), Vec::new())
    } else if fraction >= SURROUNDING && !away.is_empty() {
        let suspect = |view| Suspect { view, figure: "looks away".into() };
        (
            Verdict::Suspicious("look at these views: are their poses right?"),
            away.into_iter().map(suspect).collect(),
        )
    } else {
        (Verdict::Fine, Vec::new())
    };
    Check { name: NAME, figure, limit, verdict, suspects, values: Vec::new() }
}
