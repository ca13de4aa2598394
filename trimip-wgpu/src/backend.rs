//! The GPU as a backend: all stages record into one submission, a step is one span, and sums are read when they are there.

use crate::buffer::Buffer;
use crate::ceilings::Ceilings;
use crate::device::{Bind, Counts, GROUP, Gpu, Receipt, Size};
use crate::encoder::WgpuEncoder;
use crate::field::{WgpuField, padded};
use crate::kernel::{Addition, GATHERING};
use crate::loss::{Sums, WgpuLoss};
use crate::occupancy::{OCCUPIED_AT, WgpuOccupancy};
use crate::optimizer::WgpuOptimizer;
use crate::renderer::WgpuRenderer;
use crate::rows::BLOCK;
use crate::sampler::WgpuSampler;
use bytemuck::Pod;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use trimip_core::backend::{Stages, TrainWork};
use trimip_core::batch::{Deposit, Segment, StepSums, Workspace};
use trimip_core::config::Precision;
use trimip_core::tri_mip::FEATURES;
use trimip_core::{Backend, Config, Error, Layout, Result, ViewSet};

/// Marched samples that a training step has room for, for each sample it aims to keep.
const MARCHED_PER_AIM: usize = 4;

/// Kept samples that a training step has room for, for each that it aims to keep.
const KEPT_PER_AIM: usize = 2;

/// Rounds after which llvmpipe ends the loops of an invocation, less some for the other loops.
const SOFTWARE_ROUNDS: usize = 60_000;

/// Samples of a span of a view.
const VIEW_SAMPLES: usize = 1 << 20;

/// Samples that a span must have room for: one ray through the whole box.
const LEAST_ROOM: usize = 4096;

/// Marched samples for which a span of the training loop is made.
const SAMPLES_PER_SPAN: usize = 512;

/// A GPU.
pub struct WgpuBackend {
    gpu: Arc<Gpu>,
    addition: Addition,
    workspaces: Mutex<Vec<Workspace<Self>>>,
    known: Arc<Known>,
    /// Counters of the model that is trained, to be read with the sums of a step: the grid's and the field's.
    watched: Mutex<Option<[wgpu::Buffer; 2]>>,
    room: Mutex<usize>,
}

/// Counts on the device as they were last read.
#[derive(Default)]
pub struct Known {
    /// Occupied cells.
    pub occupied: AtomicU64,
    /// Factors that did not fit into f16.
    pub overflows: AtomicU64,
}

/// Scratch of a workspace.
pub struct Lane {
    gpu: Arc<Gpu>,
    /// A number of rows that the host knows.
    pub(crate) count: Buffer<u32>,
    pub(crate) bits: Buffer<u32>,
    pub(crate) blocks: Buffer<u32>,
    pub(crate) old_segments: Buffer<Segment>,
    pub(crate) marks: Buffer<u32>,
    pub(crate) sums: Buffer<f32>,
    /// Arrays that rows are gathered into, by their width in words.
    spares: HashMap<usize, Buffer<u32>>,
    /// Rays were marched: there may have been too little room.
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
            sums: Buffer::zeros(gpu, 0),
            spares: HashMap::new(),
            marched: false,
        }
    }

    /// Lets an array have the rows `kept`, of `width` words each.
    pub(crate) fn keep<T: Pod>(&mut self, kept: &Buffer<u32>, array: &mut Buffer<T>, width: usize) {
        let spare = self.spares.entry(width).or_insert_with(|| Buffer::zeros(&self.gpu, 0));
        let Some((counts, counter)) = kept.counter() else { return };
        let values = width * 4 / size_of::<T>();
        spare.reserve(array.capacity() * size_of::<T>() / 4);
        spare.count_by(kept.most() * width, counts, counter, width);
        let params = [width as u32, counter];
        let counts = Bind { buffer: counts, offset: 0, size: None };
        let binds = [array.bind(), spare.bind(), kept.bind(), counts];
        let size = Size::Counted { counts: counts.buffer, counter, per: width as u32, group: GROUP };
        self.gpu.dispatch(&GATHERING, &binds, &params, size);
        array.swap(spare);
        array.count_by(kept.most() * values, counts.buffer, counter, values);
    }
}

impl WgpuBackend {
    /// The adapter whose name contains `adapter`, or the best one when it is empty. `deterministic` adds texel gradients
    /// in fixed point: the same bits every time.
    ///
    /// # Errors
    /// When there is no such adapter, or it opens no device.
    pub fn new(adapter: &str, deterministic: bool) -> Result<Self> {
        let gpu = Gpu::open(adapter)?;
        let addition = match (deterministic, gpu.adds_floats()) {
            (true, _) => Addition::Fixed,
            (false, true) => Addition::Atomic,
            (false, false) => Addition::Exchange,
        };
        Ok(Self::with(gpu, addition))
    }

    /// The adapter whose name contains `adapter`, adding texel gradients in one of the ways that `deterministic` decides
    /// between; `None` where the device does not have it.
    ///
    /// # Errors
    /// When there is no such adapter, or it opens no device.
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

    /// What crossed between host and device, and how often the host waited.
    pub fn counts(&self) -> Counts {
        self.gpu.counts()
    }

    /// Measures what the device reaches at best.
    pub fn ceilings(&self) -> Ceilings {
        Ceilings::measure(&self.gpu)
    }

    /// True when the device has the cooperative matrices of `field.precision = "f16"`.
    pub fn cooperates(&self) -> bool {
        self.gpu.matrices().is_some()
    }

    /// How texel gradients are added.
    pub fn addition(&self) -> Addition {
        self.addition
    }

    /// Gives the device up when it is called, as a reset of the driver does: for tests of what happens then.
    pub fn loss(&self) -> impl Fn() + Send + use<> {
        let gpu = Arc::clone(&self.gpu);
        move || gpu.destroy()
    }

    /// The adapter's name and driver.
    pub fn adapter(&self) -> String {
        self.gpu.name()
    }

    fn with_workspace(&self, field: &WgpuField, work: impl FnOnce(&mut Workspace<Self>)) {
        let pooled = self.workspaces.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut workspace = pooled.unwrap_or_else(|| Workspace::new(self, field));
        work(&mut workspace);
        self.workspaces.lock().unwrap_or_else(PoisonError::into_inner).push(workspace);
    }
}

/// Samples that a span has room for, and those of them that it has room to keep, on a device that binds at most `binding`
/// bytes at once.
pub fn rooms(config: &Config, training: bool, binding: u64) -> (usize, usize) {
    let widest = (size_of::<f32>() * FEATURES.max(padded(config.field.hidden as usize))) as u64;
    // Whole blocks, as arrays have them.
    let most = usize::try_from(binding / widest).unwrap_or(usize::MAX) / BLOCK * BLOCK;
    let wanted = config.train.samples_per_step as usize;
    let marched = if training { (MARCHED_PER_AIM * wanted).max(LEAST_ROOM) } else { VIEW_SAMPLES }.min(most);
    let kept =
        if training { (KEPT_PER_AIM * wanted).clamp(LEAST_ROOM, marched.max(LEAST_ROOM)) } else { marched };
    (marched, kept.min(marched))
}

/// A step's sums on their way to the host.
pub struct StepReceipt {
    sums: Receipt<u32>,
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
        let (steps, most) = (config.renderer.steps_per_diagonal as usize, self.longest_ray());
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
            loss: WgpuLoss::new(gpu, &config.loss),
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

    fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        work()
    }

    fn train_spans(
        &self,
        field: &WgpuField,
        rays: u32,
        _: u32,
        deposits: &mut [Deposit<Self>],
        work: &TrainWork<'_, Self>,
    ) {
        let Some(deposit) = deposits.first_mut() else { return };
        self.with_workspace(field, |workspace| work(workspace, deposit, 0..rays));
    }

    fn map_spans<T: Pod + Send + Sync>(
        &self,
        field: &WgpuField,
        count: u32,
        per_span: u32,
        out: &mut Buffer<T>,
        work: &(dyn Fn(&mut Workspace<Self>, Range<u32>) + Sync),
        result: &(dyn Fn(&Workspace<Self>) -> &Buffer<T> + Sync),
    ) {
        out.resize(count as usize);
        let room = *self.room.lock().unwrap_or_else(PoisonError::into_inner);
        let mut chunk = (per_span as usize * (room / SAMPLES_PER_SPAN).max(1)).min(count as usize) as u32;
        self.with_workspace(field, |workspace| {
            let mut start = 0;
            while start < count {
                let span = chunk.clamp(1, count - start);
                workspace.lane.marched = false;
                work(workspace, start..start + span);
                if workspace.lane.marched {
                    let counts = workspace.samples.counts.read();
                    let (marched, dropped) = (counts[0][0], counts[1][0] + counts[1][1]);
                    if dropped > 0 && span > 1 {
                        chunk = span / 2;
                        continue;
                    }
                    let mean = (marched as usize / span as usize).max(1);
                    // A view's next rows may hold more than its last.
                    chunk = (room / mean / 2).min(1 << 20) as u32;
                }
                let bytes = |values: u32| u64::from(values) * size_of::<T>() as u64;
                self.gpu.copy(result(workspace).raw(), 0, out.raw(), bytes(start), bytes(span));
                start += span;
            }
        });
    }

    fn deposits(&self, _: u32) -> usize {
        1
    }

    fn post(&self, deposits: &[Deposit<Self>]) -> Option<StepReceipt> {
        let sums = deposits.iter().find_map(|deposit| deposit.sums.0.as_ref())?;
        let watched = self.watched.lock().unwrap_or_else(PoisonError::into_inner);
        Some(StepReceipt {
            sums: self.gpu.send(&sums.buffer, 0, 8),
            watched: watched.as_ref().map(|[grid, field]| {
                [self.gpu.send(grid, u64::from(4 * OCCUPIED_AT), 1), self.gpu.send(field, 0, 1)]
            }),
            rays: sums.rays,
        })
    }

    fn submit(&self) {
        self.gpu.submit();
    }

    fn redeem(&self, receipt: Option<StepReceipt>) -> Result<StepSums> {
        let Some(StepReceipt { sums, watched, rays }) = receipt else { return Ok(StepSums::default()) };
        let words = self.gpu.redeem(sums);
        if let Some([occupied, overflows]) = watched {
            self.known.occupied.store(self.gpu.redeem(occupied)[0].into(), Ordering::Relaxed);
            self.known.overflows.store(self.gpu.redeem(overflows)[0].into(), Ordering::Relaxed);
        }
        self.gpu.check("a training step")?;
        let float = |i: usize| f64::from(f32::from_bits(words[i]));
        Ok(StepSums {
            loss: float(0),
            weight: float(1),
            squared_error: float(2),
            rays: rays.into(),
            marched: (words[4] + words[6]).into(),
            kept: words[5].into(),
            non_finite: float(3) as u64,
        })
    }

    fn health(&self) -> Result<()> {
        self.gpu.check("reading the model back")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Arrays end with whole blocks of rows, and these too have to lie within what the device binds.
    #[test]
    fn rooms_fit_a_binding() {
        let mut config = Config::default();
        for binding in [128 << 20, (1 << 31) - 4, u64::from(u32::MAX)] {
            for hidden in (16..=512).step_by(16) {
                config.field.hidden = hidden;
                for (samples, training) in [(262_144, true), (1 << 20, true), (1024, false)] {
                    config.train.samples_per_step = samples;
                    let (marched, kept) = rooms(&config, training, binding);
                    let bytes = marched.next_multiple_of(BLOCK) * padded(hidden as usize).max(FEATURES) * 4;
                    assert!(bytes as u64 <= binding && kept <= marched, "{hidden} {samples} {binding}");
                }
            }
        }
    }
}
