//! The device: its limits, buffers, transfers and failures. All work goes through its recorder.

use super::adapter::{choose, choose_async, choose_one_of};
use super::bind::{Bind, Size};
use super::kernel::Kernel;
use super::lock::lock;
use super::matrices::{COOPERATION, Matrices};
use super::pipeline::{Pipeline, Pipelines};
use super::recorder::{Recorder, arguments};
use super::shared::Shared;
use bytemuck::Pod;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use trimip_core::{Error, Result};

/// A device, its pipelines and its recorder.
pub struct Gpu {
    pub(super) device: wgpu::Device,
    queue: wgpu::Queue,
    info: wgpu::AdapterInfo,
    limits: wgpu::Limits,
    matrices: Option<Matrices>,
    pipelines: Pipelines,
    recorder: Mutex<Recorder>,
    pub(super) counters: Counters,
    /// The first failure of the device, or the reason why the device was lost.
    pub(super) failure: Arc<Mutex<Option<String>>>,
}

/// Counters of transfers between host and device, and of the host's waits.
#[derive(Default)]
pub(super) struct Counters {
    written: AtomicU64,
    pub read: AtomicU64,
    submissions: AtomicU64,
    pub stalls: AtomicU64,
    held: AtomicU64,
    most_held: AtomicU64,
    largest: AtomicU64,
}

/// Values of the counters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Bytes that the host wrote to buffers, without the parameters of dispatches.
    pub written: u64,
    /// Bytes read back.
    pub read: u64,
    /// Submissions to the queue.
    pub submissions: u64,
    /// Number of times that the host waited until the device was idle.
    pub stalls: u64,
    /// Peak number of bytes held by arrays on the device.
    pub most_held: u64,
}

impl Gpu {
    /// Opens the adapter whose name contains `name` (ignoring case), or the best one if `name` is empty.
    ///
    /// # Errors
    /// When there is no such adapter, or it cannot open a device.
    pub fn open(name: &str) -> Result<Arc<Self>> {
        pollster::block_on(Self::of(choose(name)?))
    }

    /// Opens an adapter as [`Gpu::open`] does, but selects the one at `index`, modulo their number, among equally good
    /// adapters.
    ///
    /// # Errors
    /// As [`Gpu::open`].
    pub fn open_one_of(name: &str, index: usize) -> Result<Arc<Self>> {
        pollster::block_on(Self::of(choose_one_of(name, index)?))
    }

    /// Opens an adapter as [`Gpu::open`] does, without blocking.
    ///
    /// # Errors
    /// As [`Gpu::open`].
    pub async fn open_async(name: &str) -> Result<Arc<Self>> {
        Self::of(choose_async(name).await?).await
    }

    /// Opens an adapter.
    async fn of(adapter: wgpu::Adapter) -> Result<Arc<Self>> {
        let info = adapter.get_info();
        // Requests the adapter's own limits, because the default limits are those of the least capable adapter.
        let limits = adapter.limits();
        let matrices = Matrices::of(&adapter);
        let mut wanted = wgpu::Features::SHADER_FLOAT32_ATOMIC | wgpu::Features::TIMESTAMP_QUERY;
        if matrices.is_some() {
            wanted |= COOPERATION;
        }
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("trimip"),
            required_features: adapter.features() & wanted,
            required_limits: limits.clone(),
            experimental_features: experimental(),
            ..Default::default()
        };
        let (device, queue) = adapter
            .request_device(&descriptor)
            .await
            .map_err(|error| Error::device(format!("cannot open a device on `{}`: {error}", info.name)))?;
        let failure = Arc::new(Mutex::new(None));
        let note = |failure: &Arc<Mutex<Option<String>>>| {
            let failure = Arc::clone(failure);
            move |message: String| {
                lock(&failure).get_or_insert(message);
            }
        };
        let refused = note(&failure);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| refused(error.to_string())));
        // The loss of the device replaces other failures, because it causes them.
        let lost = Arc::clone(&failure);
        device.set_device_lost_callback(move |reason, message| {
            *lock(&lost) = Some(format!("the device was lost ({reason:?}): {message}"));
        });
        let pipelines = Pipelines::default();
        let recorder = Recorder::new(&device, pipelines.of(arguments()));
        Ok(Arc::new(Self {
            pipelines,
            device,
            queue,
            info,
            limits,
            matrices,
            recorder: Mutex::new(recorder),
            counters: Counters::default(),
            failure,
        }))
    }

    /// Returns the name and driver of the adapter.
    pub fn name(&self) -> String {
        format!("{} ({:?}, {})", self.info.name, self.info.backend, self.info.driver_info)
    }

    /// Returns true if the device is a software adapter, which runs on the processor.
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// Returns true if the device supports atomic addition of f32.
    pub fn adds_floats(&self) -> bool {
        self.device.features().contains(wgpu::Features::SHADER_FLOAT32_ATOMIC)
    }

    /// Returns the cooperative matrices with f16 factors and f32 sums, if the device has them.
    pub fn matrices(&self) -> Option<Matrices> {
        self.matrices
    }

    /// Returns the device's limits.
    pub fn limits(&self) -> &wgpu::Limits {
        &self.limits
    }

    /// Returns the values of the counters.
    pub fn counts(&self) -> Counts {
        let at = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let Counters { written, read, submissions, stalls, most_held, .. } = &self.counters;
        Counts {
            written: at(written),
            read: at(read),
            submissions: at(submissions),
            stalls: at(stalls),
            most_held: at(most_held),
        }
    }

    /// Destroys the device, as a driver reset does; all later work fails.
    pub fn destroy(&self) {
        self.device.destroy();
    }

    /// Creates a buffer of zeros. Its owner calls [`Gpu::released`] when dropping it.
    pub fn buffer(&self, label: &str, bytes: u64) -> wgpu::Buffer {
        let Counters { held, most_held, largest, .. } = &self.counters;
        let now = held.fetch_add(bytes, Ordering::Relaxed) + bytes;
        most_held.fetch_max(now, Ordering::Relaxed);
        largest.fetch_max(bytes, Ordering::Relaxed);
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes.next_multiple_of(4).max(16),
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        })
    }

    /// Records that a buffer of `bytes` bytes was released.
    pub fn released(&self, bytes: u64) {
        self.counters.held.fetch_sub(bytes, Ordering::Relaxed);
    }

    /// Writes the bytes of `values` to the front of a buffer, after all work recorded so far.
    pub fn write<T: Pod>(&self, buffer: &wgpu::Buffer, values: &[T]) {
        self.write_at(buffer, 0, values);
    }

    /// Writes values as [`Gpu::write`] does, at a byte offset that is a multiple of 4.
    pub fn write_at<T: Pod>(&self, buffer: &wgpu::Buffer, offset: u64, values: &[T]) {
        if values.is_empty() {
            return;
        }
        self.submit();
        self.queue.write_buffer(buffer, offset, bytemuck::cast_slice(values));
        self.counters.written.fetch_add(size_of_val(values) as u64, Ordering::Relaxed);
    }

    /// Sets a range of bytes of a buffer to zero.
    pub fn clear(&self, buffer: &wgpu::Buffer, offset: u64, size: u64) {
        self.recorder().encoder().clear_buffer(buffer, offset, Some(size));
    }

    /// Copies bytes between buffers, from byte `first` of `from` to byte `place` of `to`.
    pub fn copy(&self, from: &wgpu::Buffer, first: u64, to: &wgpu::Buffer, place: u64, bytes: u64) {
        self.recorder().encoder().copy_buffer_to_buffer(from, first, to, place, bytes);
    }

    /// Returns the pipeline of a kernel. A stage calls this function once per kernel, when the stage is built.
    pub fn pipeline(&self, kernel: Kernel) -> Pipeline {
        self.pipelines.of(kernel)
    }

    /// Records a dispatch with its bindings of buffers, in the order of [`Kernel::bindings`], and its parameters.
    pub fn dispatch<P: Shared>(
        &self,
        pipeline: &Pipeline,
        binds: &[Bind<'_>],
        parameters: &P,
        size: Size<'_>,
    ) {
        if matches!(size, Size::Items(0) | Size::Groups(0)) {
            return;
        }
        let mut recorder = self.recorder();
        if recorder.is_full() {
            self.submit_recorder(&mut recorder);
        }
        recorder.dispatch(pipeline, binds, parameters, size);
    }

    /// Submits all recorded work.
    pub fn submit(&self) {
        self.submit_recorder(&mut self.recorder());
    }

    /// Submits all recorded work as [`Gpu::submit`] does, for a caller that holds the recorder.
    pub(super) fn submit_recorder(&self, recorder: &mut Recorder) {
        let submitted = recorder.submit(&self.queue);
        self.counters.submissions.fetch_add(submitted.into(), Ordering::Relaxed);
    }

    /// Checks whether anything has failed on the device so far.
    ///
    /// # Errors
    /// When the device was lost, or any work failed. The error states the loss or else the first failure, the stage,
    /// the memory in use and the limits.
    pub fn check(&self, stage: &str) -> Result<()> {
        if lock(&self.failure).is_none() {
            return Ok(());
        }
        // A loss is reported only when the device is polled, after the errors that it caused.
        self.poll(wgpu::PollType::Poll);
        let Some(message) = lock(&self.failure).clone() else { return Ok(()) };
        let mebibytes = |bytes: u64| bytes.div_ceil(1 << 20);
        let at = |counter: &AtomicU64| mebibytes(counter.load(Ordering::Relaxed));
        Err(Error::device(format!(
            "{} failed in {stage}: {message}; {} MiB were in use, the largest buffer had {} MiB and may have {} MiB; if \
             memory was short, lower train.samples_per_step or field.hidden, otherwise update the driver or use backend = \"cpu\"",
            self.name(),
            at(&self.counters.held),
            at(&self.counters.largest),
            mebibytes(self.limits.max_storage_buffer_binding_size.min(self.limits.max_buffer_size)),
        )))
    }

    /// Polls the device; returns false if it failed. wgpu panics if a driver loses its device during a wait; this
    /// function catches the panic and records it as an ordinary failure.
    pub(super) fn poll(&self, how: wgpu::PollType) -> bool {
        match catch_unwind(AssertUnwindSafe(|| self.device.poll(how))) {
            Ok(polled) => polled.is_ok(),
            Err(panic) => {
                let told = panic.downcast_ref::<String>().map(String::as_str);
                let message =
                    told.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no reason given");
                lock(&self.failure).get_or_insert_with(|| format!("the device was lost: {message}"));
                false
            }
        }
    }

    /// Locks the recorder.
    pub(super) fn recorder(&self) -> MutexGuard<'_, Recorder> {
        lock(&self.recorder)
    }
}

/// Permits the experimental features that are requested.
#[allow(unsafe_code)] // the only way to have cooperative matrices
fn experimental() -> wgpu::ExperimentalFeatures {
    // SAFETY: cooperative matrices are the only experimental feature that is requested. Every load and store of a
    // matrix stays within its array, because arrays end with a whole block of rows.
    unsafe { wgpu::ExperimentalFeatures::enabled() }
}
