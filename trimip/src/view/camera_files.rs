//! Writes cameras as files that other programs read: a transforms file (nerfstudio, instant-ngp), the text files of a COLMAP model,
//! or the cameras of a glTF scene (Blender, three.js). World axes and units are those of the photographs.

use super::{Named, write_cameras};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use trimip_core::{
    Camera, Error, Result, atomic::write_atomically, geometry::projections::Model, scene::origin::LocalOrigin,
};

/// Distance of the near plane of cameras in glTF, world units. glTF requires one above 0; renderings here have none.
const NEAR: f64 = 0.01;

/// Distance of the principal point from the middle of the image that glTF can leave out, pixels.
const CENTRED: f64 = 0.5;

/// A format of camera files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum CameraFormat {
    /// A transforms file: `.json`.
    Transforms,
    /// A glTF scene with one node and camera per view: `.gltf`. A camera in glTF has a field of view and an aspect ratio; its exact
    /// projection is in the `extras` of its node, with the keys of a transforms file.
    Gltf,
    /// A folder with the text files of a COLMAP model without points: a name without extension.
    Colmap,
}

impl CameraFormat {
    /// Returns the format that the name of a file or folder stands for.
    ///
    /// # Errors
    /// When the extension stands for no format.
    pub fn of(path: &Path) -> Result<Self> {
        match path.extension().map(|ending| ending.to_string_lossy().to_lowercase()).as_deref() {
            Some("json") => Ok(Self::Transforms),
            Some("gltf") => Ok(Self::Gltf),
            None => Ok(Self::Colmap),
            Some(_) => Err(Error::input(
                path.display(),
                "names no format of cameras",
                "end it in .json (transforms) or .gltf, or name a folder without extension (COLMAP)",
            )),
        }
    }
}

/// Writes cameras in the format of `path`'s name, in the coordinates of the photographs; `cameras` are relative to `origin`. Returns
/// the files, and one line for each property that the format does not have.
///
/// # Errors
/// When the name stands for no format, the format has no such camera, or a file cannot be written.
pub fn export_cameras(
    path: &Path,
    cameras: &[Named],
    origin: LocalOrigin,
) -> Result<(Vec<PathBuf>, Vec<String>)> {
    match CameraFormat::of(path)? {
        CameraFormat::Transforms => {
            write_cameras(path, cameras, origin, None)?;
            Ok((vec![path.to_path_buf()], Vec::new()))
        }
        CameraFormat::Gltf => {
            let text = serde_json::to_string_pretty(&gltf(cameras, origin)?).map_err(Error::run)?;
            write_atomically(path, text.as_bytes())?;
            Ok((vec![path.to_path_buf()], approximated(cameras).into_iter().collect()))
        }
        CameraFormat::Colmap => {
            let stated: Vec<_> = cameras
                .iter()
                .map(|(name, camera)| {
                    (name.clone(), Camera { origin: origin.stated(camera.origin), ..*camera })
                })
                .collect();
            let texts = trimip_data::colmap::Texts::of(&stated)?;
            std::fs::create_dir_all(path).map_err(|error| {
                Error::input(path.display(), format!("cannot be created: {error}"), "name another folder")
            })?;
            let files = [
                ("cameras.txt", texts.cameras),
                ("images.txt", texts.images),
                ("points3D.txt", String::new()),
            ];
            let files = files.map(|(name, text)| (path.join(name), text));
            for (file, text) in &files {
                write_atomically(file, text.as_bytes())?;
            }
            Ok((files.map(|(file, _)| file).into(), Vec::new()))
        }
    }
}

/// Returns a glTF scene of the cameras. A camera in glTF looks along −z, as here.
fn gltf(cameras: &[Named], origin: LocalOrigin) -> Result<Value> {
    let mut nodes = Vec::with_capacity(cameras.len());
    let mut list = Vec::with_capacity(cameras.len());
    for (name, camera) in cameras {
        let k = camera.intrinsics;
        if k.lens.model != Model::Perspective {
            return Err(Error::input(
                format!("the camera of {name}"),
                format!("glTF has no {} cameras", k.lens.model.definition().name),
                "choose a transforms file (.json)",
            ));
        }
        let [width, height] = [f64::from(k.width) / k.fx, f64::from(k.height) / k.fy];
        list.push(json!({
            "type": "perspective",
            "perspective": { "yfov": 2.0 * (0.5 * height).atan(), "aspectRatio": width / height, "znear": NEAR },
        }));
        let [x, y, z] = camera.rotation.to_cols_array_2d();
        let at = origin.stated(camera.origin);
        let matrix = [
            [x[0], x[1], x[2], 0.0],
            [y[0], y[1], y[2], 0.0],
            [z[0], z[1], z[2], 0.0],
            [at.x, at.y, at.z, 1.0],
        ];
        let mut extras =
            json!({ "w": k.width, "h": k.height, "fl_x": k.fx, "fl_y": k.fy, "cx": k.cx, "cy": k.cy });
        if let Some((model, terms)) = trimip_data::lens_terms(&k.lens) {
            extras["camera_model"] = json!(model);
            terms.into_iter().for_each(|(key, term)| extras[key] = json!(term));
        }
        nodes.push(json!({
            "name": name, "camera": nodes.len(), "matrix": matrix.as_flattened(), "extras": extras,
        }));
    }
    Ok(json!({
        "asset": { "version": "2.0", "generator": format!("trimip {}", env!("CARGO_PKG_VERSION")) },
        "scene": 0,
        "scenes": [{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }],
        "nodes": nodes,
        "cameras": list,
    }))
}

/// Returns a line that says how many cameras glTF only approximates.
fn approximated(cameras: &[Named]) -> Option<String> {
    let is_exact = |camera: &Camera| {
        let k = camera.intrinsics;
        let off = [k.cx - 0.5 * f64::from(k.width), k.cy - 0.5 * f64::from(k.height)];
        k.lens.is_straight() && off.iter().all(|off| off.abs() <= CENTRED)
    };
    let count = cameras.iter().filter(|(_, camera)| !is_exact(camera)).count();
    (count > 0).then(|| {
        format!(
            "glTF has no distortion, and its principal point is the middle of the image: {count} of {} cameras are approximated; \
             their exact projections are in the extras of their nodes",
            cameras.len()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};
    use trimip_core::{Intrinsics, Lens};

    fn cameras(lens: Lens) -> Vec<Named> {
        let k = Intrinsics { width: 50, height: 40, fx: 60.0, fy: 61.0, cx: 25.0, cy: 20.0, lens };
        let eyes = [DVec3::new(3.0, 1.0, 2.0), DVec3::new(-0.25, 7.0, 0.125)];
        let camera = |eye| Camera::look_at(k, eye, DVec3::new(0.0, 0.5, 0.0), DVec3::Z);
        eyes.iter().enumerate().map(|(i, &eye)| (format!("r_{i}"), camera(eye))).collect()
    }

    #[test]
    fn a_camera_of_gltf_projects_as_its_camera_does() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cameras.gltf");
        let origin = LocalOrigin::at(&[4_075_539.0, 931_735.0, 4_801_629.0]);
        let cameras = cameras(Lens::default());
        let (files, notes) = export_cameras(&path, &cameras, origin).unwrap();
        assert_eq!((files, notes), (vec![path.clone()], Vec::new()));
        let document: Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
        for (index, (name, camera)) in cameras.iter().enumerate() {
            let node = &document["nodes"][index];
            assert_eq!((node["name"].as_str(), node["camera"].as_u64()), (Some(&**name), Some(index as u64)));
            let m: Vec<f64> = serde_json::from_value(node["matrix"].clone()).unwrap();
            let rotation = DMat3::from_cols_array(&[m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]]);
            let at = origin.local(DVec3::new(m[12], m[13], m[14]));
            let perspective = &document["cameras"][index]["perspective"];
            let number = |key: &str| perspective[key].as_f64().unwrap();
            // The equations of glTF: y' = y/(−z·tan(yfov/2)), x' = x/(−z·aspect·tan(yfov/2)), both −1 to 1 within the image.
            for point in [DVec3::new(0.1, 0.2, 0.3), DVec3::new(-0.5, 0.25, 1.0)] {
                let local = rotation.transpose() * (point - at);
                let tangent = (0.5 * number("yfov")).tan();
                let seen = [local.x / (number("aspectRatio") * tangent), local.y / tangent]
                    .map(|part| part / -local.z);
                let local = camera.rotation.transpose() * (point - camera.origin);
                let k = camera.intrinsics;
                let pixel = [k.cx + k.fx * local.x / -local.z, k.cy - k.fy * local.y / -local.z];
                let expected = [2.0 * pixel[0] / 50.0 - 1.0, 1.0 - 2.0 * pixel[1] / 40.0];
                assert!(
                    (0..2).all(|axis| (seen[axis] - expected[axis]).abs() < 1e-8),
                    "{seen:?} {expected:?}"
                );
            }
        }
    }

    #[test]
    fn what_gltf_cannot_say_is_noted_or_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cameras.gltf");
        let bent = Lens::perspective([0.1, -0.02, 0.0, 0.0], [0.0, 0.003], [0.0; 3]);
        let (_, notes) = export_cameras(&path, &cameras(bent), LocalOrigin::default()).unwrap();
        assert!(notes.len() == 1 && notes[0].contains("2 of 2 cameras"), "{notes:?}");
        let document: Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
        assert_eq!(document["nodes"][0]["extras"]["k1"], 0.1);
        let panorama = Model::ALL.iter().copied().find(|model| !model.definition().directed).unwrap();
        let error = export_cameras(&path, &cameras(Lens::of(panorama)), LocalOrigin::default()).unwrap_err();
        assert!(error.message().contains("glTF has no"), "{error}");
        let error = export_cameras(&folder.path().join("a.txt"), &cameras(bent), LocalOrigin::default());
        assert!(error.unwrap_err().message().contains("names no format of cameras"));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_folder_of_colmap_and_a_transforms_file_hold_the_cameras_of_the_photographs() {
        let folder = tempfile::tempdir().unwrap();
        let origin = LocalOrigin::at(&[448_260.0, 5_411_932.0, 311.0]);
        let all = cameras(Lens::default());
        let (files, _) = export_cameras(&folder.path().join("sparse"), &all, origin).unwrap();
        assert_eq!(files.len(), 3);
        let images = std::fs::read_to_string(&files[1]).unwrap();
        assert!(images.contains(" 1 r_0\n") && images.contains(" 1 r_1\n"), "{images}");
        let path = folder.path().join("cameras.json");
        export_cameras(&path, &all, origin).unwrap();
        let read = crate::view::cameras::named_path(&path, Intrinsics::default(), origin).unwrap();
        for ((name, camera), (read_name, read)) in all.iter().zip(&read) {
            assert_eq!(
                (name, camera.intrinsics, camera.rotation),
                (read_name, read.intrinsics, read.rotation)
            );
            assert!((camera.origin - read.origin).length() < 2e-9);
        }
    }
}
