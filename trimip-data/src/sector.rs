//! Chooses the frames in one sector of the cameras (`data.holdout_by = "sector"`): test views with no training view between them.

use trimip_core::{Camera, scene_plan};

/// Cameras are at one place if their distances to each other are at most this share of their distance to the origin.
const ONE_PLACE: f64 = 1e-9;

/// A group of neighbouring cameras.
#[derive(Debug, PartialEq)]
pub(crate) struct Sector {
    /// Their indices, in order.
    pub(crate) frames: Vec<usize>,
    /// Its extent, in words after "within".
    pub(crate) extent: String,
}

/// How far a camera is from the first one.
#[derive(Clone, Copy)]
enum Apart {
    /// Angle between the two cameras, seen from the point that the cameras look at, radians.
    Seen(f64),
    /// Angle between their viewing directions, radians, if all cameras are at one place.
    Turned(f64),
    /// Their distance, world units, if all cameras look along one direction.
    Moved(f64),
}

impl Apart {
    fn value(self) -> f64 {
        match self {
            Self::Seen(value) | Self::Turned(value) | Self::Moved(value) => value,
        }
    }

    fn words(self) -> String {
        match self {
            Self::Seen(angle) => {
                format!(
                    "{:.0}° of the first camera, as seen from the point that all look at",
                    angle.to_degrees()
                )
            }
            Self::Turned(angle) => {
                format!("{:.0}° of the first camera's viewing direction", angle.to_degrees())
            }
            Self::Moved(distance) => format!("{distance:.4} world units of the first camera"),
        }
    }
}

/// Returns the first of `cameras` and those nearest to it, `count` in all, or `None` without a camera. Nearness is the
/// angle as seen from the point that all cameras look at. If they look along one direction, it is their distance; if
/// they are at one place, the angle between viewing directions. Of equally near cameras, the first in order are taken.
pub(crate) fn around_first(cameras: &[Camera], count: usize) -> Option<Sector> {
    let first = cameras.first()?;
    let near = ONE_PLACE * first.origin.length().max(f64::MIN_POSITIVE);
    let at_one_place = cameras.iter().all(|camera| camera.origin.distance(first.origin) <= near);
    let focus = scene_plan::focus(cameras);
    let apart = |camera: &Camera| match focus {
        _ if at_one_place => Apart::Turned(first.rotation.z_axis.angle_between(camera.rotation.z_axis)),
        Some(focus) => {
            let [own, other] = [first, camera].map(|camera| camera.origin - focus);
            Apart::Seen(own.angle_between(other))
        }
        None => Apart::Moved(camera.origin.distance(first.origin)),
    };
    let mut ordered: Vec<(Apart, usize)> = cameras.iter().map(apart).zip(0..).collect();
    // The angle of a camera exactly at the point is NaN, which counts as the largest.
    ordered.sort_by(|a, b| a.0.value().total_cmp(&b.0.value()));
    ordered.truncate(count);
    let extent = ordered.last()?.0.words();
    let mut frames: Vec<usize> = ordered.into_iter().map(|(_, index)| index).collect();
    frames.sort_unstable();
    Some(Sector { frames, extent })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use trimip_core::Intrinsics;

    fn look(from: DVec3, to: DVec3) -> Camera {
        Camera::look_at(Intrinsics::from_angle(64, 64, 0.7), from, to, DVec3::Z)
    }

    /// Returns a camera every 15° on a ring around `centre`; successive cameras are 105° apart.
    fn ring(centre: DVec3, radius: f64) -> Vec<Camera> {
        let at = |i: i32| f64::from(7 * i * 15).to_radians();
        let place = |i: i32| centre + radius * DVec3::new(at(i).cos(), at(i).sin(), 0.4);
        (0..24).map(|i| look(place(i), centre)).collect()
    }

    #[test]
    fn a_sector_of_a_ring_is_the_arc_around_the_first_camera() {
        for (centre, radius) in [(DVec3::ZERO, 4.0), (DVec3::new(4.5e5, -5.4e6, 300.0), 2.0)] {
            let cameras = ring(centre, radius);
            // 7 · 7 = 49 = 2 · 24 + 1, so 7 is its own inverse modulo 24, and the camera at k · 15° is number 7k modulo 24.
            let numbers = |steps: &[i32]| -> Vec<usize> {
                let mut all: Vec<usize> = steps.iter().map(|k| (7 * k).rem_euclid(24) as usize).collect();
                all.sort_unstable();
                all
            };
            for (count, steps) in [(1, &[0][..]), (3, &[-1, 0, 1]), (5, &[-2, -1, 0, 1, 2])] {
                let found = around_first(&cameras, count).unwrap();
                assert_eq!(found.frames, numbers(steps), "{count} around {centre}");
                // The directions of neighbours differ by less than their azimuths, because all rise by atan(0.4).
                let half = f64::from((count as i32 - 1) / 2 * 15).to_radians() * 0.5;
                let angle = 2.0 * (half.sin() / 1.16_f64.sqrt()).asin().to_degrees();
                assert!(found.extent.starts_with(&format!("{angle:.0}° of")), "{} of {angle}", found.extent);
            }
        }
    }

    #[test]
    fn cameras_that_look_along_one_direction_are_divided_by_their_places() {
        let place = |i: i32| DVec3::new(f64::from(i * 3 % 10), 0.0, 0.0);
        let cameras: Vec<Camera> = (0..10).map(|i| look(place(i), place(i) + DVec3::Y)).collect();
        let found = around_first(&cameras, 3).unwrap();
        // The cameras are at 0, 3, 6, 9, 2, 5, 8, 1, 4, 7.
        assert_eq!(
            (found.frames, found.extent.as_str()),
            (vec![0, 4, 7], "2.0000 world units of the first camera")
        );
    }

    #[test]
    fn of_equally_near_cameras_the_first_in_order_counts() {
        for side in [1.0, -1.0] {
            let cameras = [0.0, side, -side].map(|x| look(DVec3::new(x, 0.0, 0.0), DVec3::new(x, 1.0, 0.0)));
            assert_eq!(around_first(&cameras, 2).unwrap().frames, [0, 1]);
        }
    }

    #[test]
    fn cameras_at_one_place_are_divided_by_their_directions() {
        let here = DVec3::new(5.0, 6.0, 7.0);
        let turned = |i: i32| {
            let turn = f64::from(i * 7 % 12 * 30).to_radians();
            look(here, here + DVec3::new(turn.cos(), turn.sin(), 0.0))
        };
        let cameras: Vec<Camera> = (0..12).map(turned).collect();
        let found = around_first(&cameras, 3).unwrap();
        // The cameras look at 0, 7, 2, 9, 4, 11, 6, 1, .. times 30°.
        assert_eq!(found.frames, [0, 5, 7]);
        assert_eq!(found.extent, "30° of the first camera's viewing direction");
    }

    #[test]
    fn of_no_camera_there_is_no_sector() {
        assert_eq!(around_first(&[], 1), None);
    }
}
