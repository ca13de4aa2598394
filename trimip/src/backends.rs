//! Registry of the backends compiled into this build. A configuration selects one by name.

#[cfg(feature = "wgpu")]
use crate::formatting;
use std::sync::Arc;
use trimip_core::{
    Backend, Config, Error, ForeignSection, Result, Session, ViewSet, Viewer,
    engine::exchange::{Rank, Ranks},
    field::model::Model,
    scene_plan::Compute,
};
#[cfg(feature = "wgpu")]
use trimip_wgpu::{SOFTWARE_CELLS_PER_SECOND, SOFTWARE_SAMPLES_PER_SECOND, WgpuConfig};

/// Function that opens a session which several ranks share.
type TrainOver = fn(&Config, ViewSet, Arc<dyn Ranks>) -> Result<Box<dyn Session>>;

/// A registered backend. A `Rank` argument is the rank of this process on its machine.
struct Entry {
    name: &'static str,
    /// The settings of the backend.
    section: Option<ForeignSection>,
    describe: fn() -> String,
    usable: fn() -> bool,
    train: fn(&Config, ViewSet, Rank) -> Result<Box<dyn Session>>,
    train_over: TrainOver,
    load: fn(&Model, Rank) -> Result<Box<dyn Viewer>>,
    memory: fn(&Config, &ViewSet) -> Vec<(String, u64)>,
    compute: fn(&Config, Rank) -> Result<Compute>,
    /// Full name of the configured device if it is a software renderer, `None` for a real GPU or the CPU backend.
    software: fn(&Config) -> Option<String>,
}

/// Backends of this build.
const ENTRIES: &[Entry] = &[
    Entry {
        name: "cpu",
        section: None,
        describe: trimip_cpu::features,
        usable: || true,
        train: |config, views, _| trimip_cpu::open(config, views),
        train_over: trimip_cpu::open_over,
        load: |model, _| trimip_cpu::load(model, model.config.threads),
        memory: trimip_cpu::memory,
        compute: |config, _| Ok(trimip_cpu::compute(config.threads)),
        software: |_| None,
    },
    #[cfg(feature = "wgpu")]
    Entry {
        name: "wgpu",
        section: Some(trimip_wgpu::SECTION),
        describe: || "any of the adapters below".into(),
        usable: || !trimip_wgpu::adapters().is_empty(),
        train: |config, views, near| trimip_wgpu::open(config, views, near.id),
        train_over: trimip_wgpu::open_over,
        load: |model, near| trimip_wgpu::load(model, &adapter(&model.config)?, near.id),
        memory: trimip_wgpu::memory,
        compute: |config, near| trimip_wgpu::compute(&adapter(config)?, near.id),
        software: |config| trimip_wgpu::software(&adapter(config).ok()?),
    },
];

/// Sections of settings of the backends that this build lacks.
pub(crate) const ABSENT: &[&str] = if cfg!(feature = "wgpu") { &[] } else { &["wgpu"] };

/// Returns the sections of settings of the backends of this build.
pub fn sections() -> impl Iterator<Item = ForeignSection> {
    ENTRIES.iter().filter_map(|entry| entry.section)
}

/// Returns the setting that selects an adapter by a part of its name; empty for backends without adapters.
fn adapter(config: &Config) -> Result<String> {
    #[cfg(feature = "wgpu")]
    if config.backend == "wgpu" {
        return Ok(config.section::<WgpuConfig>()?.adapter);
    }
    let _ = config;
    Ok(String::new())
}

/// Looks up a backend by name.
fn entry(name: &str) -> Result<&'static Entry> {
    ENTRIES.iter().find(|entry| entry.name == name).ok_or_else(|| match name {
        "wgpu" => Error::input(
            "backend = \"wgpu\"",
            "this build has no wgpu backend",
            "build with the feature `wgpu`, or use backend = \"cpu\"",
        ),
        _ => Error::input(
            format!("backend = \"{name}\""),
            "unknown backend",
            format!("use one of: {}", names().join(", ")),
        ),
    })
}

/// Returns the names of the backends of this build.
pub fn names() -> Vec<&'static str> {
    ENTRIES.iter().map(|entry| entry.name).collect()
}

/// Returns the names of the backends that this machine can run.
pub fn usable() -> Vec<String> {
    ENTRIES.iter().filter(|entry| (entry.usable)()).map(|entry| entry.name.to_string()).collect()
}

/// Describes each backend of this build in one line.
pub fn describe() -> Vec<String> {
    ENTRIES.iter().map(|entry| format!("{}: {}", entry.name, (entry.describe)())).collect()
}

/// Returns the graphics adapters that a backend of this build can use, one line each.
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

/// Returns the graphics adapters that a backend of this build can use: none without wgpu.
#[cfg(not(feature = "wgpu"))]
pub fn adapters() -> Vec<String> {
    vec!["none: this build has no wgpu backend".into()]
}

/// Checks that this build has a backend named `name`.
///
/// # Errors
/// When it has none; the message lists the available names.
pub fn check(name: &str) -> Result<()> {
    entry(name).map(drop)
}

/// Creates a new model and opens a training session on the configured backend.
///
/// # Errors
/// When the backend or its device does not exist, or the configuration does not fit it.
pub fn train(config: &Config, views: ViewSet) -> Result<Box<dyn Session>> {
    train_beside(config, views, Rank::ONLY)
}

/// Like [`train`], in a process whose rank on this machine is `near`. If several devices are equally good, each process
/// uses a different one.
///
/// # Errors
/// As [`train`].
pub fn train_beside(config: &Config, views: ViewSet, near: Rank) -> Result<Box<dyn Session>> {
    (entry(&config.backend)?.train)(config, views, near)
}

/// Like [`train`], together with other ranks. Every rank has to call this function, with the same configuration and views.
///
/// # Errors
/// As [`train`], and when the backend cannot be divided among that many ranks.
pub fn train_over(config: &Config, views: ViewSet, ranks: Arc<dyn Ranks>) -> Result<Box<dyn Session>> {
    (entry(&config.backend)?.train_over)(config, views, ranks)
}

/// Opens a trained model for rendering on the backend that its configuration names.
///
/// # Errors
/// When the backend or its device does not exist, or the model does not fit it.
pub fn load(model: &Model) -> Result<Box<dyn Viewer>> {
    load_beside(model, Rank::ONLY)
}

/// Like [`load`], in a process whose rank on this machine is `near`; see [`train_beside`].
///
/// # Errors
/// As [`load`].
pub fn load_beside(model: &Model, near: Rank) -> Result<Box<dyn Viewer>> {
    (entry(&model.config.backend)?.load)(model, near)
}

/// Predicts the memory for training, in bytes per part; the photographs are one of the parts. Empty for an unknown backend.
pub fn predict_memory(config: &Config, views: &ViewSet) -> Vec<(String, u64)> {
    entry(&config.backend).map_or_else(|_| Vec::new(), |entry| (entry.memory)(config, views))
}

/// Describes the device and the instruction set that the configured backend uses in a process whose rank on this machine is `near`.
///
/// # Errors
/// When the backend or its device does not exist.
pub fn compute(config: &Config, near: Rank) -> Result<Compute> {
    (entry(&config.backend)?.compute)(config, near)
}

/// Work that is generic over the backend type.
pub trait Visitor {
    /// Result of the work.
    type Output;

    /// Does the work; `open` creates a fresh backend on each call.
    ///
    /// # Errors
    /// When the backend cannot be opened, or the work fails.
    fn visit<B: Backend>(self, open: &dyn Fn() -> Result<B>) -> Result<Self::Output>;
}

/// Runs `visitor` on the backend `name`: a GPU backend uses the adapter whose name contains `adapter`, the CPU backend
/// `threads` threads (0: one per core).
///
/// # Errors
/// When the backend does not exist, or the work fails.
pub fn visit<V: Visitor>(name: &str, adapter: &str, threads: u32, visitor: V) -> Result<V::Output> {
    check(name)?;
    #[cfg(feature = "wgpu")]
    if name == "wgpu" {
        return visitor.visit(&|| trimip_wgpu::WgpuBackend::new(adapter, true));
    }
    let _ = adapter;
    let simd = trimip_cpu::simd::Simd::detect();
    visitor.visit(&|| trimip_cpu::CpuBackend::new(threads, simd))
}

/// Like [`visit`], on the configured backend.
///
/// # Errors
/// As [`visit`].
pub fn visit_configured<V: Visitor>(config: &Config, visitor: V) -> Result<V::Output> {
    visit(&config.backend, &adapter(config)?, config.threads, visitor)
}

/// Returns the full name of the configured device if it is a software renderer.
fn software(config: &Config) -> Option<String> {
    (entry(&config.backend).ok()?.software)(config)
}

/// Returns the remark that is printed before rendering if the selected adapter is a software renderer.
pub fn software_remark(config: &Config) -> Option<String> {
    software(config).map(|name| {
        format!(
            "the adapter {name} is a software renderer on the CPU: backend = \"cpu\" is many times as fast"
        )
    })
}

/// Returns the warning that is printed before the first step if the selected adapter is a software renderer: its name,
/// the time of a step, and an alternative.
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

/// Returns the text of [`software_warning`]. `cells` is the number of density queries in the first step, and in each
/// step that refreshes the occupancy grid during its warm-up.
#[cfg(feature = "wgpu")]
fn software_text(name: &str, samples_per_step: u32, cells: f64) -> String {
    let step = f64::from(samples_per_step) / SOFTWARE_SAMPLES_PER_SECOND;
    format!(
        "the adapter {name} is a software renderer on the CPU: a step of {} takes about {} on two cores, the \
         first about {}; use backend = \"cpu\"",
        formatting::many(samples_per_step.into(), "sample"),
        formatting::duration(step),
        formatting::duration(step + cells / SOFTWARE_CELLS_PER_SECOND)
    )
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
                Err(error) => assert!(
                    error.kind() == trimip_core::ErrorKind::Input && error.message().contains("cpu"),
                    "{error}"
                ),
            }
        }
        assert!(check("cuda").is_err() && check("cpu").is_ok());
    }
}
