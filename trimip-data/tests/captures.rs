//! Tests of captures: every format gives the same cameras and pixels, and the files around a COLMAP model are found.

use crate::common::{
    assert_same,
    colmap::{Sparse, capture, capture_by, later_models, models, rotation},
    save_image, settings, write,
};
use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_core::{Camera, Cone, ViewSet};
use trimip_data::settings::DataConfig;
use trimip_data::{Scene, colmap::Model, inspect, open, unwatched, write_multiscale};

/// Saves the photographs of a capture.
fn save_images(folder: &Path, sparse: &Sparse, [width, height]: [u32; 2]) {
    for (.., name, _) in &sparse.images {
        save_image(&folder.join(name), width, height);
    }
}

fn scene(root: &Path) -> Scene {
    open(&settings(root, 2)).unwrap()
}

/// Returns the same capture as frames of a transforms file; the conversion of the poses is written out.
fn transforms(sparse: &Sparse) -> Vec<Value> {
    let mut frames = Vec::new();
    for (_, q, t, camera, name, _) in &sparse.images {
        let r = rotation(*q);
        // Column c of the camera-to-world rotation is row c of R; y and z change sign. The centre is −Rᵀt.
        let flip = [1.0, -1.0, -1.0];
        let row = |i: usize| {
            let centre = -(0..3).map(|c| r[c][i] * t[c]).sum::<f64>();
            json!([flip[0] * r[0][i], flip[1] * r[1][i], flip[2] * r[2][i], centre])
        };
        let mut frame = json!({
            "file_path": format!("images/{name}"),
            "transform_matrix": [row(0), row(1), row(2), [0, 0, 0, 1]],
            "w": 60, "h": 40,
        });
        let (_, _, model, _, p) = &sparse.cameras[*camera as usize - 1];
        let keys: &[&str] = match *model {
            "SIMPLE_PINHOLE" | "SIMPLE_FISHEYE" => &["f", "cx", "cy"],
            "PINHOLE" | "FISHEYE" => &["fl_x", "fl_y", "cx", "cy"],
            "SIMPLE_RADIAL" | "SIMPLE_RADIAL_FISHEYE" => &["f", "cx", "cy", "k1"],
            "RADIAL" | "RADIAL_FISHEYE" => &["f", "cx", "cy", "k1", "k2"],
            "OPENCV" => &["fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2"],
            "OPENCV_FISHEYE" => &["fl_x", "fl_y", "cx", "cy", "k1", "k2", "k3", "k4"],
            "FULL_OPENCV" => &["fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"],
            _ => &["fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"],
        };
        assert_eq!(keys.len(), p.len());
        for (key, value) in keys.iter().zip(p) {
            if *key == "f" {
                (frame["fl_x"], frame["fl_y"]) = (json!(value), json!(value));
            } else {
                frame[*key] = json!(value);
            }
        }
        let fisheye = model.starts_with("SIMPLE_RADIAL_F") || model.starts_with("RADIAL_F");
        frame["camera_model"] = json!(if fisheye { "OPENCV_FISHEYE" } else { model });
        frames.push(frame);
    }
    frames.sort_by_key(|frame| frame["file_path"].as_str().unwrap().to_string());
    frames
}

/// Asserts that two sets have the same rays and pixels.
fn assert_same_rays(a: &ViewSet, b: &ViewSet) {
    assert_eq!(a.views.len(), b.views.len());
    assert!(a.pixels == b.pixels);
    for (a, b) in a.views.iter().zip(&b.views) {
        assert_same_cones(&a.camera, &b.camera);
    }
}

/// Returns a capture whose rotations are exact in binary, as quaternions and as matrices, so that no reader rounds: those of a tetrahedron.
fn exactly_posed() -> Sparse {
    let mut sparse = capture();
    let half = [-0.5, 0.5];
    let turns = half.iter().flat_map(|&x| half.iter().flat_map(move |&y| half.map(|z| [0.5, x, y, z])));
    let turns = turns.chain([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]]);
    for (image, turn) in sparse.images.iter_mut().zip(turns) {
        (image.1, image.2) = (turn, [0.125, -0.25, 4.0]);
    }
    sparse
}

fn assert_same_cones(a: &Camera, b: &Camera) {
    let (width, height) = (a.intrinsics.width, a.intrinsics.height);
    assert_eq!((width, height), (b.intrinsics.width, b.intrinsics.height));
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        let (a, b): (Cone<f64>, Cone<f64>) = (a.cone(x, y), b.cone(x, y));
        assert!((DVec3::from(a.origin) - DVec3::from(b.origin)).length() < 1e-9);
        assert!((DVec3::from(a.direction) - DVec3::from(b.direction)).length() < 1e-9, "{x} {y}");
        assert!((a.slope - b.slope).abs() <= 1e-9 * a.slope, "{x} {y}");
    }
}

#[test]
fn every_format_opens_to_the_same_bits() {
    let sparse = exactly_posed();
    let roots = [0; 3].map(|_| tempfile::tempdir().unwrap());
    let [text, binary, frames] = [0, 1, 2].map(|i| roots[i].path());
    roots.iter().for_each(|root| save_images(&root.path().join("images"), &sparse, [60, 40]));
    sparse.write_text(&text.join("sparse/0"));
    sparse.write_binary(&binary.join("sparse/0"));
    write(&frames.join("transforms.json"), &json!({ "frames": transforms(&sparse) }));
    let ours = scene(text).train;
    for root in [binary, frames] {
        assert_same(&ours, &scene(root).train);
    }
}

#[test]
fn every_format_gives_the_same_rays_and_pixels() {
    let sparse = capture();
    let roots = [0; 5].map(|_| tempfile::tempdir().unwrap());
    let [text, binary, divided, single, listed] = [0, 1, 2, 3, 4].map(|i| roots[i].path());
    roots.iter().for_each(|root| save_images(&root.path().join("images"), &sparse, [60, 40]));
    sparse.write_text(&text.join("sparse/0"));
    sparse.write_binary(&binary.join("sparse/0"));
    let frames = transforms(&sparse);
    let part = |test: bool| -> Vec<Value> {
        let chosen = frames.iter().enumerate().filter(|(index, _)| index.is_multiple_of(8) == test);
        chosen.map(|(_, frame)| frame.clone()).collect()
    };
    let names = |test: bool| -> Vec<Value> {
        // As in nerfstudio's lists, with the backslashes of Windows.
        part(test)
            .iter()
            .map(|frame| json!(frame["file_path"].as_str().unwrap().replace('/', "\\")))
            .collect()
    };
    write(&divided.join("transforms_train.json"), &json!({ "frames": part(false) }));
    write(&divided.join("transforms_test.json"), &json!({ "frames": part(true) }));
    write(&single.join("transforms.json"), &json!({ "frames": frames }));
    let reversed: Vec<&Value> = frames.iter().rev().collect();
    write(
        &listed.join("transforms.json"),
        &json!({ "frames": reversed, "train_filenames": names(false), "test_filenames": names(true) }),
    );
    let ours = scene(text);
    assert_eq!((ours.train.scales[0].views.len(), ours.test.len()), (8, 2));
    for root in [binary, divided, single] {
        let theirs = scene(root);
        assert_same_rays(&ours.train, &theirs.train);
        for index in 0..2 {
            assert_same_rays(&ours.test.load(index).unwrap(), &theirs.test.load(index).unwrap());
        }
    }
    // The lists choose the frames, but the file determines their order.
    let theirs = scene(listed);
    assert_eq!((theirs.train.scales[0].views.len(), theirs.test.len()), (8, 2));
    for index in 0..8 {
        assert_same_cones(&ours.train.views[index].camera, &theirs.train.views[7 - index].camera);
    }
    // Two folders share file names.
    let shown: Vec<&str> = ours.train.views[..8].iter().map(|view| view.name.as_str()).collect();
    assert_eq!(shown[..2], ["left_0001", "left_0002"]);
    assert_eq!(shown[4], "right side_0000");
}

/// Projects a point (u, v, w) in the camera's axes (x right, y down, z forward) by COLMAP's sensor/models.h, written out.
fn literal(model: &str, p: &[f64], [u, v, w]: [f64; 3]) -> [f64; 2] {
    let (x, y) = (u / w, v / w);
    let r2 = x * x + y * y;
    let theta = r2.sqrt().atan();
    let (a, b) = (x * theta / r2.sqrt(), y * theta / r2.sqrt());
    let t2 = theta * theta;
    match model {
        "SIMPLE_PINHOLE" => [p[0] * x + p[1], p[0] * y + p[2]],
        "PINHOLE" => [p[0] * x + p[2], p[1] * y + p[3]],
        "SIMPLE_RADIAL" => [p[0] * (x + x * p[3] * r2) + p[1], p[0] * (y + y * p[3] * r2) + p[2]],
        "RADIAL" => {
            let radial = p[3] * r2 + p[4] * r2 * r2;
            [p[0] * (x + x * radial) + p[1], p[0] * (y + y * radial) + p[2]]
        }
        "OPENCV" => {
            let radial = p[4] * r2 + p[5] * r2 * r2;
            let dx = x * radial + 2.0 * p[6] * x * y + p[7] * (r2 + 2.0 * x * x);
            let dy = y * radial + 2.0 * p[7] * x * y + p[6] * (r2 + 2.0 * y * y);
            [p[0] * (x + dx) + p[2], p[1] * (y + dy) + p[3]]
        }
        "FULL_OPENCV" => {
            let (r4, r6) = (r2 * r2, r2 * r2 * r2);
            let radial =
                (1.0 + p[4] * r2 + p[5] * r4 + p[8] * r6) / (1.0 + p[9] * r2 + p[10] * r4 + p[11] * r6);
            let dx = x * radial + 2.0 * p[6] * x * y + p[7] * (r2 + 2.0 * x * x) - x;
            let dy = y * radial + 2.0 * p[7] * x * y + p[6] * (r2 + 2.0 * y * y) - y;
            [p[0] * (x + dx) + p[2], p[1] * (y + dy) + p[3]]
        }
        "OPENCV_FISHEYE" => {
            let radial = p[4] * t2 + p[5] * t2.powi(2) + p[6] * t2.powi(3) + p[7] * t2.powi(4);
            [p[0] * (a + a * radial) + p[2], p[1] * (b + b * radial) + p[3]]
        }
        "SIMPLE_FISHEYE" => [p[0] * a + p[1], p[0] * b + p[2]],
        "FISHEYE" => [p[0] * a + p[2], p[1] * b + p[3]],
        "SIMPLE_RADIAL_FISHEYE" => [p[0] * (a + a * p[3] * t2) + p[1], p[0] * (b + b * p[3] * t2) + p[2]],
        "RADIAL_FISHEYE" => {
            let radial = p[3] * t2 + p[4] * t2 * t2;
            [p[0] * (a + a * radial) + p[1], p[0] * (b + b * radial) + p[2]]
        }
        "THIN_PRISM_FISHEYE" => {
            let radial = p[4] * t2 + p[5] * t2.powi(2) + p[8] * t2.powi(3) + p[9] * t2.powi(4);
            let dx = a * radial + 2.0 * p[6] * a * b + p[7] * (t2 + 2.0 * a * a) + p[10] * t2;
            let dy = b * radial + 2.0 * p[7] * a * b + p[6] * (t2 + 2.0 * b * b) + p[11] * t2;
            [p[0] * (a + dx) + p[2], p[1] * (b + dy) + p[3]]
        }
        other => panic!("{other} has no equation here"),
    }
}

#[test]
fn every_camera_model_projects_as_colmap_does() {
    let sparse = capture_by([models(), later_models()].concat());
    let root = tempfile::tempdir().unwrap();
    save_images(&root.path().join("images"), &sparse, [60, 40]);
    sparse.write_binary(&root.path().join("sparse"));
    let mut config = settings(root.path(), 1);
    config.train = vec!["train".into(), "test".into()];
    let views = open(&config).unwrap().train.views;
    for (_, q, t, camera, name, _) in &sparse.images {
        let shown = name.replace(".png", "").replace('/', "_");
        let view = views.iter().find(|view| view.name == shown).unwrap();
        let (_, _, model, _, parameters) = &sparse.cameras[*camera as usize - 1];
        let r = rotation(*q);
        let mut seen = 0;
        for i in 0..400 {
            // A spiral that fills the volume around the origin.
            let (radius, angle) = (1.6 * f64::from(i) / 400.0, 2.399_963 * f64::from(i));
            let point = [radius * angle.cos(), radius * angle.sin(), 1.3 * (0.37 * f64::from(i)).sin()];
            let at = [0, 1, 2].map(|i| (0..3).map(|j| r[i][j] * point[j]).sum::<f64>() + t[i]);
            let expected = literal(model, parameters, at);
            let local = view.camera.rotation.transpose() * (DVec3::from(point) - view.camera.origin);
            if let Some(found) = view.camera.intrinsics.image_of(local) {
                seen += 1;
                let apart = (found[0] - expected[0]).hypot(found[1] - expected[1]);
                assert!(apart < 1e-9, "{model}: {found:?} {expected:?}");
            }
        }
        assert!(seen > 300, "{model} {seen}");
    }
}

/// Asserts that every pixel with features has a known depth, that of the nearest of their points, and no other pixel has one.
fn assert_depths(scene: &Scene) {
    let mut expected = std::collections::BTreeMap::new();
    for scale in &scene.train.scales {
        for (point, seen) in scene.points.iter().flat_map(|p| p.track.iter().map(move |seen| (p, seen))) {
            let view = &scene.train.views[scale.views.start + seen.view as usize];
            let [x, y] = seen.at.map(|place| (place as u32 / scale.factor) as usize);
            let pixel = (view.offset + y * view.camera.intrinsics.width as usize + x) as u32;
            let distance = (DVec3::from(point.position) - view.camera.origin).length() as f32;
            let nearest = expected.entry(pixel).or_insert(distance);
            *nearest = distance.min(*nearest);
        }
    }
    let depths = &scene.train.depths;
    assert!(depths.iter().map(|known| (known.pixel, known.distance)).eq(expected));
    assert!(depths.iter().all(|known| known.deviation > 0.0 && known.deviation < known.distance));
}

#[test]
fn points_are_kept_with_the_training_views_that_saw_them() {
    let sparse = capture();
    let root = tempfile::tempdir().unwrap();
    save_images(&root.path().join("images"), &sparse, [60, 40]);
    sparse.write_binary(&root.path().join("sparse/0"));
    let scene = scene(root.path());
    assert_eq!(scene.points.len(), 125);
    assert_eq!((scene.points[3].color, scene.points[3].error), ([3, 7, 200], Some(0.5)));
    // Two of ten images are test frames.
    assert!(scene.points.iter().all(|point| point.track.len() == 8 && point.seen == Some(10)));
    // The height of each feature identifies its image.
    for seen in &scene.points[7].track {
        let name = &scene.train.views[seen.view as usize].name;
        let image = sparse.images.iter().find(|(.., n, _)| n.replace(".png", "").replace('/', "_") == *name);
        let expected = image.unwrap().5[7].0;
        assert_eq!(seen.at, expected);
    }
    assert_depths(&scene);
    let stated = scene.stated.unwrap();
    assert_eq!(stated.source, "around 125 points of the COLMAP model");
    for axis in 0..3 {
        assert!((stated.aabb.min[axis] + 0.88).abs() < 1e-9 && (stated.aabb.max[axis] - 0.88).abs() < 1e-9);
    }
    assert!(scene.description.iter().any(|line| line.contains("10 cameras, 10 images, 125 points")));
}

#[test]
fn text_is_read_with_its_peculiarities() {
    let sparse = capture();
    let [cameras, images, points] = sparse.text();
    // Comments between entries, CRLF, empty feature lines, no line break at the end.
    let stripped: String = images
        .lines()
        .scan(false, |features, line| {
            let own = std::mem::replace(features, !*features && !line.starts_with('#'));
            Some(if own { "\r\n".into() } else { format!("{line}\r\n") })
        })
        .collect();
    let root = tempfile::tempdir().unwrap();
    let plain = tempfile::tempdir().unwrap();
    let folder = root.path().join("sparse/0");
    fs::create_dir_all(&folder).unwrap();
    sparse.write_text(&plain.path().join("sparse/0"));
    fs::write(folder.join("cameras.txt"), format!("\u{feff}\n# more\n{}", cameras.replace('\n', "  \r\n")))
        .unwrap();
    fs::write(folder.join("images.txt"), stripped.trim_end()).unwrap();
    fs::write(folder.join("points3D.txt"), points.replace('\n', "\n# between\n\n")).unwrap();
    let [own, same] = [root.path(), plain.path()].map(|root| Model::read(&root.join("sparse/0")).unwrap());
    assert_eq!((&own.cameras, &own.points), (&same.cameras, &same.points));
    assert!(own.images.iter().all(|image| image.places.is_empty()));
    for (a, b) in own.images.iter().zip(&same.images) {
        assert_eq!((a.id, a.rotation, a.translation, &a.name), (b.id, b.rotation, b.translation, &b.name));
    }
    assert!(own.images.iter().any(|image| image.name == "right side/0003.png"));
    // Points whose tracks have no features still bound the scene.
    save_images(&root.path().join("images"), &sparse, [60, 40]);
    let scene = scene(root.path());
    assert!(scene.stated.is_some() && scene.points.iter().all(|point| point.track.is_empty()));
}

#[test]
fn text_and_binary_files_hold_the_same_model() {
    let sparse = capture();
    let [text, binary] = [0; 2].map(|_| tempfile::tempdir().unwrap());
    sparse.write_text(text.path());
    sparse.write_binary(binary.path());
    assert_eq!(Model::read(text.path()).unwrap(), Model::read(binary.path()).unwrap());
}

#[test]
fn a_quaternion_of_any_length_is_the_same_rotation() {
    let root = tempfile::tempdir().unwrap();
    let mut sparse = capture();
    save_images(&root.path().join("images"), &sparse, [60, 40]);
    let mut cameras = Vec::new();
    for factor in [1.0, -3.0, 1e-200, 1e300] {
        sparse
            .images
            .iter_mut()
            .zip(capture().images)
            .for_each(|(image, own)| image.1 = own.1.map(|q| q * factor));
        sparse.write_binary(&root.path().join("sparse"));
        cameras.push(scene(root.path()).train.views[0].camera);
    }
    cameras.iter().for_each(|camera| assert_same_cones(camera, &cameras[0]));
    let (q, _) = (sparse.images[2].1, sparse.images[2].2);
    let [w, x, y, z] = q.map(|part| part / 1e300);
    // Frame 0 is a test frame, so the first training view is image 3 of the file.
    let to_camera = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w));
    let expected = to_camera.transpose() * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    assert!((expected.x_axis - cameras[0].rotation.x_axis).length() < 1e-12);
    assert!((expected.z_axis - cameras[0].rotation.z_axis).length() < 1e-12);
}

#[test]
fn models_and_photographs_are_found_where_programs_put_them() {
    let sparse = capture();
    for (model, images) in [
        ("", "images"),
        ("sparse/0", "images"),
        ("sparse/0", ""),
        ("sparse", "images"),
        ("colmap/sparse/0", "images"),
        ("colmap/sparse", "images"),
        ("colmap/bin", "colmap/images"),
        ("colmap/txt", "images"),
        ("colmap", "images"),
        ("colmap/sparse/0", "colmap/images"),
    ] {
        let root = tempfile::tempdir().unwrap();
        sparse.write_binary(&root.path().join(model));
        save_images(&root.path().join(images), &sparse, [60, 40]);
        assert_eq!(scene(root.path()).train.views.len(), 16, "{model} {images}");
    }
    // A scene may also be opened by the folder of its model.
    let root = tempfile::tempdir().unwrap();
    sparse.write_text(&root.path().join("sparse/0"));
    save_images(&root.path().join("images"), &sparse, [60, 40]);
    assert_eq!(scene(&root.path().join("sparse/0")).train.views.len(), 16);
    // The error for the folder above the scene names the scene.
    let above = tempfile::tempdir().unwrap();
    fs::rename(root.path(), above.path().join("garden")).unwrap();
    let message = open(&settings(above.path(), 1)).unwrap_err().message();
    assert!(message.contains("garden, which holds one"), "{message}");
}

#[test]
fn the_model_with_the_most_images_is_read() {
    let sparse = capture();
    let root = tempfile::tempdir().unwrap();
    save_images(&root.path().join("images"), &sparse, [60, 40]);
    let mut few = Sparse { points: Vec::new(), ..sparse.clone() };
    few.images.truncate(3);
    few.write_binary(&root.path().join("sparse/0"));
    sparse.write_text(&root.path().join("sparse/1"));
    let scene = scene(root.path());
    assert_eq!(scene.train.scales[0].views.len(), 8);
    assert!(scene.warnings.iter().any(|w| w.contains("with 3, 1 with") && w.contains("sparse/1 is read")));
    fs::remove_dir_all(root.path().join("sparse/1")).unwrap();
    let scene = open(&settings(root.path(), 1)).unwrap();
    assert!(
        scene.warnings.iter().any(|w| w.contains("COLMAP placed 3 of the 10 photographs")),
        "{:?}",
        scene.warnings
    );
}

#[test]
fn photographs_in_another_size_have_scaled_cameras() {
    let sparse = capture();
    let root = tempfile::tempdir().unwrap();
    save_images(&root.path().join("images"), &sparse, [60, 40]);
    save_images(&root.path().join("images_4"), &sparse, [15, 10]);
    save_images(&root.path().join("images_7"), &sparse, [9, 6]);
    save_images(&root.path().join("cut"), &sparse, [15, 8]);
    sparse.write_binary(&root.path().join("sparse/0"));
    let whole = scene(root.path());
    let mut config = settings(root.path(), 1);
    config.images = "images_4".into();
    let quarter = open(&config).unwrap();
    assert!(quarter.warnings.iter().any(|w| w.contains("0.2500 times as wide")), "{:?}", quarter.warnings);
    for (own, other) in quarter.train.views.iter().zip(&whole.train.views) {
        let (own, other) = (own.camera.intrinsics, other.camera.intrinsics.reduced(2));
        assert!((own.fx - other.fx).abs().max((own.cy - other.cy).abs()) < 1e-12);
        assert_eq!((own.width, own.height, own.lens), (15, 10, other.lens));
    }
    assert_eq!(quarter.points[5].track[1].at, whole.points[5].track[1].at.map(|place| 0.25 * place));
    // 60 / 7 and 40 / 7 are rounded to whole pixels.
    config.images = "images_7".into();
    let seventh = open(&config).unwrap().train.views[0].camera.intrinsics;
    assert!((seventh.fx / whole.train.views[0].camera.intrinsics.fx - 0.15).abs() < 1e-12);
    config.images = "cut".into();
    let message = open(&config).unwrap_err().message();
    assert!(message.contains("is 15x8 pixels, but the file states 60x40"), "{message}");
    fs::rename(root.path().join("images_4"), root.path().join("images_5")).unwrap();
    fs::remove_dir_all(root.path().join("images")).unwrap();
    fs::rename(root.path().join("images_5"), root.path().join("images")).unwrap();
    let found = open(&settings(root.path(), 1)).unwrap();
    assert!(found.warnings.iter().any(|w| w.contains("0.2500 times as wide")), "{:?}", found.warnings);
    assert_same(&found.train, &quarter.train);
}

/// Returns settings of a COLMAP capture with a list of test frames.
fn listed(root: &Path, list: &str) -> DataConfig {
    fs::write(root.join("test.txt"), list).unwrap();
    DataConfig { test_list: "test.txt".into(), ..settings(root, 1) }
}

#[test]
fn a_list_of_names_divides_any_scene() {
    let sparse = capture();
    let root = tempfile::tempdir().unwrap();
    save_images(&root.path().join("images"), &sparse, [60, 40]);
    sparse.write_binary(&root.path().join("sparse/0"));
    let list = "# tested on\r\n\r\nleft/0001.png\r\n  images/right side/0004\r\n";
    let names = |scene: &Scene| -> Vec<String> {
        (0..scene.test.len()).map(|i| scene.test.load(i).unwrap().views[0].name.clone()).collect()
    };
    let divided = open(&listed(root.path(), list)).unwrap();
    assert_eq!(names(&divided), ["left_0001", "right side_0004"]);
    assert_eq!(divided.train.views.len(), 8);
    assert!(divided.description[0].contains("the frames of test.txt"), "{}", divided.description[0]);
    assert!(!divided.description.iter().any(|line| line.contains("every 8th")), "{:?}", divided.description);
    // The same frames from transforms files, with and without splits.
    let frames = transforms(&sparse);
    write(&root.path().join("transforms.json"), &json!({ "frames": frames }));
    let same = open(&listed(root.path(), list)).unwrap();
    assert_same_rays(&divided.train, &same.train);
    for (split, part) in [("train", &frames[..5]), ("test", &frames[5..])] {
        write(&root.path().join(format!("transforms_{split}.json")), &json!({ "frames": part }));
    }
    let same = open(&listed(root.path(), list)).unwrap();
    assert_same_rays(&divided.train, &same.train);
    assert_eq!(same.test.len(), 2);
    // A written multi-scale set has the frames of the list as its test split.
    let set = tempfile::tempdir().unwrap();
    let summary = write_multiscale(&listed(root.path(), list), set.path(), &unwatched).unwrap();
    assert_eq!(summary.splits, [("train".to_string(), 8), ("test".to_string(), 2)]);
    for (list, what) in [
        ("0009\nleft/0007.png", "names that match no frame of the scene: 0009, left/0007.png"),
        ("0001.png", "names that match more than one frame: 0001.png"),
        ("# none", "leaves no test frame"),
    ] {
        let message = open(&listed(root.path(), list)).unwrap_err().message();
        assert!(message.contains("test.txt: ") && message.contains(what), "{message}");
    }
    let mut config = listed(root.path(), list);
    config.holdout = 3;
    assert!(open(&config).unwrap_err().message().contains("data.holdout = 3"));
    config = listed(root.path(), list);
    config.test_list = "absent.txt".into();
    assert!(open(&config).unwrap_err().message().contains("absent.txt: cannot be read"));
    config.format = "builtin".into();
    assert!(open(&config).unwrap_err().message().contains("cannot divide the frames of a built-in scene"));
}

#[test]
fn lists_of_a_transforms_file_are_its_splits() {
    let root = tempfile::tempdir().unwrap();
    let sparse = capture();
    save_images(&root.path().join("images"), &sparse, [60, 40]);
    let frames = transforms(&sparse);
    let named: Vec<&str> = frames.iter().map(|frame| frame["file_path"].as_str().unwrap()).collect();
    let path = root.path().join("transforms.json");
    let with = |lists: Value| {
        let mut document = json!({ "frames": frames, "applied_scale": 0.5,
            "applied_transform": [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]] });
        lists.as_object().unwrap().iter().for_each(|(key, list)| document[key] = list.clone());
        write(&path, &document);
        open(&settings(root.path(), 1))
    };
    let lists =
        json!({ "train_filenames": named[..6], "val_filenames": [named[6]], "test_filenames": [named[7]] });
    let scene = with(lists).unwrap();
    assert_eq!((scene.train.views.len(), scene.test.len()), (6, 1));
    assert!(scene.warnings.iter().any(|w| w.contains("lists 2 frames in no split")), "{:?}", scene.warnings);
    assert!(scene.description.iter().any(|line| line.contains("0.5 times")), "{:?}", scene.description);
    let mut config = settings(root.path(), 1);
    config.test = "val".into();
    assert_eq!(open(&config).unwrap().test.load(0).unwrap().views[0].name, "right side_0001");
    // Without a list of test frames, the frames of "val" are the test frames, or some training frames are held out.
    let scene = with(json!({ "train_filenames": named[..9], "val_filenames": named[9..] })).unwrap();
    assert_eq!((scene.train.views.len(), scene.test.len()), (9, 1));
    assert!(scene.warnings.iter().any(|w| w.contains("\"val\" is the test split")), "{:?}", scene.warnings);
    let scene = with(json!({ "train_filenames": named[..9] })).unwrap();
    assert_eq!((scene.train.views.len(), scene.test.len()), (7, 2));
    for (lists, what) in [
        (
            json!({ "train_filenames": ["images/none.png"] }),
            "\"train_filenames\": images/none.png: is no frame",
        ),
        (
            json!({ "train_filenames": [named[0]], "test_filenames": [named[0]] }),
            "is in the split \"train\" too",
        ),
        (json!({ "train_filenames": [named[0], named[0]] }), "is in the list twice"),
        (json!({ "train_filenames": 3 }), "is 3; expected an array"),
        (json!({ "train_filenames": [] }), "has no frame for split \"train\""),
        (json!({ "applied_scale": 0 }), "\"applied_scale\" is 0"),
        (
            json!({ "applied_transform": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]] }),
            "\"applied_transform\" is not a",
        ),
    ] {
        let message = with(lists).unwrap_err().message();
        assert!(message.contains("transforms.json: ") && message.contains(what), "{message}");
    }
}

#[test]
fn each_broken_model_is_told_apart() {
    type Change = fn(&mut Sparse);
    let cases: [(Change, &str, &str); 13] = [
        (|s| s.cameras[1].0 = 1, "cameras.", "camera 1: is listed twice"),
        (|s| s.cameras[1].3 = [0, 40], "cameras.", "is 0x40 pixels"),
        (|s| s.cameras[1].3 = [1 << 40, 40], "cameras.", "is 1099511627776x40 pixels"),
        (|s| s.cameras[1].4[0] = -1.0, "cameras.", "has the focal length -1"),
        (
            |s| (s.cameras[1].1, s.cameras[1].2) = (7, "FOV"),
            "cameras.",
            "FOV, which is not supported; run COLMAP's",
        ),
        (|s| (s.cameras[1].1, s.cameras[1].2) = (99, "99"), "cameras.", "99, which is unknown"),
        (|s| s.images[2].0 = 1, "images.", "is listed twice"),
        (|s| s.images[2].1 = [0.0; 4], "images.", "has a rotation of length 0"),
        (|s| s.images[2].2[1] = f64::INFINITY, "images.", "inf"),
        (|s| s.images[2].3 = 77, "images.", "image 3 (left/0001.png): has the camera 77"),
        (|s| s.images[2].4 = "left/0000.png".into(), "images.", "has the name of image 1"),
        (|s| s.points[2].0 = 1, "points3D.", "point 1: is listed twice"),
        (|s| s.points[2].4[0][1] = 999, "points3D.", "names feature 999 of image 1, which has 125"),
    ];
    let root = tempfile::tempdir().unwrap();
    save_images(&root.path().join("images"), &capture(), [60, 40]);
    for (change, file, what) in cases {
        for binary in [false, true] {
            let mut sparse = capture();
            change(&mut sparse);
            let folder = root.path().join("sparse/0");
            let _ = fs::remove_dir_all(&folder);
            if binary {
                sparse.write_binary(&folder);
            } else {
                sparse.write_text(&folder);
            }
            let error = open(&settings(root.path(), 1)).unwrap_err();
            assert_eq!(error.kind(), trimip_core::ErrorKind::Input);
            let message = error.message();
            let named = message.contains(file) && message.contains(what);
            // Text files state the name of a model, binary files its number.
            assert!(named, "binary {binary}: {what}:\n{message}");
        }
    }
    // A binary file that ends early, at every length.
    let sparse = capture();
    let folder = root.path().join("sparse/0");
    fs::remove_dir_all(&folder).unwrap();
    sparse.write_binary(&folder);
    for (name, whole) in crate::common::colmap::FILES.iter().zip(sparse.binary()) {
        let path = folder.join(format!("{name}.bin"));
        for length in (0..whole.len()).step_by(whole.len() / 60 + 1) {
            fs::write(&path, &whole[..length]).unwrap();
            let message = open(&settings(root.path(), 1)).unwrap_err().message();
            assert!(message.contains(&format!("{name}.bin: byte ")), "{length} {message}");
        }
        fs::write(&path, [&whole[..], &[0]].concat()).unwrap();
        let message = open(&settings(root.path(), 1)).unwrap_err().message();
        assert!(message.contains("1 bytes follow the last entry"), "{message}");
        fs::write(&path, whole).unwrap();
    }
    assert!(inspect(&settings(root.path(), 1), &unwatched).is_ok());
}
