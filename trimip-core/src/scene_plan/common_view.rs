//! The common view of cameras: the point nearest to their optical axes, and the region that many of them see. World units.

use crate::{
    Aabb, Camera, ViewSet,
    scene::{origin::LocalOrigin, strays::without_strays},
};
use glam::{DMat3, DVec3};

/// Number of cells along each side of the grid for the common view.
const CELLS: usize = 40;

/// Largest number of cameras used, evenly spread.
pub(super) const MOST_CAMERAS: usize = 128;

/// Share of the cameras that must see a place for it to belong to the subject.
pub(super) const COMMON: f64 = 0.5;

/// Cameras count as parallel if the smallest eigenvalue of the mean of I − d·dᵀ over the viewing directions d is below
/// this: all directions within about 3°.
const PARALLEL: f64 = 3e-3;

/// Returns the cameras of the finest photographs, at most [`MOST_CAMERAS`], without stray ones.
pub(super) fn cameras(views: &ViewSet) -> Vec<Camera> {
    let Some(finest) = views.scales.first() else { return Vec::new() };
    let all: Vec<Camera> = finest.views.clone().map(|view| views.views[view].camera).collect();
    let near = without_strays(&all);
    let stride = near.len().div_ceil(MOST_CAMERAS).max(1);
    near.into_iter().step_by(stride).collect()
}

/// Returns the point nearest to all optical axes, in world units, by least squares; `None` without cameras, or if the axes are
/// parallel. Panoramas and stray cameras are left out.
pub fn focus(cameras: &[Camera]) -> Option<DVec3> {
    let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
    let directed = |camera: &&Camera| camera.intrinsics.lens.model.definition().directed;
    let near = without_strays(cameras);
    let cameras: Vec<&Camera> = near.iter().filter(directed).collect();
    for camera in &cameras {
        let axis = camera.rotation.z_axis;
        let across = DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
        matrix += across;
        right += across * camera.origin;
    }
    // The eigenvalues of a mean of projections lie in [0, 1], so their product, the determinant, is at most the smallest
    // eigenvalue.
    let mean = matrix * (1.0 / cameras.len().max(1) as f64);
    (mean.determinant() > PARALLEL * 0.5).then(|| matrix.inverse() * right).filter(|focus| focus.is_finite())
}

/// Largest distance between cameras that count as at one place, as a share of their distance from the origin of the data's
/// coordinates.
const ONE_PLACE: f64 = 1e-9;

/// Returns true if several cameras, in coordinates relative to `origin`, look around from one place: such cameras show no
/// depth.
pub(super) fn at_one_place(cameras: &[Camera], origin: LocalOrigin) -> bool {
    let Some((first, others)) = cameras.split_first() else { return false };
    let near = ONE_PLACE * origin.stated(first.origin).length().max(f64::MIN_POSITIVE);
    let together = others.iter().all(|other| other.origin.distance(first.origin) <= near);
    together && !others.is_empty() && focus(cameras).is_some()
}

/// Returns true if most of the cameras look towards a point.
pub(super) fn is_ahead(cameras: &[Camera], point: DVec3) -> bool {
    let before = |camera: &&Camera| camera.rotation.z_axis.dot(point - camera.origin) < 0.0;
    2 * cameras.iter().filter(before).count() > cameras.len()
}

/// Returns the bounds of what at least the share [`COMMON`] of the cameras see within `aabb`; `None` if there is no such
/// region.
pub(super) fn common_view(cameras: &[Camera], aabb: &Aabb<f64>) -> Option<Aabb<f64>> {
    let cell = aabb.extent().map(|side| side / CELLS as f64);
    let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
    for i in 0..CELLS.pow(3) {
        let index = [i % CELLS, i / CELLS % CELLS, i / CELLS / CELLS];
        let at = DVec3::from_array(std::array::from_fn(|axis| {
            aabb.min[axis] + (index[axis] as f64 + 0.5) * cell[axis]
        }));
        let seeing = cameras.iter().filter(|camera| camera.sees(at)).count();
        if seeing as f64 >= COMMON * cameras.len() as f64 {
            for axis in 0..3 {
                low[axis] = low[axis].min(index[axis]);
                high[axis] = high[axis].max(index[axis] + 1);
            }
        }
    }
    let corner = |at: [usize; 3]| std::array::from_fn(|axis| aabb.min[axis] + at[axis] as f64 * cell[axis]);
    (high[0] > 0).then(|| Aabb { min: corner(low), max: corner(high) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intrinsics;

    fn ring(centre: DVec3, radius: f64, count: usize) -> Vec<Camera> {
        let k = Intrinsics::from_angle(64, 64, 0.7);
        (0..count)
            .map(|i| {
                let turn = i as f64 * 2.4;
                let origin = centre + radius * DVec3::new(turn.cos(), turn.sin(), 0.3 * (i % 3) as f64);
                Camera::look_at(k, origin, centre, DVec3::Z)
            })
            .collect()
    }

    #[test]
    fn cameras_look_at_one_place_wherever_it_is() {
        for (centre, radius) in [(DVec3::ZERO, 4.0), (DVec3::new(500.0, -200.0, 70.0), 0.02)] {
            let found = focus(&ring(centre, radius, 20)).unwrap();
            assert!((found - centre).length() < 1e-6 * radius.max(centre.length()), "{found}");
        }
        let first = ring(DVec3::ZERO, 4.0, 1)[0];
        let aside = |i: i32| Camera { origin: DVec3::new(0.1 * f64::from(i), 0.0, 0.0), ..first };
        let mut stray = ring(DVec3::ZERO, 4.0, 20);
        stray[5] = Camera { origin: DVec3::new(900.0, 800.0, -700.0), ..stray[5] };
        assert!(focus(&stray).unwrap().length() < 1e-6, "a stray camera moves the focus");
        let parallel: Vec<Camera> = (0..10).map(aside).collect();
        assert_eq!(focus(&parallel), None);
        assert_eq!(focus(&[]), None);
    }

    #[test]
    fn cameras_that_only_turn_stand_at_one_place() {
        let (around, none) = (ring(DVec3::new(5.0, 6.0, 7.0), 4.0, 12), LocalOrigin::default());
        assert!(!at_one_place(&around, none));
        let turned: Vec<Camera> =
            around.iter().map(|camera| Camera { origin: around[0].origin, ..*camera }).collect();
        assert!(at_one_place(&turned, none));
        assert!(!at_one_place(&turned[..1], none) && !at_one_place(&[], none));
    }

    #[test]
    fn the_common_view_holds_what_all_see_and_is_no_larger_than_their_view() {
        let cameras = ring(DVec3::new(3.0, 0.0, 0.0), 4.0, 24);
        let cube = Aabb { min: [-1.0, -4.0, -4.0], max: [7.0, 4.0, 4.0] };
        let view = common_view(&cameras, &cube).unwrap();
        // Half the picture's width at the centre's distance is 4·tan(0.35) = 1.46, and a cell is 0.2 wide.
        for axis in 0..3 {
            let centre = [3.0, 0.0, 0.0][axis];
            assert!(view.min[axis] < centre - 1.0 && view.max[axis] > centre + 1.0, "{view:?}");
            assert!(view.min[axis] > centre - 3.0 && view.max[axis] < centre + 3.0, "{view:?}");
        }
        let away: Vec<_> = cameras
            .iter()
            .map(|c| {
                Camera::look_at(c.intrinsics, c.origin, 2.0 * c.origin - DVec3::new(3.0, 0.0, 0.0), DVec3::Z)
            })
            .collect();
        assert_eq!(common_view(&away, &cube), None, "cameras that look outwards");
    }
}
