//! The adapters of this machine: their capabilities, and the choice among them.

use super::matrices::Matrices;
use trimip_core::{Error, Result};

/// An adapter and its capabilities.
#[derive(Clone, Debug)]
pub struct AdapterFacts {
    /// Name of the adapter.
    pub name: String,
    /// Kind, backend and driver, in one line.
    pub about: String,
    /// Relevant limits and features: name and value.
    pub offers: Vec<(&'static str, String)>,
}

fn instance() -> wgpu::Instance {
    wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle())
}

fn all_adapters() -> Vec<wgpu::Adapter> {
    pollster::block_on(all_adapters_async())
}

async fn all_adapters_async() -> Vec<wgpu::Adapter> {
    instance().enumerate_adapters(wgpu::Backends::all()).await
}

/// Returns all adapters of this machine.
pub fn adapters() -> Vec<AdapterFacts> {
    all_adapters().iter().map(facts).collect()
}

fn facts(adapter: &wgpu::Adapter) -> AdapterFacts {
    let (info, limits, features) = (adapter.get_info(), adapter.limits(), adapter.features());
    let has = |feature| if features.contains(feature) { "yes" } else { "no" }.to_string();
    let mebibytes = |bytes: u64| format!("{} MiB", bytes >> 20);
    AdapterFacts {
        about: format!("{:?}, {:?}, {} {}", info.device_type, info.backend, info.driver, info.driver_info)
            .trim_end()
            .to_string(),
        name: info.name,
        offers: vec![
            ("largest binding", mebibytes(limits.max_storage_buffer_binding_size)),
            ("largest buffer", mebibytes(limits.max_buffer_size)),
            ("storage buffers of a stage", limits.max_storage_buffers_per_shader_stage.to_string()),
            ("invocations of a workgroup", limits.max_compute_invocations_per_workgroup.to_string()),
            ("workgroup memory", format!("{} KiB", limits.max_compute_workgroup_storage_size >> 10)),
            ("atomic f32 additions", has(wgpu::Features::SHADER_FLOAT32_ATOMIC)),
            ("f16", has(wgpu::Features::SHADER_F16)),
            (
                "cooperative matrices",
                Matrices::of(adapter)
                    .map_or("no".into(), |m| format!("{0}x{0}, f16 with sums of f32", m.side)),
            ),
        ],
    }
}

/// Ranks adapters for a user who names none: hardware first, software last.
fn rank(info: &wgpu::AdapterInfo) -> u32 {
    match info.device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}

/// Returns the adapter whose name contains `name` (ignoring case), or the best adapter if `name` is empty.
///
/// # Errors
/// When there is no such adapter.
pub fn choose(name: &str) -> Result<wgpu::Adapter> {
    choose_among(all_adapters(), name)
}

/// Returns adapter `index`, modulo their number, among the adapters that match `name` and have the kind and backend of
/// the one that [`choose`] returns.
///
/// # Errors
/// As [`choose`].
pub fn choose_one_of(name: &str, index: usize) -> Result<wgpu::Adapter> {
    if index == 0 {
        return choose(name);
    }
    let best = choose_among(all_adapters(), name)?.get_info();
    let mut alike = all_adapters();
    alike.retain(|a| {
        let info = a.get_info();
        info.name.to_lowercase().contains(&name.to_lowercase())
            && (info.device_type, info.backend) == (best.device_type, best.backend)
    });
    let count = alike.len().max(1);
    alike.into_iter().nth(index % count).map_or_else(|| choose_among(all_adapters(), name), Ok)
}

/// Chooses an adapter as [`choose`] does, without blocking.
///
/// # Errors
/// As [`choose`].
pub async fn choose_async(name: &str) -> Result<wgpu::Adapter> {
    choose_among(all_adapters_async().await, name)
}

fn choose_among(mut adapters: Vec<wgpu::Adapter>, name: &str) -> Result<wgpu::Adapter> {
    let names: Vec<String> = adapters.iter().map(|a| format!("`{}`", a.get_info().name)).collect();
    adapters.retain(|a| a.get_info().name.to_lowercase().contains(&name.to_lowercase()));
    adapters.sort_by_key(|a| rank(&a.get_info()));
    adapters.into_iter().next().ok_or_else(|| match names.is_empty() {
        true => Error::input(
            "backend = \"wgpu\"",
            "this machine has no adapter for wgpu (Vulkan, Metal or Direct3D 12)",
            "install the graphics driver, or use backend = \"cpu\"",
        ),
        false => Error::input(
            format!("wgpu.adapter = \"{name}\""),
            "no adapter has a name that contains this",
            format!("choose one of {}", names.join(", ")),
        ),
    })
}

/// Returns the full name of the adapter that `choose` returns for `name`, if it is a software adapter, which runs on
/// the processor.
pub fn software(name: &str) -> Option<String> {
    let info = choose(name).ok()?.get_info();
    (info.device_type == wgpu::DeviceType::Cpu).then_some(info.name)
}

/// Returns the size in bytes of the largest binding of the adapter that `choose` returns for `name`, if there is one.
pub fn largest_binding(name: &str) -> Option<u64> {
    choose(name).ok().map(|adapter| adapter.limits().max_storage_buffer_binding_size)
}
