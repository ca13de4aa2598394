//! The GPU backend. All stages record into one submission, a step is one span, and sums are read once they are
//! available.

use crate::buffer::Buffer;
use crate::ceilings::Ceilings;
use crate::device::{Bind, Counts, GROUP, Gpu, Size};
use crate::encoder::WgpuEncoder;
use crate::field::WgpuField;
use crate::kernel::{Addition, GATHERING};
use crate::loss::{GAIN_WORDS, SUM_WORDS, Sums, WgpuLoss, sums_of};
use crate::occupancy::{OCCUPIED_AT, WgpuOccupancy};
use crate::optimizer::WgpuOptimizer;
use crate::read_back::Receipt;
use crate::renderer::WgpuRenderer;
use crate::rooms::{LEAST_ROOM, VIEW_SAMPLES, rooms};
use crate::sampler::WgpuSampler;
use crate::spans::Spans;
use bytemuck::Pod;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use trimip_core::backend::{Stages, TrainWork};
use trimip_core::batch::{Batch, Deposit, Segment, StepResult, StepSums, Tiling, Workspace};
use trimip_core::config::Precision;
use trimip_core::{Backend, Config, Error, Layout, Result, ViewSet};

/// Iterations after which llvmpipe ends the loops of an invocation, minus some for its other loops.
const SOFTWARE_ROUNDS: usize = 60_000;

/// Byte offset of the sum of the weights within a step's sums.
const WEIGHT_AT: u64 = 4;

/// Marched samples that the training loop plans for one span.
const SAMPLES_PER_SPAN: usize = 512;

/// Maximum number of pixels or probes in a first span, before their number of samples is known.
const MOST_AT_FIRST: usize = 1 << 18;

/// A GPU device with its workspaces and counters.
pub struct WgpuBackend {
    gpu: Arc<Gpu>,
    addition: Addition,
    workspaces: Mutex<Vec<Workspace<Self>>>,
    known: Arc<Known>,
    /// Counters of the model in training, read together with a step's sums: the occupancy grid's and the field's.
    watched: Mutex<Option<[wgpu::Buffer; 2]>>,
    room: Mutex<usize>,
}

/// The last values of the device's counters that were read.
#[derive(Default)]
pub struct Known {
    /// Number of occupied cells.
    pub occupied: AtomicU64,
    /// Number of factors that f16 cannot hold.
    pub overflows: AtomicU64,
}

/// Scratch memory of a workspace.
pub struct Lane {
    gpu: Arc<Gpu>,
    /// A number of rows that is known to the host.
    pub(crate) count: Buffer<u32>,
    pub(crate) bits: Buffer<u32>,
    pub(crate) blocks: Buffer<u32>,
    pub(crate) old_segments: Buffer<Segment>,
    pub(crate) marks: Buffer<u32>,
    /// For hybrid rendering, one per ray: 1 if the proxy is sure of it.
    pub(crate) sure: Buffer<u32>,
    pub(crate) sums: Buffer<f32>,
    /// Destination arrays for gathered rows, by row width in words.
    spares: HashMap<usize, Buffer<u32>>,
    /// True if rays were marched, so that samples may have been dropped for lack of room.
    pub(crate) marched: bool,
}

impl Lane {
    fn new(gpu: &Arc<Gpu>) -> Self {
        let words = || Buffer::zeros(gpu, 0);
        Self {
            gpu: Arc::clone(gpu),
            count: Buffer::zeros(gpu, 1),
            bits: words(),
            blocks: words(),
            old_segments: Buffer::zeros(gpu, 0),
            marks: words(),
            sure: words(),
            sums: Buffer::zeros(gpu, 0),
            spares: HashMap::new(),
            marched: false,
        }
    }

    /// Keeps the rows `kept` of an array, of `width` words each, and drops the others.
    pub(crate) fn keep<T: Pod>(&mut self, kept: &Buffer<u32>, array: &mut Buffer<T>, width: usize) {
        let spare = self.spares.entry(width).or_insert_with(|| Buffer::zeros(&self.gpu, 0));
        let Some((counts, counter)) = kept.counter() else { return };
        let values = width * 4 / size_of::<T>();
        spare.reserve(array.capacity() * size_of::<T>() / 4);
        spare.count_by(kept.most() * width, counts, counter, width);
        let params = [width as u32, counter];
        let counts = Bind { buffer: counts, offset: 0, size: None };
        let binds = [array.bind(), spare.bind(), kept.bind(), counts];
        let size =
            Size::Counted { counts: counts.buffer, counter, per: width as u32, group: GROUP, times: 1 };
        self.gpu.dispatch(&GATHERING, &binds, &params, size);
        array.swap(spare);
        array.count_by(kept.most() * values, counts.buffer, counter, values);
    }
}

impl WgpuBackend {
    /// Opens the adapter whose name contains `adapter`, or the best one if `adapter` is empty. `deterministic` sums
    /// texel gradients in fixed point, which gives the same bits every time.
    ///
    /// # Errors
    /// When there is no such adapter, or it cannot open a device.
    pub fn new(adapter: &str, deterministic: bool) -> Result<Self> {
        Ok(Self::of(Gpu::open(adapter)?, deterministic))
    }

    /// As [`WgpuBackend::new`], on the adapter number `index` of those that are as good, counted around: one for each rank on a
    /// machine.
    ///
    /// # Errors
    /// As [`WgpuBackend::new`].
    pub fn one_of(adapter: &str, index: usize, deterministic: bool) -> Result<Self> {
        Ok(Self::of(Gpu::open_one_of(adapter, index)?, deterministic))
    }

    /// As [`WgpuBackend::new`], without blocking, for a page in a browser.
    ///
    /// # Errors
    /// As [`WgpuBackend::new`].
    pub async fn new_async(adapter: &str, deterministic: bool) -> Result<Self> {
        Ok(Self::of(Gpu::open_async(adapter).await?, deterministic))
    }

    fn of(gpu: Arc<Gpu>, deterministic: bool) -> Self {
        let addition = match (deterministic, gpu.adds_floats()) {
            (true, _) => Addition::Fixed,
            (false, true) => Addition::Atomic,
            (false, false) => Addition::Exchange,
        };
        Self::with(gpu, addition)
    }

    /// Opens an adapter as [`WgpuBackend::new`] does, but with the given way of adding texel gradients. Returns
    /// `None` if the device does not support it.
    ///
    /// # Errors
    /// When there is no such adapter, or it cannot open a device.
    pub fn adding(adapter: &str, addition: Addition) -> Result<Option<Self>> {
        let gpu = Gpu::open(adapter)?;
        let can = addition != Addition::Atomic || gpu.adds_floats();
        Ok(can.then(|| Self::with(gpu, addition)))
    }

    fn with(gpu: Arc<Gpu>, addition: Addition) -> Self {
        Self {
            gpu,
            addition,
            workspaces: Mutex::default(),
            known: Arc::default(),
            watched: Mutex::default(),
            room: Mutex::new(VIEW_SAMPLES),
        }
    }

    /// Counts of transfers between host and device, and of the host's waits.
    pub fn counts(&self) -> Counts {
        self.gpu.counts()
    }

    /// Measures the peak rates of the device.
    pub fn ceilings(&self) -> Ceilings {
        Ceilings::measure(&self.gpu)
    }

    /// True if the device has the cooperative matrices that `field.precision = "f16"` needs.
    pub fn cooperates(&self) -> bool {
        self.gpu.matrices().is_some()
    }

    /// The way in which texel gradients are added.
    pub fn addition(&self) -> Addition {
        self.addition
    }

    /// Returns a function that destroys the device, as a driver reset does. Tests use it to check what happens then.
    pub fn destroyer(&self) -> impl Fn() + Send + use<> {
        let gpu = Arc::clone(&self.gpu);
        move || gpu.destroy()
    }

    /// Name and driver of the adapter.
    pub fn adapter(&self) -> String {
        self.gpu.name()
    }

    fn with_workspace(&self, field: &WgpuField, work: impl FnOnce(&mut Workspace<Self>)) {
        let mut workspace = self.take_workspace(field);
        work(&mut workspace);
        self.keep_workspace(workspace);
    }

    fn take_workspace(&self, field: &WgpuField) -> Workspace<Self> {
        let pooled = self.workspaces.lock().unwrap_or_else(PoisonError::into_inner).pop();
        pooled.unwrap_or_else(|| Workspace::new(self, field))
    }

    fn keep_workspace(&self, workspace: Workspace<Self>) {
        self.workspaces.lock().unwrap_or_else(PoisonError::into_inner).push(workspace);
    }

    /// The spans of a map over `count` items.
    fn spans(&self, count: u32, per_span: u32) -> Spans {
        let room = *self.room.lock().unwrap_or_else(PoisonError::into_inner);
        let chunk = (per_span as usize * (room / SAMPLES_PER_SPAN).max(1)).min(count as usize);
        let chunk = chunk.min(MOST_AT_FIRST) as u32;
        Spans::new(count, chunk, room)
    }

    /// Copies a span's results into the result array.
    fn gather<T: Pod + Send + Sync>(&self, from: &Buffer<T>, span: Range<u32>, to: &Buffer<T>) {
        let bytes = |values: u32| u64::from(values) * size_of::<T>() as u64;
        self.gpu.copy(from.raw(), 0, to.raw(), bytes(span.start), bytes(span.end - span.start));
    }
}

/// A pending transfer of a step's sums to the host.
pub struct StepReceipt {
    sums: Receipt<u32>,
    exposures: Option<Receipt<u32>>,
    watched: Option<[Receipt<u32>; 2]>,
    rays: u32,
}

impl Backend for WgpuBackend {
    type Buffer<T: Pod + Send + Sync> = Buffer<T>;
    type Lane = Lane;
    type Sums = Sums;
    type Receipt = Option<StepReceipt>;
    type Encoder = WgpuEncoder;
    type Field = WgpuField;
    type Renderer = WgpuRenderer;
    type Optimizer = WgpuOptimizer;
    type Sampler = WgpuSampler;
    type Occupancy = WgpuOccupancy;
    type Loss = WgpuLoss;

    const LAG: usize = 2;
    const RAYS_OF_A_BAND: u32 = 1 << 18;

    fn name(&self) -> &'static str {
        "wgpu"
    }

    fn longest_ray(&self) -> usize {
        if self.gpu.is_software() { SOFTWARE_ROUNDS } else { usize::MAX }
    }

    fn device_name(&self) -> String {
        self.gpu.name()
    }

    fn notes(&self, config: &Config) -> Vec<String> {
        match config.field.precision {
            Precision::F32 => Vec::new(),
            Precision::F16 if self.gpu.matrices().is_some() => {
                match self.known.overflows.load(Ordering::Relaxed) {
                    0 => Vec::new(),
                    count => vec![format!(
                        "field.precision = \"f16\": {count} numbers were too large for f16, the run goes on in f32"
                    )],
                }
            }
            Precision::F16 => vec![format!(
                "field.precision = \"f16\": {} has no cooperative matrices of f16 with sums of f32, computed in f32",
                self.gpu.name()
            )],
            Precision::Bf16 => {
                vec!["field.precision = \"bf16\" is a CPU's: the GPU computes in f32, or in \"f16\"".into()]
            }
        }
    }

    fn stages(&self, config: &Config, views: Option<ViewSet>) -> Result<Stages<Self>> {
        let layout = Layout::new(config);
        let training = views.is_some();
        let (steps, most) =
            (trimip_core::Space::new(&config.scene).most_steps(config.step_length()) - 2, self.longest_ray());
        if steps > most {
            return Err(Error::input(
                "renderer.steps_per_diagonal",
                format!("{steps}, and {} follows a ray for {most} samples", self.gpu.name()),
                "use fewer steps, or backend = \"cpu\"",
            ));
        }
        let binding = self.gpu.limits().max_storage_buffer_binding_size;
        let (room, kept_room) = rooms(config, training, binding);
        if room < LEAST_ROOM {
            return Err(Error::input(
                "field.hidden",
                format!(
                    "{} wide, {room} samples fit into the {binding} bytes that the device binds at once",
                    config.field.hidden
                ),
                format!(
                    "use a smaller field.hidden (a ray may have {LEAST_ROOM} samples), or backend = \"cpu\""
                ),
            ));
        }
        *self.room.lock().unwrap_or_else(PoisonError::into_inner) = room;
        let gpu = &self.gpu;
        let occupancy = WgpuOccupancy::new(gpu, config, training, room, Arc::clone(&self.known));
        self.known.overflows.store(0, Ordering::Relaxed);
        let field = WgpuField::new(gpu, config, &layout, Arc::clone(&self.known));
        *self.watched.lock().unwrap_or_else(PoisonError::into_inner) =
            Some([occupancy.state().raw().clone(), field.overflows().raw().clone()]);
        let skipped = Buffer::zeros(gpu, 1);
        let stages = Stages {
            encoder: WgpuEncoder::new(gpu, config, training, self.addition, &skipped),
            field,
            renderer: WgpuRenderer::new(gpu, config, training, [room, kept_room]),
            optimizer: WgpuOptimizer::new(gpu, config, &layout, training, skipped),
            sampler: WgpuSampler::new(gpu, config, views)?,
            occupancy,
            loss: WgpuLoss::new(gpu, config),
        };
        gpu.submit();
        gpu.check("building the stages")?;
        Ok(stages)
    }

    fn lane(&self) -> Lane {
        Lane::new(&self.gpu)
    }

    fn zeros<T: Pod + Send + Sync>(&self, length: usize) -> Buffer<T> {
        Buffer::zeros(&self.gpu, length)
    }

    fn write<T: Pod + Send + Sync>(&self, buffer: &mut Buffer<T>, values: &[T]) {
        buffer.write(values);
    }

    fn read<T: Pod + Send + Sync>(&self, buffer: &Buffer<T>) -> Vec<T> {
        buffer.read()
    }

    async fn read_async<T: Pod + Send + Sync>(&self, buffer: &Buffer<T>) -> Vec<T> {
        buffer.read_async().await
    }

    fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        work()
    }

    fn train_spans(
        &self,
        field: &WgpuField,
        batch: &Batch<'_>,
        deposits: &mut [Deposit<Self>],
        work: &TrainWork<'_, Self>,
    ) {
        let Some(deposit) = deposits.first_mut() else { return };
        self.with_workspace(field, |workspace| {
            work(workspace, deposit, batch.share.part(batch.draw.pixels()))
        });
    }

    fn map_spans<T: Pod + Send + Sync>(
        &self,
        field: &WgpuField,
        tiling: Tiling,
        out: &mut Buffer<T>,
        work: &(dyn Fn(&mut Workspace<Self>, Range<u32>) + Sync),
        result: &(dyn Fn(&Workspace<Self>) -> &Buffer<T> + Sync),
    ) {
        out.resize(tiling.count as usize);
        let mut spans = self.spans(tiling.count, tiling.per_tile);
        self.with_workspace(field, |workspace| {
            while let Some(span) = spans.next() {
                workspace.lane.marched = false;
                work(workspace, span.clone());
                let marched = workspace.lane.marched;
                if spans.fits(&span, marched.then(|| workspace.samples.counts.read())) {
                    self.gather(result(workspace), span, out);
                }
            }
        });
    }

    async fn map_spans_async<T: Pod + Send + Sync>(
        &self,
        field: &WgpuField,
        tiling: Tiling,
        out: &mut Buffer<T>,
        work: &(dyn Fn(&mut Workspace<Self>, Range<u32>) + Sync),
        result: &(dyn Fn(&Workspace<Self>) -> &Buffer<T> + Sync),
    ) {
        out.resize(tiling.count as usize);
        let mut spans = self.spans(tiling.count, tiling.per_tile);
        let mut workspace = self.take_workspace(field);
        while let Some(span) = spans.next() {
            workspace.lane.marched = false;
            work(&mut workspace, span.clone());
            let counts = match workspace.lane.marched {
                true => Some(workspace.samples.counts.read_async().await),
                false => None,
            };
            if spans.fits(&span, counts) {
                self.gather(result(&workspace), span, out);
            }
        }
        self.keep_workspace(workspace);
    }

    fn weight(&self, deposits: &[Deposit<Self>]) -> f64 {
        let sums = deposits.iter().find_map(|deposit| deposit.sums.0.as_ref());
        sums.map_or(0.0, |sums| self.gpu.redeem(self.gpu.send::<f32>(&sums.buffer, WEIGHT_AT, 1))[0].into())
    }

    fn set_weight(&self, deposits: &mut [Deposit<Self>], weight: f64) {
        if let Some(sums) = deposits.iter().find_map(|deposit| deposit.sums.0.as_ref()) {
            self.gpu.write_at(&sums.buffer, WEIGHT_AT, &[weight as f32]);
        }
    }

    fn deposits(&self, _: u32) -> usize {
        1
    }

    fn post(&self, deposits: &[Deposit<Self>]) -> Option<StepReceipt> {
        let sums = deposits.iter().find_map(|deposit| deposit.sums.0.as_ref())?;
        let watched = self.watched.lock().unwrap_or_else(PoisonError::into_inner);
        Some(StepReceipt {
            sums: self.gpu.send(&sums.buffer, 0, 8),
            exposures: sums.exposures.as_ref().map(|(buffer, photographs)| {
                self.gpu.send(buffer, (4 * GAIN_WORDS * photographs) as u64, SUM_WORDS * photographs)
            }),
            watched: watched.as_ref().map(|[grid, field]| {
                [self.gpu.send(grid, u64::from(4 * OCCUPIED_AT), 1), self.gpu.send(field, 0, 1)]
            }),
            rays: sums.rays,
        })
    }

    fn submit(&self) {
        self.gpu.submit();
    }

    fn redeem(&self, receipt: Option<StepReceipt>) -> Result<StepResult> {
        let Some(StepReceipt { sums, exposures, watched, rays }) = receipt else {
            return Ok(StepResult::default());
        };
        let words = self.gpu.redeem(sums);
        let exposures = exposures.map(|exposures| self.gpu.redeem(exposures)).unwrap_or_default();
        if let Some([occupied, overflows]) = watched {
            self.known.occupied.store(self.gpu.redeem(occupied)[0].into(), Ordering::Relaxed);
            self.known.overflows.store(self.gpu.redeem(overflows)[0].into(), Ordering::Relaxed);
        }
        self.gpu.check("a training step")?;
        let float = |i: usize| f64::from(f32::from_bits(words[i]));
        let sums = StepSums {
            loss: float(0),
            weight: float(1),
            squared_error: float(2),
            rays: rays.into(),
            marched: (words[4] + words[6]).into(),
            kept: words[5].into(),
            non_finite: float(3) as u64,
        };
        Ok(StepResult { sums, exposures: sums_of(&exposures) })
    }

    fn health(&self) -> Result<()> {
        self.gpu.check("reading the model back")
    }
}
