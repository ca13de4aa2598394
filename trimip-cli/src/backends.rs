//! The one place that knows which backends this build has; a configuration picks one by name.

use trimip_core::{Config, Error, Result, Session, ViewSet, model::Model};

/// Backends of this build.
pub fn names() -> &'static [&'static str] {
    &["cpu"]
}

/// Each backend of this build in one line.
pub fn describe() -> Vec<String> {
    vec![format!("cpu: {}", trimip_cpu::features())]
}

/// Graphics adapters that a backend of this build could use, one line each.
pub fn adapters() -> Vec<String> {
    vec!["none: this build has no wgpu backend".into()]
}

/// Refuses a name that this build has no backend for.
pub fn check(name: &str) -> Result<()> {
    match name {
        "cpu" => Ok(()),
        "wgpu" => Err(trimip_wgpu::missing()),
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
    trimip_cpu::open(config, views)
}

/// A finished model to render.
pub fn load(model: &Model, backend: &str, threads: u32) -> Result<Box<dyn Session>> {
    check(backend)?;
    trimip_cpu::load(model, threads)
}

/// Bytes that training will need, by part; the photographs included.
pub fn predict_memory(config: &Config, views: &ViewSet) -> Vec<(String, u64)> {
    trimip_cpu::memory(config, views)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_backend_is_the_users_to_mend() {
        assert!(check("cpu").is_ok());
        for name in ["wgpu", "cuda", ""] {
            let error = check(name).unwrap_err();
            assert!(error.exit_code() == 2 && error.message.contains("cpu"), "{error}");
        }
    }
}
