//! The range of sphere radii for a set of cameras.

use crate::{Aabb, Camera};
use glam::DVec3;

/// Returns the bounds of the radii, in world units, of the spheres of all pixels of `cameras` in `aabb`. The lower bound is
/// 0 for a camera inside the box. `None` without cameras.
pub fn range<'a>(cameras: impl IntoIterator<Item = &'a Camera>, aabb: &Aabb<f64>) -> Option<[f64; 2]> {
    let (min, max) = (DVec3::from_array(aabb.min), DVec3::from_array(aabb.max));
    let of = |camera: &Camera| {
        let k = &camera.intrinsics;
        // The radius of Eq. 3 decreases from the optical axis to the corners of the image.
        let clamp = |at: f64, side: u32| (at.max(0.0) as u32).min(side.saturating_sub(1));
        let (right, lower) = (k.width.saturating_sub(1), k.height.saturating_sub(1));
        let pixels =
            [(0, 0), (right, 0), (0, lower), (right, lower), (clamp(k.cx, k.width), clamp(k.cy, k.height))];
        let cones = pixels.map(|(x, y)| camera.cone::<f64>(x, y));
        let nearest = (camera.origin.clamp(min, max) - camera.origin).length();
        let farthest = (camera.origin - min).abs().max((camera.origin - max).abs()).length();
        [
            cones.iter().map(|cone| cone.radius_at(nearest)).fold(f64::INFINITY, f64::min),
            cones.iter().map(|cone| cone.radius_at(farthest)).fold(0.0, f64::max),
        ]
    };
    cameras.into_iter().map(of).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intrinsics;

    #[test]
    fn no_sphere_lies_outside_of_the_range() {
        let aabb = Aabb { min: [-1.0, -0.5, -0.25], max: [1.0, 0.75, 0.5] };
        let k = Intrinsics {
            width: 40,
            height: 30,
            fx: 50.0,
            fy: 60.0,
            cx: 12.0,
            cy: 20.0,
            ..Intrinsics::default()
        };
        for origin in [DVec3::new(3.0, 1.0, 2.0), DVec3::new(0.1, 0.2, 0.1), DVec3::new(0.0, 0.0, 9.0)] {
            let camera = Camera::look_at(k, origin, DVec3::new(0.2, 0.0, 0.1), DVec3::Y);
            let [low, high] = range([&camera], &aabb).unwrap();
            let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
            for (x, y) in (0..40).flat_map(|x| (0..30).map(move |y| (x, y))) {
                let cone = camera.cone::<f64>(x, y);
                let (enter, leave) = aabb.intersect(cone.origin, cone.direction);
                if enter < leave {
                    least = least.min(cone.radius_at(enter));
                    most = most.max(cone.radius_at(leave));
                }
            }
            // The bounds are not much wider than the actual range: the farthest corner need not be in the picture.
            assert!(low <= least && least <= 1.5 * low + 1e-3, "{origin}: {low} for {least}");
            assert!(most <= high && high <= 2.0 * most, "{origin}: {high} for {most}");
        }
        assert_eq!(range([], &aabb), None);
    }
}
