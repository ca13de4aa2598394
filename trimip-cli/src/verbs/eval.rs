//! `eval`: a model's PSNR and SSIM per scale on its test set.

use crate::{
    args::EvalArguments,
    backends, interrupt,
    progress::{bar, table},
    run_folder, settings, terminal,
};
use serde_json::json;
use std::sync::atomic::Ordering;
use std::time::Instant;
use trimip_core::{
    Error, Result,
    evaluate::{evaluate, mean_quality, per_scale},
    tensors::write_atomically,
};

/// Measures a model; exit code 1 when it misses `eval.min_psnr`.
pub fn run(arguments: &EvalArguments) -> Result<u8> {
    let mut model = run_folder::read_model(&arguments.model)?;
    settings::override_model(&mut model, &arguments.set)?;
    let config = model.config.clone();
    backends::check(&config.backend)?;
    if let Some(parent) = arguments.json.as_deref().and_then(|path| path.parent()) {
        run_folder::create_writable(if parent.as_os_str().is_empty() { ".".as_ref() } else { parent })?;
    }
    let stop = interrupt::install()?;
    let scene = trimip_data::open(&config.data)?;
    for warning in &scene.warnings {
        terminal::note(format!("warning: {warning}"));
    }
    let mut session = backends::load(&model)?;
    session.notes().iter().for_each(|note| terminal::note(format!("warning: {note}")));

    let (started, stride) = (Instant::now(), arguments.stride as usize);
    let total = scene.test.len().div_ceil(stride);
    if total == 0 {
        return Err(Error::input(
            &config.data.test,
            "the test split holds no view",
            "name another data.test",
        ));
    }
    let bar = bar("{bar:12} view {pos} of {len}  {wide_msg}", total as u64);
    let mut whole = true;
    let qualities =
        evaluate(session.as_mut(), scene.test.as_ref(), stride, config.data.background, |view| {
            bar.set_position((view.index / stride) as u64 + 1);
            bar.set_message(format!("{} 1/{}: {:.2} dB", view.name, view.scale, view.psnr));
            whole = !stop.load(Ordering::Relaxed);
            Ok(whole)
        })?;
    bar.finish_and_clear();
    if !whole {
        return Ok(interrupt::EXIT_CODE);
    }

    let scales = per_scale(&qualities, 1);
    let mean = mean_quality(&scales);
    table(&scales).iter().for_each(terminal::prose);
    if let Some(path) = &arguments.json {
        let views: Vec<_> = qualities
            .iter()
            .map(|q| json!({ "index": q.index, "scale": q.scale, "psnr": q.psnr, "psnr_8bit": q.psnr_8bit, "psnr_opposite": q.psnr_opposite, "psnr_constant": q.psnr_constant, "ssim": q.ssim }))
            .collect();
        let report = json!({
            "model": arguments.model.display().to_string(),
            "scene": scene.name,
            "backend": session.backend(),
            "stride": stride,
            "seconds": started.elapsed().as_secs_f64(),
            "background": config.data.background,
            "scales": scales,
            "mean": mean,
            "views": views,
        });
        write_atomically(path, serde_json::to_string_pretty(&report).map_err(Error::run)?.as_bytes())?;
    }
    mean.judge(&config.eval)?;
    Ok(0)
}
