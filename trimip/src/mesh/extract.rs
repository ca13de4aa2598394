//! The surface of a model, in the scene's own units and axes: where its density crosses a level, or where the depths of its pictures agree.

use super::{
    Goal, Grid, Mesh, Removed,
    clean::{clean, remove_specks},
    colors::{Sight, colors},
    fusion,
    occupied::{Occupied, Region},
    simplify,
    smooth::smooth,
    solid::{self, Solid},
};
use trimip_core::{
    Aabb, Camera, Config, Crop, Error, Result, Viewer, config::Contraction, field::model::Model,
    scene::origin::LocalOrigin,
};

/// Optical depth of a marching step at the density of the surface, unless a level is given. With this value, a ray that grazes the surface
/// over a few steps has an opacity of about a half.
const DEPTH_AT_SURFACE: f64 = 0.2;

/// Minimum number of cameras that see a part. In contracted space, parts that fewer cameras see are left out.
const LEAST_CAMERAS: u32 = 3;

/// Definition of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Surface {
    /// Where the density crosses a level. The surface is closed, except where a crop or the minimum number of cameras opens it.
    Density,
    /// Where the depths of pictures that the model renders of the training cameras agree. The surface is open where too few pictures show
    /// it. Haze and the insides of objects leave no trace.
    Depths,
}

/// Settings of an extraction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extraction {
    /// Cells along the longest side of the box.
    pub resolution: u32,
    /// Definition of the surface.
    pub surface: Surface,
    /// Density of [`Surface::Density`], per world unit; `None` = the density at which a marching step has an optical depth of 0.2.
    pub level: Option<f64>,
    /// Minimum bounding-box diagonal of a connected part, as a share of the longest side of the box; smaller parts are left out.
    pub specks: f64,
    /// Rounds of smoothing before the mesh is simplified.
    pub smoothing: u32,
    /// How far the mesh is simplified.
    pub goal: Goal,
    /// True to compute the colour of every vertex.
    pub colors: bool,
    /// Region to extract. The surface is open where the border of the crop cuts it. [`Crop::None`] extracts the scene's box, or in
    /// contracted space the box around its ball, and closes the surface there.
    pub crop: Crop,
    /// Minimum number of cameras that see a part; other parts are left out. 0 keeps all; the number of cameras is the upper limit.
    pub least_cameras: u32,
}

impl Extraction {
    /// Returns the default extraction of a model: within the crop of its scene; in contracted space from depths, and only parts that at
    /// least three cameras see. Without cameras, the surface is that of the density.
    pub fn of(config: &Config, cameras: &[Camera]) -> Self {
        let (surface, least_cameras) = match config.scene.contraction {
            Contraction::None => (Surface::Density, 0),
            Contraction::Ball if cameras.is_empty() => (Surface::Density, 0),
            Contraction::Ball => (Surface::Depths, LEAST_CAMERAS),
        };
        Self { crop: config.scene.crop, surface, least_cameras, ..Self::default() }
    }
}

impl Default for Extraction {
    fn default() -> Self {
        Self {
            resolution: 512,
            surface: Surface::Density,
            level: None,
            specks: 0.02,
            smoothing: 0,
            goal: Goal::Triangles(100_000),
            colors: true,
            crop: Crop::None,
            least_cameras: 0,
        }
    }
}

/// The quantity from which a surface was extracted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Source {
    /// The surface of this density, per world unit.
    Density(f64),
    /// The depths of this number of pictures.
    Depths(usize),
}

/// A mesh with figures of its extraction.
#[derive(Clone, Debug)]
pub struct Extracted {
    /// The mesh, in the world of the photographs' cameras.
    pub mesh: Mesh,
    /// The quantity from which the surface was extracted.
    pub source: Source,
    /// Width of a cell of the grid, world units.
    pub spacing: f64,
    /// Parts that were left out.
    pub removed: Removed,
    /// Triangles that were left out because too few cameras see them.
    pub unseen: usize,
    /// Triangles before simplification.
    pub triangles: usize,
}

/// Returns the default density of the surface, at which a marching step has an optical depth of 0.2.
pub fn level_of(config: &Config) -> f64 {
    let renderer = &config.renderer;
    // Rendering marches with the step length at the end of the training schedule.
    DEPTH_AT_SURFACE / (f64::from(config.step_length()) * renderer.step_scale.at(1.0))
}

/// Extracts the surface of a model, seen by the training `cameras`. Leaves out parts beyond the crop and parts that too few cameras see; the
/// mesh is open there. `watch` receives the share of the layers done and returns false to stop; the result is then `None`.
///
/// - [`Surface::Density`] fills voids in occupied cells that no line of sight from outside reaches; the lines have the directions in which
///   the cameras look or, without cameras, all directions. Memory use: two layers of the grid, two bits per grid point, and the mesh.
/// - [`Surface::Depths`] renders at most 128 pictures of at most 0.4 megapixels. Memory use: the depths of these pictures, a layer of the
///   grid, one bit per grid point, and the mesh. A viewer whose `renderer.cones` is 1 renders reduced pictures sooner.
///
/// # Errors
/// When the settings are out of range, the model has no surface at this level, there is no camera to render depths of, or the device fails.
pub fn extract(
    viewer: &mut dyn Viewer,
    model: &Model,
    what: &Extraction,
    cameras: &[Camera],
    watch: &mut dyn FnMut(f64) -> bool,
) -> Result<Option<Extracted>> {
    let level = what.level.unwrap_or_else(|| level_of(&model.config));
    check(what, level)?;
    let field = Occupied::new(model, what.crop)?;
    let grid = around(&field.aabb, what.resolution);
    let threads = model.config.threads as usize;
    let least = what.least_cameras.min(cameras.len().try_into().unwrap_or(u32::MAX));
    let speck = what.specks * field.aabb.longest();
    let region = Region { field: &field, grid: &grid, cameras, least, threads };
    let (solid, source) = match what.surface {
        Surface::Density => {
            let part = solid::Part { crop: what.crop, speck };
            (solid::surface(viewer, &region, level as f32, &part, watch)?, Source::Density(level))
        }
        Surface::Depths => {
            let Some(mut fused) = fusion::surface(viewer, &region, watch)? else { return Ok(None) };
            let removed = Removed { specks: remove_specks(&mut fused.mesh, speck), cavities: 0 };
            let solid = Solid { mesh: fused.mesh, removed, unseen: 0, closed: false };
            (Some(solid), Source::Depths(fused.pictures))
        }
    };
    let Some(Solid { mut mesh, removed, unseen, closed }) = solid else { return Ok(None) };
    if mesh.triangles.is_empty() {
        let left_out = match unseen {
            0 => String::new(),
            count => {
                format!(" ({count} triangles were left out because fewer than {least} cameras see them)")
            }
        };
        return Err(Error::run(match source {
            Source::Density(level) => format!(
                "the model has no surface of density {level:.3} that is larger than a speck{left_out}; try a lower level"
            ),
            Source::Depths(count) => format!(
                "the depths of {count} pictures agree on no surface that is larger than a speck; extract the surface of \
                 the density, or ask for fewer cameras per part"
            ),
        }));
    }
    smooth(&mut mesh, what.smoothing);
    mesh.find_normals();
    let triangles = mesh.triangles.len();
    if !watch(1.0) {
        return Ok(None);
    }
    simplify(&mut mesh, what.goal);
    // Simplification may collapse a thin neck and leave a few of its triangles.
    if closed {
        clean(&mut mesh, speck);
    } else {
        remove_specks(&mut mesh, speck);
    }
    if !watch(1.0) {
        return Ok(None);
    }
    if what.colors {
        mesh.colors = vertex_colors(viewer, &mesh, grid.spacing)?;
    }
    mesh.origin = LocalOrigin::of(&model.config.data);
    Ok(Some(Extracted { mesh, source, spacing: grid.spacing, removed, unseen, triangles }))
}

/// Refuses settings that are out of range.
fn check(what: &Extraction, level: f64) -> Result<()> {
    if !(8..=2048).contains(&what.resolution) {
        let found = format!("a mesh of {} cells along the longest side", what.resolution);
        return Err(Error::input(found, "out of range", "choose 8 to 2048"));
    }
    if !(level > 0.0 && level.is_finite()) {
        return Err(Error::input(
            format!("a surface of density {level}"),
            "out of range",
            "choose a positive density",
        ));
    }
    if !(0.0..1.0).contains(&what.specks) {
        let found = format!("specks of {} times the box", what.specks);
        return Err(Error::input(found, "out of range", "choose 0 (keep all) to less than 1"));
    }
    if let Goal::Error(error) = what.goal
        && !(error > 0.0 && error <= 1.0)
    {
        let found = format!("a simplification error of {error}");
        return Err(Error::input(
            found,
            "out of range",
            "choose a share of the longest side, above 0 and at most 1",
        ));
    }
    Ok(())
}

/// Returns a grid of points over a box, one point larger on every side, so that surfaces end within the grid.
fn around(aabb: &Aabb<f64>, resolution: u32) -> Grid {
    let spacing = aabb.longest() / f64::from(resolution);
    let cells = aabb.extent().map(|side| (side / spacing - 1e-6).ceil().max(1.0));
    let centre = aabb.centre();
    Grid {
        origin: std::array::from_fn(|axis| centre[axis] - spacing * (0.5 * cells[axis] + 1.0)),
        spacing,
        points: cells.map(|cells| cells as usize + 3),
    }
}

/// Returns the colour of each vertex, over two cells on either side of the surface.
fn vertex_colors(viewer: &mut dyn Viewer, mesh: &Mesh, spacing: f64) -> Result<Vec<[f32; 3]>> {
    let vertices = mesh.positions.iter().zip(&mesh.normals);
    let points: Vec<_> = vertices.map(|(&position, &normal)| [position, normal]).collect();
    colors(viewer, &points, Sight { reach: 2.0 * spacing, radius: 0.5 * spacing })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Defects;
    use glam::DVec3;
    use std::f64::consts::PI;
    use trimip_core::{
        Frame, Query,
        engine::batch::Radiance,
        field::{
            model::OCCUPANCY,
            tensors::{Tensor, TensorFile},
        },
    };

    /// A field whose density is LEVEL·e^(GROWTH·depth), where the depth below a surface is signed.
    struct Analytic<F>(F);

    /// Density of the surface.
    const LEVEL: f64 = 30.0;

    /// Growth of the density's logarithm per unit of depth, as at a solid surface of a trained model.
    const GROWTH: f64 = 40.0;

    impl<F: Fn([f64; 3]) -> f64 + Send> Viewer for Analytic<F> {
        fn backend(&self) -> &str {
            "analytic"
        }
        fn device_name(&self) -> String {
            "analytic".into()
        }
        fn render(&mut self, _: &Camera) -> Result<Frame> {
            Err(Error::run("renders nothing"))
        }
        fn render_watched(
            &mut self,
            _: &Camera,
            _: &mut dyn FnMut(u32, u32) -> bool,
        ) -> Result<Option<Frame>> {
            Err(Error::run("renders nothing"))
        }
        fn query(&mut self, queries: &[Query]) -> Result<Vec<Radiance>> {
            let one = |query: &Query| {
                let density = LEVEL * (GROWTH * (self.0)(query.point)).exp().min(1e4);
                // Each point has a colour of its own.
                Radiance { density: density as f32, rgb: query.point.map(|x| (0.5 + 0.1 * x.sin()) as f32) }
            };
            Ok(queries.iter().map(one).collect())
        }
    }

    /// Returns a model without parameters in the box around `centre` with these half sides, fully occupied.
    fn model(centre: [f64; 3], half: [f64; 3]) -> Model {
        let mut config = Config::default();
        config.scene.aabb_min = std::array::from_fn(|i| (centre[i] - half[i]) as f32);
        config.scene.aabb_max = std::array::from_fn(|i| (centre[i] + half[i]) as f32);
        config.occupancy.resolution = 16;
        let mut file = TensorFile::default();
        file.tensors.insert(OCCUPANCY.into(), Tensor::u8(&[16 * 16 * 16 / 8], vec![255; 16 * 16 * 16 / 8]));
        Model::new(config, file)
    }

    fn surface(
        depth: impl Fn([f64; 3]) -> f64 + Send,
        model: &Model,
        what: &Extraction,
    ) -> Result<Extracted> {
        Ok(extract(&mut Analytic(depth), model, what, &[], &mut |_| true)?.expect("not stopped"))
    }

    const CENTRE: [f64; 3] = [10.0, -20.0, 30.0];

    fn from_centre(point: [f64; 3]) -> DVec3 {
        DVec3::from_array(point) - DVec3::from_array(CENTRE)
    }

    fn places(mesh: &Mesh) -> Vec<DVec3> {
        mesh.positions.iter().map(|position| from_centre(position.map(f64::from))).collect()
    }

    #[test]
    fn a_torus_far_from_the_origin_has_its_place_its_size_and_its_hole() {
        const RADII: [f64; 2] = [1.0, 0.3];
        let beyond = |p: DVec3| (p.truncate().length() - RADII[0]).hypot(p.z) - RADII[1];
        let model = model(CENTRE, [1.5, 1.5, 0.5]);
        let goal = Goal::Triangles(20_000);
        let what = Extraction { resolution: 128, level: Some(LEVEL), goal, ..Extraction::default() };
        let found = surface(|point| -beyond(from_centre(point)), &model, &what).unwrap();
        assert_eq!(found.mesh.defects(), Defects::default());
        let simplified = found.mesh.triangles.len();
        assert!((19_000..=20_100).contains(&simplified), "{simplified} of {} triangles", found.triangles);
        let euler = found.mesh.positions.len() as i64 - found.mesh.triangles.len() as i64 / 2;
        assert_eq!(euler, 0, "one hole");
        // Hausdorff distance, from the mesh to the torus and back. In a cell of width h, linear interpolation of an exponential errs by
        // k·h/8 of the width, and a flat triangle by h²/8r; simplification adds a tenth of a cell.
        let bound = found.spacing * (GROWTH * found.spacing / 8.0 + 0.15);
        let places = places(&found.mesh);
        let furthest = places.iter().map(|&p| beyond(p).abs()).fold(0.0, f64::max);
        assert!(furthest < bound, "{furthest}, not below {bound}");
        for (i, j) in (0..24).flat_map(|i| (0..12).map(move |j| (i, j))) {
            let (around, across) = (f64::from(i) * PI / 12.0, f64::from(j) * PI / 6.0);
            let ring = RADII[0] + RADII[1] * across.cos();
            let point = DVec3::new(ring * around.cos(), ring * around.sin(), RADII[1] * across.sin());
            let nearest = places.iter().map(|p| p.distance(point)).fold(f64::INFINITY, f64::min);
            assert!(nearest < 3.0 * found.spacing, "{point} is {nearest} from the mesh");
        }
        let volume = 2.0 * PI * PI * RADII[0] * RADII[1] * RADII[1];
        assert!((found.mesh.volume() / volume - 1.0).abs() < 0.02, "{}, not {volume}", found.mesh.volume());
        for ((normal, place), color) in found.mesh.normals.iter().zip(&places).zip(&found.mesh.colors) {
            let outward = *place - RADII[0] * place.truncate().normalize().extend(0.0);
            let cosine = outward.normalize().dot(DVec3::from_array(normal.map(f64::from)));
            assert!(cosine > 0.98, "normal {normal:?} at {place}");
            for axis in 0..3 {
                let own = 0.5 + 0.1 * (place[axis] + CENTRE[axis]).sin();
                assert!((f64::from(color[axis]) - own).abs() < 0.01, "{color:?} at {place}");
            }
        }
    }

    #[test]
    fn the_default_level_follows_the_step_of_pictures() {
        let mut model = model(CENTRE, [1.5; 3]);
        let depth = |config: &Config, step: f64| level_of(config) * f64::from(config.step_length()) * step;
        assert!((depth(&model.config, 1.0) - 0.2).abs() < 1e-9);
        model.config.renderer.step_scale =
            trimip_core::config::schedule::Schedule::new(vec![[0.0, 8.0], [0.5, 2.0]]);
        assert!((depth(&model.config, 2.0) - 0.2).abs() < 1e-9);
    }

    #[test]
    fn specks_go_and_voids_that_nobody_sees_are_filled() {
        // A ball with a void, and a small ball next to it.
        let depth = |point: [f64; 3]| {
            let p = from_centre(point);
            let shell = (0.8 - p.length()).min(p.length() - 0.4);
            shell.max(0.04 - p.distance(DVec3::new(1.2, 1.2, 1.2)))
        };
        let model = model(CENTRE, [1.5; 3]);
        let all = Extraction {
            resolution: 96,
            level: Some(LEVEL),
            specks: 0.0,
            goal: Goal::Everything,
            colors: false,
            ..Extraction::default()
        };
        let ball = 4.0 / 3.0 * PI * 0.8_f64.powi(3);
        let found = surface(depth, &model, &all).unwrap();
        assert_eq!((found.removed.specks, found.mesh.defects()), (0, Defects::default()));
        let clean = surface(depth, &model, &Extraction { specks: 0.1, ..all }).unwrap();
        assert_eq!((clean.removed.specks, clean.mesh.defects()), (1, Defects::default()));
        assert!(
            (clean.mesh.volume() / ball - 1.0).abs() < 0.02,
            "the void is filled: {}",
            clean.mesh.volume()
        );
        assert!(clean.mesh.triangles.len() < found.mesh.triangles.len() && clean.mesh.colors.is_empty());
        assert!(places(&clean.mesh).iter().all(|p| (p.length() - 0.8).abs() < clean.spacing));
    }

    #[test]
    fn a_surface_that_leaves_the_box_is_closed_at_it() {
        let bounded = model(CENTRE, [0.5; 3]);
        // In contracted space the mesh ends at the middle half of the cube, although the field continues.
        let mut contracted = model(CENTRE, [1.0; 3]);
        contracted.config.scene.contraction = Contraction::Ball;
        for model in [bounded, contracted] {
            let what = Extraction { resolution: 32, level: Some(LEVEL), ..Extraction::default() };
            let found = surface(|point| 0.1 - from_centre(point).x, &model, &what).unwrap();
            assert_eq!(found.mesh.defects(), Defects::default());
            let [low, high] = found.mesh.bounds().unwrap();
            for axis in 0..3 {
                let far = if axis == 0 { 0.1 } else { 0.5 };
                assert!((f64::from(low[axis]) - CENTRE[axis] + 0.5).abs() <= found.spacing);
                assert!((f64::from(high[axis]) - CENTRE[axis] - far).abs() <= found.spacing);
            }
        }
    }

    #[test]
    fn a_crop_leaves_the_surface_within_it_and_open_at_its_border() {
        // A plane across x, cropped to a ball that reaches to both sides of it, in a bounded and in a contracted scene.
        let bounded = model(CENTRE, [1.0; 3]);
        let mut contracted = model(CENTRE, [0.5; 3]);
        contracted.config.scene.contraction = Contraction::Ball;
        for model in [bounded, contracted] {
            let crop = Crop::Ball { centre: CENTRE, radius: 0.8 };
            let goal = Goal::Everything;
            let what = Extraction { resolution: 48, level: Some(LEVEL), crop, goal, ..Extraction::default() };
            let found = surface(|point| 0.1 - from_centre(point).x, &model, &what).unwrap();
            let places = places(&found.mesh);
            assert!(
                places.iter().all(|p| (p.x - 0.1).abs() < 1.5 * found.spacing),
                "no wall of the cut is left"
            );
            let reach = places.iter().map(|p| p.truncate().length().max(p.z.abs())).fold(0.0, f64::max);
            // The plane cuts the ball in a disc of radius √(0.8² − 0.1²).
            assert!((reach - 0.794).abs() < 2.0 * found.spacing, "{reach}");
            assert!(found.mesh.defects().open > 100 && found.unseen == 0);
        }
    }

    #[test]
    fn a_half_space_keeps_one_side_of_a_ball_which_is_open_at_the_plane() {
        let bounded = model(CENTRE, [1.0; 3]);
        let mut contracted = model(CENTRE, [1.0; 3]);
        contracted.config.scene.contraction = Contraction::Ball;
        for model in [bounded, contracted] {
            // The plane z = 0.2 above the centre; the upper side is kept.
            let [x, y, z] = CENTRE;
            let crop = Crop::Half { point: [x, y, z + 0.2], normal: [0.0, 0.0, 3.0] };
            let goal = Goal::Everything;
            let what = Extraction { resolution: 48, level: Some(LEVEL), crop, goal, ..Extraction::default() };
            let found = surface(|point| 0.4 - from_centre(point).length(), &model, &what).unwrap();
            let places = places(&found.mesh);
            // Triangles at the rim reach one cell, with a diagonal of √3, into the cut.
            let worst = places.iter().map(|p| (p.length() - 0.4).abs()).fold(0.0, f64::max);
            assert!(
                worst < 3.0_f64.sqrt() * found.spacing,
                "no wall of the cut is left: {worst}, {}",
                found.spacing
            );
            let low = places.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
            assert!((low - 0.2).abs() < 1.5 * found.spacing, "{low}");
            let high = places.iter().map(|p| p.z).fold(f64::NEG_INFINITY, f64::max);
            assert!((high - 0.4).abs() < found.spacing && found.mesh.defects().open > 50, "{high}");
        }
    }

    #[test]
    fn a_crop_beside_the_box_is_refused() {
        let model = model(CENTRE, [1.0; 3]);
        for crop in [
            Crop::Ball { centre: [0.0; 3], radius: 1.0 },
            Crop::Half { point: [0.0, 0.0, 40.0], normal: [0.0, 0.0, 1.0] },
        ] {
            let what = Extraction { resolution: 16, level: Some(LEVEL), crop, ..Extraction::default() };
            let error = surface(|_| 1.0, &model, &what).unwrap_err();
            let named = error.message().contains(&crop.to_string());
            assert!(error.kind() == trimip_core::ErrorKind::Input && named, "{error}");
        }
    }

    #[test]
    fn what_few_cameras_see_is_left_out() {
        // Two balls next to each other. One of three cameras sees the second ball.
        let [first, second] = [DVec3::new(-0.6, 0.0, 0.0), DVec3::new(0.6, 0.0, 0.0)];
        let depth = |point: [f64; 3]| {
            let p = from_centre(point);
            (0.3 - p.distance(first)).max(0.3 - p.distance(second))
        };
        let model = model(CENTRE, [1.0; 3]);
        let centre = DVec3::from(CENTRE);
        let looking = |from: DVec3, at: DVec3| {
            let k = trimip_core::Intrinsics::from_angle(64, 64, 0.2);
            Camera::look_at(k, centre + from, centre + at, DVec3::Z)
        };
        let cameras = [
            looking(first + 4.0 * DVec3::Y, first),
            looking(first - 4.0 * DVec3::Y, first),
            looking(second + 4.0 * DVec3::Y, second),
        ];
        let extracted = |least_cameras| {
            let goal = Goal::Everything;
            let what = Extraction {
                resolution: 64,
                level: Some(LEVEL),
                least_cameras,
                goal,
                ..Extraction::default()
            };
            extract(&mut Analytic(depth), &model, &what, &cameras, &mut |_| true).unwrap().unwrap()
        };
        let all = extracted(0);
        assert_eq!((all.unseen, all.mesh.defects()), (0, Defects::default()));
        let one = extracted(1);
        let sides = |mesh: &Mesh| {
            let right = places(mesh).iter().filter(|p| p.x > 0.0).count();
            [mesh.positions.len() - right, right]
        };
        let ([left, right], [whole, _]) = (sides(&one.mesh), sides(&all.mesh));
        assert!(
            left > right && right > whole / 4,
            "{left}, {right} of {whole} vertices: one camera sees half of a ball"
        );
        assert!(one.unseen > 0 && one.mesh.triangles.len() + one.unseen == all.mesh.triangles.len());
        // No block is seen by two cameras: one looks from the front, the other from the back.
        let error = extract(
            &mut Analytic(depth),
            &model,
            &Extraction { resolution: 64, level: Some(LEVEL), least_cameras: 2, ..Extraction::default() },
            &cameras[1..],
            &mut |_| true,
        );
        assert!(error.unwrap_err().message().contains("fewer than 2 cameras see them"));
    }

    #[test]
    fn simplification_by_error_keeps_the_surface_within_it() {
        let model = model(CENTRE, [1.0; 3]);
        let what = Extraction {
            resolution: 64,
            level: Some(LEVEL),
            goal: Goal::Error(0.01),
            ..Extraction::default()
        };
        let found = surface(|point| 0.7 - from_centre(point).length(), &model, &what).unwrap();
        assert!(found.mesh.triangles.len() * 4 < found.triangles, "{} triangles", found.mesh.triangles.len());
        let volume = 4.0 / 3.0 * PI * 0.7_f64.powi(3);
        assert!((found.mesh.volume() / volume - 1.0).abs() < 0.06);
        assert_eq!(found.mesh.defects(), Defects::default());
    }

    #[test]
    fn what_cannot_be_extracted_says_why() {
        let model = model(CENTRE, [1.0; 3]);
        let what = Extraction { resolution: 16, level: Some(LEVEL), ..Extraction::default() };
        let refused = |what: Extraction| surface(|_| -1.0, &model, &what).unwrap_err();
        assert!(refused(what).message().contains("no surface of density 30"));
        for (bad, part) in [
            (Extraction { resolution: 4, ..what }, "8 to 2048"),
            (Extraction { resolution: 1 << 20, ..what }, "8 to 2048"),
            (Extraction { level: Some(f64::NAN), ..what }, "positive density"),
            (Extraction { level: Some(0.0), ..what }, "positive density"),
            (Extraction { specks: -0.1, ..what }, "specks"),
            (Extraction { specks: f64::NAN, ..what }, "specks"),
            (Extraction { goal: Goal::Error(f64::NAN), ..what }, "error"),
        ] {
            let error = refused(bad);
            assert!(
                error.kind() == trimip_core::ErrorKind::Input && error.message().contains(part),
                "{error}"
            );
        }
        let mut calls = 0;
        let mut watch = |_| {
            calls += 1;
            calls < 3
        };
        let stopped = extract(&mut Analytic(|_| 1.0), &model, &what, &[], &mut watch).unwrap();
        assert!(stopped.is_none() && calls == 3);
    }
}
