//! A model on a device, ready to render. The code is generic over backends and implements [`Viewer`].

use crate::{
    Backend, Camera, Config, Crop, Encoder, Error, Field, Frame, Layout, Pixel, Query, Renderer, Result,
    Space, ViewSet, Viewer,
    config::{Exposure, RendererKind},
    engine::{
        backend::{Occupancy, Sampler, Stages},
        batch::{Radiance, Segment, Tile, Tiling, Workspace},
        proxy::Proxy,
    },
    field::{
        model::{Assets, Model, OCCUPANCY, assets},
        tensors::{Tensor, TensorFile},
    },
    geometry::occupancy::coordinates,
    math::bits,
};
use glam::DVec3;
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

/// Rays per tile when a view is rendered.
const RAYS_PER_TILE: u32 = 256;

/// A model on a device: its parameters and the stages that render them. [`Trainer`](crate::engine::trainer::Trainer) adds
/// what training needs.
pub struct LoadedModel<B: Backend> {
    pub(crate) backend: Arc<B>,
    pub(crate) config: Config,
    /// Centre of the scene's box; the origin of the coordinates in which the stages work.
    centre: DVec3,
    pub(crate) layout: Layout,
    pub(crate) stages: Stages<B>,
    pub(crate) parameters: B::Buffer<f32>,
    frame: B::Buffer<Pixel>,
    /// Data that the renderer needs in addition to the parameters.
    assets: Assets,
    /// The occupancy bits of a finished model before any clipping. They are kept on the host, because a web page cannot
    /// wait for a read from the device.
    unclipped: Vec<u8>,
}

impl<B: Backend> LoadedModel<B> {
    /// Loads a finished model.
    ///
    /// # Errors
    /// When its tensors do not fit its configuration, or the configuration does not fit the device.
    pub fn new(backend: B, model: &Model) -> Result<Self> {
        if model.config.renderer.kind == RendererKind::Hybrid && !Proxy::is_in(&assets(&model.file)) {
            return Err(Error::input(
                "renderer.kind = \"hybrid\"",
                "the model has no proxy",
                "compute it with `trimip-cli bake`, or render with renderer.kind = \"volume\"",
            ));
        }
        let mut loaded = Self::build(Arc::new(backend), &model.config, None)?;
        loaded.restore_model("model", &model.file, None)?;
        loaded.unclipped = model.file.u8("model", OCCUPANCY, &[loaded.cells().div_ceil(8)])?.to_vec();
        loaded.stages.renderer.set_progress(1.0);
        Ok(loaded)
    }

    /// Creates a model with initial parameters; its stages can train if `views` is given. Data derived from the
    /// parameters is not built yet.
    pub(crate) fn build(backend: Arc<B>, config: &Config, views: Option<ViewSet>) -> Result<Self> {
        let (centred, centre) = config.centred();
        let layout = Layout::new(&centred);
        let views = views.map(|mut views| {
            views.views.iter_mut().for_each(|view| view.camera.origin -= centre);
            views
        });
        let stages = backend.stages(&centred, views)?;
        let mut parameters = backend.zeros(layout.len());
        backend.write(&mut parameters, &layout.initial(config));
        Ok(Self {
            frame: backend.zeros(0),
            assets: Assets::new(),
            unclipped: Vec::new(),
            backend,
            config: config.clone(),
            centre,
            layout,
            stages,
            parameters,
        })
    }

    /// Returns the backend, so that its counters can be read.
    pub fn device(&self) -> &B {
        &self.backend
    }

    /// Returns the names and ranges of the parameters.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Returns all parameters as one flat array in the order of the [`layout`](Self::layout), padding included.
    pub fn parameters(&self) -> Vec<f32> {
        self.backend.read(&self.parameters)
    }

    /// Replaces all parameters with `values`, in the form of [`parameters`](Self::parameters).
    pub fn set_parameters(&mut self, values: &[f32]) {
        self.backend.write(&mut self.parameters, values);
        self.refresh();
    }

    /// Marks every cell of the occupancy grid as occupied.
    pub fn occupy_all(&mut self) {
        let cells = self.cells();
        self.stages.occupancy.restore(&vec![0xff; cells.div_ceil(8)], Some(&vec![1.0; cells]));
    }

    /// Renders a view as [`Viewer::render`] does, but never blocks: the future is pending while the device works. Web
    /// pages use this method.
    ///
    /// # Errors
    /// As [`Viewer::render`].
    pub async fn render_async(&mut self, camera: &Camera) -> Result<Frame> {
        let bands = Bands::of(camera, B::RAYS_OF_A_BAND)?;
        let mut pixels = Vec::with_capacity(bands.pixels());
        for (_, range) in bands.clone() {
            let Self { backend, stages, parameters, frame, .. } = self;
            let (backend, stages, parameters) = (&**backend, &*stages, &*parameters);
            let camera = &Camera { origin: camera.origin - self.centre, ..*camera };
            let tiling = Tiling { count: range.len() as u32, per_tile: RAYS_PER_TILE };
            let work = |workspace: &mut Workspace<B>, tile: Range<u32>| {
                camera_tile(stages, parameters, workspace, camera, range.start, tile);
            };
            backend
                .map_tiles_async(&stages.field, tiling, frame, &work, &|workspace| &workspace.pixels)
                .await;
            pixels.extend(backend.read_async(frame).await);
            backend.health()?;
        }
        Ok(bands.frame(pixels))
    }

    fn render_view(
        &mut self,
        camera: &Camera,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Frame>> {
        let bands = Bands::of(camera, B::RAYS_OF_A_BAND)?;
        let (backend, stages, parameters) = (&*self.backend, &self.stages, &self.parameters);
        let camera = &Camera { origin: camera.origin - self.centre, ..*camera };
        let mut pixels = Vec::with_capacity(bands.pixels());
        for (row, range) in bands.clone() {
            if !watch(row, bands.height) {
                return Ok(None);
            }
            let frame = &mut self.frame;
            backend.install(|| {
                backend.map_tiles(
                    &stages.field,
                    Tiling { count: range.len() as u32, per_tile: RAYS_PER_TILE },
                    frame,
                    &|workspace, tile| {
                        camera_tile(stages, parameters, workspace, camera, range.start, tile);
                    },
                    &|workspace| &workspace.pixels,
                );
            });
            pixels.extend(self.backend.read(&self.frame));
            self.backend.health()?;
        }
        Ok(Some(bands.frame(pixels)))
    }

    /// Implements [`Viewer::samples`].
    fn count_samples(
        &mut self,
        camera: &Camera,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Vec<u32>>> {
        let bands = Bands::of(camera, B::RAYS_OF_A_BAND)?;
        let (backend, stages, parameters) = (&*self.backend, &self.stages, &self.parameters);
        let camera = &Camera { origin: camera.origin - self.centre, ..*camera };
        let all = Mutex::new(vec![0; bands.pixels()]);
        for (row, range) in bands.clone() {
            if !watch(row, bands.height) {
                return Ok(None);
            }
            let work = |workspace: &mut Workspace<B>, tile: Range<u32>| {
                camera_tile(stages, parameters, workspace, camera, range.start, tile.clone());
                let segments = backend.read(&workspace.samples.segments);
                let groups = backend.read(&workspace.rays.groups);
                let of = |group: &Segment| {
                    let cones = &segments[group.start as usize..][..group.count as usize];
                    cones.iter().map(|cone| cone.count).sum()
                };
                let mut all = all.lock().unwrap_or_else(PoisonError::into_inner);
                let into = &mut all[(range.start + tile.start) as usize..(range.start + tile.end) as usize];
                into.iter_mut().zip(&groups).for_each(|(count, group)| *count = of(group));
            };
            let tiling = Tiling { count: range.len() as u32, per_tile: RAYS_PER_TILE };
            let frame = &mut self.frame;
            backend.install(|| {
                backend.map_tiles(&stages.field, tiling, frame, &work, &|workspace| &workspace.pixels);
            });
            backend.health()?;
        }
        Ok(Some(all.into_inner().unwrap_or_else(PoisonError::into_inner)))
    }

    /// Returns the occupancy bits of a finished model, cleared for cells whose centre is outside at least one part of
    /// `keep`.
    fn clipped(&self, keep: &[Crop]) -> Vec<u8> {
        let space = Space::<f32>::new(&self.config.centred().0.scene);
        let resolution = self.config.occupancy.resolution;
        let mut bits = self.unclipped.clone();
        for cell in 0..self.cells() as u32 {
            let place = coordinates(cell, resolution).map(|c| (c as f32 + 0.5) / resolution as f32);
            let world = DVec3::from_array(space.to_world(place).map(f64::from)) + self.centre;
            if !keep.iter().all(|part| part.contains(world.to_array())) {
                bits::clear(&mut bits, cell as usize);
            }
        }
        bits
    }

    /// Rebuilds all data derived from the parameters.
    pub(crate) fn refresh(&mut self) {
        let Self { backend, stages, parameters, .. } = self;
        backend.install(|| {
            stages.encoder.refresh(parameters);
            stages.field.refresh(parameters);
        });
    }

    pub(crate) fn restore_model(
        &mut self,
        name: &str,
        file: &TensorFile,
        densities: Option<&[f32]>,
    ) -> Result<()> {
        let values = self.layout.from_tensors(file, name, "")?;
        let bits = file.u8(name, OCCUPANCY, &[self.cells().div_ceil(8)])?;
        self.assets = assets(file);
        self.stages.renderer.set_assets(&self.assets)?;
        self.stages.occupancy.restore(bits, densities);
        self.set_parameters(&values);
        Ok(())
    }

    /// Returns the named tensors of the parameters `values`, the bits of the occupancy grid, and the assets.
    pub(crate) fn tensors(&self, values: &[f32]) -> TensorFile {
        let mut file = TensorFile::default();
        self.layout.to_tensors(values, "", &mut file);
        let bits = self.stages.occupancy.bits();
        file.tensors.insert(OCCUPANCY.into(), Tensor::u8(&[bits.len()], bits));
        file.tensors.extend(self.assets.clone());
        file
    }

    /// Returns the number of cells of the occupancy grid.
    pub(crate) fn cells(&self) -> usize {
        self.config.occupancy.cells()
    }
}

/// Iterator over the bands of rows in which a view is rendered. Each item is the first row of a band and the band's
/// range of pixels.
#[derive(Clone)]
struct Bands {
    width: u32,
    height: u32,
    rows: u32,
    next: u32,
}

impl Bands {
    /// Creates bands of about `rays` pixels.
    fn of(camera: &Camera, rays: u32) -> Result<Self> {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        if width.checked_mul(height).is_none() {
            return Err(Error::input(
                "camera",
                format!("{width} x {height} pixels"),
                "render at most 2^32 pixels at once",
            ));
        }
        Ok(Self { width, height, rows: (rays / width.max(1)).clamp(1, height.max(1)), next: 0 })
    }

    fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    fn frame(&self, pixels: Vec<Pixel>) -> Frame {
        Frame { width: self.width, height: self.height, pixels }
    }
}

impl Iterator for Bands {
    type Item = (u32, Range<u32>);

    fn next(&mut self) -> Option<Self::Item> {
        let (first, last) = (self.next, (self.next + self.rows).min(self.height));
        self.next = last;
        (first < last).then(|| (first, first * self.width..last * self.width))
    }
}

/// Renders the pixels `tile` of the band that begins at pixel `first`.
fn camera_tile<B: Backend>(
    stages: &Stages<B>,
    parameters: &B::Buffer<f32>,
    workspace: &mut Workspace<B>,
    camera: &Camera,
    first: u32,
    tile: Range<u32>,
) {
    let range = first + tile.start..first + tile.end;
    stages.sampler.camera_rays(&mut workspace.stream, camera, range, &mut workspace.rays);
    forward(stages, parameters, workspace, None);
}

/// Runs the forward pass from rays to pixels, which training and rendering share.
pub(crate) fn forward<B: Backend>(
    stages: &Stages<B>,
    parameters: &B::Buffer<f32>,
    workspace: &mut Workspace<B>,
    jitter: Option<u64>,
) {
    stages.renderer.visibility_pass(stages, parameters, workspace, jitter);
    let Workspace { stream, rays, samples, field_context, radiance, cones, pixels, .. } = workspace;
    let tile = &mut Tile { stream, parameters, rays, samples };
    stages.field.color(tile, stages.renderer.color_weight(), field_context, radiance);
    stages.renderer.composite(tile, radiance, cones, pixels);
}

impl<B: Backend> Viewer for LoadedModel<B> {
    fn backend(&self) -> &str {
        self.backend.name()
    }

    fn device_name(&self) -> String {
        self.backend.device_name()
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = self.backend.notes(&self.config);
        if self.config.loss.exposure == Exposure::Gain {
            notes.push(
                "loss.exposure = \"gain\": the model has the mean exposure of its photographs, and test views are rendered \
                 and measured with it"
                    .into(),
            );
        }
        notes
    }

    fn render(&mut self, camera: &Camera) -> Result<Frame> {
        let frame = self.render_view(camera, &mut |_, _| true)?;
        // Rendering is cancelled only by a watcher, and this one never cancels.
        frame.ok_or_else(|| Error::run("a view was not rendered"))
    }

    fn render_watched(
        &mut self,
        camera: &Camera,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Frame>> {
        self.render_view(camera, watch)
    }

    fn query(&mut self, queries: &[Query]) -> Result<Vec<Radiance>> {
        self.evaluate(queries, true)
    }

    fn densities(&mut self, queries: &[Query]) -> Result<Vec<f32>> {
        Ok(self.evaluate(queries, false)?.into_iter().map(|radiance| radiance.density).collect())
    }

    fn features(&mut self, queries: &[Query]) -> Result<Vec<f32>> {
        self.encode(queries)
    }

    fn samples(
        &mut self,
        camera: &Camera,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Vec<u32>>> {
        self.count_samples(camera, watch)
    }

    fn clip(&mut self, keep: &[Crop]) -> Result<()> {
        match keep {
            [] => self.stages.occupancy.restore(&self.unclipped, None),
            _ => self.stages.occupancy.restore(&self.clipped(keep), None),
        }
        self.backend.health()
    }
}
