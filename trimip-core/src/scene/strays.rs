//! Stray cameras, which are far from all others, and lost cameras, whose poses a solver failed to find.

use crate::Camera;
use glam::DVec3;

/// A camera is a stray if its distance from the middle of all cameras is more than this many times the median distance: its pose
/// is wrong, or it belongs to another place.
pub const STRAY: f64 = 30.0;

/// A camera is lost if its distance exceeds this multiple of the median distance. No capture spans so much, so the solver failed
/// to find its pose.
pub const LOST: f64 = 1000.0;

/// Largest shares of stray and of lost cameras: with more of them, the middle is meaningless.
const MOST_STRAYS: f64 = 0.1;
const MOST_LOST: f64 = 0.25;

/// Returns the index of each stray camera, in order, and the camera's distance from the middle of all cameras in multiples
/// of the median distance.
pub fn strays(cameras: &[Camera]) -> Vec<(usize, f64)> {
    farther(cameras, STRAY, MOST_STRAYS)
}

/// Returns the indices of the lost cameras, in order.
pub fn lost(cameras: &[Camera]) -> Vec<usize> {
    farther(cameras, LOST, MOST_LOST).into_iter().map(|(index, _)| index).collect()
}

/// Returns the cameras whose distance from the middle of all cameras (the median position) exceeds `least` times the median
/// distance, each with that multiple; empty if they are more than the share `most` of all cameras.
fn farther(cameras: &[Camera], least: f64, most: f64) -> Vec<(usize, f64)> {
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or(0.0)
    };
    let middle = DVec3::from_array(std::array::from_fn(|axis| {
        median(cameras.iter().map(|camera| camera.origin[axis]).collect())
    }));
    let distances: Vec<f64> = cameras.iter().map(|camera| camera.origin.distance(middle)).collect();
    let usual = median(distances.clone());
    let times = distances.iter().map(|distance| distance / usual).enumerate();
    let far: Vec<(usize, f64)> = times.filter(|(_, times)| *times > least && times.is_finite()).collect();
    if far.len() as f64 > most * cameras.len() as f64 { Vec::new() } else { far }
}

/// Returns the cameras that are not strays, in their order.
pub fn without_strays(cameras: &[Camera]) -> Vec<Camera> {
    let strays = strays(cameras);
    let is_near = |(index, _): &(usize, &Camera)| strays.iter().all(|(stray, _)| stray != index);
    cameras.iter().enumerate().filter(is_near).map(|(_, camera)| *camera).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intrinsics;

    /// Returns cameras on a sphere around `centre`.
    fn ring(centre: DVec3, radius: f64, count: usize) -> Vec<Camera> {
        let k = Intrinsics::from_angle(64, 64, 0.7);
        let at = |i: usize| {
            let turn = i as f64 * 2.4;
            let direction = DVec3::new(turn.cos(), turn.sin(), 0.3 * (i % 3) as f64).normalize();
            Camera::look_at(k, centre + radius * direction, centre, DVec3::Z)
        };
        (0..count).map(at).collect()
    }

    #[test]
    fn cameras_far_from_all_others_are_strays() {
        let centre = DVec3::new(3.0, 4.0, 5.0);
        let mut cameras = ring(centre, 2.0, 40);
        assert_eq!(strays(&cameras), []);
        cameras[7].origin = DVec3::new(0.0, 5000.0, 0.0);
        let found = strays(&cameras);
        assert_eq!(without_strays(&cameras), [&cameras[..7], &cameras[8..]].concat());
        assert!(found.len() == 1 && found[0].0 == 7 && (found[0].1 / 2500.0 - 1.0).abs() < 0.1, "{found:?}");
        assert_eq!(lost(&cameras), [7]);
        cameras[7].origin = DVec3::new(0.0, 500.0, 0.0);
        assert!(strays(&cameras).len() == 1 && lost(&cameras).is_empty());
        // With so many lost cameras, none counts as a stray.
        cameras[..10].iter_mut().for_each(|camera| camera.origin *= 1e12);
        assert!(strays(&cameras).is_empty() && lost(&cameras) == Vec::from_iter(0..10));
        cameras[10].origin *= 1e12;
        assert!(lost(&cameras).is_empty());
        // If half of the cameras are at one place, or many are far away, there is no middle from which distances can be
        // measured.
        let burst = [vec![cameras[0]; 30], ring(centre, 2.0, 10)].concat();
        assert_eq!(strays(&burst), []);
        let two = [ring(centre, 2.0, 10), ring(100.0 * centre, 2.0, 6)].concat();
        assert_eq!(strays(&two), []);
        assert_eq!(strays(&[]), []);
    }
}
