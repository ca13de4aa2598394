//! `bake`: computes the proxy of a model and writes it to the model file. After that, the default is hybrid rendering with the proxy.

use crate::{args::BakeArguments, interrupt, progress::bar, terminal};
use std::sync::atomic::Ordering;
use std::time::Instant;
use trimip::run::{folder as run_folder, lock_for_writing};
use trimip::{Error, Result, backends, settings};
use trimip_core::config::RendererKind;
use trimip_core::engine::proxy::{Baking, bake};
use trimip_core::field::model::Model;

/// Number of steps of the bar.
const BAR: u64 = 1000;

/// Computes the proxy and writes the model with it.
pub fn run(arguments: &BakeArguments) -> Result<u8> {
    run_folder::expect_any(&arguments.model)?;
    let path = match arguments.model.is_dir() {
        true => run_folder::RunFolder::new(&arguments.model).model(),
        false => arguments.model.clone(),
    };
    if arguments.model.is_dir() && !path.exists() {
        return Err(Error::input(
            arguments.model.display(),
            "no model.safetensors in this folder",
            "train to the end first, or name a model file",
        ));
    }
    let out = arguments.out.as_ref().unwrap_or(&path);
    // Without the lock, this command could overwrite the model of a run that trains in the folder.
    let _held = lock_for_writing(out)?;
    let mut model = Model::read(&path)?;
    settings::override_model(&mut model, &arguments.set)?;
    model.config.renderer.kind = RendererKind::Volume;
    backends::check(&model.config.backend)?;
    if let Some(folder) = out.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        run_folder::create_writable(folder)?;
    }
    let stop = interrupt::install()?;
    let mut viewer = backends::load(&model)?;
    let started = Instant::now();
    let bar = bar("{bar:30} {percent:>3} %  {eta} left", BAR);
    let proxy = bake(viewer.as_mut(), &model, &Baking::of(&model.config), &mut |fraction| {
        bar.set_position((fraction * BAR as f64) as u64);
        !stop.load(Ordering::Relaxed)
    })?;
    bar.finish_and_clear();
    let Some(proxy) = proxy else { return Ok(interrupt::EXIT_CODE) };
    let assets = proxy.to_assets()?;
    let packed: usize = assets.values().map(trimip_core::field::tensors::Tensor::size).sum();
    let [x, y, z] = proxy.cells();
    terminal::prose(format!(
        "proxy: {x} x {y} x {z} cells, {:.1} % of them in bricks with a density, {} in the file; {:.1} s",
        100.0 * proxy.filled(),
        terminal::bytes(packed as u64),
        started.elapsed().as_secs_f64()
    ));
    model.file.tensors.extend(assets);
    model.config.renderer.kind = RendererKind::Hybrid;
    let bytes = Model::new(model.config, model.file).write(out)?;
    terminal::line(format!("{}: {}", out.display(), terminal::bytes(bytes)));
    Ok(0)
}
