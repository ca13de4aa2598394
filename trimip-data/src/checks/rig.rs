//! Checks the cameras as a whole: whether there are enough, whether some are far from the others, and whether their lenses are plausible.

use super::{
    check::{Check, Suspect, Values, Verdict},
    views::{cameras, of_views},
};
use trimip_core::{
    Camera, ViewSet,
    geometry::projections::Model,
    plural::count,
    scene::strays::{STRAY, strays},
};

/// Least number of photographs from which training usually learns a scene.
const FEWEST: usize = 8;

/// Plausible fields of view across the longer side, degrees: from a telephoto to a wide-angle lens.
const FIELDS: [f64; 2] = [4.0, 150.0];

/// Largest plausible distance of the principal point from the middle of the picture, as a fraction of the side.
const MOST_SHIFT: f64 = 0.25;

/// Checks that there are enough photographs.
pub fn number(train: &ViewSet) -> Check {
    const NAME: &str = "number of photographs";
    let limit = format!("fewer than {FEWEST}: places that only one photograph shows have no depth");
    let views = cameras(train).len();
    let verdict = match views {
        0 => return Check::unknown(NAME, limit, "there is no photograph"),
        few if few < FEWEST => Verdict::Suspicious(
            "take 20 to 100 around the subject, each showing much of what its neighbours show",
        ),
        _ => Verdict::Fine,
    };
    Check {
        name: NAME,
        figure: format!("{} to learn from", count(views, "photograph")),
        limit,
        verdict,
        suspects: Vec::new(),
        values: Vec::new(),
    }
}

/// Checks that no camera is far from all others.
pub fn stray(train: &ViewSet) -> Check {
    let cameras = cameras(train);
    let strays = strays(&cameras).into_iter();
    let suspects: Vec<Suspect> = strays
        .map(|(view, times)| Suspect { view, figure: format!("{times:.0} times the median distance") })
        .collect();
    Check {
        name: "cameras far from the others",
        figure: of_views(suspects.len(), cameras.len()),
        limit: format!("more than {STRAY} times the median distance from the middle of all cameras"),
        verdict: match suspects.is_empty() {
            true => Verdict::Fine,
            false => Verdict::Suspicious(
                "their poses are wrong, or they show another place: leave them out; the box is planned without them",
            ),
        },
        suspects,
        values: Vec::new(),
    }
}

/// Checks that fields of view and principal points are plausible.
pub fn optics(train: &ViewSet) -> Check {
    let cameras = cameras(train);
    let perspective = |camera: &&Camera| camera.intrinsics.lens.model == Model::Perspective;
    let field = |camera: &Camera| {
        let k = &camera.intrinsics;
        let [x, y] = [(k.width, k.fx), (k.height, k.fy)].map(|(side, focal)| 0.5 * f64::from(side) / focal);
        2.0 * x.max(y).atan().to_degrees()
    };
    let shift = |camera: &Camera| {
        let k = &camera.intrinsics;
        let of = |centre: f64, side: u32| (centre / f64::from(side) - 0.5).abs();
        of(k.cx, k.width).max(of(k.cy, k.height))
    };
    let doubt = |camera: &Camera| {
        let (field, shift) = (field(camera), shift(camera));
        match () {
            () if !(FIELDS[0]..=FIELDS[1]).contains(&field) => {
                Some(format!("a field of view of {field:.1}°"))
            }
            () if shift > MOST_SHIFT => {
                Some(format!("a principal point {:.0} % from the middle", 100.0 * shift))
            }
            () => None,
        }
    };
    let doubted = cameras.iter().enumerate().filter(|(_, camera)| perspective(camera));
    let suspects: Vec<Suspect> =
        doubted.filter_map(|(view, camera)| Some(Suspect { view, figure: doubt(camera)? })).collect();
    let fields: Vec<Option<f64>> =
        cameras.iter().map(|camera| perspective(&camera).then(|| field(camera))).collect();
    Check {
        name: "fields of view",
        figure: format!("unlikely in {}", of_views(suspects.len(), cameras.len())),
        limit: format!(
            "below {} or above {} degrees, or a principal point more than {:.0} % of a side from the middle",
            FIELDS[0],
            FIELDS[1],
            100.0 * MOST_SHIFT
        ),
        verdict: match suspects.is_empty() {
            true => Verdict::Fine,
            false => Verdict::Suspicious(
                "focal lengths and principal points have to be in pixels of the photographs as stored, angles in radians: calibrate \
                 again, or correct them",
            ),
        },
        suspects,
        values: vec![Values { name: "field of view / degrees", of: fields }],
    }
}
