//! `render`: renders views of a model as pictures, from test views, a pose, a camera path, a turntable or a flythrough.

use super::strip;
use crate::{
    args::{PictureFormat, RenderArguments},
    cameras, interrupt,
    progress::bar,
    ranks, terminal,
};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;
use trimip::ranks::{digest, farm, labour};
use trimip::run::{folder as run_folder, store::file_stem};
use trimip::view::{
    Job, Named, Quantity, cameras::resized, flythrough, turntable, turntable::Turntable, video, write_cameras,
};
use trimip::{Camera, Config, Error, Intrinsics, Result, Viewer, backends, model::Model, settings, view};
use trimip_core::exchange::Ranks;

/// Width and height of pictures in pixels, for cameras without.
const SIDE: u32 = 800;

/// Horizontal field of view in degrees, for cameras without: that of the Blender scenes.
const FOV: f64 = 39.597_758_2;

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
    let wanted = Wanted::of(arguments)?;
    let Wanted { model, cameras, what, format, out } = &wanted;
    let (config, what) = (&model.config, &what[..]);
    if let Some(video) = &arguments.video {
        check_video(arguments, video, what, cameras)?;
    }
    view::expect_no_others(out, cameras, what, *format)?;
    run_folder::create_writable(out)?;
    // Single views are quick; many go on where an interrupted command stopped.
    let mut job = match is_film(arguments) {
        true => Some(Job::open(out, model, cameras, what, *format, arguments.fresh)?),
        false => None,
    };
    let stop = interrupt::install()?;
    let mut session = backends::load(model)?;
    backends::software_remark(config).iter().for_each(|remark| terminal::note(format!("warning: {remark}")));
    session.notes().iter().for_each(|note| terminal::note(format!("warning: {note}")));
    let ranged = what.contains(&Quantity::Depth).then_some(&config.scene);
    write_cameras(&out.join(view::CAMERAS), cameras, ranged)?;

    let rows = |camera: &Camera| u64::from(camera.intrinsics.height);
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
        wanted.draw(session.as_mut(), view, &mut |done, _| {
            bar.inc(u64::from(done - told));
            told = done;
            !stop.load(Ordering::Relaxed)
        })
    };
    let mut keep = |view: usize, drawn: Option<Drawn>| -> Result<bool> {
        let Some(Drawn { paths, took }) = drawn else { return Ok(false) };
        seconds.push(took);
        job.as_mut().map_or(Ok(()), |job| job.finish(&cameras[view].0))?;
        paths.iter().for_each(|path| bar.suspend(|| terminal::line(path.display())));
        pictures[view] = Some(paths);
        Ok(!stop.load(Ordering::Relaxed))
    };
    match ranks::all() {
        // The jobs of other ranks are numbers of views.
        Some(all) => farm(&*all, &wanted.digest()?, &left, &|| !stop.load(Ordering::Relaxed), draw, keep)?,
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

/// Does its part of [`run`] on another rank than the first.
///
/// # Errors
/// When the model cannot be opened here.
pub fn help(arguments: &RenderArguments, ranks: &dyn Ranks) -> Result<()> {
    let wanted = Wanted::of(arguments)?;
    let mut session = backends::load(&wanted.model)?;
    let stop = interrupt::install()?;
    let mut going = |_, _| !stop.load(Ordering::Relaxed);
    labour(ranks, &wanted.digest()?, |view| wanted.draw(session.as_mut(), view, &mut going))
}

/// What is rendered, and how.
struct Wanted {
    model: Model,
    cameras: Vec<Named>,
    what: Vec<Quantity>,
    format: view::PictureFormat,
    out: PathBuf,
}

/// The pictures of a view.
#[derive(Serialize, Deserialize)]
struct Drawn {
    paths: Vec<PathBuf>,
    /// Seconds of rendering.
    took: f64,
}

impl Wanted {
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
        backends::check(&model.config.backend)?;
        let cameras = resize(chosen(arguments, &model.config)?, arguments.scale)?;
        let out = arguments.out.clone().unwrap_or_else(|| beside(&arguments.model));
        Ok(Self { model, cameras, what, format, out })
    }

    /// The same on every rank that has the same work.
    fn digest(&self) -> Result<String> {
        let Self { model, cameras, what, format, out } = self;
        Ok(digest([model.hash()?.to_string(), format!("{cameras:?} {what:?} {format:?} {out:?}")]))
    }

    /// Renders a view and writes its pictures; `None` if `watch` stopped it.
    fn draw(
        &self,
        session: &mut dyn Viewer,
        view: usize,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Drawn>> {
        let (name, camera) = &self.cameras[view];
        let started = Instant::now();
        let Some(frame) = session.render_watched(camera, watch)? else { return Ok(None) };
        let took = started.elapsed().as_secs_f64();
        let scene = &self.model.config.scene;
        let paths = view::write(&self.out, name, &frame, camera, &self.what, self.format, scene)?;
        Ok(Some(Drawn { paths, took }))
    }
}

/// Whether the pictures follow one another.
fn is_film(arguments: &RenderArguments) -> bool {
    arguments.path.is_some() || arguments.turntable.is_some() || arguments.flythrough.is_some()
}

/// Fails before the work if a video could not be written after it.
fn check_video(arguments: &RenderArguments, path: &Path, what: &[Quantity], cameras: &[Named]) -> Result<()> {
    let refuse =
        |what: &str, expected: &str| Err(Error::input(format!("--video {}", path.display()), what, expected));
    if !is_film(arguments) {
        return refuse("there is one view", "add --turntable N, --flythrough N or --path FILE");
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
        return refuse("the views have several sizes", "give the frames of the path one w and h");
    }
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        run_folder::create_writable(folder)?;
    }
    video::check(path)
}

/// Rendering speed of the views, without writing files.
fn speed(mut seconds: Vec<f64>) -> Option<String> {
    seconds.sort_by(f64::total_cmp);
    let median = *seconds.get(seconds.len() / 2)?;
    let rate = format!("{:.2} frames/s", 1.0 / median);
    Some(match seconds.len() {
        1 => format!("1 view rendered, {median:.3} s, {rate}"),
        count => format!("{count} views rendered, median {median:.3} s each, {rate}"),
    })
}

/// `renders` in the run folder, or beside the model file.
pub fn beside(model: &Path) -> PathBuf {
    let folder = if model.is_dir() { model } else { model.parent().unwrap_or(Path::new("")) };
    folder.join("renders")
}

/// The cameras that the arguments select.
pub fn chosen(arguments: &RenderArguments, config: &Config) -> Result<Vec<Named>> {
    if let Some(fov) = arguments.fov
        && !(fov > 0.0 && fov < 180.0)
    {
        return Err(Error::input(
            format!("--fov {fov}"),
            "out of range",
            "expected degrees above 0 and below 180",
        ));
    }
    let intrinsics = stated(arguments, Intrinsics::from_angle(SIDE, SIDE, FOV.to_radians()));
    let up = match &arguments.up {
        Some(given) => cameras::vector("--up", given)?,
        None => DVec3::from_array(config.scene.up.map(f64::from)),
    };
    if let Some(text) = &arguments.pose {
        return Ok(vec![("pose".into(), cameras::pose(text, intrinsics)?)]);
    }
    if let Some(text) = &arguments.look_at {
        return Ok(vec![("look_at".into(), cameras::look_at(text, up, intrinsics)?)]);
    }
    if let Some(file) = &arguments.path {
        return view::cameras::path(file, intrinsics);
    }
    if let Some(count) = arguments.turntable {
        let (elevation, distance) = (arguments.elevation, arguments.distance);
        return turntable::cameras(&config.scene, &Turntable { count, elevation, distance, up }, intrinsics);
    }
    if let Some(count) = arguments.flythrough {
        let (_, half) = turntable::middle(&config.scene);
        let along =
            flythrough::cameras(&trimip_data::open_test(&config.section()?)?.train, count, half.length())?;
        let sized = |camera: Camera| Camera { intrinsics: stated(arguments, camera.intrinsics), ..camera };
        return Ok(along.into_iter().map(|(name, camera)| (name, sized(camera))).collect());
    }
    let RenderArguments { width, height, fov, .. } = arguments;
    let given = [("--width", width.is_some()), ("--height", height.is_some()), ("--fov", fov.is_some())];
    if let Some((option, _)) = given.iter().find(|(_, given)| *given) {
        return Err(Error::input(
            *option,
            "test views have the size and the field of view of their photographs",
            "use --scale, or choose another camera (--pose, --look-at, --path, --turntable, --flythrough)",
        ));
    }
    test_views(config, &arguments.views)
}

/// The projection of `--width`, `--height` and `--fov` with square pixels; what is not given is that of `like`.
fn stated(arguments: &RenderArguments, like: Intrinsics) -> Intrinsics {
    let RenderArguments { width, height, fov, .. } = *arguments;
    if (width, height, fov) == (None, None, None) {
        return like;
    }
    let aspect = f64::from(like.width) / f64::from(like.height);
    let side = |pixels: f64| pixels.round().clamp(1.0, view::cameras::MAX_SIDE) as u32;
    let width = width.or(height.map(|height| side(f64::from(height) * aspect))).unwrap_or(like.width);
    let height = height.unwrap_or_else(|| side(f64::from(width) / aspect));
    let angle = fov.map_or_else(|| 2.0 * (0.5 * f64::from(like.width) / like.fx).atan(), f64::to_radians);
    Intrinsics::from_angle(width, height, angle)
}

/// The first test view that the arguments select, or view 0; `None` if they select another camera.
pub fn test_view(arguments: &RenderArguments) -> Option<usize> {
    let RenderArguments { pose, look_at, views, .. } = arguments;
    let other = pose.is_some() || look_at.is_some() || is_film(arguments);
    (!other).then(|| views.first().copied().unwrap_or(0))
}

/// Cameras of test views at full size; view 0 if `views` is empty.
fn test_views(config: &Config, views: &[usize]) -> Result<Vec<Named>> {
    let frames = trimip_data::open_test(&config.section()?)?.frames;
    let views = if views.is_empty() { &[0] } else { views };
    views
        .iter()
        .map(|&index| {
            if index >= frames.len() {
                return Err(Error::input(
                    format!("--views {index}"),
                    format!(
                        "the test split holds {} view{}",
                        frames.len(),
                        if frames.len() == 1 { "" } else { "s" }
                    ),
                    format!("name views from 0 to {}", frames.len().saturating_sub(1)),
                ));
            }
            let set = frames.load(index)?;
            let view = set.views.first().ok_or_else(|| {
                Error::input(format!("--views {index}"), "the view is empty", "choose another view")
            })?;
            Ok((format!("{index:04}_{}", file_stem(&view.name)), view.camera))
        })
        .collect()
}

/// The same views with `factor` times as many pixels along each side.
pub fn resize(cameras: Vec<Named>, factor: f64) -> Result<Vec<Named>> {
    cameras
        .into_iter()
        .map(|(name, camera)| {
            Ok((name, Camera { intrinsics: resized(camera.intrinsics, factor)?, ..camera }))
        })
        .collect()
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
