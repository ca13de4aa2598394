//! Occupied and free space, known from points that several photographs saw: rays end near these points, and pass through free
//! space on the way. A run in which only cells near points can be occupied at first cannot explain photographs by copies of
//! the scene in front of their cameras (INGeo, arXiv 2212.01959, starts from known geometry in the same way).

use crate::geometry::occupancy::cell_of;
use crate::geometry::space::RayParameter;
use crate::{Config, Space, View, ViewSet, math::bits};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Number of cells in each direction around a point's cell that count as near the point at first. Half of a small object
/// has no points.
const NEAR: u8 = 2;

/// Number of times that [`NEAR`] doubles before cells far from points may be occupied: walls have points only at their
/// edges.
const DOUBLINGS: u8 = 3;

/// Number of cells in each direction around a point's cell that are never free.
const AROUND: usize = 1;

/// Number of rays that must end in a cell before the cell counts as having a point; a single match may be wrong.
const LEAST_ENDS: u16 = 2;

/// Number of photographs that must look through a cell before the cell counts as empty under [`Confinement::Near`], and before it
/// counts as free. Points of wrong matches lie behind surfaces, so the few photographs that show such a point seem to look
/// through the surface. In *bonsai*, 0.4 % of the cells that three photographs look through hold a surface, and 0.06 % of those
/// that sixteen look through.
const LEAST_VIEWS: [u16; 2] = [3, 16];

/// Radius of the free ball around a camera, as a fraction of the distance from the camera to its nearest point. No ray of
/// the camera passes the space next to the camera, where the next camera may be.
const CLOSE: f64 = 0.2;

/// Number of standard deviations in front of a ray's end up to which the ray is certainly in free space.
const CERTAIN: f64 = 3.0;

/// Restriction of the occupancy grid to cells that can be occupied. A run goes through the variants in order and never
/// back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Confinement {
    /// Only cells that have a point at most this many cells away along each axis, and that few photographs look through.
    Near(u8),
    /// All cells except the free ones, which many photographs look through.
    NotFree,
    /// All cells.
    #[default]
    None,
}

impl Confinement {
    /// Returns the confinement that the settings request at `progress`.
    pub fn at(config: &Config, progress: f64) -> Self {
        let occupancy = &config.occupancy;
        if progress < occupancy.seeded {
            let doublings = progress / occupancy.seeded * f64::from(DOUBLINGS + 1);
            Self::Near(NEAR << (doublings as u8).min(DOUBLINGS))
        } else if progress < occupancy.cleared {
            Self::NotFree
        } else {
            Self::None
        }
    }
}

/// The cells near points, and the free cells.
#[derive(Debug)]
pub struct KnownSpace {
    /// For each cell, the least reach at which the cell is near a point: [`NEAR`], one of its doublings, or [`u8::MAX`] if
    /// none is enough.
    reach: Vec<u8>,
    /// Bits of the cells that some photographs look through (`passed`), and of the cells that many look through (`free`),
    /// see [`LEAST_VIEWS`].
    passed: Vec<u8>,
    free: Vec<u8>,
}

impl KnownSpace {
    /// Derives known space from the rays of known depth in the finest scale of `views`, which are in world coordinates.
    /// Returns `None` if the settings confine no cells, or if no cell is near a point.
    pub fn of(config: &Config, views: &ViewSet) -> Option<Self> {
        let finest = views.scales.first()?;
        if Confinement::at(config, 0.0) == Confinement::None {
            return None;
        }
        let cells = config.occupancy.cells();
        let mut rays = Rays {
            space: Space::new(&config.scene),
            side: config.occupancy.resolution,
            ends: vec![0; cells],
            views: vec![0; cells],
            last: vec![0; cells],
        };
        for (number, view) in (1..).zip(&views.views[finest.views.clone()]) {
            rays.add(views, view, number);
        }
        let side = config.occupancy.resolution as usize;
        let ends: Vec<bool> = rays.ends.iter().map(|count| *count >= LEAST_ENDS).collect();
        if !ends.contains(&true) {
            return None;
        }
        let around = widened(&ends, side, AROUND);
        let seen_by = |least: u16| bits::of(cells, |cell| rays.views[cell] >= least && !around[cell]);
        let [passed, free] = LEAST_VIEWS.map(seen_by);
        Some(Self { reach: reach(ends, side), passed, free })
    }

    /// Returns true if a cell can be occupied under `confinement`.
    pub fn allows(&self, confinement: Confinement, cell: usize) -> bool {
        match confinement {
            Confinement::Near(reach) => self.reach[cell] <= reach && !bits::is_set(&self.passed, cell),
            Confinement::NotFree => !bits::is_set(&self.free, cell),
            Confinement::None => true,
        }
    }
}

/// Counts of rays for each cell.
struct Rays {
    space: Space<f64>,
    side: u32,
    /// Number of rays that end in the cell.
    ends: Vec<u16>,
    /// Number of views with a ray that passes the cell.
    views: Vec<u16>,
    /// Number of the last view with such a ray.
    last: Vec<u32>,
}

impl Rays {
    /// Adds the rays of a view whose depth is known.
    fn add(&mut self, views: &ViewSet, view: &View, number: u32) {
        let k = &view.camera.intrinsics;
        let pixels = view.offset..view.offset + k.width as usize * k.height as usize;
        let before = |end: usize| views.depths.partition_point(|known| (known.pixel as usize) < end);
        let step = self.space.cell(self.side);
        let depths = &views.depths[before(pixels.start)..before(pixels.end)];
        let nearest = depths.iter().map(|known| f64::from(known.distance)).fold(f64::INFINITY, f64::min);
        if nearest.is_finite() {
            self.add_around(view.camera.origin, CLOSE * nearest);
        }
        for known in depths {
            let pixel = known.pixel - view.offset as u32;
            let cone = view.camera.cone::<f64>(pixel % k.width, pixel / k.width);
            let at = |t: f64| std::array::from_fn(|axis| cone.origin[axis] + t * cone.direction[axis]);
            let (enter, leave) = match self.space.parameterisation(cone.origin, cone.direction) {
                RayParameter::Straight { enter, leave } => (enter.max(0.0), leave),
                RayParameter::Curved(_) => (0.0, f64::INFINITY),
            };
            let distance = f64::from(known.distance);
            if (enter..leave).contains(&distance) {
                let end = self.cell(at(distance));
                self.ends[end] = self.ends[end].saturating_add(1);
            }
            let uncertain = CERTAIN * f64::from(known.deviation) + step / self.space.scale(at(distance));
            let mut t = enter;
            while t < leave.min(distance - uncertain) {
                let cell = self.cell(at(t));
                if self.last[cell] != number {
                    self.last[cell] = number;
                    self.views[cell] = self.views[cell].saturating_add(1);
                }
                t += step / self.space.scale(at(t));
            }
        }
    }

    /// Marks as free the cells whose centres lie within `radius` of a camera, world units. Contraction lengthens no distance, so
    /// these cells also lie within `radius` of the camera in contracted space.
    fn add_around(&mut self, origin: DVec3, radius: f64) {
        let (side, extent) = (f64::from(self.side), self.space.aabb().extent());
        let place = self.space.to_cube(origin.to_array());
        let ends = |sign: f64| std::array::from_fn(|axis| place[axis] + sign * radius / extent[axis]);
        let [low, high]: [[f64; 3]; 2] = [ends(-1.0), ends(1.0)];
        let cells = |axis: usize| {
            let end = |place: f64| (place * side).clamp(0.0, side) as u32;
            end(low[axis])..end(high[axis]).saturating_add(1).min(self.side)
        };
        let [columns, rows, layers] = [cells(0), cells(1), cells(2)];
        for (z, y) in layers.flat_map(|z| rows.clone().map(move |y| (z, y))) {
            for x in columns.clone() {
                let centre = [x, y, z].map(|cell| (f64::from(cell) + 0.5) / side);
                if DVec3::from(self.space.to_world(centre)).distance(origin) <= radius {
                    let cell = (x + self.side * (y + self.side * z)) as usize;
                    self.views[cell] = self.views[cell].max(LEAST_VIEWS[1]);
                }
            }
        }
    }

    fn cell(&self, point: [f64; 3]) -> usize {
        cell_of(self.space.to_cube(point).map(|x| x as f32), self.side) as usize
    }
}

/// Returns, for each cell, the smallest of [`NEAR`] and its doublings within which one of `cells` lies; [`u8::MAX`] if none
/// is enough.
fn reach(mut cells: Vec<bool>, side: usize) -> Vec<u8> {
    let mut reach = vec![u8::MAX; cells.len()];
    let mut before = 0;
    for doublings in 0..=DOUBLINGS {
        let now = NEAR << doublings;
        cells = widened(&cells, side, usize::from(now - before));
        for (reach, _) in reach.iter_mut().zip(&cells).filter(|(_, near)| **near) {
            *reach = now.min(*reach);
        }
        before = now;
    }
    reach
}

/// Returns the cells that lie within `reach` cells of one of `cells`, along each axis.
fn widened(cells: &[bool], side: usize, reach: usize) -> Vec<bool> {
    let mut wide = cells.to_vec();
    for stride in [1, side, side * side] {
        let before = wide.clone();
        for (cell, value) in wide.iter_mut().enumerate() {
            let place = cell / stride % side;
            let first = cell - stride * place.min(reach);
            let last = cell + stride * (side - 1 - place).min(reach);
            *value = (first..=last).step_by(stride).any(|near| before[near]);
        }
    }
    wide
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Contraction;
    use crate::scene::depths::KnownDepth;
    use crate::{Alpha, Camera, Intrinsics, Scale, View};

    /// Returns four views, see [`many_views`].
    fn views(depths: &[(usize, usize, usize, f32)]) -> ViewSet {
        many_views(4, depths)
    }

    /// Returns views of the origin, alternately from (4, 0, 0) and (−4, 0, 0). `depths` are their known pixels: view, column,
    /// row and distance.
    fn many_views(count: usize, depths: &[(usize, usize, usize, f32)]) -> ViewSet {
        let k = Intrinsics::from_angle(32, 32, 0.7);
        let view = |i: usize| View {
            name: i.to_string(),
            camera: Camera::look_at(
                k,
                DVec3::X * if i.is_multiple_of(2) { 4.0 } else { -4.0 },
                DVec3::ZERO,
                DVec3::Z,
            ),
            offset: 1024 * i,
        };
        let known = |&(view, x, y, distance): &(usize, usize, usize, f32)| KnownDepth {
            pixel: (1024 * view + 32 * y + x) as u32,
            distance,
            deviation: 0.1,
        };
        let mut depths: Vec<KnownDepth> = depths.iter().map(known).collect();
        depths.sort_unstable_by_key(|known| known.pixel);
        ViewSet {
            views: (0..count).map(view).collect(),
            pixels: vec![[0; 4]; 1024 * count].into(),
            alpha: Alpha::Straight,
            scales: vec![Scale { factor: 1, weight: 1.0, views: 0..count, pixels: 0..1024 * count }],
            depths,
        }
    }

    /// Number of cells along a side of the grid; each is 0.625 units wide in uncontracted space.
    const SIDE: usize = 64;

    fn place() -> Config {
        let mut config = Config::default();
        config.scene.contraction = Contraction::Ball;
        (config.scene.aabb_min, config.scene.aabb_max) = ([-20.0; 3], [20.0; 3]);
        config.occupancy.resolution = SIDE as u32;
        (config.occupancy.seeded, config.occupancy.cleared) = (0.2, 0.5);
        config
    }

    #[test]
    fn cells_around_ends_that_two_rays_share_are_near() {
        let config = place();
        let space = Space::<f64>::new(&config.scene);
        // Both views see a point near the origin; only view 1 sees another point, far behind the first.
        let views = views(&[(0, 16, 16, 4.0), (1, 15, 16, 4.01), (1, 3, 3, 40.0)]);
        let known = KnownSpace::of(&config, &views).unwrap();
        let cone = views.views[0].camera.cone::<f64>(16, 16);
        let end = std::array::from_fn(|axis| cone.origin[axis] + 4.0 * cone.direction[axis]);
        let place = space.to_cube(end).map(|x| (x * SIDE as f64) as i64);
        let passed = |cell| !known.allows(Confinement::Near(u8::MAX), cell);
        for cell in 0..SIDE.pow(3) {
            let at = [cell % SIDE, cell / SIDE % SIDE, cell / (SIDE * SIDE)];
            let distance = (0..3).map(|axis| (at[axis] as i64 - place[axis]).abs()).max().unwrap();
            for reach in [2, 4, 8, 16] {
                let near = distance <= reach && !passed(cell);
                assert_eq!(known.allows(Confinement::Near(reach as u8), cell), near, "{at:?} within {reach}");
            }
        }
    }

    #[test]
    fn cells_that_photographs_look_through_are_empty_and_free_if_they_are_many() {
        use Confinement::{Near, None, NotFree};
        let config = place();
        let space = Space::<f64>::new(&config.scene);
        let cell = |x: f64| cell_of(space.to_cube([x, 0.01, -0.01]).map(|x| x as f32), SIDE as u32) as usize;
        // Half of the views are on each side of the origin, or all of them on one side.
        for (count, one_side, [empty, free]) in [
            (4, false, [false, false]),
            (3, true, [true, false]),
            (15, true, [true, false]),
            (16, true, [true, true]),
            (32, false, [true, true]),
        ] {
            let depths: Vec<_> = (0..count).map(|view| (view, 16, 16, 4.0)).collect();
            let mut views = many_views(count, &depths);
            for view in views.views.iter_mut().filter(|_| one_side) {
                view.camera = Camera::look_at(view.camera.intrinsics, DVec3::X * 4.0, DVec3::ZERO, DVec3::Z);
            }
            let known = KnownSpace::of(&config, &views).unwrap();
            let refused = |by, x: f64| !known.allows(by, cell(x));
            for x in [3.0, 2.4, 1.9] {
                let found = [Near(u8::MAX), NotFree].map(|by| refused(by, x));
                assert_eq!(found, [empty, free], "{count} views, between the cameras and the point");
            }
            for x in [4.3, 3.9, 3.6] {
                assert!(refused(Near(u8::MAX), x) && refused(NotFree, x), "nothing stands close to a camera");
            }
            assert!(![0.2, 0.0, -0.2].into_iter().any(|x| refused(Near(u8::MAX), x)), "at the point");
            assert!(!one_side || ![-1.0, -3.0].into_iter().any(|x| refused(NotFree, x)), "behind it");
            assert!((0..SIDE.pow(3)).all(|cell| known.allows(None, cell)));
        }
    }

    #[test]
    fn rays_beyond_the_box_of_a_bounded_space_tell_nothing() {
        let mut config = place();
        config.scene.contraction = Contraction::None;
        (config.scene.aabb_min, config.scene.aabb_max) = ([-1.0; 3], [1.0; 3]);
        // Two views see the origin; three look past it and see a point beyond the box.
        let seen = [(0, 16, 16, 4.0), (2, 16, 16, 4.0), (0, 0, 0, 9.0), (1, 0, 0, 9.0), (3, 0, 0, 9.0)];
        let known = KnownSpace::of(&config, &views(&seen)).unwrap();
        let border = |cell: usize| {
            [cell % SIDE, cell / SIDE % SIDE, cell / (SIDE * SIDE)].iter().any(|x| *x == 0 || x + 1 == SIDE)
        };
        for cell in (0..SIDE.pow(3)).filter(|cell| border(*cell)) {
            assert!(!known.allows(Confinement::Near(NEAR), cell) && known.allows(Confinement::NotFree, cell));
        }
    }

    #[test]
    fn nothing_known_confines_nothing() {
        assert!(KnownSpace::of(&place(), &views(&[])).is_none());
        let one = KnownSpace::of(&place(), &views(&[(1, 3, 3, 40.0)]));
        assert!(one.is_none(), "one observation may be wrong");
        let mut config = place();
        (config.occupancy.seeded, config.occupancy.cleared) = (0.0, 0.0);
        assert!(KnownSpace::of(&config, &views(&[(0, 16, 16, 4.0), (1, 15, 16, 4.0)])).is_none());
    }

    #[test]
    fn confinement_follows_the_run() {
        let config = place();
        let at = |progress| Confinement::at(&config, progress);
        let near = [0.0, 0.04, 0.06, 0.11, 0.16, 0.19].map(at);
        assert_eq!(near, [2, 2, 4, 8, 16, 16].map(Confinement::Near));
        assert_eq!([0.2, 0.49, 0.5, 1.0].map(at), {
            use Confinement::{None, NotFree};
            [NotFree, NotFree, None, None]
        });
        assert!(near.is_sorted() && Confinement::Near(u8::MAX) < Confinement::NotFree);
    }

    #[test]
    fn cells_at_the_border_have_their_neighbours_within_the_grid() {
        for corner in [0, 7, 7 * 8, 7 * 64, 511] {
            let mut cells = vec![false; 512];
            cells[corner] = true;
            assert_eq!(widened(&cells, 8, 2).iter().filter(|cell| **cell).count(), 27, "{corner}");
        }
    }
}
