//! The device: the choice of adapter and limits, and the recorder that collects the dispatches of a whole step for a
//! single submission.

use crate::adapter::{COOPERATION, choose, choose_async, choose_one_of, matrices};
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

/// Bytes between the parameters of two dispatches: an alignment that every device supports.
const PARAMETERS_STRIDE: usize = 256;

/// Dispatches per submission. More are submitted in several parts.
const DISPATCHES: usize = 2048;

/// Bytes of the arguments of an indirect dispatch.
const SIZES: u64 = 16;

/// Maximum number of workgroups along x; every device supports it.
const MOST_GROUPS: u64 = 65_535;

/// Workgroup size of the kernels that work item by item.
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
    /// The reason why the device was lost or refused work; the first cause is kept.
    pub(crate) failure: Arc<Mutex<Option<String>>>,
}

/// Work that is recorded and not yet submitted.
pub(crate) struct Recorder {
    encoder: Option<wgpu::CommandEncoder>,
    /// Parameters of the dispatches, one per stride.
    parameters: Vec<u8>,
    uniforms: wgpu::Buffer,
    /// Arguments of indirect dispatches.
    sizes: wgpu::Buffer,
    indirect: u32,
    /// Number of the submission being recorded.
    pub number: u64,
    /// The latest submissions, newest last.
    pub submitted: VecDeque<(u64, wgpu::SubmissionIndex)>,
}

/// Number of submissions that are remembered, so that the host can wait for one without waiting for later ones.
const REMEMBERED: usize = 16;

/// Counters of transfers between host and device, and of the host's waits.
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

/// Values of the counters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Bytes that the host wrote to buffers, without the parameters of dispatches.
    pub written: u64,
    /// Bytes read back.
    pub read: u64,
    /// Submissions to the queue.
    pub submissions: u64,
    /// Times that the host waited until the device was idle.
    pub stalls: u64,
    /// Peak number of bytes held by arrays on the device.
    pub most_held: u64,
}

/// A part of a buffer, bound to a kernel.
#[derive(Clone, Copy)]
pub struct Bind<'a> {
    /// The buffer.
    pub buffer: &'a wgpu::Buffer,
    /// Offset in bytes; a multiple of 256.
    pub offset: u64,
    /// Size in bytes; `None` for the rest of the buffer.
    pub size: Option<u64>,
}

/// The amount of work of a dispatch.
#[derive(Clone, Copy)]
pub enum Size<'a> {
    /// Number of invocations, in workgroups of [`GROUP`].
    Items(u64),
    /// Number of workgroups.
    Groups(u64),
    /// A count on the device times `per` items, `times` workgroups for every `group` items.
    Counted {
        /// Counters on the device.
        counts: &'a wgpu::Buffer,
        /// Index of the counter.
        counter: u32,
        /// Items per count.
        per: u32,
        /// Items that a workgroup covers.
        group: u32,
        /// Workgroups that cover the same items.
        times: u32,
    },
}

impl Gpu {
    /// Opens the adapter whose name contains `name` (ignoring case), or the best one if `name` is empty.
    ///
    /// # Errors
    /// When there is no such adapter, or it cannot open a device.
    pub fn open(name: &str) -> Result<Arc<Self>> {
        pollster::block_on(Self::of(choose(name)?))
    }

    /// As [`Gpu::open`], but the adapter number `index` of those that are as good, counted around.
    ///
    /// # Errors
    /// As [`Gpu::open`].
    pub fn open_one_of(name: &str, index: usize) -> Result<Arc<Self>> {
        pollster::block_on(Self::of(choose_one_of(name, index)?))
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
        // Requests the adapter's own limits: the defaults are those of the least capable adapter.
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
            experimental_features: experimental(),
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
        // A lost device is the cause of everything that was refused after it.
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

    /// Name and driver of the adapter.
    pub fn name(&self) -> String {
        format!("{} ({:?}, {})", self.info.name, self.info.backend, self.info.driver_info)
    }

    /// True if the device is a software adapter, which runs on the processor.
    pub fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// True if the device supports atomic addition of f32.
    pub fn adds_floats(&self) -> bool {
        self.device.features().contains(wgpu::Features::SHADER_FLOAT32_ATOMIC)
    }

    /// Cooperative matrices with f16 factors and f32 sums, if the device has them.
    pub fn matrices(&self) -> Option<Matrices> {
        self.matrices
    }

    /// The device's limits.
    pub fn limits(&self) -> &wgpu::Limits {
        &self.limits
    }

    /// Values of the counters.
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

    /// Destroys the device, as a driver reset does; everything afterwards fails.
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

    /// Writes values to the front of a buffer, after all work recorded so far.
    pub fn write<T: Pod>(&self, buffer: &wgpu::Buffer, values: &[T]) {
        self.write_at(buffer, 0, values);
    }

    /// As [`Gpu::write`], at a byte offset that is a multiple of 4.
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
        let mut recorder = self.recorder();
        self.encoder(&mut recorder).clear_buffer(buffer, offset, Some(size));
    }

    /// Copies bytes between buffers, from byte `first` of `from` to byte `place` of `to`.
    pub fn copy(&self, from: &wgpu::Buffer, first: u64, to: &wgpu::Buffer, place: u64, bytes: u64) {
        let mut recorder = self.recorder();
        self.encoder(&mut recorder).copy_buffer_to_buffer(from, first, to, place, bytes);
    }

    /// Records a dispatch of a kernel with its bindings, in the order of [`Kernel::bindings`], and its parameters.
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
            Size::Counted { counts, counter, per, group, times } => {
                let slot = recorder.indirect;
                recorder.indirect += 1;
                let sizes = recorder.sizes.clone();
                let binds = [counts, &sizes].map(|buffer| Bind { buffer, offset: 0, size: None });
                self.record(
                    &mut recorder,
                    &crate::kernel::ARGUMENTS,
                    &binds,
                    &[counter, per, group, times, slot],
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
        // Kernel and call are written side by side in this crate, and every kernel runs in the tests.
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

    /// Submits all recorded work.
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

    /// Checks whether anything has failed on the device so far.
    ///
    /// # Errors
    /// Reports the loss of the device or else the first failure, with the stage, the memory in use and the limits.
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
             memory was short lower train.samples_per_step or field.hidden, else renew the driver or use backend = \"cpu\"",
            self.name(),
            at(&self.counters.held),
            at(&self.counters.largest),
            mebibytes(self.limits.max_storage_buffer_binding_size.min(self.limits.max_buffer_size)),
        )))
    }

    /// Polls the device; returns false if it failed. wgpu panics if a driver loses its device during a wait; this
    /// catches the panic and records it as an ordinary failure.
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

/// Locks a mutex. A poisoned mutex is used as it is: no thread leaves its data half changed.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Leave for the experimental features that are requested.
#[allow(unsafe_code)] // the only way to have cooperative matrices
fn experimental() -> wgpu::ExperimentalFeatures {
    // SAFETY: of the experimental features, only cooperative matrices are requested. Every load and store of them stays
    // within its array, because arrays end with a whole block of rows.
    unsafe { wgpu::ExperimentalFeatures::enabled() }
}
