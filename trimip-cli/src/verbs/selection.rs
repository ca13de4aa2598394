//! The cameras that the options of `render` select, and the folder of their pictures.

use crate::{args::RenderArguments, cameras};
use glam::DVec3;
use std::path::{Path, PathBuf};
use trimip::run::{cameras::training_cameras, store::file_stem};
use trimip::view::{Named, cameras::resized, flythrough, turntable, turntable::Turntable};
use trimip::{Camera, Config, Error, Intrinsics, Result, view};
use trimip_core::scene::origin::LocalOrigin;

/// Default width and height of pictures, pixels.
const SIDE: u32 = 800;

/// Default horizontal field of view, degrees; the value of the Blender scenes.
const FOV: f64 = 39.597_758_2;

/// Returns true if the pictures are the frames of a film.
pub fn is_film(arguments: &RenderArguments) -> bool {
    arguments.path.is_some() || arguments.turntable.is_some() || arguments.flythrough.is_some()
}

/// Returns the path of `renders` in the run folder, or next to the model file.
pub fn beside(model: &Path) -> PathBuf {
    let folder = if model.is_dir() { model } else { model.parent().unwrap_or(Path::new("")) };
    folder.join("renders")
}

/// Returns the cameras that the arguments select, in the coordinates of the model. Arguments are in the coordinates of the photographs.
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
    let origin = LocalOrigin::of(&config.data);
    if let Some(text) = &arguments.pose {
        return Ok(vec![("pose".into(), origin.local(cameras::pose(text, intrinsics)?))]);
    }
    if let Some(text) = &arguments.look_at {
        return Ok(vec![("look_at".into(), origin.local(cameras::look_at(text, up, intrinsics)?))]);
    }
    if let Some(file) = &arguments.path {
        return view::cameras::path(file, intrinsics, origin);
    }
    if let Some(count) = arguments.turntable {
        let (elevation, distance) = (arguments.elevation, arguments.distance);
        return turntable::cameras(&config.scene, &Turntable { count, elevation, distance, up }, intrinsics);
    }
    if let Some(count) = arguments.flythrough {
        let (_, half) = turntable::middle(&config.scene);
        let photographed = photographed(&arguments.model, config)?;
        let along = flythrough::cameras(&photographed, count, half.length())?;
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

/// Returns the training cameras: from the data set or, if that is missing, from the run folder.
///
/// # Errors
/// When neither has training cameras.
pub fn photographed(model: &Path, config: &Config) -> Result<Vec<Camera>> {
    let missing = match trimip_data::open_test(&config.section()?) {
        Ok(data) => return Ok(data.train),
        Err(error) => error,
    };
    training_cameras(model, LocalOrigin::of(&config.data))?.ok_or(missing)
}

/// Returns the intrinsics of `--width`, `--height` and `--fov`. Without these options, the aspect ratio and the horizontal field of view
/// are those of `like`.
fn stated(arguments: &RenderArguments, like: Intrinsics) -> Intrinsics {
    let RenderArguments { width, height, fov, .. } = *arguments;
    if (width, height, fov) == (None, None, None) {
        return like;
    }
    let aspect = f64::from(like.width) / f64::from(like.height);
    let side = |pixels: f64| pixels.round().clamp(1.0, view::cameras::MAX_SIDE) as u32;
    let width = width.or(height.map(|height| side(f64::from(height) * aspect))).unwrap_or(like.width);
    let height = height.unwrap_or_else(|| side(f64::from(width) / aspect));
    if fov.is_none() && !like.lens.model.definition().angles {
        let [x, y] = [f64::from(width) / f64::from(like.width), f64::from(height) / f64::from(like.height)];
        let (fx, fy, cx, cy) = (like.fx * x, like.fy * y, like.cx * x, like.cy * y);
        return Intrinsics { width, height, fx, fy, cx, cy, lens: like.lens };
    }
    let angle = fov.map_or_else(|| 2.0 * (0.5 * f64::from(like.width) / like.fx).atan(), f64::to_radians);
    Intrinsics::from_angle(width, height, angle)
}

/// Returns the index of the first test view that the arguments select, or 0; `None` if they select another camera.
pub fn test_view(arguments: &RenderArguments) -> Option<usize> {
    let RenderArguments { pose, look_at, views, .. } = arguments;
    let other = pose.is_some() || look_at.is_some() || is_film(arguments);
    (!other).then(|| views.first().copied().unwrap_or(0))
}

/// Returns the cameras of test views at full size; that of view 0 if `views` is empty.
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

/// Scales the pixels along each side of the views by `factor`.
pub fn resize(cameras: Vec<Named>, factor: f64) -> Result<Vec<Named>> {
    cameras
        .into_iter()
        .map(|(name, camera)| {
            Ok((name, Camera { intrinsics: resized(camera.intrinsics, factor)?, ..camera }))
        })
        .collect()
}
