//! The up direction of a scene, from the positions and directions of its cameras. The up direction keeps rendered pictures
//! upright.

use super::common_view::cameras;
use super::facing::{Facing, axes};
use crate::ViewSet;
use glam::DVec3;

/// The cameras' own up directions agree if the length of their mean is at least this.
const AGREE: f64 = 0.3;

/// Cameras that look along one direction pass over a ground if their region is at least this share of a picture's footprint
/// along both axes; cameras that face a subject stay within a smaller region.
const OVER: f64 = 0.5;

/// Positions lie in a plane if their spread perpendicular to the plane is at most this share of the smaller spread within
/// it.
const FLAT: f64 = 0.3;

/// Least |cosine| between the cameras' mean viewing direction and the normal of their plane that distinguishes the two
/// sides of the plane.
const SIDED: f64 = 0.1;

/// The up direction, and its source.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Up {
    /// The direction, rounded to two digits; `None` if it is unknown.
    pub(super) direction: Option<DVec3>,
    /// Text for the plan; `None` if the direction is simply the mean of the cameras' own up directions.
    pub(super) reason: Option<String>,
}

/// Finds the up direction of these views. `facing` describes their cameras, if they look along one direction.
pub(super) fn find(views: &ViewSet, facing: Option<&Facing>) -> Up {
    let cameras = cameras(views);
    let count = cameras.len().max(1) as f64;
    let own = cameras.iter().map(|camera| camera.rotation.y_axis).sum::<DVec3>() / count;
    let held = rounded(own).filter(|_| own.length() >= AGREE);
    let because = |direction: Option<DVec3>, reason: String| Up { direction, reason: Some(reason) };
    if let Some(facing) = facing {
        let over = facing.pictures().is_some_and(|[_, shorter]| shorter >= OVER);
        if over {
            let shown = rounded(-facing.direction);
            let wall = held.map_or_else(String::new, |held| {
                format!("; if they face a wall, set scene.up=[{}, {}, {}]", held.x, held.y, held.z)
            });
            let reason = "up points towards the cameras, which pass over what they look at";
            return because(shown, format!("{reason}{wall}"));
        }
        if facing.distance.is_none() || facing.pictures().is_some_and(|[longer, _]| longer >= OVER) {
            let taken =
                if held.is_some() { "is the mean up direction of the cameras" } else { "stays as it is" };
            return because(
                held,
                format!("up is not known, because the cameras look along one direction: scene.up {taken}"),
            );
        }
    }
    if held.is_some() {
        return Up { direction: held, reason: None };
    }
    let looks = cameras.iter().map(|camera| -camera.rotation.z_axis).sum::<DVec3>() / count;
    let places: Vec<DVec3> = cameras.iter().map(|camera| camera.origin).collect();
    let [_, (within, _), (across, normal)] = axes(&places);
    let side = looks.dot(normal);
    if across <= FLAT * within && side.abs() >= SIDED {
        let reason = "the cameras are held in several ways: up is the normal of the plane of their positions, towards the side from which they look down";
        return because(rounded(-side.signum() * normal), reason.into());
    }
    because(
        None,
        "up is not known, because the cameras are held in several ways: scene.up stays as it is".into(),
    )
}

/// Rounds a direction to two digits; `None` for a vector without a direction.
fn rounded(direction: DVec3) -> Option<DVec3> {
    let rounded = (100.0 * direction.normalize_or_zero()).round() / 100.0;
    (rounded != DVec3::ZERO).then_some(rounded + DVec3::ZERO)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Alpha, Camera, Intrinsics, Scale, View};
    use glam::DMat3;

    /// Returns views of the ground z = 0, which is painted with waves that repeat nowhere; the views are grey above the
    /// horizon.
    fn views(cameras: &[Camera]) -> ViewSet {
        let mut set = ViewSet {
            views: Vec::new(),
            pixels: Default::default(),
            alpha: Alpha::Straight,
            scales: Vec::new(),
            depths: Vec::new(),
        };
        for (i, camera) in cameras.iter().enumerate() {
            set.views.push(View { name: i.to_string(), camera: *camera, offset: set.pixels.len() });
            let k = camera.intrinsics;
            for (x, y) in (0..k.height).flat_map(|y| (0..k.width).map(move |x| (x, y))) {
                let cone = camera.cone::<f64>(x, y);
                let at = -cone.origin[2] / cone.direction[2];
                let [u, v] = [0, 1].map(|axis| cone.origin[axis] + at * cone.direction[axis]);
                let wave = |a: f64, b: f64| (127.5 + 120.0 * (a * u + b * v + (b * u).cos()).sin()) as u8;
                let ground = [wave(2.1, 3.7), wave(-4.3, 1.3), wave(1.7, -2.9), 255];
                set.pixels.push(if at > 0.0 { ground } else { [128, 128, 128, 255] });
            }
        }
        let (count, pixels) = (set.views.len(), set.pixels.len());
        set.scales.push(Scale { factor: 1, weight: 1.0, views: 0..count, pixels: 0..pixels });
        // A scale of a few grey pixels, in which nothing can be seen.
        for (i, camera) in cameras.iter().enumerate() {
            let camera = Camera { intrinsics: camera.intrinsics.reduced(3), ..*camera };
            set.views.push(View { name: i.to_string(), camera, offset: set.pixels.len() });
            (0..8 * 6).for_each(|_| set.pixels.push([128, 128, 128, 255]));
        }
        let (views, coarse) = (count..set.views.len(), pixels..set.pixels.len());
        set.scales.push(Scale { factor: 8, weight: 64.0, views, pixels: coarse });
        set
    }

    fn intrinsics() -> Intrinsics {
        Intrinsics { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 32.0, cy: 24.0, ..Intrinsics::default() }
    }

    /// Returns a camera that looks along a direction, rolled around it by quarters of a circle.
    fn look(origin: DVec3, along: DVec3, up: DVec3, quarters: u32) -> Camera {
        let camera = Camera::look_at(intrinsics(), origin, origin + along, up);
        let roll = DMat3::from_rotation_z(f64::from(quarters) * std::f64::consts::FRAC_PI_2);
        Camera { rotation: camera.rotation * roll, ..camera }
    }

    fn orbit(quarters: fn(u32) -> u32) -> Vec<Camera> {
        let camera = |i: u32| {
            let turn = f64::from(i) * std::f64::consts::TAU / 24.0;
            let origin = DVec3::new(3.0 * turn.cos(), 3.0 * turn.sin(), 1.5);
            look(origin, -origin, DVec3::Z, quarters(i))
        };
        (0..24).map(camera).collect()
    }

    /// Returns five by five cameras half a unit apart that look straight down, each tilted by up to `tilt` radians.
    fn nadir(height: f64, tilt: f64, heading: fn(u32) -> DVec3) -> Vec<Camera> {
        let camera = |i: u32| {
            let origin = DVec3::new(0.5 * f64::from(i % 5), 0.5 * f64::from(i / 5), height);
            let aside = DVec3::new((7.3 * f64::from(i)).sin(), (3.1 * f64::from(i)).cos(), 0.0);
            look(origin, -DVec3::Z + tilt * aside, heading(i / 5), 0)
        };
        (0..25).map(camera).collect()
    }

    /// Returns the up direction, and the cameras' ball if they look along one direction. Checks that both follow when the world is
    /// rotated, moved and scaled.
    fn found(cameras: &[Camera]) -> (Up, Option<(DVec3, f64)>) {
        let mut set = views(cameras);
        let facing = Facing::of(&set);
        let usual = (find(&set, facing.as_ref()), facing.and_then(|facing| facing.ball()));
        let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -2.0).normalize(), 0.8);
        for view in &mut set.views {
            view.camera.origin = 40.0 * (turn * view.camera.origin) + DVec3::new(30.0, -9.0, 700.0);
            view.camera.rotation = turn * view.camera.rotation;
        }
        let facing = Facing::of(&set);
        let turned = find(&set, facing.as_ref());
        match (usual.0.direction, turned.direction) {
            (Some(usual), Some(turned)) => {
                assert!((turn * usual - turned).length() < 0.03, "{usual} {turned}");
            }
            (usual, turned) => assert_eq!(usual, turned),
        }
        assert_eq!(usual.0.reason.is_some(), turned.reason.is_some());
        let ball = facing.and_then(|facing| facing.ball());
        assert_eq!(usual.1.is_some(), ball.is_some());
        if let (Some((_, usual)), Some((_, turned))) = (usual.1, ball) {
            assert!((turned / usual / 40.0 - 1.0).abs() < 0.06, "{usual} {turned}");
        }
        usual
    }

    fn assert_up(up: &Up, expected: DVec3) {
        let direction = up.direction.unwrap_or_else(|| panic!("{up:?}"));
        assert!((direction - expected).length() < 0.05, "{up:?}");
    }

    #[test]
    fn cameras_around_a_subject_are_held_upright() {
        let (up, facing) = found(&orbit(|_| 0));
        assert_up(&up, DVec3::Z);
        assert!(up.reason.is_none() && facing.is_none());
        // All cameras are rolled by a quarter turn, or rolled differently: their own up directions cancel each other.
        let held: [fn(u32) -> u32; 3] = [|_| 1, |i| i % 4, |i| 2 * (i % 2)];
        for quarters in held {
            let (up, facing) = found(&orbit(quarters));
            assert_up(&up, DVec3::Z);
            assert!(up.reason.unwrap().contains("several ways") && facing.is_none());
        }
    }

    #[test]
    fn a_drone_that_looks_down_is_above_what_it_sees() {
        let same: fn(u32) -> DVec3 = |_| DVec3::Y;
        let mowing: fn(u32) -> DVec3 = |row| if row % 2 == 0 { DVec3::X } else { -DVec3::X };
        for (height, tilt, heading) in
            [(2.5, 0.0, same), (2.5, 0.0, mowing), (2.5, 0.08, same), (1.6, 0.03, mowing)]
        {
            let cameras = nadir(height, tilt, heading);
            let (up, ball) = found(&cameras);
            assert_up(&up, DVec3::Z);
            assert!(up.reason.unwrap().contains("pass over"));
            let (centre, radius) = ball.unwrap();
            assert!((centre.z / height).abs() < 0.12, "{height}, {tilt}: {centre}");
            // Everything that the pictures show of the ground is in the ball.
            for camera in &cameras {
                for (x, y) in [(0, 0), (63, 0), (0, 47), (63, 47)] {
                    let cone = camera.cone::<f64>(x, y);
                    let (origin, ray) = (DVec3::from(cone.origin), DVec3::from(cone.direction));
                    let ground = origin - ray * (origin.z / ray.z);
                    assert!((ground - centre).length() < 1.15 * radius, "{ground} of {centre}, {radius}");
                }
            }
        }
    }

    #[test]
    fn cameras_that_face_a_subject_are_held_upright() {
        // The ground of these views serves as a wall: z points to the cameras, y is up.
        let place = |i: u32| DVec3::new(0.2 * f64::from(i % 5) - 0.4, 0.2 * f64::from(i / 5) - 0.4, 4.0);
        let parallel: Vec<Camera> = (0..25).map(|i| look(place(i), -DVec3::Z, DVec3::Y, 0)).collect();
        let (up, ball) = found(&parallel);
        assert_up(&up, DVec3::Y);
        assert!(
            up.reason.is_none() && ball.is_some_and(|(centre, _)| centre.z.abs() < 0.5),
            "{up:?} {ball:?}"
        );
        let turned: Vec<Camera> =
            (0..25).map(|i| look(place(i), DVec3::new(0.0, 0.0, -4.0) - place(i), DVec3::Y, 0)).collect();
        let (up, ball) = found(&turned);
        assert_up(&up, DVec3::Y);
        assert!(up.reason.is_none() && ball.is_none(), "they look at a common place");
    }

    #[test]
    fn a_single_row_does_not_tell_and_is_taken_as_it_is_held() {
        let place = |i: u32| DVec3::new(0.5 * f64::from(i), 0.0, 2.5);
        let row: Vec<Camera> = (0..12).map(|i| look(place(i), -DVec3::Z, DVec3::Y, 0)).collect();
        let (up, ball) = found(&row);
        assert_up(&up, DVec3::Y);
        assert!(up.reason.unwrap().contains("not known") && ball.is_some());
        // A walk there and back: the cameras' own up directions cancel, too.
        let back: Vec<Camera> = (0..12)
            .map(|i| look(place(i), -DVec3::Z, if i % 2 == 0 { DVec3::Y } else { -DVec3::Y }, 0))
            .collect();
        let (up, _) = found(&back);
        assert!(up.direction.is_none() && up.reason.unwrap().contains("not known"));
    }

    #[test]
    fn photographs_that_agree_on_no_plane_leave_the_distance_open() {
        let cameras = nadir(2.5, 0.0, |_| DVec3::Y);
        let mut set = views(&cameras);
        for (i, pixel) in set.pixels.iter_mut().enumerate() {
            *pixel = [(i * 7919 % 251) as u8, (i * 104_729 % 241) as u8, (i * 1299 % 239) as u8, 255];
        }
        let facing = Facing::of(&set).unwrap();
        assert_eq!((facing.distance, facing.ball()), (None, None));
        assert!(find(&set, Some(&facing)).reason.unwrap().contains("not known"));
        // Known points give the distance.
        set.depths = (0..9)
            .map(|pixel| crate::scene::depths::KnownDepth { pixel, distance: 2.5, deviation: 0.1 })
            .collect();
        assert_eq!(Facing::of(&set).unwrap().distance, Some(2.5));
    }
}
