//! A training benchmark: the variants, and the figures of each variant.

use crate::curves::Reach;
use crate::terminal;
use std::path::PathBuf;
use trimip::Settings;

/// A configuration of the benchmark.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// Name of the variant and of its run folders.
    pub name: String,
    /// Assignments of the variant, each `section.key=value`.
    pub assignments: Vec<String>,
}

/// Definition of a benchmark.
#[derive(Clone, Debug)]
pub struct Bench {
    /// Settings shared by all variants.
    pub base: Settings,
    /// Variants to train.
    pub variants: Vec<Variant>,
    /// Number of seeds per variant.
    pub seeds: u32,
    /// PSNR levels in dB, ascending; the times at which runs reach them are reported.
    pub reach: Vec<f64>,
    /// Folder of the runs.
    pub out: PathBuf,
}

/// Mean figures of a variant over its seeds.
#[derive(Debug, serde::Serialize)]
pub struct VariantRow {
    /// Name of the variant.
    pub name: String,
    /// Assignments of the variant.
    pub settings: Vec<String>,
    /// Number of runs.
    pub seeds: usize,
    /// Seconds of training.
    pub seconds: f64,
    /// Mean PSNR of the scales, dB.
    pub psnr: f64,
    /// Difference between the best and the worst seed, dB.
    pub spread: f64,
    /// Mean SSIM of the scales.
    pub ssim: f64,
    /// Mean number of samples kept.
    pub samples: f64,
    /// Size of the model file, bytes.
    pub model_bytes: f64,
    /// Peak resident memory in bytes, if known.
    pub peak_memory_bytes: Option<f64>,
    /// True if no other variant is both faster and better.
    pub pareto: bool,
    /// Mean time at which the seeds reach each PSNR; `None` unless all seeds reach it. The time is an upper bound if a
    /// seed reached the PSNR before its first measurement.
    pub reaches: Vec<Option<Reach>>,
    /// Run folders of the variant.
    pub runs: Vec<PathBuf>,
}

/// Returns a header, then one row per variant.
pub fn cells(rows: &[VariantRow], reach: &[f64]) -> Vec<Vec<String>> {
    let mut cells = vec![vec![
        "variant".to_string(),
        "seeds".into(),
        "seconds".into(),
        "PSNR / dB".into(),
        "spread".into(),
        "SSIM".into(),
        "samples".into(),
        "model".into(),
        "front".into(),
    ]];
    cells[0].extend(reach.iter().map(|psnr| format!("{psnr} dB after")));
    for row in rows {
        let mut line = vec![
            row.name.clone(),
            row.seeds.to_string(),
            format!("{:.1}", row.seconds),
            format!("{:.2}", row.psnr),
            format!("{:.2}", row.spread),
            format!("{:.4}", row.ssim),
            terminal::number(row.samples, ""),
            terminal::bytes(row.model_bytes as u64),
            if row.pareto { "*".into() } else { String::new() },
        ];
        line.extend(row.reaches.iter().map(|time| time.map_or("–".into(), |reach| reach.to_string())));
        cells.push(line);
    }
    cells
}
