//! The surface of a model: where its density crosses a level, in the scene's own units and axes.

use super::{
    Goal, Grid, Mesh, Removed, clean,
    hidden::{Bits, directions, visible},
    march, simplify,
};
use glam::{DVec3, Vec3};
use trimip_core::{
    Aabb, Camera, Config, Error, Query, Result, Space, Viewer,
    compositing::composite,
    model::{Model, OCCUPANCY},
    occupancy::cell_of,
};

/// Optical depth that a marching step has at the level of the surface, unless a level is given. A ray that grazes the
/// surface within a few steps then has an opacity of about a half.
const DEPTH_AT_SURFACE: f64 = 0.2;

/// Places per query of the model; it bounds the memory.
const PLACES_AT_ONCE: usize = 1 << 17;

/// Density of a void that nobody sees, relative to that of the surface.
const FILLED: f32 = 2.0;

/// Samples that show the colour of a vertex, along the line of sight against its normal.
const COLOR_SAMPLES: usize = 8;

/// What to extract.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extraction {
    /// Cells along the longest side of the box.
    pub resolution: u32,
    /// Density of the surface, per world unit; `None` = by the marching step ([`level_of`]).
    pub level: Option<f64>,
    /// Connected parts whose box has a smaller diagonal are left out, as a share of the longest side of the box.
    pub specks: f64,
    /// How far the mesh is simplified.
    pub goal: Goal,
    /// True to find the colour of every vertex.
    pub colors: bool,
}

impl Default for Extraction {
    fn default() -> Self {
        Self { resolution: 512, level: None, specks: 0.02, goal: Goal::Triangles(100_000), colors: true }
    }
}

/// A mesh and how it came about.
#[derive(Clone, Debug)]
pub struct Extracted {
    /// The mesh, in the world of the photographs' cameras.
    pub mesh: Mesh,
    /// Density of the surface, per world unit.
    pub level: f64,
    /// Width of a cell of the grid, world units.
    pub spacing: f64,
    /// Parts that were left out.
    pub removed: Removed,
    /// Triangles before simplification.
    pub triangles: usize,
}

/// The density at which the surface is found without a given level: a marching step of it has an optical depth of
/// 0.2.
pub fn level_of(config: &Config) -> f64 {
    DEPTH_AT_SURFACE / f64::from(config.step_length())
}

/// Extracts the surface of a model. Voids of its occupied cells are filled where nobody sees them, looking in from
/// outside in the directions of `cameras`, or from everywhere without cameras. Memory holds two layers of the
/// grid, two bits of each of its points, and the mesh. `watch` gets the share of the
/// layers that are done and returns false to stop; the result is then `None`.
///
/// # Errors
/// When the settings are out of range, the model has no surface at this level, or the device fails.
pub fn extract(
    viewer: &mut dyn Viewer,
    model: &Model,
    what: &Extraction,
    cameras: &[Camera],
    watch: &mut dyn FnMut(f64) -> bool,
) -> Result<Option<Extracted>> {
    let level = what.level.unwrap_or_else(|| level_of(&model.config));
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
    let field = Occupied::new(model)?;
    let (grid, level_f32) = (around(&field.aabb, what.resolution), level as f32);
    let layers = grid.points[2];
    // Once for the solid, and, as nothing but bits of it is kept, once more for the surface.
    let mut solid = Bits::new(grid.points);
    let mut layer = vec![0.0; grid.layer()];
    for z in 0..layers {
        if !watch(0.5 * z as f64 / layers as f64) {
            return Ok(None);
        }
        field.sample(viewer, &grid, z, &mut layer)?;
        let first = z * layer.len();
        (0..layer.len()).filter(|&i| layer[i] >= level_f32).for_each(|i| solid.set(first + i));
    }
    let seen = visible(&solid, &directions(cameras));
    let mut stopped = false;
    let surface = march(&grid, level_f32, |z, layer| {
        if stopped || !watch(0.5 + 0.5 * z as f64 / layers as f64) {
            stopped = true;
            layer.fill(0.0);
            return Ok(());
        }
        field.sample(viewer, &grid, z, layer)?;
        let first = z * layer.len();
        for (i, value) in layer.iter_mut().enumerate() {
            if *value < level_f32 && !seen.get(first + i) {
                // Beyond the occupied cells nothing is rendered, so that no void is there.
                if field.holds(grid.point([i % grid.points[0], i / grid.points[0], z])) {
                    *value = level_f32 * FILLED;
                }
            }
        }
        Ok(())
    });
    let mut mesh = surface?;
    if stopped {
        return Ok(None);
    }
    let removed = clean(&mut mesh, what.specks * field.aabb.longest());
    if mesh.triangles.is_empty() {
        return Err(Error::run(format!(
            "the model has no surface of density {level:.3} that is larger than a speck; try a lower --level"
        )));
    }
    mesh.find_normals();
    let triangles = mesh.triangles.len();
    simplify(&mut mesh, what.goal);
    if what.colors {
        mesh.colors = colors(viewer, &mesh, grid.spacing)?;
    }
    Ok(Some(Extracted { mesh, level, spacing: grid.spacing, removed, triangles }))
}

/// A grid of points over a box with one more point around it on every side, so that surfaces end within it.
fn around(aabb: &Aabb<f64>, resolution: u32) -> Grid {
    let spacing = aabb.longest() / f64::from(resolution);
    let cells = aabb.extent().map(|side| (side / spacing - 1e-6).ceil().max(1.0));
    Grid {
        origin: std::array::from_fn(|axis| {
            0.5 * (aabb.min[axis] + aabb.max[axis]) - spacing * (0.5 * cells[axis] + 1.0)
        }),
        spacing,
        points: cells.map(|cells| cells as usize + 3),
    }
}

/// Where a model has a density at all.
struct Occupied {
    aabb: Aabb<f64>,
    space: Space<f64>,
    resolution: u32,
    bits: Vec<u8>,
}

impl Occupied {
    fn new(model: &Model) -> Result<Self> {
        let resolution = model.config.occupancy.resolution;
        let cells = (resolution as usize).pow(3);
        let bits = model.file.u8("model", OCCUPANCY, &[cells.div_ceil(8)])?.to_vec();
        let aabb = Aabb::new(&model.config.scene);
        Ok(Self { space: Space::of(aabb), aabb, resolution, bits })
    }

    /// True if samples are placed at a point of the world.
    fn holds(&self, point: [f64; 3]) -> bool {
        let position = self.space.to_cube(point);
        if !position.iter().all(|p| (0.0..=1.0).contains(p)) {
            return false;
        }
        let cell = cell_of(position.map(|p| p as f32), self.resolution);
        self.bits[cell as usize / 8] >> (cell % 8) & 1 == 1
    }

    /// Fills a layer of the grid with densities, zero where nothing is occupied.
    fn sample(&self, viewer: &mut dyn Viewer, grid: &Grid, z: usize, layer: &mut [f32]) -> Result<()> {
        layer.fill(0.0);
        let radius = (0.5 * grid.spacing) as f32;
        let point = |i: usize| grid.point([i % grid.points[0], i / grid.points[0], z]);
        let places: Vec<usize> = (0..layer.len()).filter(|&i| self.holds(point(i))).collect();
        for places in places.chunks(PLACES_AT_ONCE) {
            let query = |&i: &usize| Query { point: point(i), radius, direction: [0.0, 0.0, -1.0] };
            let queries: Vec<Query> = places.iter().map(query).collect();
            for (&place, radiance) in places.iter().zip(viewer.query(&queries)?) {
                layer[place] = radiance.density;
            }
        }
        Ok(())
    }
}

/// The colour of each vertex as seen against its normal: volume rendering over two cells on either side.
fn colors(viewer: &mut dyn Viewer, mesh: &Mesh, spacing: f64) -> Result<Vec<[f32; 3]>> {
    let length = 4.0 * spacing / COLOR_SAMPLES as f64;
    let mut colors = Vec::with_capacity(mesh.positions.len());
    let vertices = mesh.positions.iter().zip(&mesh.normals).collect::<Vec<_>>();
    for vertices in vertices.chunks(PLACES_AT_ONCE / COLOR_SAMPLES) {
        let queries: Vec<Query> = vertices
            .iter()
            .flat_map(|&(&position, &normal)| {
                let direction = (-Vec3::from_array(normal)).to_array();
                (0..COLOR_SAMPLES).map(move |i| {
                    let offset = length * (i as f64 + 0.5) - 2.0 * spacing;
                    let point = Vec3::from_array(position).as_dvec3()
                        + offset * DVec3::from(direction.map(f64::from));
                    Query { point: point.to_array(), radius: (0.5 * spacing) as f32, direction }
                })
            })
            .collect();
        for samples in viewer.query(&queries)?.chunks_exact(COLOR_SAMPLES) {
            let seen = samples.iter().map(|own| (own.density * length as f32, own.rgb, 0.0));
            let pixel = composite(seen, [0.0; 3]);
            // Where the line of sight is not opaque, the colour is that of what is seen.
            let share = pixel.opacity.max(1e-6).recip();
            colors.push(pixel.rgb.map(|c| (c * share).clamp(0.0, 1.0)));
        }
    }
    Ok(colors)
}
