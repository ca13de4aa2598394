//! Compute pipelines by kernel; each is compiled on first use.

use crate::device::lock;
use crate::kernel::{Access, Kernel};
use std::collections::HashMap;
use std::sync::{Arc, Mutex};

/// A compiled kernel and its bind group layout.
pub struct Pipeline {
    /// The compute pipeline.
    pub pipeline: wgpu::ComputePipeline,
    /// The layout of its bindings.
    pub layout: wgpu::BindGroupLayout,
}

/// The pipelines of a device.
pub struct Pipelines {
    device: wgpu::Device,
    made: Mutex<HashMap<String, Arc<Pipeline>>>,
}

impl Pipelines {
    /// Creates an empty cache.
    pub fn new(device: wgpu::Device) -> Self {
        Self { device, made: Mutex::default() }
    }

    /// The pipeline of a kernel, compiled if necessary.
    pub fn of(&self, kernel: &Kernel) -> Arc<Pipeline> {
        let mut made = lock(&self.made);
        Arc::clone(made.entry(kernel.key()).or_insert_with(|| Arc::new(self.compile(kernel))))
    }

    fn compile(&self, kernel: &Kernel) -> Pipeline {
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
        let entries: Vec<wgpu::BindGroupLayoutEntry> = kernel.bindings.iter().map(entry).collect();
        let (device, label) = (&self.device, Some(kernel.entry));
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
        Pipeline { pipeline, layout }
    }
}
