//! Containment of points in the crop of a scene, and the crop's bounding box.

use super::aabb::Aabb;
use crate::config::Crop;

impl Crop {
    /// Returns true if a point is in the crop or on its border.
    pub fn contains(&self, point: [f64; 3]) -> bool {
        match self {
            Self::None => true,
            Self::Box { min, max } => (0..3).all(|i| (min[i]..=max[i]).contains(&point[i])),
            Self::Ball { centre, radius } => {
                let squares = (0..3).map(|i| (point[i] - centre[i]).powi(2));
                squares.sum::<f64>() <= radius * radius
            }
            Self::Half { point: on_plane, normal } => {
                (0..3).map(|i| (point[i] - on_plane[i]) * normal[i]).sum::<f64>() >= 0.0
            }
        }
    }

    /// Returns the smallest box around the crop; `None` if the crop has no end in some direction.
    pub fn bounds(&self) -> Option<Aabb<f64>> {
        match *self {
            Self::None | Self::Half { .. } => None,
            Self::Box { min, max } => Some(Aabb { min, max }),
            Self::Ball { centre, radius } => {
                Some(Aabb { min: centre.map(|x| x - radius), max: centre.map(|x| x + radius) })
            }
        }
    }
}

impl From<Aabb<f64>> for Crop {
    fn from(Aabb { min, max }: Aabb<f64>) -> Self {
        Self::Box { min, max }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crop_holds_what_is_within_and_its_box_holds_the_crop() {
        let ball: Crop = "ball 1,2,3,2".parse().unwrap();
        assert!(ball.contains([1.0, 2.0, 5.0]) && !ball.contains([1.0, 2.0, 5.01]));
        assert!(!ball.contains([2.9, 3.9, 4.9]), "a corner of its box");
        assert_eq!(ball.bounds(), Some(Aabb { min: [-1.0, 0.0, 1.0], max: [3.0, 4.0, 5.0] }));
        let cuboid: Crop = "box 0,0,0,1,2,3".parse().unwrap();
        assert!(cuboid.contains([1.0, 2.0, 3.0]) && !cuboid.contains([1.0, 2.0, 3.1]));
        let half: Crop = "half 0,0,1,0,0,2".parse().unwrap();
        assert!(
            half.contains([5.0, -5.0, 1.0]) && !half.contains([0.0, 0.0, 0.99]) && half.bounds().is_none()
        );
        assert!(Crop::None.contains([1e30; 3]) && Crop::None.bounds().is_none());
    }
}
