//! Writes rendered views as files: colour, depth and opacity as PNG or EXR, and their cameras.

use super::{
    cameras,
    pictures::{self, DepthRange},
    turntable,
};
use serde_json::json;
use std::path::{Path, PathBuf};
use trimip_core::{
    Advice, Camera, Error, Frame, Result, atomic::write_atomically, config::SceneConfig,
    scene::origin::LocalOrigin,
};

/// File format of rendered views.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum PictureFormat {
    /// Colour as 8-bit sRGB; depth and opacity as 16-bit grey. The depth file stores its range. One file per quantity.
    Png,
    /// One file per view with 32-bit float channels: linear R G B, Z (world units), opacity.
    Exr,
}

/// A quantity of a view that can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Quantity {
    /// Colour on the configured background.
    Color,
    /// Distance along the optical axis.
    Depth,
    /// 1 - transmittance.
    Opacity,
}

/// Returns the paths of the files that [`write`] writes, in the order of writing.
pub(super) fn paths(out: &Path, name: &str, what: &[Quantity], format: PictureFormat) -> Vec<PathBuf> {
    match format {
        PictureFormat::Exr => vec![out.join(format!("{name}.exr"))],
        PictureFormat::Png => {
            what.iter().map(|&quantity| out.join(format!("{name}_{}.png", suffix(quantity)))).collect()
        }
    }
}

/// A rendered view.
#[derive(Clone, Copy)]
pub struct Rendered<'a> {
    /// Name of the view; the names of its files begin with it.
    pub name: &'a str,
    /// Its pixels.
    pub frame: &'a Frame,
    /// The camera that it was rendered from.
    pub camera: &'a Camera,
}

/// Writes the requested quantities of one view into the folder `out` and returns the paths: `name.exr`, or
/// `name_color.png`, `name_depth.png` and `name_opacity.png`. `scene` is the box that the depth range is derived from.
///
/// # Errors
/// When a file cannot be written, or the build has no EXR.
pub fn write(
    out: &Path,
    view: Rendered<'_>,
    what: &[Quantity],
    format: PictureFormat,
    scene: &SceneConfig,
) -> Result<Vec<PathBuf>> {
    let Rendered { name, frame, camera } = view;
    let (width, height) = (frame.width, frame.height);
    let paths = paths(out, name, what, format);
    if format == PictureFormat::Exr {
        let mut channels = Vec::new();
        for quantity in what {
            match quantity {
                Quantity::Color => {
                    channels.extend(["R", "G", "B"].into_iter().enumerate().map(|(c, name)| {
                        (name, frame.pixels.iter().map(|pixel| pictures::linear(pixel.rgb[c])).collect())
                    }));
                }
                // Infinite where the ray hits nothing, because compositing programs expect this of Z.
                Quantity::Depth => channels.push(("Z", pictures::depth(frame, f32::INFINITY))),
                Quantity::Opacity => channels.push(("opacity", pictures::opacity(frame))),
            }
        }
        let range = what.contains(&Quantity::Depth).then(|| depth_range(scene, camera));
        pictures::write_exr(&paths[0], width, height, channels, range)?;
        return Ok(paths);
    }
    for (quantity, path) in what.iter().zip(&paths) {
        match quantity {
            Quantity::Color => {
                pictures::write_png(path, pictures::rgb_image(width, height, &frame.rgb()))?;
            }
            Quantity::Depth => {
                let range = depth_range(scene, camera);
                pictures::write_depth_png(path, width, height, &pictures::depth(frame, range.far), range)?;
            }
            Quantity::Opacity => {
                pictures::write_png(
                    path,
                    pictures::grey(width, height, &pictures::opacity(frame), 0.0, 1.0),
                )?;
            }
        }
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

/// Returns the depth range of the sphere around the scene's box. Neighbouring views of a turntable share one range.
pub fn depth_range(scene: &SceneConfig, camera: &Camera) -> DepthRange {
    let (centre, half) = turntable::middle(scene);
    let (depth, radius) = ((camera.origin - centre).dot(camera.rotation.z_axis), half.length());
    let near = (depth - radius).max(0.0);
    // Depth behind the camera is clamped to 0, and the range never collapses.
    DepthRange { near: near as f32, far: (depth + radius).max(near + radius) as f32 }
}

/// Name of the file of cameras next to the pictures.
pub const CAMERAS: &str = "cameras.json";

/// Value of `written_by` in the file of cameras. It marks the pictures next to the file as written by this program.
const WRITER: &str = "trimip";

/// Refuses a folder if the pictures of these views, or their cameras, would replace a file that this program did not
/// write. Writes nothing.
///
/// # Errors
/// When there is such a file; the message names it.
pub fn expect_no_others(
    folder: &Path,
    views: &[cameras::Named],
    what: &[Quantity],
    format: PictureFormat,
) -> Result<()> {
    let own = folder.join(CAMERAS);
    let text = trimip_core::plain_file::read_to_string(&own).unwrap_or_default();
    let document: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    if document["written_by"] == WRITER {
        return Ok(());
    }
    let pictures = views.iter().flat_map(|(name, _)| paths(folder, name, what, format));
    match [own].into_iter().chain(pictures).find(|path| path.exists()) {
        None => Ok(()),
        Some(path) => Err(Error::input(
            path.display(),
            "would be replaced, and no rendering wrote it",
            Advice::AnyOf(vec![Advice::OtherFolder, "move this file away".into()]),
        )),
    }
}

/// Writes the cameras in the layout that `--path` reads and in the coordinates of the photographs; `cameras` are relative to
/// `origin`. With `scene`, each camera has its depth range in world units.
///
/// # Errors
/// When the file cannot be written.
pub fn write_cameras(
    path: &Path,
    cameras: &[cameras::Named],
    origin: LocalOrigin,
    scene: Option<&SceneConfig>,
) -> Result<()> {
    let frames: Vec<_> = cameras
        .iter()
        .map(|(name, camera)| {
            let (k, m) = (camera.intrinsics, camera.rotation.transpose().to_cols_array_2d());
            let o = origin.stated(camera.origin);
            let row = |i: usize| [m[i][0], m[i][1], m[i][2], o[i]];
            let mut frame = json!({
                "file_path": name, "w": k.width, "h": k.height, "fl_x": k.fx, "fl_y": k.fy, "cx": k.cx, "cy": k.cy,
                "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
            });
            if let Some((model, terms)) = trimip_data::lens_terms(&k.lens) {
                frame["camera_model"] = json!(model);
                terms.into_iter().for_each(|(key, term)| frame[key] = json!(term));
            }
            if let Some(scene) = scene {
                let range = depth_range(scene, camera);
                (frame["depth_near"], frame["depth_far"]) = (json!(range.near), json!(range.far));
            }
            frame
        })
        .collect();
    let text = serde_json::to_string_pretty(&json!({ "written_by": WRITER, "frames": frames }))
        .map_err(Error::run)?;
    write_atomically(path, text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use serde_json::Value;
    use trimip_core::{Intrinsics, Lens, geometry::projections::Model};

    /// Parses `eye/target` as a camera.
    fn look_at(text: &str, intrinsics: Intrinsics) -> Camera {
        let numbers: Vec<f64> = text.split([',', '/']).map(|number| number.parse().unwrap()).collect();
        let at = |first: usize| DVec3::new(numbers[first], numbers[first + 1], numbers[first + 2]);
        Camera::look_at(intrinsics, at(0), at(3), DVec3::Z)
    }

    #[test]
    fn written_cameras_are_read_back_as_they_were() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cameras.json");
        let intrinsics = Intrinsics {
            width: 50,
            height: 40,
            fx: 60.0,
            fy: 61.0,
            cx: 24.0,
            cy: 21.0,
            ..Intrinsics::default()
        };
        let bent = Lens::perspective([0.1, -0.02, 0.0, 0.0], [0.0, 0.003], [0.0; 3]);
        let scene =
            SceneConfig { aabb_min: [-1.0; 3], aabb_max: [1.0; 3], ..trimip_core::Config::default().scene };
        let every = Model::ALL.iter().map(|model| (None, Lens::of(*model)));
        let origin = LocalOrigin::at(&[4_075_539.0, 931_735.0, 4_801_629.0]);
        let lenses = [(None, Lens::default()), (Some(&scene), Lens::default()), (None, bent)];
        for (ranged, lens) in lenses.into_iter().chain(every) {
            let camera = look_at("3,1,2/0,0.5,0", Intrinsics { lens, ..intrinsics });
            write_cameras(&path, &[("a".into(), camera)], origin, ranged).unwrap();
            let read = cameras::path(&path, Intrinsics::from_angle(1, 1, 1.0), origin).unwrap();
            assert!((read[0].1.origin - camera.origin).length() < 2e-9, "{:?}", read[0].1);
            assert_eq!(Camera { origin: camera.origin, ..read[0].1 }, camera);
            let json: Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
            let at = |row: usize| json["frames"][0]["transform_matrix"][row][3].as_f64().unwrap();
            assert!((at(0) - 4_075_542.0).abs() + (at(1) - 931_736.0).abs() < 2e-9, "{json}");
            let stated =
                ["depth_near", "depth_far"].map(|key| json["frames"][0][key].as_f64().map(|v| v as f32));
            let range = ranged.map(|scene| depth_range(scene, &camera));
            assert_eq!(stated, [range.map(|range| range.near), range.map(|range| range.far)]);
        }
    }

    #[test]
    fn files_of_others_are_named_and_those_of_a_rendering_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let (here, views) =
            (folder.path(), [("a".to_string(), look_at("3,1,2/0,0,0", Intrinsics::from_angle(1, 1, 1.0)))]);
        let check =
            || expect_no_others(here, &views, &[Quantity::Color, Quantity::Depth], PictureFormat::Png);
        for name in ["a_color.png", "a_depth.png", CAMERAS] {
            check().unwrap();
            std::fs::write(here.join(name), "{\"frames\": []}").unwrap();
            let error = check().unwrap_err();
            assert!(
                error.kind() == trimip_core::ErrorKind::Input && error.message().contains(name),
                "{error}"
            );
            std::fs::remove_file(here.join(name)).unwrap();
        }
        std::fs::write(here.join("b_color.png"), "mine").unwrap();
        check().unwrap();
        write_cameras(&here.join(CAMERAS), &views, LocalOrigin::default(), None).unwrap();
        std::fs::write(here.join("a_color.png"), "a picture").unwrap();
        check().unwrap();
    }

    #[test]
    fn the_range_of_depths_holds_the_box_wherever_the_camera_looks() {
        let scene = SceneConfig {
            aabb_min: [-1.0, -2.0, 0.0],
            aabb_max: [1.0, 0.5, 3.0],
            ..trimip_core::Config::default().scene
        };
        let k = Intrinsics::from_angle(8, 8, 0.7);
        for text in ["9,0,2/0,0,1", "9,0,2/0,9,1", "0.5,0,1/3,3,3", "9,0,2/99,0,3"] {
            let camera = look_at(text, k);
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
}
