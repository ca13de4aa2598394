//! The initial view of a viewer.

use serde::Serialize;
use trimip_core::{
    Camera,
    config::{Contraction, SceneConfig},
};

/// Smallest and largest field of view of the initial view, degrees.
const ANGLES: [f64; 2] = [30.0, 90.0];

/// An initial view for a page.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Home {
    /// Camera-to-world matrix [R|t], row by row; axes right, up, back.
    pub pose: [f64; 12],
    /// Horizontal field of view, degrees.
    pub fov: f64,
}

/// Returns the view of the camera that is nearest to the middle of all training `cameras`. In an unbounded scene, any view from outside
/// shows parts that no photograph shows. `None` without cameras, and for a bounded scene, whose whole box is visible from outside.
pub fn home(scene: &SceneConfig, cameras: &[Camera]) -> Option<Home> {
    if scene.contraction == Contraction::None {
        return None;
    }
    let middle =
        cameras.iter().map(|camera| camera.origin).sum::<glam::DVec3>() / cameras.len().max(1) as f64;
    let distance = |camera: &&Camera| camera.origin.distance_squared(middle);
    let camera = cameras.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    let (r, t, k) = (camera.rotation, camera.origin, camera.intrinsics);
    let row = |i: usize| [r.col(0)[i], r.col(1)[i], r.col(2)[i], t[i]];
    let rows = [row(0), row(1), row(2)];
    // A window may be wide although the photograph is in portrait format, so the larger of its two angles is used.
    let angle = |side: u32, focal: f64| 2.0 * (0.5 * f64::from(side) / focal).atan();
    let fov = angle(k.width, k.fx).max(angle(k.height, k.fy)).to_degrees();
    Some(Home { pose: std::array::from_fn(|i| rows[i / 4][i % 4]), fov: fov.clamp(ANGLES[0], ANGLES[1]) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use trimip_core::Intrinsics;

    #[test]
    fn a_place_is_entered_where_a_photograph_was_taken_in_the_middle_of_all() {
        let at = |x: f64| {
            Camera::look_at(
                Intrinsics::from_angle(40, 60, 0.7),
                DVec3::new(x, 5.0, 1.0),
                DVec3::ZERO,
                DVec3::Z,
            )
        };
        let cameras = [at(-3.0), at(0.5), at(4.0)];
        let mut scene = trimip_core::Config::default().scene;
        assert_eq!(home(&scene, &cameras), None, "an object is seen from outside");
        scene.contraction = Contraction::Ball;
        assert_eq!(home(&scene, &[]), None);
        let home = home(&scene, &cameras).unwrap();
        assert_eq!([3, 7, 11].map(|i| home.pose[i]), [0.5, 5.0, 1.0]);
        let back = DVec3::new(home.pose[2], home.pose[6], home.pose[10]);
        assert!((back - cameras[1].origin.normalize()).length() < 1e-12);
        // The angle of the longer side.
        let expected = 2.0 * (1.5 * (0.35_f64).tan()).atan();
        assert!((home.fov - expected.to_degrees()).abs() < 1e-9, "{}", home.fov);
    }
}
