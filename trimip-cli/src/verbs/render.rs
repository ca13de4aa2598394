//! `render`: renders views of a model as pictures, from test views, a pose, a target, a camera path, a turntable or a flythrough.

use super::{
    selection::{beside, chosen, is_film, resize},
    strip,
};
use crate::{
    args::{PictureFormat, RenderArguments},
    interrupt,
    progress::bar,
    ranks, terminal,
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;
use trimip::ranks::{digest, scatter_jobs, work_on_jobs};
use trimip::run::folder::{self as run_folder, RunFolder};
use trimip::view::{Mean, MotionBlur, Named, Quantity, RenderJob, video, write_cameras};
use trimip::{Camera, Config, Crop, Error, Result, Viewer, backends, model::Model, settings, view};
use trimip_core::{Frame, engine::exchange::Ranks, scene::origin::LocalOrigin};

/// Refuses the folder of a run: the files with the cameras of its photographs and of the rendered pictures have the same name.
fn expect_no_run(out: &Path) -> Result<()> {
    let folder = RunFolder::new(out);
    match folder.is_ours() {
        false => Ok(()),
        true => Err(Error::input(
            folder.cameras().display(),
            "the cameras of a run's photographs would be replaced by those of the pictures",
            "choose another --out folder",
        )),
    }
}

/// Renders every camera that the arguments select.
pub fn run(arguments: &RenderArguments) -> Result<u8> {
    if arguments.strip {
        return strip::run(arguments);
    }
    if arguments.format == PictureFormat::Exr && !cfg!(feature = "exr") {
        return Err(Error::input(
            "--format exr",
            "this build has no EXR",
            "use --format png, or build with feature `exr`",
        ));
    }
    let request = RenderRequest::of(arguments)?;
    let RenderRequest { model, cameras, what, format, out, .. } = &request;
    let (config, what) = (&model.config, &what[..]);
    if let Some(video) = &arguments.video {
        check_video(arguments, video, what, cameras)?;
    }
    if arguments.motion_blur.is_some() && !is_film(arguments) {
        let place = "--motion-blur";
        return Err(Error::input(
            place,
            "has only one view",
            "add --turntable N, --flythrough N or --path FILE",
        ));
    }
    expect_no_run(out)?;
    view::expect_no_others(out, cameras, what, *format)?;
    run_folder::create_writable(out)?;
    // For a film, a job records the finished views, so that an interrupted command can be resumed. Single views are fast and have no job.
    let mut job = match is_film(arguments) {
        true => Some(RenderJob::open(out, model, &request.all_cameras(), what, *format, arguments.fresh)?),
        false => None,
    };
    let stop = interrupt::install()?;
    let mut session = backends::load(model)?;
    session.clip(&parts(config))?;
    backends::software_remark(config).iter().for_each(|remark| terminal::note(format!("warning: {remark}")));
    session.notes().iter().for_each(|note| terminal::note(format!("warning: {note}")));
    let ranged = what.contains(&Quantity::Depth).then_some(&config.scene);
    write_cameras(&out.join(view::CAMERAS), cameras, LocalOrigin::of(&config.data), ranged)?;

    let pictures_of_view = u64::from(request.blur.map_or(1, |blur| blur.cameras));
    let rows = |camera: &Camera| pictures_of_view * u64::from(camera.intrinsics.height);
    let bar =
        bar("{bar:30} {percent:>3} %  {eta} left", cameras.iter().map(|(_, camera)| rows(camera)).sum());
    let mut pictures: Vec<Option<Vec<PathBuf>>> =
        cameras.iter().map(|(name, _)| job.as_ref().and_then(|job| job.finished(name))).collect();
    let left: Vec<usize> = (0..cameras.len()).filter(|&view| pictures[view].is_none()).collect();
    let earlier = cameras.len() - left.len();
    let finished = cameras.iter().zip(&pictures).filter(|(_, paths)| paths.is_some());
    bar.inc(finished.map(|((_, camera), _)| rows(camera)).sum());
    let mut seconds = Vec::new();
    let mut draw = |view: usize| {
        let mut told = 0;
        request.draw(session.as_mut(), view, &mut |done, _| {
            bar.inc(u64::from(done - told));
            told = done;
            !stop.load(Ordering::Relaxed)
        })
    };
    let mut keep = |view: usize, drawn: Option<RenderedView>| -> Result<bool> {
        let Some(RenderedView { paths, took }) = drawn else { return Ok(false) };
        seconds.push(took);
        job.as_mut().map_or(Ok(()), |job| job.finish(&cameras[view].0))?;
        paths.iter().for_each(|path| bar.suspend(|| terminal::line(path.display())));
        pictures[view] = Some(paths);
        Ok(!stop.load(Ordering::Relaxed))
    };
    match ranks::all() {
        // The other ranks receive their jobs as indices of views.
        Some(all) => {
            scatter_jobs(&*all, &request.digest()?, &left, &|| !stop.load(Ordering::Relaxed), draw, keep)?;
        }
        None => {
            for view in left {
                if !keep(view, draw(view)?)? {
                    break;
                }
            }
        }
    }
    if pictures.iter().any(Option::is_none) {
        return Ok(interrupt::EXIT_CODE);
    }
    bar.finish_and_clear();
    if earlier > 0 {
        let views = terminal::many(earlier as u64, "view");
        terminal::aside(format!("{views} rendered earlier; --fresh renders all again"));
    }
    if let Some(line) = speed(seconds) {
        terminal::aside(line);
    }
    let Some(path) = &arguments.video else { return Ok(0) };
    let color = what.iter().position(|&quantity| quantity == Quantity::Color).unwrap_or(0);
    let colors: Vec<PathBuf> =
        pictures.into_iter().flatten().map(|mut paths| paths.swap_remove(color)).collect();
    if !video::encode(path, &colors, arguments.rate, &mut |_| !stop.load(Ordering::Relaxed))? {
        return Ok(interrupt::EXIT_CODE);
    }
    terminal::line(path.display());
    Ok(0)
}

/// Does this rank's part of [`run`]; called on ranks other than 0.
///
/// # Errors
/// When the model cannot be opened on this machine.
pub fn work(arguments: &RenderArguments, ranks: &dyn Ranks) -> Result<()> {
    let request = RenderRequest::of(arguments)?;
    let mut session = backends::load_beside(&request.model, ranks.on_machine())?;
    session.clip(&parts(&request.model.config))?;
    let stop = interrupt::install()?;
    let mut going = |_, _| !stop.load(Ordering::Relaxed);
    work_on_jobs(ranks, &request.digest()?, |view| request.draw(session.as_mut(), view, &mut going))
}

/// Returns the crop of the pictures as a list; empty if there is none.
fn parts(config: &Config) -> Vec<Crop> {
    Some(config.scene.crop).filter(|crop| *crop != Crop::None).into_iter().collect()
}

/// The views to render, and the quantities and format of their pictures.
struct RenderRequest {
    model: Model,
    cameras: Vec<Named>,
    what: Vec<Quantity>,
    format: view::PictureFormat,
    blur: Option<MotionBlur>,
    out: PathBuf,
}

/// The written pictures of a view.
#[derive(Serialize, Deserialize)]
struct RenderedView {
    paths: Vec<PathBuf>,
    /// Rendering time, seconds.
    took: f64,
}

impl RenderRequest {
    fn of(arguments: &RenderArguments) -> Result<Self> {
        let format = match arguments.format {
            PictureFormat::Png => view::PictureFormat::Png,
            PictureFormat::Exr => view::PictureFormat::Exr,
        };
        let mut what: Vec<Quantity> = Vec::new();
        for quantity in arguments.what.iter().map(|&quantity| quantity.into()) {
            if !what.contains(&quantity) {
                what.push(quantity);
            }
        }
        let mut model = run_folder::read_model(&arguments.model)?;
        settings::override_model(&mut model, &arguments.set)?;
        // The crop is part of the job, so pictures with a different crop are rendered again.
        model.config.scene.crop = arguments.crop.of(&model.config);
        backends::check(&model.config.backend)?;
        let cameras = resize(chosen(arguments, &model.config)?, arguments.scale)?;
        let out = arguments.out.clone().unwrap_or_else(|| beside(&arguments.model));
        let shutter = arguments.shutter;
        if !(0.0..=1.0).contains(&shutter) {
            let expected = "expected a fraction of the time between two frames, from 0 to 1";
            return Err(Error::input(format!("--shutter {shutter}"), "out of range", expected));
        }
        let blur = arguments.motion_blur.map(|cameras| MotionBlur { cameras, shutter });
        Ok(Self { model, cameras, what, format, blur, out })
    }

    /// Returns the cameras of all pictures that are rendered, several per view with motion blur.
    fn all_cameras(&self) -> Vec<Named> {
        self.blur.map_or_else(|| self.cameras.clone(), |blur| blur.of_path(&self.cameras))
    }

    /// Returns a digest that is equal on all ranks with the same work.
    fn digest(&self) -> Result<String> {
        let Self { model, cameras, what, format, blur, out } = self;
        Ok(digest([model.hash()?.to_string(), format!("{cameras:?} {what:?} {format:?} {blur:?} {out:?}")]))
    }

    /// Renders a view and writes its pictures. Returns `None` if `watch` stopped it.
    fn draw(
        &self,
        session: &mut dyn Viewer,
        view: usize,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<RenderedView>> {
        let (name, camera) = &self.cameras[view];
        let started = Instant::now();
        let frame = match self.blur {
            None => session.render_watched(camera, watch)?,
            Some(blur) => blurred(session, &blur.of_frame(&self.cameras, view), watch)?,
        };
        let Some(frame) = frame else { return Ok(None) };
        let took = started.elapsed().as_secs_f64();
        let scene = &self.model.config.scene;
        let view = view::Rendered { name, frame: &frame, camera };
        let paths = view::write(&self.out, view, &self.what, self.format, scene)?;
        Ok(Some(RenderedView { paths, took }))
    }
}

/// Renders the mean of the pictures of several cameras. Returns `None` if `watch` stopped it.
fn blurred(
    session: &mut dyn Viewer,
    cameras: &[Camera],
    watch: &mut dyn FnMut(u32, u32) -> bool,
) -> Result<Option<Frame>> {
    let mut mean = Mean::default();
    for (index, camera) in cameras.iter().enumerate() {
        let (before, count) = (index as u32, cameras.len() as u32);
        let mut part = |done: u32, all: u32| watch(before * all + done, count * all);
        let Some(frame) = session.render_watched(camera, &mut part)? else { return Ok(None) };
        mean.add(&frame);
    }
    Ok(Some(mean.frame()))
}

/// Fails before rendering if the video could not be written afterwards.
fn check_video(arguments: &RenderArguments, path: &Path, what: &[Quantity], cameras: &[Named]) -> Result<()> {
    let refuse =
        |what: &str, expected: &str| Err(Error::input(format!("--video {}", path.display()), what, expected));
    if !is_film(arguments) {
        return refuse("has only one view", "add --turntable N, --flythrough N or --path FILE");
    }
    if arguments.format != PictureFormat::Png || !what.contains(&Quantity::Color) {
        return refuse("is made of colours in PNG files", "leave out --format, and name color in --what");
    }
    if !(arguments.rate > 0.0 && arguments.rate <= 1000.0) {
        return refuse(
            &format!("{} pictures a second", arguments.rate),
            "expected --rate above 0, at most 1000",
        );
    }
    let size = |camera: &Camera| (camera.intrinsics.width, camera.intrinsics.height);
    if cameras.iter().any(|(_, camera)| size(camera) != size(&cameras[0].1)) {
        return refuse("has views of several sizes", "give all frames of the path the same w and h");
    }
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        run_folder::create_writable(folder)?;
    }
    video::check(path, cameras.first().map_or([1; 2], |(_, camera)| size(camera).into()))
}

/// Summarises the rendering speed of the views, without the time for writing files.
fn speed(mut seconds: Vec<f64>) -> Option<String> {
    seconds.sort_by(f64::total_cmp);
    let median = *seconds.get(seconds.len() / 2)?;
    let rate = format!("{:.2} frames/s", 1.0 / median);
    Some(match seconds.len() {
        1 => format!("1 view rendered, {median:.3} s, {rate}"),
        count => format!("{count} views rendered, median {median:.3} s each, {rate}"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_view_is_one_and_two_are_more() {
        assert!(speed(vec![0.5]).unwrap().starts_with("1 view rendered"));
        assert!(speed(vec![0.5, 0.5]).unwrap().starts_with("2 views rendered"));
        assert_eq!(speed(vec![]), None);
    }
}
