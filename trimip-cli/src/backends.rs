//! The one place that knows which backends this build has; a configuration picks one by name.

use crate::check::{self, Tell};
#[cfg(feature = "wgpu")]
use crate::terminal;
use crate::verbs::bench::stages::{self, StageError};
use trimip_core::{Camera, Config, Error, Result, Session, ViewSet, model::Model, scene_plan::Compute};
#[cfg(feature = "wgpu")]
use trimip_wgpu::{SOFTWARE_CELLS_PER_SECOND, SOFTWARE_SAMPLES_PER_SECOND};

/// Backends of this build.
pub fn names() -> &'static [&'static str] {
    if cfg!(feature = "wgpu") { &["cpu", "wgpu"] } else { &["cpu"] }
}

/// Each backend of this build in one line.
pub fn describe() -> Vec<String> {
    let mut lines = vec![format!("cpu: {}", trimip_cpu::features())];
    if cfg!(feature = "wgpu") {
        lines.push("wgpu: any of the adapters below".into());
    }
    lines
}

/// Graphics adapters that a backend of this build could use, one line each.
#[cfg(feature = "wgpu")]
pub fn adapters() -> Vec<String> {
    let mut lines = Vec::new();
    for adapter in trimip_wgpu::adapters() {
        lines.push(format!("{} ({})", adapter.name, adapter.about));
        lines.extend(adapter.offers.iter().map(|(name, value)| format!("  {name}: {value}")));
    }
    if lines.is_empty() {
        lines.push("none: install a Vulkan, Metal or Direct3D 12 driver to use backend = \"wgpu\"".into());
    }
    lines
}

/// Graphics adapters that a backend of this build could use, one line each.
#[cfg(not(feature = "wgpu"))]
pub fn adapters() -> Vec<String> {
    vec!["none: this build has no wgpu backend".into()]
}

/// Refuses a name that this build has no backend for.
pub fn check(name: &str) -> Result<()> {
    match name {
        _ if names().contains(&name) => Ok(()),
        "wgpu" => Err(Error::input(
            "backend = \"wgpu\"",
            "this build has no wgpu backend",
            "build with the feature `wgpu`, or use backend = \"cpu\"",
        )),
        _ => Err(Error::input(
            format!("backend = \"{name}\""),
            "unknown backend",
            format!("this build knows: {}", names().join(", ")),
        )),
    }
}

/// A new model in training on the configured backend.
pub fn train(config: &Config, views: ViewSet) -> Result<Box<dyn Session>> {
    check(&config.backend)?;
    #[cfg(feature = "wgpu")]
    if config.backend == "wgpu" {
        return trimip_wgpu::open(config, views);
    }
    trimip_cpu::open(config, views)
}

/// A finished model to render on the backend that its configuration names now.
pub fn load(model: &Model) -> Result<Box<dyn Session>> {
    let config = &model.config;
    check(&config.backend)?;
    #[cfg(feature = "wgpu")]
    if config.backend == "wgpu" {
        return trimip_wgpu::load(model, &config.wgpu.adapter);
    }
    trimip_cpu::load(model, config.threads)
}

/// Bytes that training will need, by part; the photographs included.
pub fn predict_memory(config: &Config, views: &ViewSet) -> Vec<(String, u64)> {
    #[cfg(feature = "wgpu")]
    if config.backend == "wgpu" {
        return trimip_wgpu::memory(config, views);
    }
    trimip_cpu::memory(config, views)
}

/// What the configured backend computes with.
pub fn compute(config: &Config) -> Result<Compute> {
    check(&config.backend)?;
    #[cfg(feature = "wgpu")]
    if config.backend == "wgpu" {
        return trimip_wgpu::compute(&config.wgpu.adapter);
    }
    Ok(trimip_cpu::compute(config.threads))
}

/// Full name of the configured adapter where it is software: the processor in a GPU's place.
fn software(config: &Config) -> Option<String> {
    #[cfg(feature = "wgpu")]
    if config.backend == "wgpu" {
        return trimip_wgpu::software(&config.wgpu.adapter);
    }
    let _ = config;
    None
}

/// What to know before a view is rendered where the adapter picked is software.
pub fn software_remark(config: &Config) -> Option<String> {
    software(config).map(|name| {
        format!(
            "the adapter {name} is software, the processor in a GPU's place: --set backend=cpu is many times as fast"
        )
    })
}

/// What to know before the first step where the adapter picked is software: its name, how long a step takes, what to do.
pub fn software_warning(config: &Config) -> Option<String> {
    #[cfg(feature = "wgpu")]
    if let Some(name) = software(config) {
        let cells = f64::from(config.occupancy.resolution).powi(3);
        let cells = cells * f64::from(config.occupancy.warmup_fraction);
        return Some(software_text(&name, config.train.samples_per_step, cells));
    }
    let _ = config;
    None
}

/// `cells` are asked in the first step, and in every step that refreshes the occupancy grid while it warms up.
#[cfg(feature = "wgpu")]
fn software_text(name: &str, samples_per_step: u32, cells: f64) -> String {
    let step = f64::from(samples_per_step) / SOFTWARE_SAMPLES_PER_SECOND;
    format!(
        "the adapter {name} is software, the processor in a GPU's place: a step of {} takes about {} on two cores, the \
         first about {}; use backend = \"cpu\"",
        terminal::many(samples_per_step.into(), "sample"),
        terminal::duration(step),
        terminal::duration(step + cells / SOFTWARE_CELLS_PER_SECOND)
    )
}

/// Backends that this machine can run.
pub fn usable() -> Vec<String> {
    #[cfg(feature = "wgpu")]
    if !trimip_wgpu::adapters().is_empty() {
        return vec!["cpu".into(), "wgpu".into()];
    }
    vec!["cpu".into()]
}

/// The catalogue of stiff and extreme cases on a backend.
pub fn catalogue(name: &str, adapter: &str, threads: u32, long: bool, tell: Tell<'_>) -> Result<()> {
    check(name)?;
    #[cfg(feature = "wgpu")]
    if name == "wgpu" {
        return check::catalogue(&|| trimip_wgpu::WgpuBackend::new(adapter, true), long, tell);
    }
    let _ = adapter;
    let simd = trimip_cpu::simd::Simd::detect();
    check::catalogue(&|| trimip_cpu::CpuBackend::new(threads, simd), long, tell)
}

/// Errors of a model's stages against f64, on the backend that its configuration names.
pub fn stage_errors(model: &Model, camera: &Camera, precision: &'static str) -> Result<Vec<StageError>> {
    let config = &model.config;
    check(&config.backend)?;
    #[cfg(feature = "wgpu")]
    if config.backend == "wgpu" {
        let backend = trimip_wgpu::WgpuBackend::new(&config.wgpu.adapter, true)?;
        return stages::on(&backend, model, camera, precision);
    }
    let backend = trimip_cpu::CpuBackend::new(config.threads, trimip_cpu::simd::Simd::detect())?;
    stages::on(&backend, model, camera, precision)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(feature = "wgpu")]
    #[test]
    fn software_is_named_with_the_time_of_a_step_and_what_to_do() {
        let [samples, cells] =
            [SOFTWARE_SAMPLES_PER_SECOND, SOFTWARE_CELLS_PER_SECOND].map(|rate| 10.0 * rate);
        let text = software_text("llvmpipe", samples as u32, cells);
        for part in ["llvmpipe", "software", "about 10 s", "about 20 s", "backend = \"cpu\""] {
            assert!(text.contains(part), "{part} in {text}");
        }
        let cpu = Config::default();
        assert!(software_warning(&cpu).is_none() && software_remark(&cpu).is_none(), "the CPU is no adapter");
    }

    #[test]
    fn an_unknown_backend_is_the_users_to_mend() {
        for name in ["cpu", "wgpu", "cuda", ""] {
            match check(name) {
                Ok(()) => assert!(names().contains(&name)),
                Err(error) => assert!(error.exit_code() == 2 && error.message.contains("cpu"), "{error}"),
            }
        }
        assert!(check("cuda").is_err() && check("cpu").is_ok());
    }
}
