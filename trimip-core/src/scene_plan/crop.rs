//! The crop in contracted space: the ball around the point that the cameras look at, large enough to fill their pictures.

use super::common_view::{COMMON, cameras, focus, is_ahead};
use super::decision::{Context, Proposal};
use super::facing::Facing;
use super::fineness::significant;
use crate::Crop;
use crate::config::Contraction;
use crate::{Camera, Cone};
use glam::DVec3;
use toml::Value;

/// Number of steps along each side of a picture. The rays at these steps bound what the camera sees.
const BORDER: u32 = 16;

pub(super) fn decide(context: &Context<'_>) -> Proposal {
    if context.now.scene.contraction == Contraction::None {
        return Proposal::Keep("the scene's box bounds what is shown".into());
    }
    let faced = Facing::of(context.facts.train).and_then(|facing| facing.ball());
    let Some((centre, radius)) = faced.or_else(|| subject(&cameras(context.facts.train))) else {
        return Proposal::Keep("the cameras have no common subject: nothing is left out".into());
    };
    let crop =
        Crop::Ball { centre: centre.to_array().map(|x| rounded(x, radius)), radius: rounded(radius, radius) };
    Proposal::Set {
        reason: format!(
            "meshes, and films and viewers on request, show only the ball with a radius of {} units around what the cameras look at",
            significant(radius)
        ),
        changes: vec![("scene.crop", Value::String(crop.to_string()))],
    }
}

/// Returns the point that the cameras look at, and the largest radius that does not exceed [`filling`] for the share
/// [`COMMON`] of the cameras. `None` if the cameras look at no common point, or do not see it.
fn subject(cameras: &[Camera]) -> Option<(DVec3, f64)> {
    let focus = focus(cameras).filter(|focus| is_ahead(cameras, *focus))?;
    let directed = |camera: &&Camera| camera.intrinsics.lens.model.definition().directed;
    let mut radii: Vec<f64> = cameras.iter().filter(directed).map(|camera| filling(camera, focus)).collect();
    radii.sort_by(|a, b| b.total_cmp(a));
    let common = ((COMMON * radii.len() as f64).ceil() as usize).max(1);
    radii
        .get(common - 1)
        .copied()
        .filter(|radius| *radius > 0.0 && radius.is_finite())
        .map(|radius| (focus, radius))
}

/// Returns the radius of the ball around a point that fills a camera's picture: the median distance from the point to the rays
/// of the picture's border, at most the distance to the camera; 0 if the point is not in the picture.
fn filling(camera: &Camera, at: DVec3) -> f64 {
    if !camera.sees(at) {
        return 0.0;
    }
    let [right, lower] =
        [camera.intrinsics.width, camera.intrinsics.height].map(|side| side.saturating_sub(1));
    let places = (0..=BORDER).flat_map(|i| {
        let along = |side: u32| (u64::from(side) * u64::from(i) / u64::from(BORDER)) as u32;
        [(along(right), 0), (along(right), lower), (0, along(lower)), (right, along(lower))]
    });
    let to_ray = |(x, y)| {
        let Cone { origin, direction, .. } = camera.cone::<f64>(x, y);
        let (origin, direction) = (DVec3::from(origin), DVec3::from(direction));
        let ahead = (at - origin).dot(direction).max(0.0);
        (at - origin - ahead * direction).length()
    };
    let mut distances: Vec<f64> = places.map(to_ray).collect();
    distances.sort_by(f64::total_cmp);
    distances[distances.len() / 2].min((at - camera.origin).length())
}

/// Rounds a coordinate to a hundredth of the radius or finer.
fn rounded(value: f64, radius: f64) -> f64 {
    let digits = (2.0 - radius.log10().floor()).max(0.0) as usize;
    format!("{value:.digits$}").parse::<f64>().unwrap_or(value) + 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intrinsics;

    /// Returns cameras on a circle around `centre` that look at it, with a view of 60 by 40 degrees.
    fn ring(centre: DVec3, radius: f64) -> Vec<Camera> {
        let tangent = |degrees: f64| (0.5 * degrees.to_radians()).tan();
        let focal = 300.0 / tangent(60.0);
        let k = Intrinsics {
            height: (2.0 * focal * tangent(40.0)).round() as u32,
            ..Intrinsics::from_angle(600, 600, 1.0_f64.to_radians() * 60.0)
        };
        let k = Intrinsics { cy: 0.5 * f64::from(k.height), ..k };
        (0..20)
            .map(|i| {
                let turn = f64::from(i) * 0.7;
                let origin = centre + radius * DVec3::new(turn.cos(), turn.sin(), 0.4);
                Camera::look_at(k, origin, centre, DVec3::Z)
            })
            .collect()
    }

    #[test]
    fn the_ball_fills_the_pictures() {
        let centre = DVec3::new(5.0, -3.0, 2.0);
        let mut cameras = ring(centre, 2.0);
        let distance = 2.0 * 1.16_f64.sqrt();
        let (found, radius) = subject(&cameras).unwrap();
        assert!((found - centre).length() < 1e-6, "{found}");
        // The border lies 20 to 34.3 degrees from the axis. All of the upright sides and a quarter of the other sides lie at 30
        // degrees or more.
        let expected = distance * 30.3_f64.to_radians().sin();
        assert!((radius / expected - 1.0).abs() < 0.02, "{radius}, not {expected}");
        // Moving fewer than half of the cameras closer to the subject does not change the radius.
        for camera in &mut cameras[..6] {
            let away = camera.origin + (centre - camera.origin) * 0.5;
            *camera = Camera { origin: away, ..*camera };
        }
        let (_, near) = subject(&cameras).unwrap();
        assert!((near / expected - 1.0).abs() < 0.02, "{near}");
    }

    #[test]
    fn cameras_that_look_outwards_have_no_subject() {
        let outwards: Vec<Camera> = ring(DVec3::ZERO, 2.0)
            .iter()
            .map(|c| Camera::look_at(c.intrinsics, c.origin, 2.0 * c.origin, DVec3::Z))
            .collect();
        assert_eq!(subject(&outwards), None);
        assert_eq!(subject(&[]), None);
    }

    #[test]
    fn numbers_are_as_short_as_the_ball_allows() {
        assert_eq!(
            [rounded(1.23456, 2.0), rounded(-0.0001, 2.0), rounded(123.456, 900.0)],
            [1.23, 0.0, 123.0]
        );
    }
}
