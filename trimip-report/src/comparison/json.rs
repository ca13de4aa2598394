//! `paper.json`: the comparison for programs. PSNR in dB, sizes in bytes, times in seconds; unknown values are `null`.

use super::content::Comparison;
use serde_json::{Value, json};
use trimip::systems::published::{CONVENTION, PUBLISHED, REMARKS};
use trimip_core::{Error, Result};

/// Returns the comparison as JSON text.
///
/// # Errors
/// When a value cannot be written as JSON.
pub fn json(comparison: &Comparison) -> Result<String> {
    let systems = comparison.systems.iter().map(|system| {
        json!({
            "name": system.name,
            "title": system.title,
            "kind": system.kind,
            "differs": system.differs,
            "beside": system.beside,
        })
    });
    let tables = comparison.scales.iter().map(|&scales| {
        let scenes = comparison
            .scenes
            .iter()
            .map(|scene| json!({ "scene": scene, "rows": comparison.scene_rows(scales, scene) }));
        json!({
            "scales": scales,
            "mean": comparison.whole_rows(scales),
            "scenes": scenes.collect::<Vec<_>>(),
        })
    });
    let value: Value = json!({
        "version": trimip::machine::version(),
        "command": comparison.command,
        "machine": comparison.machine,
        "split": comparison.split,
        "budget": comparison.budget,
        "scenes": comparison.scenes,
        "missing_scenes": comparison.missing,
        "systems": systems.collect::<Vec<_>>(),
        "measure": {
            "psnr": "-10 log10(mean squared error) per image, mean over images, then over scales, seeds and scenes; unrounded sRGB values",
            "plain": "psnr without the set's edge exponents (data.edge_exponents), like the published figures",
            "published": "figures of another machine, and often of another split and background; see published",
        },
        "tables": tables.collect::<Vec<_>>(),
        "runs": comparison.runs,
        "published": PUBLISHED,
        "published_convention": CONVENTION,
        "published_remarks": REMARKS,
    });
    serde_json::to_string_pretty(&value).map_err(Error::run)
}
