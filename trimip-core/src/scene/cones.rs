//! Number of cones per pixel. One prefiltered cone suits a pixel about as wide as a texel. The spheres of a wider cone blur
//! along the ray as much as across it, and the network's output for averaged features is not the average of its outputs. A
//! wider pixel is therefore the mean of several cones.

pub use crate::geometry::cone_pattern::PixelPattern;

use crate::{Aabb, Camera, Config, ViewSet, config::ConePattern};
use glam::DVec3;

/// The rule by which pixels are divided into cones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Division {
    /// Most cones along a side of a pixel.
    most: u32,
    /// Width that a cone should have in the middle of the box, world units; 0 divides every pixel as far as possible.
    width: f64,
    pattern: ConePattern,
    aabb: Aabb<f64>,
}

impl Division {
    /// Returns the rule of a configuration, in the coordinates of its box.
    pub fn new(config: &Config) -> Self {
        Self {
            most: config.renderer.cones,
            width: config.renderer.cone_width.into(),
            pattern: config.renderer.pattern,
            aabb: Aabb::new(&config.scene),
        }
    }

    /// Returns the cones of a pixel of `camera`: 1 to `renderer.cones` along each side, or the quincunx.
    pub fn pattern(&self, camera: &Camera) -> PixelPattern {
        self.pattern_of(footprint(camera, &self.aabb))
    }

    /// Returns the cones of a pixel at each scale of a training set, fine to coarse. The median footprint of a scale's
    /// views determines the cones.
    pub fn patterns(&self, views: &ViewSet) -> Vec<PixelPattern> {
        let of = |scale: usize| {
            let width = median_footprint(views, scale, &self.aabb);
            width.map_or(PixelPattern::WHOLE, |width| self.pattern_of(width))
        };
        (0..views.scales.len()).map(of).collect()
    }

    fn pattern_of(&self, footprint: f64) -> PixelPattern {
        match self.pattern {
            ConePattern::Quincunx => PixelPattern::Quincunx,
            // A width of 0 gives an infinite quotient, which the conversion saturates.
            ConePattern::Grid => {
                PixelPattern::Grid(((footprint / self.width).round() as u32).clamp(1, self.most))
            }
        }
    }
}

/// Returns the world width of a pixel of `camera` in the middle of the box. For cameras within the box, the distance counts
/// as at least a quarter of the box's longest side.
pub fn footprint(camera: &Camera, aabb: &Aabb<f64>) -> f64 {
    let middle = DVec3::from_array(aabb.centre());
    let distance = (camera.origin - middle).length().max(0.25 * aabb.longest());
    camera.intrinsics.footprint(distance)
}

/// Returns the median of [`footprint`] over the views of a scale; `None` without views, or if the median is not a positive
/// number.
pub fn median_footprint(views: &ViewSet, scale: usize, aabb: &Aabb<f64>) -> Option<f64> {
    let range = views.scales.get(scale)?.views.clone();
    let mut widths: Vec<f64> = views.views[range].iter().map(|view| footprint(&view.camera, aabb)).collect();
    widths.sort_by(f64::total_cmp);
    widths.get(widths.len() / 2).copied().filter(|width| width.is_finite() && *width > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intrinsics;

    fn camera(distance: f64, focal: f64) -> Camera {
        let k = Intrinsics {
            width: 8,
            height: 8,
            fx: focal,
            fy: focal,
            cx: 4.0,
            cy: 4.0,
            ..Intrinsics::default()
        };
        Camera::look_at(k, DVec3::new(0.0, -distance, 0.0), DVec3::ZERO, DVec3::Z)
    }

    fn rule(most: u32, width: f32) -> Division {
        let mut config = Config::default();
        (config.renderer.cones, config.renderer.cone_width) = (most, width);
        Division::new(&config)
    }

    #[test]
    fn cones_are_about_as_wide_as_the_rule_says() {
        // At distance 4 and focal length 400, a pixel is 0.01 wide.
        let patterns =
            |rule: Division| [100.0, 200.0, 400.0, 800.0].map(|focal| rule.pattern(&camera(4.0, focal)));
        let grids = |sides: [u32; 4]| sides.map(PixelPattern::Grid);
        assert_eq!(patterns(rule(8, 0.01)), grids([4, 2, 1, 1]));
        assert_eq!(patterns(rule(8, 0.02)), grids([2, 1, 1, 1]));
        assert_eq!(patterns(rule(3, 0.01)), grids([3, 2, 1, 1]));
        assert_eq!(patterns(rule(1, 0.0)), grids([1; 4]));
        assert_eq!(patterns(rule(5, 0.0)), grids([5; 4]));
        // At three times the distance, a pixel is three times as wide. Within the box, the distance counts as a quarter of the
        // box's side.
        assert_eq!(rule(8, 0.01).pattern(&camera(12.0, 400.0)), PixelPattern::Grid(3));
        assert_eq!(footprint(&camera(0.1, 400.0), &Aabb::new(&Config::default().scene)), 0.75 / 400.0);
    }
}
