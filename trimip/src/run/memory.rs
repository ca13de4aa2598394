//! Checks whether a run fits into memory before it begins.

use crate::formatting;
use trimip_core::{Config, Error, Result, config::MemoryChoice, field::encoders, memory};

/// Memory that a run may use, bytes, including the memory that this process already uses.
#[derive(Clone, Copy)]
struct Memory {
    /// For this process.
    own: u64,
    /// For all processes on this machine together.
    common: u64,
}

/// Compares a run's predicted memory, by parts, with the memory that this process may use; each of `ranks` processes on this
/// machine needs the predicted memory. Returns a warning if there is too little and the settings allow that.
///
/// # Errors
/// When there is too little memory; the message names the largest part and the settings that lower it.
pub fn check(config: &Config, parts: &[(String, u64)], ranks: usize) -> Result<Option<String>> {
    let resident = memory::resident_memory().unwrap_or(0);
    // Memory already in use, such as that of the photographs, is part of the prediction.
    let with = |more: Option<u64>| more.map_or(u64::MAX, |more| more.saturating_add(resident));
    let there = Memory { own: with(memory::own_memory()), common: with(memory::common_memory()) };
    match (shortage(config, parts, ranks, there), config.memory) {
        (Some(error), MemoryChoice::Refuse) => Err(error),
        (shortage, _) => Ok(shortage.map(|error| error.message())),
    }
}

/// Returns the error of a run that needs more memory than is available.
fn shortage(config: &Config, parts: &[(String, u64)], ranks: usize, there: Memory) -> Option<Error> {
    let needed = parts.iter().fold(0, |sum: u64, (_, bytes)| sum.saturating_add(*bytes));
    let (largest, bytes) = parts.iter().max_by_key(|(_, bytes)| *bytes)?;
    let together = ranks > 1 && needed <= there.own;
    let (all, most) = match together {
        true => (needed.saturating_mul(ranks as u64), there.common),
        false => (needed, there.own.min(there.common)),
    };
    let (each, having, fewer) = match together {
        false => (String::new(), "this process may use", ""),
        true => (
            format!(" in each of {ranks} ranks on this machine"),
            "together they may use",
            "start fewer ranks on this machine, ",
        ),
    };
    (all > most).then(|| {
        Error::input(
            "memory",
            format!(
                "the run needs about {}{each} ({largest}: {}), but {having} {}",
                formatting::bytes(needed),
                formatting::bytes(*bytes),
                formatting::bytes(most)
            ),
            format!("{fewer}{}, or set memory = \"warn\" to start anyway", lowered_by(config, largest)),
        )
    })
}

/// Returns the settings that lower a part of the memory. `part` is its name in the CPU's prediction.
fn lowered_by(config: &Config, part: &str) -> &'static str {
    match part {
        "training images" => "lower data.most_pixels or data.scales (or set data.pixels = \"disk\")",
        "occupancy grid and its probes" => "lower occupancy.resolution",
        "feature gradients of a step" => "lower train.samples_per_step or renderer.steps_per_diagonal",
        "network gradients" => "lower field.hidden",
        "activations of all workers" => "lower threads, field.hidden or renderer.steps_per_diagonal",
        "program" => "free memory or raise its limit",
        _ => encoders::of(config).lowered_by(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backends;
    use trimip_core::{Alpha, ViewSet};

    fn parts(config: &Config) -> Vec<(String, u64)> {
        let none = ViewSet {
            views: vec![],
            pixels: Default::default(),
            alpha: Alpha::Straight,
            scales: vec![],
            depths: Vec::new(),
        };
        backends::predict_memory(config, &none)
    }

    #[test]
    fn what_is_advised_lowers_the_largest_part() {
        type Change = fn(&mut Config);
        let cases: [(Change, &str); 4] = [
            (|c| c.occupancy.resolution = 1024, "occupancy.resolution"),
            (|c| c.encoder.plane_size = 4096, "encoder.plane_size"),
            (|c| c.train.samples_per_step = 4_194_304, "train.samples_per_step"),
            (|c| c.threads = 1024, "threads"),
        ];
        for (change, setting) in cases {
            let mut config = Config::default();
            let there = Memory { own: u64::MAX, common: 2_000_000_000 };
            assert!(shortage(&config, &parts(&config), 1, there).is_none(), "the defaults fit");
            let error = shortage(&config, &parts(&config), 8, there).expect("eight times as much");
            assert!(error.message().contains("fewer ranks"), "{error}");
            change(&mut config);
            let there = Memory { own: u64::MAX, common: 600_000_000 };
            let error = shortage(&config, &parts(&config), 1, there).expect(setting);
            assert!(
                error.kind() == trimip_core::ErrorKind::Input && error.message().contains(setting),
                "{setting}: {error}"
            );
            // A limit per process applies to each rank separately.
            let own = Memory { own: 600_000_000, common: u64::MAX };
            let error = shortage(&config, &parts(&config), 8, own).expect(setting);
            assert!(error.message().contains("this process may use"), "{error}");
            assert!(
                !error.message().contains("--out") && error.message().contains("memory = \"warn\""),
                "{error}"
            );
        }
        let each = Memory { own: 2_000_000_000, common: u64::MAX };
        let config = Config::default();
        assert!(shortage(&config, &parts(&config), 8, each).is_none(), "each of eight processes fits");
    }
}
