//! The recorder collects the dispatches of a whole step for a single submission, together with their parameters and the
//! arguments of dispatches whose size is stored on the device.

use super::bind::{Bind, MOST_GROUPS, Size};
use super::kernel::Access::{self, Parameters, Read, Write};
use super::kernel::{GROUP, Kernel};
use super::pipeline::{MOST_BINDINGS, Pipeline};
use super::shared::Shared;
use super::source::Source;
use std::array::from_fn;
use std::collections::VecDeque;
use std::num::NonZeroU64;

/// Bytes from the parameters of one dispatch to those of the next: an alignment that every device supports.
const PARAMETERS_STRIDE: usize = 512;

/// Maximum number of dispatches per submission. Longer work is submitted in several parts.
const DISPATCHES: usize = 2048;

/// Bytes of the arguments of an indirect dispatch.
const SIZES: u64 = 16;

/// Number of submissions that are remembered, so that the host can wait for one of them without waiting for later
/// submissions.
const REMEMBERED: usize = 16;

shared! {
    /// Parameters of the kernel that computes the arguments of an indirect dispatch.
    struct Arguments as Params {
        /// The number of items is counts[counter] · per. For every `group` items there are `times` workgroups.
        counter: u32,
        per: u32,
        group: u32,
        times: u32,
        /// Index of the dispatch.
        slot: u32,
    }
}

/// Returns the kernel that computes the arguments of an indirect dispatch.
pub fn arguments() -> Kernel {
    let sources = [
        Source::of::<Arguments>(),
        Source::whole("MOST_GROUPS", MOST_GROUPS),
        Source::whole("SIZE_WORDS", (SIZES / 4) as u32),
        Source::Text(include_str!("shaders/arguments.wgsl")),
    ];
    Kernel::new("size", &sources, &[(0, Read), (1, Write), (2, Parameters)])
}

/// Work that is recorded and not yet submitted.
pub struct Recorder {
    device: wgpu::Device,
    encoder: Option<wgpu::CommandEncoder>,
    /// The pass of the latest dispatches. It ends before the encoder records anything else.
    pass: Option<wgpu::ComputePass<'static>>,
    /// Parameters of the recorded dispatches, [`PARAMETERS_STRIDE`] bytes each.
    parameters: Vec<u8>,
    uniforms: wgpu::Buffer,
    /// Arguments of indirect dispatches.
    sizes: wgpu::Buffer,
    indirect: u32,
    arguments: Pipeline,
    /// Number of the submission that is being recorded.
    pub number: u64,
    /// The latest submissions, newest last.
    pub submitted: VecDeque<(u64, wgpu::SubmissionIndex)>,
}

/// Numbers of workgroups of a dispatch.
enum Groups {
    /// Numbers along x and y.
    Direct(u32, u32),
    /// Numbers on the device: byte offset of the arguments.
    Indirect(u64),
}

impl Recorder {
    /// Creates a recorder without work.
    pub fn new(device: &wgpu::Device, arguments: Pipeline) -> Self {
        let buffer = |label, size, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage,
                mapped_at_creation: false,
            })
        };
        Self {
            device: device.clone(),
            encoder: None,
            pass: None,
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
            arguments,
            number: 0,
            submitted: VecDeque::new(),
        }
    }

    /// Ends the pass of the latest dispatches and returns the command encoder; creates it if there is none.
    pub fn encoder(&mut self) -> &mut wgpu::CommandEncoder {
        self.pass = None;
        self.encoder.get_or_insert_with(|| self.device.create_command_encoder(&Default::default()))
    }

    /// Returns true if there is no room for another dispatch.
    pub fn is_full(&self) -> bool {
        self.parameters.len() >= (DISPATCHES - 1) * PARAMETERS_STRIDE
    }

    /// Records a dispatch with its bindings, in the order of [`Kernel::bindings`], and its parameters.
    pub fn dispatch<P: Shared>(
        &mut self,
        pipeline: &Pipeline,
        binds: &[Bind<'_>],
        parameters: &P,
        size: Size<'_>,
    ) {
        let direct = |groups: u64| {
            let most = u64::from(MOST_GROUPS);
            Groups::Direct(groups.min(most) as u32, groups.div_ceil(most) as u32)
        };
        let groups = match size {
            Size::Items(items) => direct(items.div_ceil(GROUP.into())),
            Size::Groups(groups) => direct(groups),
            Size::Counted { counts, counter, per, group, times } => {
                let slot = self.indirect;
                self.indirect += 1;
                let (sizes, arguments) = (self.sizes.clone(), self.arguments.clone());
                let params = Arguments { counter, per, group, times, slot };
                let binds = [counts, &sizes].map(Bind::whole);
                self.record(&arguments, &binds, &params, Groups::Direct(1, 1));
                Groups::Indirect(u64::from(slot) * SIZES)
            }
        };
        self.record(pipeline, binds, parameters, groups);
    }

    fn record<P: Shared>(&mut self, pipeline: &Pipeline, binds: &[Bind<'_>], parameters: &P, groups: Groups) {
        // A kernel and its calls are next to each other in this crate, and the tests run every kernel, so these
        // assertions hold.
        assert_eq!(binds.len(), pipeline.buffers(), "{}: bindings", pipeline.entry());
        debug_assert!(pipeline.has_layout(&P::LAYOUT), "{}: parameters", pipeline.entry());
        let offset = self.parameters.len();
        self.parameters.extend_from_slice(bytemuck::bytes_of(parameters));
        self.parameters.resize(offset + PARAMETERS_STRIDE, 0);
        let uniform = wgpu::BufferBinding {
            buffer: &self.uniforms,
            offset: 0,
            size: NonZeroU64::new(PARAMETERS_STRIDE as u64),
        };
        let mut binds = binds.iter();
        let mut resource = |access: Access| {
            let bind = if access == Parameters { None } else { binds.next() };
            bind.map_or_else(
                || uniform.clone(),
                |bind| wgpu::BufferBinding {
                    buffer: bind.buffer,
                    offset: bind.offset,
                    size: bind.size.and_then(NonZeroU64::new),
                },
            )
        };
        let bindings = pipeline.bindings();
        let entries: [wgpu::BindGroupEntry<'_>; MOST_BINDINGS] = from_fn(|i| {
            // Entries beyond the bindings are not used.
            let (binding, access) = bindings.get(i).copied().unwrap_or((0, Parameters));
            wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::Buffer(resource(access)) }
        });
        let compiled = pipeline.compiled(&self.device);
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(pipeline.entry()),
            layout: &compiled.layout,
            entries: &entries[..bindings.len()],
        });
        if self.pass.is_none() {
            let pass = self.encoder().begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            self.pass = Some(pass.forget_lifetime());
        }
        let Some(pass) = &mut self.pass else { return };
        pass.set_pipeline(&compiled.pipeline);
        pass.set_bind_group(0, &group, &[offset as u32]);
        match groups {
            Groups::Direct(x, y) => pass.dispatch_workgroups(x, y, 1),
            Groups::Indirect(offset) => pass.dispatch_workgroups_indirect(&self.sizes, offset),
        }
    }

    /// Submits the recorded work. Returns false if there is none.
    pub fn submit(&mut self, queue: &wgpu::Queue) -> bool {
        self.pass = None;
        let Some(encoder) = self.encoder.take() else { return false };
        if !self.parameters.is_empty() {
            queue.write_buffer(&self.uniforms, 0, &self.parameters);
        }
        let index = queue.submit([encoder.finish()]);
        self.submitted.push_back((self.number, index));
        if self.submitted.len() > REMEMBERED {
            self.submitted.pop_front();
        }
        self.number += 1;
        self.parameters.clear();
        self.indirect = 0;
        true
    }
}
