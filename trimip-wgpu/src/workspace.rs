//! The backend as its stages see it: its device, its pool of workspaces, and the scratch memory of a workspace.

use crate::capacity::VIEW_SAMPLES;
use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::{Bind, Buffer, Ceilings, Counts, GRID, GROUP, Gpu, Kernel, Pipeline, Size, Source};
use bytemuck::Pod;
use std::collections::HashMap;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex};
use trimip_core::Result;
use trimip_core::engine::batch::{Segment, Workspace};

/// A GPU device with its workspaces and counters.
pub struct WgpuBackend {
    pub(crate) gpu: Arc<Gpu>,
    pub(crate) addition: Addition,
    pub(crate) workspaces: Mutex<Vec<Workspace<Self>>>,
    pub(crate) counters: Arc<DeviceCounters>,
    /// Counters of the occupancy grid and of the field of the model in training. They are read together with a step's
    /// sums.
    pub(crate) watched: Mutex<Option<[wgpu::Buffer; 2]>>,
    /// Number of samples that fit into the arrays of a tile.
    pub(crate) capacity: Mutex<usize>,
}

/// Last values of the device's counters that the host has read.
#[derive(Default)]
pub struct DeviceCounters {
    /// Number of occupied cells.
    pub occupied: AtomicU64,
    /// Number of factors that f16 cannot hold.
    pub overflows: AtomicU64,
}

/// Scratch memory of a workspace.
pub struct Stream {
    gpu: Arc<Gpu>,
    gather: Pipeline,
    /// Counter for a number of rows that the host has determined.
    pub(crate) count: Buffer<u32>,
    pub(crate) bits: Buffer<u32>,
    pub(crate) blocks: Buffer<u32>,
    pub(crate) old_segments: Buffer<Segment>,
    pub(crate) marks: Buffer<u32>,
    /// For hybrid rendering: 1 for each ray whose samples the proxy chooses, 0 for each ray that is too wide.
    pub(crate) sure: Buffer<u32>,
    pub(crate) sums: Buffer<f32>,
    /// Destination arrays for gathered rows, by row width in words and the capacity of the arrays that they are swapped with.
    spares: HashMap<(usize, Capacity), Buffer<u32>>,
    /// True if rays were marched, so that samples may have been dropped for lack of room.
    pub(crate) marched: bool,
}

/// The number of samples that an array can hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Capacity {
    /// All marched samples.
    Marched,
    /// The samples that pruning keeps.
    Kept,
}

shared! {
    /// Parameters of the kernel that gathers rows.
    struct Gather as Params {
        /// Number of words of a row.
        width: u32,
        counter: u32,
    }
}

/// Returns the kernel that gathers the rows `kept` of an array.
pub fn gather() -> Kernel {
    let sources = [GRID, Source::of::<Gather>(), Source::Text(include_str!("shaders/gather.wgsl"))];
    Kernel::new("gather", &sources, &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Read)])
}

impl Stream {
    /// Creates scratch memory without contents.
    pub(crate) fn new(gpu: &Arc<Gpu>) -> Self {
        let words = || Buffer::zeros(gpu, 0);
        Self {
            gpu: Arc::clone(gpu),
            gather: gpu.pipeline(gather()),
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

    /// Keeps the rows `kept` of an array and drops all others. The array has a capacity for all marched samples, and its rows
    /// have `width` words each.
    pub(crate) fn keep<T: Pod>(&mut self, kept: &Buffer<u32>, array: &mut Buffer<T>, width: usize) {
        self.keep_in(Capacity::Marched, kept, array, width);
    }

    /// Keeps rows as [`keep`](Self::keep) does, for an array with the given capacity. The array swaps its memory with a spare array.
    /// Each capacity has its own spare arrays; if they were shared, every array would grow to the size of the largest.
    pub(crate) fn keep_in<T: Pod>(
        &mut self,
        capacity: Capacity,
        kept: &Buffer<u32>,
        array: &mut Buffer<T>,
        width: usize,
    ) {
        let spare = self.spares.entry((width, capacity)).or_insert_with(|| Buffer::zeros(&self.gpu, 0));
        let Some((counts, counter)) = kept.counter() else { return };
        let values = width * 4 / size_of::<T>();
        // The spare array gets exactly the size of `array`. If it were larger, the arrays would grow with every swap.
        let words = array.capacity() * size_of::<T>() / 4;
        if spare.capacity() < words {
            *spare = Buffer::zeros(&self.gpu, words);
        }
        spare.count_by(kept.most() * width, counts, counter, width);
        let params = Gather { width: width as u32, counter };
        let counts = Bind::whole(counts);
        let binds = [array.bind(), spare.bind(), kept.bind(), counts];
        let size =
            Size::Counted { counts: counts.buffer, counter, per: width as u32, group: GROUP, times: 1 };
        self.gpu.dispatch(&self.gather, &binds, &params, size);
        array.swap(spare);
        array.count_by(kept.most() * values, counts.buffer, counter, values);
    }
}

impl WgpuBackend {
    /// Opens the adapter whose name contains `adapter`, or the best adapter if `adapter` is empty. If `deterministic`
    /// is true, the gradients of the encoder's parameters are summed in fixed point, which is bit-identical in every
    /// run.
    ///
    /// # Errors
    /// When there is no such adapter, or it cannot open a device.
    pub fn new(adapter: &str, deterministic: bool) -> Result<Self> {
        Ok(Self::of(Gpu::open(adapter)?, deterministic))
    }

    /// Opens an adapter as [`WgpuBackend::new`] does, but selects the one at `index`, modulo their number, among equally good
    /// adapters: one for each rank on a machine.
    ///
    /// # Errors
    /// As [`WgpuBackend::new`].
    pub fn one_of(adapter: &str, index: usize, deterministic: bool) -> Result<Self> {
        Ok(Self::of(Gpu::open_one_of(adapter, index)?, deterministic))
    }

    /// Opens an adapter as [`WgpuBackend::new`] does, without blocking, for a page in a browser.
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

    /// Opens an adapter as [`WgpuBackend::new`] does, but with the given way of adding the gradients of the encoder's
    /// parameters. Returns `None` if the device does not support this way.
    ///
    /// # Errors
    /// When there is no such adapter, or it cannot open a device.
    pub fn adding(adapter: &str, addition: Addition) -> Result<Option<Self>> {
        let gpu = Gpu::open(adapter)?;
        let can = addition != Addition::Atomic || gpu.adds_floats();
        Ok(can.then(|| Self::with(gpu, addition)))
    }

    /// Creates another backend on the same device. The two share compiled kernels and [`counts`](Self::counts), and
    /// nothing else.
    pub fn on_the_same_device(&self) -> Self {
        Self::with(Arc::clone(&self.gpu), self.addition)
    }

    fn with(gpu: Arc<Gpu>, addition: Addition) -> Self {
        Self {
            gpu,
            addition,
            workspaces: Mutex::default(),
            counters: Arc::default(),
            watched: Mutex::default(),
            capacity: Mutex::new(VIEW_SAMPLES),
        }
    }

    /// Returns the counts of transfers between host and device, and of the host's waits.
    pub fn counts(&self) -> Counts {
        self.gpu.counts()
    }

    /// Measures the peak rates of the device.
    pub fn ceilings(&self) -> Ceilings {
        Ceilings::measure(&self.gpu)
    }

    /// Returns true if the device has the cooperative matrices that `field.precision = "f16"` needs.
    pub fn cooperates(&self) -> bool {
        self.gpu.matrices().is_some()
    }

    /// Returns the way in which the gradients of the encoder's parameters are added.
    pub fn addition(&self) -> Addition {
        self.addition
    }

    /// Returns a function that destroys the device, as a driver reset does. Tests use it to check what happens then.
    pub fn destroyer(&self) -> impl Fn() + Send + use<> {
        let gpu = Arc::clone(&self.gpu);
        move || gpu.destroy()
    }

    /// Returns the name and driver of the adapter.
    pub fn adapter(&self) -> String {
        self.gpu.name()
    }
}

/// The way in which the gradients of the encoder's parameters are added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Addition {
    /// 64-bit fixed point: bit-identical in every run.
    Fixed,
    /// Atomic f32 additions, if the device has them: half the memory of fixed point.
    Atomic,
    /// Compare-and-exchange of f32, which every device has: half the memory of fixed point.
    Exchange,
}
