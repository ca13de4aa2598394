//! `eval`: a model's PSNR and SSIM per scale on its test set.

use crate::{
    args::EvalArguments,
    backends, interrupt,
    progress::{bar, open, table},
    run_folder, settings, terminal,
};
use indicatif::ProgressBar;
use serde_json::json;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;
use trimip_core::{
    Error, Result,
    evaluate::{ViewResult, Watch, evaluate_frame, mean_quality, per_scale},
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
    let scene = open(&config.data)?;
    for warning in &scene.warnings {
        terminal::note(format!("warning: {warning}"));
    }
    let mut session = backends::load(&model)?;
    backends::software_remark(&config).iter().for_each(|remark| terminal::note(format!("warning: {remark}")));
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
    let bar = bar("{bar:20} {percent:>3} %  {wide_msg}", 1000);
    let mut watch = OnBar { bar: &bar, stop: &stop, total, done: 0 };
    let mut qualities = Vec::new();
    for index in (0..scene.test.len()).step_by(stride) {
        let (frames, background) = (scene.test.as_ref(), config.data.background);
        if !evaluate_frame(session.as_mut(), frames, index, 1, background, &mut watch, &mut qualities)? {
            bar.finish_and_clear();
            return Ok(interrupt::EXIT_CODE);
        }
        watch.done += 1;
    }
    bar.finish_and_clear();

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

/// Moves a bar with the rows that are rendered.
struct OnBar<'a> {
    bar: &'a ProgressBar,
    stop: &'a AtomicBool,
    /// Frames in all.
    total: usize,
    /// Frames done.
    done: usize,
}

impl Watch for OnBar<'_> {
    fn rows(&mut self, rows: u32, of: u32) -> bool {
        let part = self.done as f64 + f64::from(rows) / f64::from(of.max(1));
        self.bar.set_position((1000.0 * part / self.total.max(1) as f64) as u64);
        !self.stop.load(Ordering::Relaxed)
    }

    fn view(&mut self, view: &ViewResult<'_>) -> Result<bool> {
        let (at, name) = (self.done + 1, view.name);
        self.bar.set_message(format!(
            "view {at} of {}  {name} 1/{}: {:.2} dB",
            self.total, view.scale, view.psnr
        ));
        Ok(!self.stop.load(Ordering::Relaxed))
    }
}
