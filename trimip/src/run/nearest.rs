//! Distances of test views from the photographs that a model was trained on.

use glam::DVec3;
use trimip_core::Camera;

/// The centres of the training cameras, and their typical spacing.
#[derive(Clone, Debug, Default)]
pub struct TrainingCameras {
    centres: Vec<DVec3>,
    /// Median distance between a camera and its nearest neighbour, world units; 0 with only one camera, or if most
    /// cameras share a position.
    spacing: f64,
}

/// The distance from a camera to the nearest training camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// World units.
    pub distance: f64,
    /// The distance as a multiple of the median distance between a training camera and its nearest neighbour; `None` if that median is 0.
    pub spacings: Option<f64>,
}

impl TrainingCameras {
    /// Keeps the centres of `cameras`, world units, and measures their spacing.
    pub fn new<'a>(cameras: impl IntoIterator<Item = &'a Camera>) -> Self {
        let centres: Vec<DVec3> = cameras.into_iter().map(|camera| camera.origin).collect();
        let of = |index: usize| {
            let others = (0..centres.len()).filter(|&other| other != index);
            others.map(|other| centres[other].distance(centres[index])).fold(f64::INFINITY, f64::min)
        };
        let mut apart: Vec<f64> =
            (0..centres.len()).map(of).filter(|distance| distance.is_finite()).collect();
        apart.sort_by(f64::total_cmp);
        let spacing = apart.get(apart.len() / 2).copied().unwrap_or(0.0);
        Self { centres, spacing }
    }

    /// Returns the distance from the centre of `camera` to the nearest training camera; `None` without training cameras.
    pub fn nearest(&self, camera: &Camera) -> Option<Nearest> {
        let distances = self.centres.iter().map(|centre| centre.distance(camera.origin));
        let distance = distances.min_by(f64::total_cmp)?;
        let spacings = (self.spacing > 0.0).then_some(distance / self.spacing);
        Some(Nearest { distance, spacings })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip_core::Intrinsics;

    fn at(x: f64, y: f64) -> Camera {
        let k = Intrinsics::from_angle(8, 8, 0.7);
        Camera::look_at(k, DVec3::new(x, y, 1.0), DVec3::ZERO, DVec3::Z)
    }

    #[test]
    fn distances_are_to_the_nearest_camera_and_relative_to_the_usual_spacing() {
        // The distances to the nearest neighbours are 2, 2, 2 and 6.
        let row = [at(0.0, 0.0), at(2.0, 0.0), at(4.0, 0.0), at(10.0, 0.0)];
        let training = TrainingCameras::new(&row);
        let found = training.nearest(&at(4.0, 3.0)).unwrap();
        assert_eq!(found, Nearest { distance: 3.0, spacings: Some(1.5) });
        assert_eq!(training.nearest(&at(2.0, 0.0)).unwrap().distance, 0.0);
    }

    #[test]
    fn without_a_spacing_there_is_a_distance_alone() {
        for same in [1, 5] {
            let training = TrainingCameras::new(&vec![at(1.0, 0.0); same]);
            assert_eq!(training.nearest(&at(1.0, 2.0)), Some(Nearest { distance: 2.0, spacings: None }));
        }
        assert_eq!(TrainingCameras::default().nearest(&at(0.0, 0.0)), None);
    }
}
