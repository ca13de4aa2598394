//! The surface on which the depths of rendered pictures agree: a truncated signed distance function (TSDF; Curless and Levoy 1996), which
//! exists only in the blocks of a grid near these depths.

use super::{
    Grid, Mesh,
    hidden::Bits,
    march,
    occupied::{Occupied, Region},
    open::retain_between,
    threads,
};
use crate::view::cameras::resized;
use glam::DVec3;
use std::sync::atomic::{AtomicUsize, Ordering};
use trimip_core::{Camera, Error, Frame, Result, Viewer, geometry::projections::BallImage};

/// Maximum number of pictures, evenly spread over all cameras.
const MOST_PICTURES: usize = 128;

/// Most pixels of a picture. Cameras with more are rendered at a reduced size.
const MOST_PIXELS: f64 = 400_000.0;

/// Points along each side of a block.
const SIDE: usize = 8;

/// Points of a block.
const POINTS: usize = SIDE * SIDE * SIDE;

/// Largest distance from the surface, in cells of the grid. Distances in front of the surface are limited to it; points farther behind the
/// surface are hidden by it.
const REACH: f64 = 8.0;

/// Opacity from which a pixel shows a surface, and up to which it shows none.
const OPAQUE: f32 = 0.9;
const CLEAR: f32 = 0.1;

/// Largest deviation of a pixel's distance from a plane through its neighbours, as a share of the distance. Pixels at the edges of objects
/// deviate more: their depths are means of two surfaces.
const BEND: f64 = 0.02;

/// The depths of a rendered picture.
struct Picture {
    camera: Camera,
    /// True if rays are parallel.
    parallel: bool,
    width: usize,
    height: usize,
    /// Reciprocal of the distance along the ray, per pixel: zero where the picture shows no surface, NaN where it is not usable.
    nearness: Vec<f32>,
}

/// A mesh from the depths of pictures.
pub(super) struct Fused {
    pub mesh: Mesh,
    /// Number of pictures.
    pub pictures: usize,
}

/// Renders pictures of the cameras and returns the surface on which their depths agree, within the crop. The mesh is open where no picture
/// shows the surface, and where it hides from all but fewer than `least` of them. `watch` receives the share of the work done and returns
/// false to stop; the result is then `None`. Memory use: the depths of the pictures (at most 205 MB), one layer of blocks, and one bit per
/// grid point.
///
/// # Errors
/// When there are no cameras, or the device fails.
pub(super) fn surface(
    viewer: &mut dyn Viewer,
    region: &Region<'_>,
    watch: &mut dyn FnMut(f64) -> bool,
) -> Result<Option<Fused>> {
    let &Region { field, grid, cameras, least, threads } = region;
    if cameras.is_empty() {
        return Err(Error::run(
            "a surface from depths needs the cameras of the photographs, and there are none",
        ));
    }
    let chosen: Vec<&Camera> = cameras.iter().step_by(cameras.len().div_ceil(MOST_PICTURES).max(1)).collect();
    let mut pictures = Vec::with_capacity(chosen.len());
    for (i, camera) in chosen.iter().enumerate() {
        let share = |rows: f64| 0.7 * (i as f64 + rows) / chosen.len() as f64;
        let k = camera.intrinsics;
        let factor = (MOST_PIXELS / (f64::from(k.width) * f64::from(k.height))).sqrt().min(1.0);
        let camera = Camera { intrinsics: resized(k, factor)?, ..**camera };
        let mut go_on = |done: u32, all: u32| watch(share(f64::from(done) / f64::from(all.max(1))));
        let Some(frame) = viewer.render_watched(&camera, &mut go_on)? else { return Ok(None) };
        pictures.push(Picture::new(camera, &frame));
    }
    let fusion =
        Fusion { field, grid, pictures: &pictures, least: least.max(1), threads: threads::count(threads) };
    let near = fusion.near();
    let (mut shown, mut slab) = (Bits::new(grid.points), Vec::new());
    let (layers, mut stopped) = (grid.points[2], false);
    // Distances are in cells, so this field is 1 on the surface and its logarithm is linear, as `march` expects.
    let mesh = march(grid, 1.0, |z, layer| {
        layer.fill(0.0);
        if stopped || !watch(0.7 + 0.3 * z as f64 / layers as f64) {
            stopped = true;
            return Ok(());
        }
        if z % SIDE == 0 {
            slab = fusion.slab(&near, z / SIDE);
        }
        for (block, distances) in &slab {
            let row = z % SIDE;
            for (i, &distance) in distances[row * SIDE * SIDE..][..SIDE * SIDE].iter().enumerate() {
                let [x, y] = [block[0] * SIDE + i % SIDE, block[1] * SIDE + i / SIDE];
                if !distance.is_nan() && x < grid.points[0] && y < grid.points[1] {
                    layer[x + y * grid.points[0]] = (-distance).exp();
                    shown.set(x + grid.points[0] * (y + grid.points[1] * z));
                }
            }
        }
        Ok(())
    });
    let mut mesh = mesh?;
    if stopped {
        return Ok(None);
    }
    let index = |[x, y, z]: [usize; 3]| x + grid.points[0] * (y + grid.points[1] * z);
    retain_between(&mut mesh, grid, |point| shown.get(index(point)));
    Ok(Some(Fused { mesh, pictures: pictures.len() }))
}

impl Picture {
    fn new(camera: Camera, frame: &Frame) -> Self {
        let (width, height) = (frame.width as usize, frame.height as usize);
        let nearness = |i: usize| {
            let pixel = frame.pixels[i];
            let cone = camera.cone::<f64>((i % width) as u32, (i / width) as u32);
            let distance = f64::from(pixel.depth / pixel.opacity) / cone.cosine;
            match pixel.opacity {
                _ if cone.is_none() => f32::NAN,
                opacity if opacity <= CLEAR => 0.0,
                opacity if opacity >= OPAQUE && distance > 0.0 => distance.recip() as f32,
                _ => f32::NAN,
            }
        };
        let raw: Vec<f32> = (0..width * height).map(nearness).collect();
        // The reciprocal of the depth of a plane is linear in the picture.
        let bent = |i: usize| {
            let own = f64::from(raw[i]);
            let pairs = [
                (!i.is_multiple_of(width) && i % width + 1 < width).then(|| [i - 1, i + 1]),
                (i >= width && i + width < raw.len()).then(|| [i - width, i + width]),
            ];
            pairs.into_iter().flatten().any(|pair| {
                let [a, b] = pair.map(|other| f64::from(raw[other]));
                let deviation = (0.5 * (a + b) - own).abs();
                // Unusable neighbours, or a bent surface.
                !(deviation <= BEND * own)
            })
        };
        let nearness = (0..raw.len()).map(|i| if bent(i) { f32::NAN } else { raw[i] }).collect();
        let parallel = camera.cone::<f64>(0, 0).radius > 0.0;
        Self { camera, parallel, width, height, nearness }
    }

    /// Returns the points of the world within [`REACH`] of the surface that the picture shows, half a block apart along each ray.
    fn points(&self, spacing: f64) -> impl Iterator<Item = [f64; 3]> + '_ {
        let reach = REACH * spacing;
        let steps = (4.0 * REACH / SIDE as f64).ceil();
        let usable = (0..self.nearness.len()).filter(|&i| self.nearness[i] > 0.0);
        usable.flat_map(move |i| {
            let cone = self.camera.cone::<f64>((i % self.width) as u32, (i / self.width) as u32);
            let distance = f64::from(self.nearness[i]).recip();
            (0..=steps as usize).map(move |step| {
                let t = distance + reach * (2.0 * step as f64 / steps - 1.0);
                std::array::from_fn(|axis| cone.origin[axis] + t * cone.direction[axis])
            })
        })
    }

    /// Returns true unless no pixel can show a ball.
    fn may_show(&self, centre: DVec3, radius: f64) -> bool {
        let local = self.camera.rotation.transpose() * (centre - self.camera.origin);
        let sides = [self.width as f64, self.height as f64];
        match self.camera.intrinsics.ball(local, radius) {
            BallImage::None => false,
            BallImage::Anywhere => true,
            BallImage::Within { at, reach } => {
                (0..2).all(|axis| at[axis] + reach > 0.0 && at[axis] - reach < sides[axis])
            }
        }
    }

    /// Returns the distance from a point to the surface along the ray through the point: positive in front of the surface. `None` if the
    /// picture does not tell.
    fn distance(&self, point: DVec3) -> Option<f64> {
        let local = self.camera.rotation.transpose() * (point - self.camera.origin);
        let place = self.camera.intrinsics.image_of(local)?.map(|place| place - 0.5);
        let low = place.map(f64::floor);
        if !(low[0] >= 0.0 && low[1] >= 0.0) {
            return None;
        }
        let [x, y] = low.map(|place| place as usize);
        if x + 1 >= self.width || y + 1 >= self.height {
            return None;
        }
        let [u, v] = [place[0] - low[0], place[1] - low[1]];
        let row = |y: usize| {
            let [left, right] = [0, 1].map(|i| f64::from(self.nearness[y * self.width + x + i]));
            left + u * (right - left)
        };
        let (upper, lower) = (row(y), row(y + 1));
        let nearness = upper + v * (lower - upper);
        let own = if self.parallel { -local.z } else { local.length() };
        (!nearness.is_nan()).then(|| nearness.recip() - own)
    }
}

/// Pictures that are fused on a grid.
struct Fusion<'a> {
    field: &'a Occupied,
    grid: &'a Grid,
    pictures: &'a [Picture],
    /// Minimum number of pictures from which a point of the surface is not hidden.
    least: u32,
    threads: usize,
}

/// Distance of each point of a block from the surface, in cells, negative inside; NaN where too few pictures tell.
type Distances = [f32; POINTS];

impl Fusion<'_> {
    /// Returns the number of blocks along each axis.
    fn blocks(&self) -> [usize; 3] {
        self.grid.points.map(|points| points.div_ceil(SIDE))
    }

    /// Returns the blocks near the surfaces that pictures show.
    fn near(&self) -> Bits {
        let blocks = self.blocks();
        let mut near = Bits::new(blocks);
        let width = self.grid.spacing * SIDE as f64;
        for point in self.pictures.iter().flat_map(|picture| picture.points(self.grid.spacing)) {
            let place: [f64; 3] =
                std::array::from_fn(|axis| ((point[axis] - self.grid.origin[axis]) / width).floor());
            if (0..3).all(|axis| place[axis] >= 0.0 && place[axis] < blocks[axis] as f64) {
                let [x, y, z] = place.map(|place| place as usize);
                near.set(x + blocks[0] * (y + blocks[1] * z));
            }
        }
        near
    }

    /// Returns the blocks of layer `z` of blocks that are set in `near`, with their distances.
    fn slab(&self, near: &Bits, z: usize) -> Vec<([usize; 2], Distances)> {
        let blocks = self.blocks();
        let layer = blocks[0] * blocks[1];
        let chosen: Vec<usize> = (0..layer).filter(|i| near.get(i + layer * z)).collect();
        let next = AtomicUsize::new(0);
        let mut found: Vec<(usize, Distances)> = std::thread::scope(|scope| {
            let work = || {
                let mut own = Vec::new();
                while let Some(&i) = chosen.get(next.fetch_add(1, Ordering::Relaxed)) {
                    own.push((i, self.distances([i % blocks[0], i / blocks[0], z])));
                }
                own
            };
            let workers: Vec<_> = (0..self.threads.min(chosen.len())).map(|_| scope.spawn(work)).collect();
            let joined = workers.into_iter().map(|worker| worker.join());
            joined.flat_map(|own| own.unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
        });
        found.sort_unstable_by_key(|&(i, _)| i);
        found.into_iter().map(|(i, distances)| ([i % blocks[0], i / blocks[0]], distances)).collect()
    }

    fn distances(&self, block: [usize; 3]) -> Distances {
        let first = block.map(|index| index * SIDE);
        let half = 0.5 * self.grid.spacing * (SIDE - 1) as f64;
        let centre = DVec3::from(self.grid.point(first)) + half;
        let radius = half * 3.0_f64.sqrt();
        let (mut sums, mut counts) = ([0.0_f64; POINTS], [[0_u32; 2]; POINTS]);
        for picture in self.pictures.iter().filter(|picture| picture.may_show(centre, radius)) {
            for i in 0..POINTS {
                let offset = [i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE)];
                let point = self.grid.point(std::array::from_fn(|axis| first[axis] + offset[axis]));
                let Some(distance) = picture.distance(point.into()) else { continue };
                let cells = distance / self.grid.spacing;
                if cells >= -REACH {
                    sums[i] += cells.min(REACH);
                    counts[i][0] += 1;
                    counts[i][1] += u32::from(cells <= REACH);
                }
            }
        }
        std::array::from_fn(|i| {
            let offset = [i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE)];
            let point = self.grid.point(std::array::from_fn(|axis| first[axis] + offset[axis]));
            let [all, near] = counts[i];
            if near == 0 || all < self.least || !self.field.within(point) {
                return f32::NAN;
            }
            (sums[i] / f64::from(all)) as f32
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{Defects, Extracted, Extraction, Goal, Source, Surface, extract};
    use std::f64::consts::PI;
    use trimip_core::{
        Config, Crop, Intrinsics, Lens, Pixel, Query,
        config::Contraction,
        engine::batch::Radiance,
        field::{
            model::{Model, OCCUPANCY},
            tensors::{Tensor, TensorFile},
        },
        geometry::projections::Model as Projection,
    };

    const CENTRE: [f64; 3] = [3.0, -2.0, 5.0];
    const RADIUS: f64 = 0.6;

    /// An opaque ball, and in the pictures of camera `haze` a smaller one half-way to that camera.
    struct Ball {
        haze: Option<DVec3>,
    }

    /// Returns the distance at which a ray enters a ball.
    fn enters(origin: DVec3, direction: DVec3, centre: DVec3, radius: f64) -> Option<f64> {
        let along = (centre - origin).dot(direction);
        let across = (centre - origin - along * direction).length();
        (along > 0.0 && across < radius).then(|| along - (radius * radius - across * across).sqrt())
    }

    impl Viewer for Ball {
        fn backend(&self) -> &str {
            "analytic"
        }
        fn device_name(&self) -> String {
            "analytic".into()
        }
        fn render(&mut self, camera: &Camera) -> Result<Frame> {
            let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
            let haze = self.haze.filter(|&of| of.distance(camera.origin) < 1e-9);
            let pixel = |i: u32| {
                let cone = camera.cone::<f64>(i % width, i / width);
                let [origin, direction] = [cone.origin, cone.direction].map(DVec3::from);
                let far = enters(origin, direction, CENTRE.into(), RADIUS);
                let near = haze
                    .and_then(|of| enters(origin, direction, 0.5 * (of + DVec3::from(CENTRE)), 0.3 * RADIUS));
                match near.or(far) {
                    Some(distance) => {
                        Pixel { rgb: [0.5; 3], opacity: 1.0, depth: (distance * cone.cosine) as f32 }
                    }
                    None => Pixel::default(),
                }
            };
            Ok(Frame { width, height, pixels: (0..width * height).map(pixel).collect() })
        }
        fn render_watched(
            &mut self,
            camera: &Camera,
            watch: &mut dyn FnMut(u32, u32) -> bool,
        ) -> Result<Option<Frame>> {
            watch(1, 1).then(|| self.render(camera)).transpose()
        }
        fn query(&mut self, queries: &[Query]) -> Result<Vec<Radiance>> {
            Ok(vec![Radiance { density: 1.0, rgb: [0.5; 3] }; queries.len()])
        }
    }

    /// Returns a model without parameters of contracted space around the ball.
    fn model(threads: u32) -> Model {
        let mut config = Config::default();
        config.scene.aabb_min = std::array::from_fn(|i| (CENTRE[i] - 2.0) as f32);
        config.scene.aabb_max = std::array::from_fn(|i| (CENTRE[i] + 2.0) as f32);
        config.scene.contraction = Contraction::Ball;
        config.occupancy.resolution = 16;
        config.threads = threads;
        let mut file = TensorFile::default();
        file.tensors.insert(OCCUPANCY.into(), Tensor::u8(&[16 * 16 * 16 / 8], vec![255; 16 * 16 * 16 / 8]));
        Model::new(config, file)
    }

    /// Returns cameras of a kind around the ball, in the directions of the corners and faces of a cube.
    fn around(projection: Projection) -> Vec<Camera> {
        let directions = (0..27).map(|i: u32| DVec3::from([i % 3, i / 3 % 3, i / 9].map(f64::from)) - 1.0);
        let directions = directions.filter(|d| d.length_squared() != 2.0 && d.length_squared() > 0.0);
        let looking = |direction: DVec3| {
            let mut k = Intrinsics::from_angle(240, 200, 0.6);
            k.lens = Lens::of(projection);
            if projection == Projection::Orthographic {
                (k.fx, k.fy) = (120.0, 120.0);
            }
            let up = if direction.z.abs() > 0.9 { DVec3::Y } else { DVec3::Z };
            Camera::look_at(k, DVec3::from(CENTRE) + 3.0 * direction.normalize(), CENTRE.into(), up)
        };
        directions.map(looking).collect()
    }

    fn everything() -> Extraction {
        Extraction {
            resolution: 96,
            surface: Surface::Depths,
            goal: Goal::Everything,
            colors: false,
            least_cameras: 1,
            ..Extraction::default()
        }
    }

    fn extracted(ball: &mut Ball, what: &Extraction, cameras: &[Camera], threads: u32) -> Result<Extracted> {
        Ok(extract(ball, &model(threads), what, cameras, &mut |_| true)?.expect("not stopped"))
    }

    /// Returns the largest distance between the ball and a vertex, in cells.
    fn worst(found: &Extracted) -> f64 {
        let deviation = |p: &[f32; 3]| (DVec3::from(p.map(f64::from)).distance(CENTRE.into()) - RADIUS).abs();
        found.mesh.positions.iter().map(deviation).fold(0.0, f64::max) / found.spacing
    }

    #[test]
    fn a_ball_seen_from_everywhere_is_closed_whatever_the_camera_model_and_the_number_of_threads() {
        for projection in [Projection::Perspective, Projection::Fisheye, Projection::Orthographic] {
            let cameras = around(projection);
            let one = extracted(&mut Ball { haze: None }, &everything(), &cameras, 1).unwrap();
            assert_eq!(one.source, Source::Depths(cameras.len()));
            assert_eq!(one.mesh.defects(), Defects::default(), "{projection:?}");
            // A ray that grazes the ball measures the distance along itself, so the mean lies up to a cell outside.
            assert!(worst(&one) < 1.0, "{projection:?}: {} cells", worst(&one));
            let volume = 4.0 / 3.0 * PI * RADIUS.powi(3);
            assert!((one.mesh.volume() / volume - 1.0).abs() < 0.05, "{}, not {volume}", one.mesh.volume());
            let three = extracted(&mut Ball { haze: None }, &everything(), &cameras, 3).unwrap();
            assert_eq!(one.mesh, three.mesh);
        }
    }

    #[test]
    fn one_camera_shows_the_side_that_faces_it_and_two_have_to_agree() {
        let camera = around(Projection::Perspective)[0];
        let found = extracted(&mut Ball { haze: None }, &everything(), &[camera], 0).unwrap();
        assert!(found.mesh.defects().open > 20 && found.mesh.defects().crowded == 0);
        let towards = camera.origin - DVec3::from(CENTRE);
        let faces = |p: &[f32; 3]| (DVec3::from(p.map(f64::from)) - DVec3::from(CENTRE)).dot(towards) > 0.0;
        assert!(found.mesh.positions.iter().all(faces));
        assert!(worst(&found) < 1.0, "{}", worst(&found));
        // The second camera looks from the opposite side.
        let opposite = *around(Projection::Perspective).last().unwrap();
        let what = Extraction { least_cameras: 2, ..everything() };
        let error = extracted(&mut Ball { haze: None }, &what, &[camera, opposite], 0).unwrap_err();
        assert!(error.message().contains("the depths of 2 pictures agree on no surface"), "{error}");
    }

    #[test]
    fn what_one_picture_shows_and_the_others_see_through_leaves_no_trace() {
        let cameras = around(Projection::Perspective);
        let mut hazy = Ball { haze: Some(cameras[0].origin) };
        let found = extracted(&mut hazy, &everything(), &cameras, 0).unwrap();
        assert!(worst(&found) < 1.0, "{}", worst(&found));
        assert_eq!(found.mesh.defects(), Defects::default());
    }

    #[test]
    fn a_crop_opens_the_surface_and_a_stop_ends_the_work() {
        let cameras = around(Projection::Perspective);
        let [x, y, z] = CENTRE;
        let crop = Crop::Half { point: [x, y, z + 0.2], normal: [0.0, 0.0, 1.0] };
        let found =
            extracted(&mut Ball { haze: None }, &Extraction { crop, ..everything() }, &cameras, 0).unwrap();
        let low = found.mesh.positions.iter().map(|p| f64::from(p[2])).fold(f64::INFINITY, f64::min);
        assert!((low - z - 0.2).abs() < 1.5 * found.spacing && found.mesh.defects().open > 50, "{low}");
        for end in [0.3, 0.9] {
            let model = model(1);
            let stopped =
                extract(&mut Ball { haze: None }, &model, &everything(), &cameras, &mut |f| f < end);
            assert!(stopped.unwrap().is_none());
        }
        let error = extracted(&mut Ball { haze: None }, &everything(), &[], 0).unwrap_err();
        assert!(error.message().contains("needs the cameras"), "{error}");
    }

    #[test]
    fn pixels_at_the_edge_of_an_object_are_not_used() {
        let camera = around(Projection::Perspective)[0];
        let frame = Ball { haze: None }.render(&camera).unwrap();
        let picture = Picture::new(camera, &frame);
        let (width, shows) = (picture.width, |i: usize| frame.pixels[i].opacity > 0.5);
        let edge = |i: usize| [i - 1, i + 1, i - width, i + width].into_iter().any(|j| shows(i) != shows(j));
        let inner = (1..picture.height - 1).flat_map(|y| (1..width - 1).map(move |x| x + y * width));
        let [mut edges, mut kept] = [0, 0];
        for i in inner {
            match edge(i) {
                true => {
                    assert!(picture.nearness[i].is_nan(), "{i}");
                    edges += 1;
                }
                false => kept += usize::from(picture.nearness[i] > 0.0),
            }
        }
        let all = frame.pixels.iter().filter(|pixel| pixel.opacity > 0.5).count();
        assert!(edges > 200 && kept > all * 8 / 10, "{edges} at the edge, {kept} of {all}");
    }
}
