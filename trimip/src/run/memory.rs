//! Whether a run fits into memory, before it begins.

use crate::{machine, units};
use trimip_core::{Config, Error, Result, config::EncoderKind, config::MemoryChoice};

/// Compares a run's predicted memory, by parts, with what this process may have; `ranks` processes on this machine need it each.
/// Returns a warning if it is too little and the settings allow that.
///
/// # Errors
/// When it is too little; names the largest part and what lowers it.
pub fn check(config: &Config, parts: &[(String, u64)], ranks: usize) -> Result<Option<String>> {
    let resident = trimip_data::resident_memory().unwrap_or(0);
    // What is in use already, such as the photographs, is part of the prediction.
    let Some(most) = machine::Machine::detect().memory_available_bytes.map(|more| more + resident) else {
        return Ok(None);
    };
    match (shortage(config, parts, ranks, most), config.memory) {
        (Some(error), MemoryChoice::Refuse) => Err(error),
        (shortage, _) => Ok(shortage.map(|error| error.message)),
    }
}

/// The error of a run whose ranks together need more than `most` bytes.
fn shortage(config: &Config, parts: &[(String, u64)], ranks: usize, most: u64) -> Option<Error> {
    let needed = parts.iter().fold(0, |sum: u64, (_, bytes)| sum.saturating_add(*bytes));
    let (largest, bytes) = parts.iter().max_by_key(|(_, bytes)| *bytes)?;
    let (each, having, fewer) = match ranks {
        1 => (String::new(), "this process may have", ""),
        _ => (
            format!(" in each of {ranks} ranks on this machine"),
            "together they may have",
            "start fewer ranks on it, ",
        ),
    };
    (needed.saturating_mul(ranks as u64) > most).then(|| {
        Error::input(
            "memory",
            format!(
                "the run needs about {}{each}, of which {largest} {}, but {having} {}",
                units::bytes(needed),
                units::bytes(*bytes),
                units::bytes(most)
            ),
            format!("{fewer}{}, or set memory = \"warn\" to begin all the same", lowered_by(config, largest)),
        )
    })
}

/// The settings that lower a part of the memory, by its name in the CPU's prediction.
fn lowered_by(config: &Config, part: &str) -> &'static str {
    match part {
        "training images" => "lower data.most_pixels or data.scales (or set data.pixels = \"disk\")",
        "occupancy grid and its probes" => "lower occupancy.resolution",
        "feature gradients of a step" => "lower train.samples_per_step or renderer.steps_per_diagonal",
        "network gradients" => "lower field.hidden",
        "activations of all workers" => "lower threads, field.hidden or renderer.steps_per_diagonal",
        "program" => "free memory or raise its limit",
        _ => match config.encoder.kind {
            EncoderKind::TriMip => "lower encoder.plane_size",
            EncoderKind::HashGrid => "lower hash_grid.log2_entries",
            EncoderKind::RipMap => "lower rip_map.size",
            EncoderKind::Tensor => "lower tensor.sides",
            EncoderKind::Frequencies => "lower field.hidden",
            EncoderKind::Voxels => "lower voxels.sides",
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backends;
    use trimip_core::{Alpha, ViewSet};

    fn parts(config: &Config) -> Vec<(String, u64)> {
        let none =
            ViewSet { views: vec![], pixels: Default::default(), alpha: Alpha::Straight, scales: vec![] };
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
            assert!(shortage(&config, &parts(&config), 1, 2_000_000_000).is_none(), "the defaults fit");
            let error = shortage(&config, &parts(&config), 8, 2_000_000_000).expect("eight times as much");
            assert!(error.message.contains("fewer ranks"), "{error}");
            change(&mut config);
            let error = shortage(&config, &parts(&config), 1, 600_000_000).expect(setting);
            assert!(error.exit_code() == 2 && error.message.contains(setting), "{setting}: {error}");
            assert!(
                !error.message.contains("--out") && error.message.contains("memory = \"warn\""),
                "{error}"
            );
        }
    }
}
