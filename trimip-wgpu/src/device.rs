//! The device: which adapter, with which limits, and the recorder into which a whole step's dispatches go before they are
//! submitted once.

use crate::adapter::{COOPERATION, choose, choose_async, matrices};
use crate::kernel::{Access, Kernel};
use crate::pipelines::Pipelines;
use crate::products::Matrices;
use bytemuck::Pod;
use std::collections::VecDeque;
use std::num::NonZeroU64;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use trimip_core::{Error, Result};

/// Bytes between the parameters of two dispatches: what every device can align to.
const PARAMETERS_STRIDE: usize = 256;

/// Dispatches that fit into a submission; more are submitted in parts.
const DISPATCHES: usize = 2048;

/// Bytes of the sizes of an indirect dispatch.
const SIZES: u64 = 16;

/// Workgroups in a row of a dispatch: what every device takes.
const MOST_GROUPS: u64 = 65_535;

/// Invocations of a workgroup of the kernels that work item by item.
pub const GROUP: u32 = 64;

/// A device, its pipelines and its recorder.
pub struct Gpu {
    pub(crate) device: wgpu::Device,
    queue: wgpu::Queue,
    info: wgpu::AdapterInfo,
    limits: wgpu::Limits,
    matrices: Option<Matrices>,
    pipelines: Pipelines,
    recorder: Mutex<Recorder>,
    pub(crate) counters: Counters,
    /// Why the device went away, or what it refused, first cause first.
    pub(crate) failure: Arc<Mutex<Option<String>>>,
}

/// What is recorded and not yet submitted.
pub(crate) struct Recorder {
    encoder: Option<wgpu::CommandEncoder>,
    /// Parameters of the dispatches, one stride each.
    parameters: Vec<u8>,
    uniforms: wgpu::Buffer,
    /// Sizes of indirect dispatches.
    sizes: wgpu::Buffer,
    indirect: u32,
    /// Number of the submission that is recorded.
    pub number: u64,
    /// The last submissions, newest last.
    pub submitted: VecDeque<(u64, wgpu::SubmissionIndex)>,
}

/// Submissions that are remembered, to wait for one and not for those behind it.
const REMEMBERED: usize = 16;

/// What crossed between host and device, and how often the host waited.
#[derive(Default)]
pub(crate) struct Counters {
    written: AtomicU64,
    pub read: AtomicU64,
    submissions: AtomicU64,
    pub stalls: AtomicU64,
    held: AtomicU64,
    most_held: AtomicU64,
    largest: AtomicU64,
}

/// What the counters stand at.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Bytes of buffers written by the host; parameters of dispatches are none of them.
    pub written: u64,
    /// Bytes read back.
    pub read: u64,
    /// Submissions to the queue.
    pub submissions: u64,
    /// Times that the host waited until the device had nothing left to do.
    pub stalls: u64,
    /// Most bytes that arrays on the device had at once.
    pub most_held: u64,
}

/// A part of a buffer that a kernel sees.
#[derive(Clone, Copy)]
pub struct Bind<'a> {
    /// The buffer.
    pub buffer: &'a wgpu::Buffer,
    /// First byte; a multiple of 256.
    pub offset: u64,
    /// Bytes; `None` for all that follow.
    pub size: Option<u64>,
}

/// How much work a dispatch has.
#[derive(Clone, Copy)]
pub enum Size<'a> {
    /// Invocations, in workgroups of [`GROUP`].
    Items(u64),
    /// Workgroups.
    Groups(u64),
    /// Groups of `group` items for `per` items for each that the device has counted.
    Counted {
        /// Counters on the device.
        counts: &'a wgpu::Buffer,
        /// Which of them.
        counter: u32,
        /// Items of each.
        per: u32,
        /// Items of a workgroup.
        group: u32,
    },
}

impl Gpu {
    /// Opens the adapter whose name contains `name` (case does not matter), or the best one when it is empty.
    ///
    /// # Errors
    /// When there is no such adapter, or it opens no device.
    pub fn open(name: &str) -> Result<Arc<Self>> {
        pollster::block_on(Self::of(choose(name)?))
    }

    /// As [`Gpu::open`], without blocking.
    ///
    /// # Errors
    /// As [`Gpu::open`].
    pub async fn open_async(name: &str) -> Result<Arc<Self>> {
        Self::of(choose_async(name).await?).await
    }

    /// Opens an adapter.
    async fn of(adapter: wgpu::Adapter) -> Result<Arc<Self>> {
        let info = adapter.get_info();
        // All that the adapter has, asked for by name: the default would be the least of all adapters.
        let limits = adapter.limits();
        let matrices = matrices(&adapter);
        let mut wanted = wgpu::Features::SHADER_FLOAT32_ATOMIC | wgpu::Features::TIMESTAMP_QUERY;
        if matrices.is_some() {
            wanted |= COOPERATION;
        }
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("trimip"),
            required_features: adapter.features() & wanted,
            required_limits: limits.clone(),
            // SAFETY: cooperative matrices alone are asked for; every load and store of them lies within its array, whose
            // rows end with a whole block.
            experimental_features: unsafe { wgpu::ExperimentalFeatures::enabled() },
            ..Default::default()
        };
        let (device, queue) = adapter
            .request_device(&descriptor)
            .await
            .map_err(|error| Error::device(format!("`{}` opens no device: {error}", info.name)))?;
        let failure = Arc::new(Mutex::new(None));
        let note = |failure: &Arc<Mutex<Option<String>>>| {
            let failure = Arc::clone(failure);
            move |message: String| {
                lock(&failure).get_or_insert(message);
            }
        };
        let refused = note(&failure);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| refused(error.to_string())));
        // The loss is the cause of whatever else was refused.
        let lost = Arc::clone(&failure);
        device.set_device_lost_callback(move |reason, message| {
            *lock(&lost) = Some(format!("the device was lost ({reason:?}): {message}"));
        });
        let buffer = |label, size, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage,
                mapped_at_creation: false,
            })
        };
        let recorder = Recorder {
            encoder: None,
            parameters: Vec::new(),
            uniforms: buffer(
                "parameters",
                (DISPATCHES * PARAMETERS_STRIDE) as u64,
                wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            ),
            sizes: buffer(
                "sizes",
                DISPATCHES as u64 * SIZES,
                wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::INDIRECT,
            ),
            indirect: 0,
            number: 0,
            submitted: VecDeque::new(),
        };
        Ok(Arc::new(Self {
            pipelines: Pipelines::new(device.clone()),
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

    /// The adapter's name and driver.
    pub fn name(&self) -> String {
        format!("{} ({:?}, {})", self.info.name, self.info.backend, self.info.driver_info)
    }

    /// True when the device is a processor.
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// True when the device adds f32 atomically.
    pub fn adds_floats(&self) -> bool {
        self.device.features().contains(wgpu::Features::SHADER_FLOAT32_ATOMIC)
    }

    /// Cooperative matrices of f16 with sums of f32, where the device has them.
    pub fn matrices(&self) -> Option<Matrices> {
        self.matrices
    }

    /// The device's limits.
    pub fn limits(&self) -> &wgpu::Limits {
        &self.limits
    }

    /// What the counters stand at.
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

    /// Gives the device up, as a reset of the driver does: everything that follows fails.
    pub fn destroy(&self) {
        self.device.destroy();
    }

    /// A buffer of zeros. Who drops it says so by [`Gpu::released`].
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

    /// A buffer of so many bytes is no longer held.
    pub fn released(&self, bytes: u64) {
        self.counters.held.fetch_sub(bytes, Ordering::Relaxed);
    }

    /// Writes values to the front of a buffer, after all that was recorded before.
    pub fn write<T: Pod>(&self, buffer: &wgpu::Buffer, values: &[T]) {
        self.write_at(buffer, 0, values);
    }

    /// The same at a byte of the buffer, a multiple of 4.
    pub fn write_at<T: Pod>(&self, buffer: &wgpu::Buffer, offset: u64, values: &[T]) {
        if values.is_empty() {
            return;
        }
        self.submit();
        self.queue.write_buffer(buffer, offset, bytemuck::cast_slice(values));
        self.counters.written.fetch_add(size_of_val(values) as u64, Ordering::Relaxed);
    }

    /// Zeroes bytes of a buffer.
    pub fn clear(&self, buffer: &wgpu::Buffer, offset: u64, size: u64) {
        let mut recorder = self.recorder();
        self.encoder(&mut recorder).clear_buffer(buffer, offset, Some(size));
    }

    /// Copies bytes between buffers, from and to the byte given.
    pub fn copy(&self, from: &wgpu::Buffer, first: u64, to: &wgpu::Buffer, place: u64, bytes: u64) {
        let mut recorder = self.recorder();
        self.encoder(&mut recorder).copy_buffer_to_buffer(from, first, to, place, bytes);
    }

    /// Records a kernel with its bindings, in the order of [`Kernel::bindings`], and its parameters.
    pub fn dispatch<P: Pod>(&self, kernel: &Kernel, binds: &[Bind<'_>], parameters: &P, size: Size<'_>) {
        let groups = match size {
            Size::Items(items) => items.div_ceil(GROUP.into()),
            Size::Groups(groups) => groups,
            Size::Counted { .. } => 1,
        };
        if groups == 0 {
            return;
        }
        let mut recorder = self.recorder();
        if recorder.parameters.len() >= (DISPATCHES - 1) * PARAMETERS_STRIDE {
            self.submit_recorder(&mut recorder);
        }
        let indirect = match size {
            Size::Counted { counts, counter, per, group } => {
                let slot = recorder.indirect;
                recorder.indirect += 1;
                let sizes = recorder.sizes.clone();
                let binds = [counts, &sizes].map(|buffer| Bind { buffer, offset: 0, size: None });
                self.record(
                    &mut recorder,
                    &crate::kernel::ARGUMENTS,
                    &binds,
                    &[counter, per, group, slot],
                    Err((1, 1)),
                );
                Some((sizes, u64::from(slot) * SIZES))
            }
            _ => None,
        };
        let size = match &indirect {
            Some((sizes, offset)) => Ok((sizes, *offset)),
            None => Err((groups.min(MOST_GROUPS) as u32, groups.div_ceil(MOST_GROUPS) as u32)),
        };
        self.record(&mut recorder, kernel, binds, parameters, size);
    }

    fn record<P: Pod>(
        &self,
        recorder: &mut Recorder,
        kernel: &Kernel,
        binds: &[Bind<'_>],
        parameters: &P,
        size: std::result::Result<(&wgpu::Buffer, u64), (u32, u32)>,
    ) {
        let pipeline = self.pipelines.of(kernel);
        let offset = recorder.parameters.len();
        recorder.parameters.extend_from_slice(bytemuck::bytes_of(parameters));
        recorder.parameters.resize(offset + PARAMETERS_STRIDE, 0);
        let uniform = wgpu::BufferBinding {
            buffer: &recorder.uniforms,
            offset: 0,
            size: NonZeroU64::new(PARAMETERS_STRIDE as u64),
        };
        // Both are written side by side in this crate, and every kernel runs in the tests.
        let storage = kernel.bindings.iter().filter(|(_, access)| *access != Access::Parameters).count();
        assert_eq!(binds.len(), storage, "{}: bindings", kernel.entry);
        let mut binds = binds.iter();
        let entries: Vec<wgpu::BindGroupEntry<'_>> = kernel
            .bindings
            .iter()
            .filter_map(|&(binding, access)| {
                let resource = match access {
                    Access::Parameters => uniform.clone(),
                    Access::Read | Access::Write => binds.next().map(|bind| wgpu::BufferBinding {
                        buffer: bind.buffer,
                        offset: bind.offset,
                        size: bind.size.and_then(NonZeroU64::new),
                    })?,
                };
                Some(wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::Buffer(resource) })
            })
            .collect();
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(kernel.entry),
            layout: &pipeline.layout,
            entries: &entries,
        });
        let mut pass = self.encoder(recorder).begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(kernel.entry),
            timestamp_writes: None,
        });
        pass.set_pipeline(&pipeline.pipeline);
        pass.set_bind_group(0, &group, &[offset as u32]);
        match size {
            Ok((sizes, offset)) => pass.dispatch_workgroups_indirect(sizes, offset),
            Err((x, y)) => pass.dispatch_workgroups(x, y, 1),
        }
    }

    /// Submits what is recorded.
    pub fn submit(&self) {
        self.submit_recorder(&mut self.recorder());
    }

    pub(crate) fn submit_recorder(&self, recorder: &mut Recorder) {
        let Some(encoder) = recorder.encoder.take() else { return };
        if !recorder.parameters.is_empty() {
            self.queue.write_buffer(&recorder.uniforms, 0, &recorder.parameters);
        }
        let index = self.queue.submit([encoder.finish()]);
        recorder.submitted.push_back((recorder.number, index));
        if recorder.submitted.len() > REMEMBERED {
            recorder.submitted.pop_front();
        }
        recorder.number += 1;
        self.counters.submissions.fetch_add(1, Ordering::Relaxed);
        recorder.parameters.clear();
        recorder.indirect = 0;
    }

    /// Whether anything failed on the device so far.
    ///
    /// # Errors
    /// With the loss of the device, else the first failure; with the stage, the memory in use and the limits.
    pub fn check(&self, stage: &str) -> Result<()> {
        if lock(&self.failure).is_none() {
            return Ok(());
        }
        // A loss is told when the device is polled, after whatever else was refused because of it.
        self.poll(wgpu::PollType::Poll);
        let Some(message) = lock(&self.failure).clone() else { return Ok(()) };
        let mebibytes = |bytes: u64| bytes.div_ceil(1 << 20);
        let at = |counter: &AtomicU64| mebibytes(counter.load(Ordering::Relaxed));
        Err(Error::device(format!(
            "{} failed in {stage}: {message}; {} MiB were in use, the largest buffer had {} MiB and may have {} MiB; if \
             memory was short lower train.samples_per_step or field.hidden, else renew the driver or use backend = \"cpu\"",
            self.name(),
            at(&self.counters.held),
            at(&self.counters.largest),
            mebibytes(self.limits.max_storage_buffer_binding_size.min(self.limits.max_buffer_size)),
        )))
    }

    /// Lets the device answer; false when it failed. wgpu panics where a driver gives its device up while it is waited for:
    /// that panic ends here, as a failure like any other.
    pub(crate) fn poll(&self, how: wgpu::PollType) -> bool {
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

    pub(crate) fn recorder(&self) -> MutexGuard<'_, Recorder> {
        lock(&self.recorder)
    }

    pub(crate) fn encoder<'a>(&self, recorder: &'a mut Recorder) -> &'a mut wgpu::CommandEncoder {
        recorder.encoder.get_or_insert_with(|| self.device.create_command_encoder(&Default::default()))
    }
}

/// A lock; a thread that panicked under it left nothing half done.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
