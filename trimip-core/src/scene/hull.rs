//! The occupancy grid of a scene whose photographs have silhouettes: cells outside of the visual hull are never occupied.
//! No floaters can form there, and no samples are spent there.

use crate::geometry::occupancy::OUTSIDE;
use crate::{Aabb, Config, ViewSet, math::bits, scene::silhouettes};

/// A grid whose cells outside of the visual hull are marked as [`OUTSIDE`].
pub struct Hull {
    /// One bit per cell, set inside of the hull.
    pub bits: Vec<u8>,
    /// Density of each cell: [`OUTSIDE`], or 0 inside of the hull.
    pub densities: Vec<f32>,
}

impl Hull {
    /// Returns the hull of the silhouettes of `views` in the configured grid; both are in world coordinates. `None` if
    /// there are no silhouettes, or if they leave no cell.
    pub fn of(config: &Config, views: &ViewSet) -> Option<Self> {
        let inside = silhouettes::cells(views, &Aabb::new(&config.scene), config.occupancy.resolution)?;
        let bits = bits::of(inside.len(), |cell| inside[cell]);
        let densities = inside.iter().map(|inside| if *inside { 0.0 } else { OUTSIDE }).collect();
        inside.contains(&true).then_some(Self { bits, densities })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Alpha, Camera, Intrinsics, Scale, View};
    use glam::DVec3;

    /// Returns silhouettes of a ball of radius 0.5 around the origin, from all sides.
    fn ball() -> ViewSet {
        ball_through(Intrinsics::from_angle(128, 128, 0.7))
    }

    /// Returns silhouettes of the same ball, seen by cameras with intrinsics `k`.
    fn ball_through(k: Intrinsics) -> ViewSet {
        let (mut views, mut pixels) = (Vec::new(), Vec::new());
        for i in 0..40 {
            let (turn, height) = (f64::from(i) * 2.4, f64::from(i) / 20.0 - 0.975);
            let across = (1.0 - height * height).sqrt();
            let origin = 4.0 * DVec3::new(across * turn.cos(), across * turn.sin(), height);
            let camera = Camera::look_at(k, origin, DVec3::ZERO, DVec3::Z);
            views.push(View { name: i.to_string(), camera, offset: pixels.len() });
            for (y, x) in (0..128).flat_map(|y| (0..128).map(move |x| (y, x))) {
                let cone = camera.cone::<f64>(x, y);
                let (from, direction) = (DVec3::from(cone.origin), DVec3::from(cone.direction));
                let nearest = (from - direction * from.dot(direction)).length();
                pixels.push([9, 9, 9, if nearest < 0.5 { 255 } else { 0 }]);
            }
        }
        let all = Scale { factor: 1, weight: 1.0, views: 0..40, pixels: 0..pixels.len() };
        ViewSet {
            views,
            pixels: pixels.into(),
            alpha: Alpha::Straight,
            scales: vec![all],
            depths: Vec::new(),
        }
    }

    #[test]
    fn the_hull_of_a_ball_is_the_ball_and_a_little_more() {
        let mut config = Config::default();
        config.occupancy.resolution = 48;
        let Hull { bits, densities } = Hull::of(&config, &ball()).unwrap();
        let cell = 3.0 / 48.0;
        for (i, density) in densities.iter().enumerate() {
            let inside = bits::is_set(&bits, i);
            assert_eq!(*density, if inside { 0.0 } else { OUTSIDE });
            let at = |place: usize| (place as f64 + 0.5) * cell - 1.5;
            let centre = DVec3::new(at(i % 48), at(i / 48 % 48), at(i / 48 / 48));
            // Half a cell's diagonal is 0.054, and a pixel is 0.023 wide. Forty views leave corners around the ball.
            if centre.length() < 0.5 + 0.054 {
                assert!(inside, "{centre} is of the ball");
            }
            if centre.length() > 0.5 + 0.3 {
                assert!(!inside, "{centre} is far away");
            }
        }
    }

    #[test]
    fn every_camera_model_carves_around_the_ball() {
        let mut config = Config::default();
        config.occupancy.resolution = 24;
        let cell = 3.0 / 24.0;
        for model in crate::geometry::projections::Model::ALL {
            let Hull { bits, .. } = Hull::of(&config, &ball_through(model.example(128, 128))).unwrap();
            for i in 0..24_usize.pow(3) {
                let at = |place: usize| (place as f64 + 0.5) * cell - 1.5;
                let centre = DVec3::new(at(i % 24), at(i / 24 % 24), at(i / 24 / 24));
                let inside = bits[i / 8] >> (i % 8) & 1 == 1;
                // Half a cell's diagonal is 0.108; a pixel of a panorama is up to 0.066 wide.
                assert!(inside || centre.length() > 0.5 + 0.108, "{}: {centre}", model.name());
                assert!(!inside || centre.length() < 0.5 + 0.5, "{}: {centre}", model.name());
            }
        }
    }

    #[test]
    fn one_wrong_mask_carves_nothing_and_opaque_photographs_have_no_hull() {
        let config = Config::default();
        let count = |views: &ViewSet| {
            Hull::of(&config, views).map(|hull| hull.densities.iter().filter(|d| **d >= 0.0).count())
        };
        let mut views = ball();
        let before = count(&views).unwrap();
        let start = views.views[7].offset;
        views.pixels[start..start + 128 * 128].iter_mut().for_each(|pixel| pixel[3] = 0);
        // The wrong mask is a vote that every cell it sees is empty, so a cell is lost if only one other view shows it to
        // be empty.
        let after = count(&views).unwrap();
        assert!(after > before / 2, "{after} of {before}");
        views.pixels.iter_mut().for_each(|pixel| pixel[3] = 255);
        assert_eq!(count(&views), None);
        views.pixels.iter_mut().for_each(|pixel| pixel[3] = 0);
        assert_eq!(count(&views), None, "silhouettes that leave nothing");
    }
}
