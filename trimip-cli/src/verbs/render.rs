//! `render`: views of a model as pictures, from test views, a pose, a camera path or a turntable.

use super::strip;
use crate::{
    args::{PictureFormat, Quantity, RenderArguments},
    backends, cameras, interrupt,
    pictures::{self, DepthRange},
    progress::bar,
    run_folder, settings,
    store::file_stem,
    terminal,
    turntable::{self, Turntable},
};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;
use trimip_core::{
    Camera, Config, Error, Frame, Intrinsics, Result, config::SceneConfig, tensors::write_atomically,
};

/// Renders every camera the arguments name.
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
    let mut model = run_folder::read_model(&arguments.model)?;
    settings::override_model(&mut model, &arguments.set)?;
    let config = model.config.clone();
    backends::check(&config.backend)?;
    let cameras = resize(chosen(arguments, &config)?, arguments.scale)?;
    let out = arguments.out.clone().unwrap_or_else(|| beside(&arguments.model));
    run_folder::create_writable(&out)?;
    let stop = interrupt::install()?;
    let mut session = backends::load(&model)?;
    backends::software_remark(&config).iter().for_each(|remark| terminal::note(format!("warning: {remark}")));
    session.notes().iter().for_each(|note| terminal::note(format!("warning: {note}")));
    let ranged = arguments.what.contains(&Quantity::Depth).then_some(&config.scene);
    write_cameras(&out.join("cameras.json"), &cameras, ranged)?;

    let rows = |camera: &Camera| u64::from(camera.intrinsics.height);
    let bar =
        bar("{bar:30} {percent:>3} %  {eta} left", cameras.iter().map(|(_, camera)| rows(camera)).sum());
    let mut seconds = Vec::new();
    for (name, camera) in &cameras {
        let started = Instant::now();
        let before = bar.position();
        let watch = &mut |done: u32, _: u32| {
            bar.set_position(before + u64::from(done));
            !stop.load(Ordering::Relaxed)
        };
        let Some(frame) = session.render_watched(camera, watch)? else {
            return Ok(interrupt::EXIT_CODE);
        };
        seconds.push(started.elapsed().as_secs_f64());
        for path in write(&out, name, &frame, camera, arguments, &config.scene)? {
            bar.suspend(|| terminal::line(path.display()));
        }
        bar.set_position(before + rows(camera));
    }
    bar.finish_and_clear();
    if let Some(line) = speed(seconds) {
        terminal::aside(line);
    }
    Ok(0)
}

/// How fast the views were rendered, files and pictures aside.
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

/// The cameras that the arguments name.
pub fn chosen(arguments: &RenderArguments, config: &Config) -> Result<Vec<cameras::Named>> {
    if !(arguments.fov > 0.0 && arguments.fov < 180.0) {
        return Err(Error::input(
            format!("--fov {}", arguments.fov),
            "out of range",
            "expected degrees above 0 and below 180",
        ));
    }
    let intrinsics = Intrinsics::from_angle(arguments.width, arguments.height, arguments.fov.to_radians());
    let up = cameras::vector("--up", &arguments.up)?;
    if let Some(text) = &arguments.pose {
        return Ok(vec![("pose".into(), cameras::pose(text, intrinsics)?)]);
    }
    if let Some(text) = &arguments.look_at {
        return Ok(vec![("look_at".into(), cameras::look_at(text, up, intrinsics)?)]);
    }
    if let Some(file) = &arguments.path {
        return cameras::path(file, intrinsics);
    }
    if let Some(count) = arguments.turntable {
        let (elevation, distance) = (arguments.elevation, arguments.distance);
        return turntable::cameras(&config.scene, &Turntable { count, elevation, distance, up }, intrinsics);
    }
    test_views(config, &arguments.views)
}

/// The first test view that the arguments name, where they name no other camera; view 0 where they name none.
pub fn test_view(arguments: &RenderArguments) -> Option<usize> {
    let RenderArguments { pose, look_at, path, turntable, views, .. } = arguments;
    let other = pose.is_some() || look_at.is_some() || path.is_some() || turntable.is_some();
    (!other).then(|| views.first().copied().unwrap_or(0))
}

/// Cameras of test views at full size; view 0 when none is named.
fn test_views(config: &Config, views: &[usize]) -> Result<Vec<cameras::Named>> {
    let scene = trimip_data::open(&config.data)?;
    let views = if views.is_empty() { &[0] } else { views };
    views
        .iter()
        .map(|&index| {
            if index >= scene.test.len() {
                return Err(Error::input(
                    format!("--views {index}"),
                    format!(
                        "the test split holds {} view{}",
                        scene.test.len(),
                        if scene.test.len() == 1 { "" } else { "s" }
                    ),
                    format!("name views from 0 to {}", scene.test.len().saturating_sub(1)),
                ));
            }
            let set = scene.test.load(index)?;
            let view = set.views.first().ok_or_else(|| {
                Error::input(format!("--views {index}"), "the view is empty", "choose another view")
            })?;
            Ok((format!("{index:04}_{}", file_stem(&view.name)), view.camera))
        })
        .collect()
}

/// The same views with `factor` times as many pixels along each side.
pub fn resize(cameras: Vec<cameras::Named>, factor: f64) -> Result<Vec<cameras::Named>> {
    cameras
        .into_iter()
        .map(|(name, camera)| {
            Ok((name, Camera { intrinsics: cameras::resized(camera.intrinsics, factor)?, ..camera }))
        })
        .collect()
}

/// Writes the asked quantities of one view; returns the files.
fn write(
    out: &Path,
    name: &str,
    frame: &Frame,
    camera: &Camera,
    arguments: &RenderArguments,
    scene: &SceneConfig,
) -> Result<Vec<PathBuf>> {
    let (width, height) = (frame.width, frame.height);
    if arguments.format == PictureFormat::Exr {
        let mut channels = Vec::new();
        for quantity in &arguments.what {
            match quantity {
                Quantity::Color => {
                    channels.extend(["R", "G", "B"].into_iter().enumerate().map(|(c, name)| {
                        (name, frame.pixels.iter().map(|pixel| pictures::linear(pixel.rgb[c])).collect())
                    }))
                }
                // Infinite where nothing is seen, as compositing programs expect of Z.
                Quantity::Depth => channels.push(("Z", pictures::depth(frame, f32::INFINITY))),
                Quantity::Opacity => channels.push(("opacity", pictures::opacity(frame))),
            }
        }
        let path = out.join(format!("{name}.exr"));
        let range = arguments.what.contains(&Quantity::Depth).then(|| depth_range(scene, camera));
        pictures::write_exr(&path, width, height, channels, range)?;
        return Ok(vec![path]);
    }
    let mut paths = Vec::new();
    for quantity in &arguments.what {
        let path = out.join(format!("{name}_{}.png", suffix(*quantity)));
        match quantity {
            Quantity::Color => {
                pictures::write_png(&path, pictures::rgb_image(width, height, &frame.rgb()))?;
            }
            Quantity::Depth => {
                let range = depth_range(scene, camera);
                pictures::write_depth_png(&path, width, height, &pictures::depth(frame, range.far), range)?;
            }
            Quantity::Opacity => {
                pictures::write_png(
                    &path,
                    pictures::grey(width, height, &pictures::opacity(frame), 0.0, 1.0),
                )?;
            }
        }
        paths.push(path);
    }
    Ok(paths)
}

fn suffix(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::Color => "color",
        Quantity::Depth => "depth",
        Quantity::Opacity => "opacity",
    }
}

/// Depths of the ball around the scene's box, so that neighbouring views of a turntable share one range.
fn depth_range(scene: &SceneConfig, camera: &Camera) -> DepthRange {
    let (centre, half) = turntable::middle(scene);
    let (depth, radius) = ((camera.origin - centre).dot(camera.rotation.z_axis), half.length());
    let near = (depth - radius).max(0.0);
    // Behind the camera there is no depth; the range stays one of numbers that differ.
    DepthRange { near: near as f32, far: (depth + radius).max(near + radius) as f32 }
}

/// The cameras beside their pictures, in the layout that `--path` reads; with `scene`, each with its range of depths in
/// world units.
fn write_cameras(path: &Path, cameras: &[cameras::Named], scene: Option<&SceneConfig>) -> Result<()> {
    let frames: Vec<_> = cameras
        .iter()
        .map(|(name, camera)| {
            let (k, m, o) = (camera.intrinsics, camera.rotation.transpose().to_cols_array_2d(), camera.origin);
            let row = |i: usize| [m[i][0], m[i][1], m[i][2], o[i]];
            let mut frame = json!({
                "file_path": name, "w": k.width, "h": k.height, "fl_x": k.fx, "fl_y": k.fy, "cx": k.cx, "cy": k.cy,
                "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
            });
            if let Some(scene) = scene {
                let range = depth_range(scene, camera);
                (frame["depth_near"], frame["depth_far"]) = (json!(range.near), json!(range.far));
            }
            frame
        })
        .collect();
    let text = serde_json::to_string_pretty(&json!({ "frames": frames })).map_err(Error::run)?;
    write_atomically(path, text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use serde_json::Value;

    #[test]
    fn written_cameras_are_read_back_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cameras.json");
        let intrinsics = Intrinsics { width: 50, height: 40, fx: 60.0, fy: 61.0, cx: 24.0, cy: 21.0 };
        let camera = cameras::look_at("3,1,2/0,0.5,0", DVec3::Z, intrinsics).unwrap();
        let scene = SceneConfig { aabb_min: [-1.0; 3], aabb_max: [1.0; 3] };
        for ranged in [None, Some(&scene)] {
            write_cameras(&path, &[("a".into(), camera)], ranged).unwrap();
            let read = cameras::path(&path, Intrinsics::from_angle(1, 1, 1.0)).unwrap();
            assert_eq!(read[0].1, camera);
            let json: Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
            let stated =
                ["depth_near", "depth_far"].map(|key| json["frames"][0][key].as_f64().map(|v| v as f32));
            let range = ranged.map(|scene| depth_range(scene, &camera));
            assert_eq!(stated, [range.map(|range| range.near), range.map(|range| range.far)]);
        }
    }

    #[test]
    fn the_range_of_depths_holds_the_box_wherever_the_camera_looks() {
        let scene = SceneConfig { aabb_min: [-1.0, -2.0, 0.0], aabb_max: [1.0, 0.5, 3.0] };
        let k = Intrinsics::from_angle(8, 8, 0.7);
        for text in ["9,0,2/0,0,1", "9,0,2/0,9,1", "0.5,0,1/3,3,3", "9,0,2/99,0,3"] {
            let camera = cameras::look_at(text, DVec3::Z, k).unwrap();
            let range = depth_range(&scene, &camera);
            assert!(0.0 <= range.near && range.near < range.far, "{text}");
            for i in 0..8 {
                let corner = |axis: usize| [scene.aabb_min, scene.aabb_max][i >> axis & 1][axis].into();
                let corner = DVec3::new(corner(0), corner(1), corner(2));
                let depth = (camera.origin - corner).dot(camera.rotation.z_axis);
                assert!(depth < 0.0 || (range.near..=range.far).contains(&(depth as f32)), "{text}: {depth}");
            }
        }
    }

    #[test]
    fn one_view_is_one_and_two_are_more() {
        assert!(speed(vec![0.5]).unwrap().starts_with("1 view rendered"));
        assert!(speed(vec![0.5, 0.5]).unwrap().starts_with("2 views rendered"));
        assert_eq!(speed(vec![]), None);
    }
}
