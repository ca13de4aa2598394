//! `report.json`: the report for programs. Sizes in bytes, times in seconds, PSNR in dB; unknown values are `null`.

use super::content::{Report, Status};
use crate::{run::history::Evaluation, view::PIXELS_PER_DEGREE};
use serde_json::{Value, json};
use trimip_core::measures::quality::mean_quality;
use trimip_core::{Error, Result};
use trimip_data::settings::DataConfig;

/// Returns the report as JSON text.
///
/// # Errors
/// When a value cannot be written as JSON.
pub fn text(report: &Report<'_>) -> Result<String> {
    serde_json::to_string_pretty(&value(report)).map_err(Error::run)
}

fn value(report: &Report<'_>) -> Value {
    let (history, config) = (report.history, report.config);
    let (status, failure) = match &report.status {
        Status::Finished => ("finished", None),
        Status::Stopped => ("stopped", None),
        Status::Failed(message) => ("failed", Some(message)),
    };
    let headline = report.headline();
    let origins: serde_json::Map<String, Value> = report
        .settings
        .iter()
        .map(|(path, value, origin)| {
            (path.to_string(), json!({ "value": value, "origin": origin.to_string() }))
        })
        .collect();
    let verdict = report.verdict();
    let last = history.parts.last().map(|part| &part.provenance);
    json!({
        "version": crate::machine::version(),
        "status": status,
        "failure": failure,
        "verdict": verdict.label(),
        "verdict_reasons": verdict.reasons(),
        "run": report.run,
        "command": last.and_then(|last| last.command.as_ref()),
        "ended_unix": last.and_then(|last| last.ended_unix),
        "backend": config.backend,
        "devices": history.devices(),
        "scene": report.scene,
        "steps": history.totals.step,
        "samples": history.totals.samples,
        "rays": history.totals.rays,
        "marched_samples": history.totals.marched,
        "empty_batches": history.totals.empty_batches,
        "non_finite": history.totals.non_finite,
        "train_seconds": history.totals.seconds,
        "evaluation_seconds": history.evaluation_seconds(),
        "wall_seconds": history.parts.iter().map(|part| part.wall_seconds).sum::<f64>(),
        "sessions": history.parts.len(),
        "samples_per_second": report.samples_per_second(),
        "samples_per_ray": history.totals.samples_per_ray(),
        "backward_fraction": history.totals.backward_fraction(),
        "rays_per_second": history.totals.rays_per_second(),
        "peak_memory_bytes": history.peak_memory_bytes(),
        "predicted_memory_bytes": history.predicted_memory_bytes,
        "model_bytes": report.model_bytes,
        "measure": meanings(report),
        "scales": headline.map_or(json!([]), |e| json!(e.scales)),
        "mean": headline.map_or(Value::Null, |e| json!(mean_quality(&e.scales))),
        "curve": report.curve().into_iter().map(point).collect::<Vec<_>>(),
        "views": report.views,
        "psnr_by_distance": report.psnr_by_distance().map(|found| json!({
            "views": found.views,
            "rank_correlation": found.rank_correlation,
            "least_spacings": found.spacings.map(|spacings| spacings.0),
            "greatest_spacings": found.spacings.map(|spacings| spacings.1),
        })),
        "poses": history.poses.map(|(moved, aligned)| json!({ "moved": moved, "aligned": aligned })),
        "warnings": history.warnings,
        "machine": report.machine,
        "settings": origins,
    })
}

/// Returns the definitions of the measures, and the views and conditions of the measurement.
fn meanings(report: &Report<'_>) -> Value {
    let (history, config, headline) = (report.history, report.config, report.headline());
    json!({
        "psnr": "-10 log10(mean squared error) per image, mean over images, then over scales; unrounded sRGB values",
        "psnr_8bit": "psnr of values rounded to 8 bits",
        "psnr_plain": "psnr of unrounded values without the set's edge exponents (data.edge_exponents)",
        "psnr_box": "psnr of unrounded values against a true box filter of the finest photographs",
        "psnr_opposite": "psnr of unrounded values on another background, black where the configured one is bright and white where it is dark",
        "psnr_exposed": "psnr of unrounded values times one gain per channel; the gain of each half of a picture is fitted on the other half",
        "psnr_constant": "psnr of each photograph's mean colour in place of the rendering, from the mean squared error over all images of a scale",
        "ssim": "Wang et al. 2004: Gaussian window of 11 pixels, sigma 1.5, K1 = 0.01, K2 = 0.03, mean of the channels",
        "ms_ssim": "Wang et al. 2003: five scales, the published weights, the windows of ssim; images of 176 pixels and more",
        "flip": "mean LDR-FLIP of Andersson et al. 2020, of values rounded to 8 bits",
        "flip_pixels_per_degree": PIXELS_PER_DEGREE,
        "lpips": "Zhang et al. 2018, by the network of eval.lpips; images of 32 pixels and more",
        "nearest_distance": "distance from a view's camera to the nearest training camera, world units",
        "nearest_spacings": "nearest_distance divided by the median distance of a training camera to the nearest other one",
        "psnr_by_distance": "Spearman's rank correlation of psnr and nearest_distance over the views of the finest scale",
        "perceptual_images": "number of images over which ms_ssim, flip and lpips are averaged; their mean is over the scales that have them",
        "background": config.data.background,
        "convention": config.data.convention,
        "split": config.section::<DataConfig>().map(|data| data.tested_on()).ok(),
        "stride": headline.map(|e| e.stride),
        "views": headline.map(Evaluation::views),
        "test_views": history.test_views(),
        "complete": history.last().is_some(),
    })
}

fn point(evaluation: &Evaluation) -> Value {
    let totals = &evaluation.totals;
    json!({
        "seconds": totals.seconds,
        "step": totals.step,
        "samples": totals.samples,
        "rays": totals.rays,
        "psnr": evaluation.scales.iter().map(|q| q.measures.psnr).collect::<Vec<_>>(),
        "ssim": evaluation.scales.iter().map(|q| q.measures.ssim).collect::<Vec<_>>(),
        "mean_psnr": evaluation.psnr,
        "mean_ssim": evaluation.ssim,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fields_that_programs_rely_on_are_there() {
        crate::run::fixtures::report(|report| {
            let json = value(report);
            for key in [
                "verdict",
                "verdict_reasons",
                "run",
                "command",
                "backend",
                "scene",
                "train_seconds",
                "peak_memory_bytes",
                "model_bytes",
                "settings",
            ] {
                assert!(json.get(key).is_some(), "{key}");
            }
            assert_eq!((&json["verdict"], &json["measure"]["test_views"]), (&json!("fair"), &json!(200)));
            assert_eq!(json["steps"], 100);
            assert_eq!(json["samples"], 100_000);
            assert_eq!(json["rays"], 1000);
            assert_eq!((&json["samples_per_ray"], &json["rays_per_second"]), (&json!(100.0), &json!(100.0)));
            assert_eq!(json["mean"]["psnr"], 24.5);
            // Values that were not measured are null.
            assert_eq!(
                json["scales"][1],
                json!({
                    "scale": 2, "images": 8, "perceptual_images": 0, "psnr": 25.5, "psnr_8bit": null, "psnr_opposite": null, "psnr_plain": null,
                    "psnr_box": null, "psnr_exposed": null, "psnr_constant": 12.0, "ssim": 0.9,
                    "ms_ssim": null, "flip": null, "lpips": null,
                })
            );
            assert_eq!(json["curve"].as_array().unwrap().len(), 2);
            assert_eq!(json["curve"][0]["psnr"], json!([19.0, 21.0]));
        });
    }
}
