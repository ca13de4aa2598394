//! Tests of every registered camera model: transforms files, multi-scale sets and COLMAP models are read, written and
//! read again, and the built-in scene is rendered through its cameras. A new model is tested without a change here.

use crate::common::{colmap::Sparse, save_image};
use glam::DVec3;
use serde_json::{Value, json};
use std::path::Path;
use trimip_core::{Camera, Intrinsics, geometry::projections::Model};
use trimip_data::settings::{DataConfig, Finish};
use trimip_data::{builtin, lens_terms, unwatched};

/// Returns a camera of each model around the built-in scene.
fn cameras(width: u32, height: u32) -> Vec<Camera> {
    let camera = |model: &Model| {
        let k = model.example(width, height);
        let k = Intrinsics { cx: k.cx + 1.25, fy: 0.875 * k.fy, ..k };
        Camera::look_at(k, DVec3::new(2.5, -2.5, 1.5), DVec3::ZERO, DVec3::Z)
    };
    Model::ALL.iter().map(camera).collect()
}

/// Returns the frame of a transforms file for a camera, with its own keys.
fn frame(name: &str, camera: &Camera) -> Value {
    let (k, r, o) = (camera.intrinsics, camera.rotation.transpose().to_cols_array_2d(), camera.origin);
    let row = |i: usize| json!([r[i][0], r[i][1], r[i][2], o[i]]);
    let mut frame = json!({
        "file_path": name, "w": k.width, "h": k.height, "fl_x": k.fx, "fl_y": k.fy, "cx": k.cx, "cy": k.cy,
        "transform_matrix": [row(0), row(1), row(2), [0, 0, 0, 1]],
    });
    if let Some((model, terms)) = lens_terms(&k.lens) {
        frame["camera_model"] = json!(model);
        terms.into_iter().for_each(|(key, term)| frame[key] = json!(term));
    }
    frame
}

/// Writes pictures of the built-in scene and their transforms files, with one frame of each model.
fn write(folder: &Path) -> Vec<Camera> {
    let all = cameras(24, 16);
    for split in ["train", "test"] {
        std::fs::create_dir_all(folder.join(split)).unwrap();
        let frames: Vec<Value> = (0..)
            .zip(&all)
            .map(|(i, camera)| {
                let pixels = builtin::render(camera, 2, Finish::Mixed, &|| ());
                let name = format!("{split}/{i}.png");
                image::save_buffer(
                    folder.join(&name),
                    pixels.as_flattened(),
                    24,
                    16,
                    image::ColorType::Rgba8,
                )
                .unwrap();
                frame(&name, camera)
            })
            .collect();
        let text = json!({ "frames": frames }).to_string();
        std::fs::write(folder.join(format!("transforms_{split}.json")), text).unwrap();
    }
    all
}

fn data(folder: &Path, format: &str) -> DataConfig {
    let mut data = DataConfig::default();
    (data.root, data.format, data.scales) = (folder.to_str().unwrap().into(), format.into(), 2);
    data
}

/// Returns the cameras of all training views, fine to coarse.
fn read(data: &DataConfig) -> Vec<Camera> {
    let scene = trimip_data::open(data).unwrap();
    scene.train.views.iter().map(|view| view.camera).collect()
}

fn assert_same(found: &[Camera], expected: &[Camera]) {
    assert_eq!(found.len(), expected.len());
    for (a, b) in found.iter().zip(expected) {
        assert_eq!(a.intrinsics, b.intrinsics);
        assert!((a.origin - b.origin).length() < 1e-12 && a.rotation.abs_diff_eq(b.rotation, 1e-12));
    }
}

#[test]
fn models_of_transforms_and_of_multiscale_sets_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let (own, written) = (folder.path().join("own"), folder.path().join("written"));
    let all = write(&own);
    let reduced = |camera: &Camera| Camera { intrinsics: camera.intrinsics.reduced(1), ..*camera };
    let expected: Vec<Camera> = all.iter().copied().chain(all.iter().map(reduced)).collect();
    assert_same(&read(&data(&own, "blender")), &expected);
    trimip_data::write_multiscale(&data(&own, "blender"), &written, &unwatched).unwrap();
    assert_same(&read(&data(&written, "multiscale")), &expected);
}

/// Writes a training split of one frame of 24 × 16 pixels with these keys in the file and in the frame.
fn state(folder: &Path, file: &Value, own: &Value) -> DataConfig {
    save_image(&folder.join("train/0.png"), 24, 16);
    let mut frame = json!({
        "file_path": "train/0.png",
        "transform_matrix": [[1, 0, 0, 0.5], [0, 1, 0, 0.25], [0, 0, 1, 4], [0, 0, 0, 1]],
    });
    let mut document = file.clone();
    own.as_object().into_iter().flatten().for_each(|(key, value)| frame[key] = value.clone());
    document["frames"] = json!([frame]);
    for split in ["train", "test"] {
        std::fs::write(folder.join(format!("transforms_{split}.json")), document.to_string()).unwrap();
    }
    DataConfig { scales: 1, ..data(folder, "blender") }
}

/// Returns the camera of a file with these keys.
fn stated(file: Value, own: Value) -> trimip_core::Result<Camera> {
    let folder = tempfile::tempdir().unwrap();
    let scene = trimip_data::open(&state(folder.path(), &file, &own))?;
    Ok(scene.train.views[0].camera)
}

#[test]
fn a_model_that_nobody_has_is_refused_with_the_names_of_all() {
    let error = stated(json!({ "camera_model": "FOV", "fl_x": 20.0 }), json!({})).unwrap_err();
    assert_eq!(error.kind(), trimip_core::ErrorKind::Input);
    for model in Model::ALL {
        let text = error.to_string();
        assert!(model.definition().file_names.iter().all(|name| text.contains(name)), "{text}");
    }
}

#[test]
fn models_of_colmap_are_those_of_the_registry() {
    let folder = tempfile::tempdir().unwrap();
    let mut sparse = Sparse::default();
    let mut expected = Vec::new();
    for (model, colmap) in Model::ALL.iter().flat_map(|m| m.definition().colmap.iter().map(move |c| (*m, c)))
    {
        let id = sparse.cameras.len() as u32 + 1;
        let value = |name: &&str| match *name {
            "w" => 24.0,
            "h" => 16.0,
            "cx" => 11.5,
            "cy" => 8.25,
            focal if focal.starts_with('f') => 20.0,
            _ => 0.0,
        };
        let parameters = colmap.parameters.iter().map(value).collect();
        sparse.cameras.push((id, colmap.number, colmap.name, [24, 16], parameters));
        let name = format!("{id:02}.png");
        save_image(&folder.path().join("images").join(&name), 24, 16);
        sparse.images.push((
            id,
            [1.0, 0.0, 0.0, 0.0],
            [0.125 * f64::from(id), 0.0, 4.0],
            id,
            name,
            Vec::new(),
        ));
        expected.push((model, colmap.parameters));
    }
    for binary in [false, true] {
        let model = folder.path().join("sparse/0");
        if binary {
            sparse.write_binary(&model);
        } else {
            sparse.write_text(&model);
        }
        let mut data = data(folder.path(), "colmap");
        (data.scales, data.holdout) = (1, 4);
        let scene = trimip_data::open(&data).unwrap();
        assert!(!scene.train.views.is_empty());
        for view in &scene.train.views {
            let index: usize = view.name.trim_end_matches(".png").parse().unwrap();
            let (model, parameters) = &expected[index - 1];
            let k = view.camera.intrinsics;
            assert_eq!((k.lens.model, k.width, k.height), (*model, 24, 16), "{}", view.name);
            match model.definition().focal {
                Some(focal) if !parameters.contains(&"f") => {
                    assert_eq!(([k.fx, k.fy], k.cx, k.cy), (focal(24.0, 16.0), 12.0, 8.0));
                }
                _ => assert_eq!((k.fx, k.fy, k.cx, k.cy), (20.0, 20.0, 11.5, 8.25)),
            }
        }
    }
}

#[test]
fn an_orthographic_camera_is_stated_by_pixels_a_unit_or_by_its_width() {
    // The longer side of 24 pixels is 3 units wide. An angle of view has no effect on an orthographic camera.
    let scale = json!({ "camera_model": "ORTHOGRAPHIC", "ortho_scale": 3.0, "camera_angle_x": 0.7 });
    let k = stated(scale.clone(), json!({})).unwrap().intrinsics;
    assert_eq!((k.lens.model, k.fx, k.fy, k.cx, k.cy), (Model::Orthographic, 8.0, 8.0, 12.0, 8.0));
    let own = stated(scale, json!({ "fl_x": 5.0, "fl_y": 6.0 })).unwrap().intrinsics;
    assert_eq!((own.lens.model, own.fx, own.fy), (Model::Orthographic, 5.0, 6.0));
    let flagged = stated(json!({ "fl_x": 5.0 }), json!({ "orthographic": true })).unwrap().intrinsics;
    assert_eq!((flagged.lens.model, flagged.fx, flagged.fy), (Model::Orthographic, 5.0, 5.0));
    for (file, what) in [
        (json!({ "camera_model": "ORTHOPHOTO", "camera_angle_x": 0.7 }), "ortho_scale"),
        (json!({ "camera_model": "ORTHOPHOTO", "ortho_scale": -1.0 }), "ortho_scale"),
        (json!({ "camera_model": "ORTHOPHOTO", "fl_x": 5.0, "k1": 0.1 }), "k1 = 0.1"),
        (json!({ "orthographic": "yes" }), "orthographic"),
    ] {
        let error = stated(file, json!({})).unwrap_err();
        assert!(error.kind() == trimip_core::ErrorKind::Input && error.to_string().contains(what), "{error}");
    }
}

#[test]
fn the_built_in_scene_has_its_size_in_an_orthographic_picture() {
    let k = Model::Orthographic.example(240, 240);
    // Seen from above, along −z, every surface lies at its x and y: the picture is the scene's shadow at 80 pixels per unit.
    let camera = Camera::look_at(k, DVec3::new(0.0, 0.0, 5.0), DVec3::ZERO, DVec3::Y);
    let pixels = builtin::render(&camera, 1, Finish::Mixed, &|| ());
    for (i, pixel) in pixels.iter().enumerate() {
        let [x, y] = [(i % 240) as f64, (i / 240) as f64].map(|at| (at + 0.5 - 120.0) / 80.0);
        let from = DVec3::new(x, -y, 5.0);
        assert_eq!(pixel[3] == 255, builtin::radiance(from, -DVec3::Z).is_some(), "{from}");
    }
}

#[test]
fn a_panorama_is_stated_by_its_name_alone() {
    let whole = (Model::Equirectangular, 12.0, 16.0, 12.0, 8.0);
    for (file, own) in [
        (json!({ "camera_model": "EQUIRECTANGULAR" }), json!({})),
        (json!({ "camera_angle_x": 0.7 }), json!({ "camera_model": "equirectangular" })),
        (json!({ "equirectangular": true }), json!({})),
        (
            json!({ "camera_model": "EQUIRECTANGULAR", "w": 24, "h": 16 }),
            json!({ "fl_x": 12.0, "fl_y": 16.0 }),
        ),
    ] {
        let k = stated(file, own).unwrap().intrinsics;
        assert_eq!((k.lens.model, k.fx, k.fy, k.cx, k.cy), whole);
    }
    let error = stated(json!({ "camera_model": "EQUIRECTANGULAR", "k1": 0.1 }), json!({})).unwrap_err();
    assert!(error.to_string().contains("k1 = 0.1"), "{error}");
}

#[test]
fn a_panorama_shows_the_built_in_scene_in_the_directions_of_its_pixels() {
    let focal = Model::Equirectangular.definition().focal.unwrap();
    let [fx, fy] = focal(128.0, 64.0);
    let k = Intrinsics { fx, fy, cx: 64.0, cy: 32.0, ..Model::Equirectangular.example(128, 64) };
    let eye = DVec3::new(1.6, -1.4, 1.0);
    let camera = Camera::look_at(k, eye, DVec3::ZERO, DVec3::Z);
    let pixels = builtin::render(&camera, 1, Finish::Mixed, &|| ());
    let pi = std::f64::consts::PI;
    let mut seen = 0;
    for (i, pixel) in pixels.iter().enumerate() {
        let (longitude, latitude) =
            (pi * ((i % 128) as f64 + 0.5 - 64.0) / 64.0, pi * (32.0 - (i / 128) as f64 - 0.5) / 64.0);
        let local =
            DVec3::new(longitude.sin() * latitude.cos(), latitude.sin(), -longitude.cos() * latitude.cos());
        seen += usize::from(pixel[3] == 255);
        assert_eq!(pixel[3] == 255, builtin::radiance(eye, camera.rotation * local).is_some(), "{i}");
    }
    assert!(seen > 100 && seen < 4096, "{seen}");
}
