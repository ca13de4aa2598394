//! Eight views of a model side by side. The cameras are around a bounded scene; in an unbounded scene they follow the
//! cameras of the photographs, so that the views show only what photographs saw. World units.

use super::cameras::Named;
use super::flythrough;
use super::pictures::rgb_image;
use super::turntable::{self, Turntable};
use glam::DVec3;
use image::{RgbImage, imageops};
use std::time::{Duration, Instant};
use trimip_core::{
    Camera, Intrinsics, Result, Viewer,
    config::{Contraction, SceneConfig},
};

/// Number of views in a strip.
const VIEWS: u32 = 8;

/// Elevation of the cameras around an object, degrees.
const ELEVATION: f64 = 20.0;

/// Horizontal field of view of the cameras, degrees.
const ANGLE: f64 = 40.0;

/// Returns the cameras of a strip with pictures of `side` × `side` pixels, from left to right: a little from above
/// around a bounded scene, along `photographed` through contracted space. If no two photographed cameras differ, the
/// cameras are on the circle in contracted space too.
///
/// # Errors
/// When the scene allows no upright view.
pub fn cameras(scene: &SceneConfig, photographed: &[Camera], side: u32) -> Result<Vec<Named>> {
    let intrinsics = Intrinsics::from_angle(side, side, ANGLE.to_radians());
    if scene.contraction == Contraction::Ball {
        let (_, half) = turntable::middle(scene);
        if let Ok(film) = flythrough::cameras(photographed, VIEWS, half.length()) {
            return Ok(film
                .into_iter()
                .map(|(name, camera)| (name, Camera { intrinsics, ..camera }))
                .collect());
        }
    }
    let up = DVec3::from_array(scene.up.map(f64::from));
    let table = Turntable { count: VIEWS, elevation: ELEVATION, distance: None, up };
    turntable::cameras(scene, &table, intrinsics)
}

/// Renders the views of these cameras side by side, each `side` × `side` pixels; `None` if that takes longer than `most`.
///
/// # Errors
/// When the device fails.
pub fn strip(
    viewer: &mut dyn Viewer,
    cameras: &[Named],
    side: u32,
    most: Duration,
) -> Result<Option<RgbImage>> {
    let started = Instant::now();
    let mut strip = RgbImage::new(cameras.len() as u32 * side, side);
    for (i, (_, camera)) in cameras.iter().enumerate() {
        let Some(frame) = viewer.render_watched(camera, &mut |_, _| started.elapsed() < most)? else {
            return Ok(None);
        };
        let view = rgb_image(side, side, &frame.rgb());
        imageops::replace(&mut strip, &view, (i as u32 * side).into(), 0);
    }
    Ok(Some(strip))
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip_core::Config;

    #[test]
    fn an_object_is_seen_from_all_around_and_a_place_from_where_it_was_photographed() {
        let mut scene = Config::default().scene;
        let photographed: Vec<Camera> = (0..12)
            .map(|i| {
                let angle = 0.1 * f64::from(i);
                let eye = DVec3::new(angle.cos(), angle.sin(), 0.2);
                Camera::look_at(Intrinsics::from_angle(60, 40, 0.9), eye, DVec3::ZERO, DVec3::Z)
            })
            .collect();
        let behind = |scene: &SceneConfig, photographed: &[Camera]| {
            let all = cameras(scene, photographed, 32).unwrap();
            assert!(
                all.len() == 8
                    && all.iter().all(|(_, c)| (c.intrinsics.width, c.intrinsics.height) == (32, 32))
            );
            all.iter().filter(|(_, camera)| camera.origin.x < 0.0).count()
        };
        assert!(behind(&scene, &photographed) >= 3);
        scene.contraction = Contraction::Ball;
        assert_eq!(behind(&scene, &photographed), 0);
        assert!(behind(&scene, &photographed[..1]) >= 3, "one photograph makes no path");
    }
}
