//! Compute pipelines. A stage looks up the pipelines of its kernels once, when the stage is built. Each pipeline is
//! compiled at its first dispatch.

use super::bind::MOST_BUFFERS;
use super::kernel::{Access, Kernel};
use super::lock::lock;
use super::shared::Layout;
use std::sync::{Arc, Mutex, OnceLock};

/// Maximum number of bindings of a kernel: its buffers and its parameters.
pub const MOST_BINDINGS: usize = MOST_BUFFERS + 1;

/// A kernel on a device.
#[derive(Clone)]
pub struct Pipeline(Arc<Prepared>);

struct Prepared {
    kernel: Kernel,
    /// Number of bindings of buffers.
    buffers: usize,
    compiled: OnceLock<Compiled>,
}

/// A compiled kernel and the layout of its bindings.
pub struct Compiled {
    /// The compute pipeline.
    pub pipeline: wgpu::ComputePipeline,
    /// The layout of its bindings.
    pub layout: wgpu::BindGroupLayout,
}

impl Pipeline {
    /// Creates a pipeline that is not compiled yet.
    pub fn new(kernel: Kernel) -> Self {
        let buffers = kernel.bindings().iter().filter(|(_, access)| *access != Access::Parameters).count();
        Self(Arc::new(Prepared { kernel, buffers, compiled: OnceLock::new() }))
    }

    /// Returns the name of the entry point.
    pub fn entry(&self) -> &'static str {
        self.0.kernel.entry
    }

    /// Returns the binding numbers and their access, in order.
    pub fn bindings(&self) -> &[(u32, Access)] {
        self.0.kernel.bindings()
    }

    /// Returns the number of bindings of buffers.
    pub fn buffers(&self) -> usize {
        self.0.buffers
    }

    /// Returns true if the kernel's WGSL has a struct of this layout.
    pub fn has_layout(&self, layout: &Layout) -> bool {
        self.0.kernel.layouts().any(|own| own == layout)
    }

    /// Returns the compiled kernel. The first call compiles it.
    pub fn compiled(&self, device: &wgpu::Device) -> &Compiled {
        self.0.compiled.get_or_init(|| compile(device, &self.0.kernel))
    }
}

/// The pipelines of a device. Equal kernels share a pipeline, so that they are compiled only once.
#[derive(Default)]
pub struct Pipelines(Mutex<Vec<Pipeline>>);

impl Pipelines {
    /// Returns the pipeline of a kernel, and creates it if no equal kernel has one.
    pub fn of(&self, kernel: Kernel) -> Pipeline {
        let mut all = lock(&self.0);
        if let Some(same) = all.iter().find(|pipeline| pipeline.0.kernel == kernel) {
            return same.clone();
        }
        let new = Pipeline::new(kernel);
        all.push(new.clone());
        new
    }
}

fn compile(device: &wgpu::Device, kernel: &Kernel) -> Compiled {
    let entry = |&(binding, access): &(u32, Access)| {
        let (ty, has_dynamic_offset) = match access {
            Access::Parameters => (wgpu::BufferBindingType::Uniform, true),
            Access::Read => (wgpu::BufferBindingType::Storage { read_only: true }, false),
            Access::Write => (wgpu::BufferBindingType::Storage { read_only: false }, false),
        };
        wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset, min_binding_size: None },
            count: None,
        }
    };
    let entries: Vec<wgpu::BindGroupLayoutEntry> = kernel.bindings().iter().map(entry).collect();
    let label = Some(kernel.entry);
    let layout =
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label, entries: &entries });
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label,
        source: wgpu::ShaderSource::Wgsl(kernel.source().into()),
    });
    let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label,
        bind_group_layouts: &[Some(&layout)],
        immediate_size: 0,
    });
    let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label,
        layout: Some(&pipeline_layout),
        module: &module,
        entry_point: Some(kernel.entry),
        compilation_options: Default::default(),
        cache: None,
    });
    Compiled { pipeline, layout }
}
