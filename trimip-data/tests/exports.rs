//! Tests of exports of other programs. Cameras written in the conventions of OpenSfM, Bundler and Polycam are read as the same
//! cameras that a transforms file gives, and errors name the broken entry.

use crate::common::{
    ring::{assert_cameras, cameras, name, polycam, save_images, vision},
    save_image, settings, write,
};
use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};
use std::{fmt::Write, fs};
use trimip_core::{Camera, Intrinsics, Lens};
use trimip_data::open;

/// Returns a reconstruction of OpenSfM.
fn reconstruction(all: &[Camera], camera: &Value) -> Value {
    let shots: serde_json::Map<String, Value> = all
        .iter()
        .enumerate()
        .map(|(index, own)| {
            let (rotation, translation) = vision(own);
            let (axis, angle) = DQuat::from_mat3(&rotation).to_axis_angle();
            let shot = json!({ "rotation": (axis * angle).to_array(), "translation": translation.to_array(), "camera": "a b" });
            (format!("{index}.png"), shot)
        })
        .collect();
    let points: serde_json::Map<String, Value> = (0..120)
        .map(|i| {
            let at = [f64::from(i % 5), f64::from(i / 5 % 5), f64::from(i / 25)];
            (i.to_string(), json!({ "coordinates": at, "color": [10.0, 20.0, f64::from(i)] }))
        })
        .collect();
    json!({ "cameras": { "a b": camera }, "shots": shots, "points": points })
}

#[test]
fn reconstructions_of_opensfm_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    save_images(root, [60, 40]);
    let size = |lens: Lens, [fx, fy]: [f64; 2], [cx, cy]: [f64; 2]| Intrinsics {
        width: 60,
        height: 40,
        fx,
        fy,
        cx,
        cy,
        lens,
    };
    let cases = [
        (
            json!({ "projection_type": "perspective", "width": 60, "height": 40, "focal": 0.85, "k1": -0.1, "k2": 0.02 }),
            size(Lens::perspective([-0.1, 0.02, 0.0, 0.0], [0.0; 2], [0.0; 3]), [51.0; 2], [30.0, 20.0]),
        ),
        (
            json!({ "projection_type": "brown", "width": 60, "height": 40, "focal_x": 0.85, "focal_y": 0.9, "c_x": 0.01,
                "c_y": -0.02, "k1": -0.1, "k2": 0.02, "k3": 0.001, "p1": 0.002, "p2": -0.003 }),
            size(
                Lens::perspective([-0.1, 0.02, 0.001, 0.0], [0.002, -0.003], [0.0; 3]),
                [51.0, 54.0],
                [30.6, 18.8],
            ),
        ),
        (
            json!({ "projection_type": "fisheye", "width": 60, "height": 40, "focal": 0.5, "k1": -0.01, "k2": 0.002 }),
            size(Lens::fisheye([-0.01, 0.002, 0.0, 0.0], [0.0; 2], [0.0; 2]), [30.0; 2], [30.0, 20.0]),
        ),
    ];
    for place in ["reconstruction.json", "opensfm/reconstruction.json"] {
        let path = root.join(place);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        for (camera, intrinsics) in &cases {
            let all = cameras(*intrinsics);
            let few = reconstruction(&all[..2], camera);
            write(&path, &json!([few, reconstruction(&all, camera)]));
            let scene = open(&settings(root, 1)).unwrap();
            assert_cameras(&scene, &all);
            assert!(
                scene.warnings.iter().any(|w| w.contains("holds 2 reconstructions")),
                "{:?}",
                scene.warnings
            );
            assert_eq!((scene.points.len(), scene.points[7].color[0]), (120, 10));
            assert!(scene.stated.unwrap().source.contains("120 points"));
        }
        fs::remove_file(path).unwrap();
    }
    let path = root.join("reconstruction.json");
    let good = reconstruction(&cameras(cases[0].1), &cases[0].0);
    type Change = fn(&mut Value);
    let broken: [(Change, &str); 7] = [
        (|d| *d = json!({}), "holds no reconstruction"),
        (|d| d[0]["shots"]["3.png"]["camera"] = json!("other"), "shot 3.png: has the unknown camera other"),
        (|d| d[0]["shots"]["3.png"]["rotation"] = json!([1, 2]), "expected three numbers"),
        (|d| d[0]["cameras"]["a b"]["projection_type"] = json!("dual"), "\"dual\", which is not read"),
        (|d| d[0]["cameras"]["a b"]["focal"] = json!(0), "has no positive focal length"),
        (|d| d[0]["cameras"]["a b"]["width"] = json!(0.5), "expected a whole number of pixels"),
        (|d| d[0]["shots"] = json!({}), "has no frame with a pose"),
    ];
    for (change, what) in broken {
        let mut document = json!([good]);
        change(&mut document);
        write(&path, &document);
        let error = open(&settings(root, 1)).unwrap_err();
        assert!(
            error.kind() == trimip_core::ErrorKind::Input && error.message().contains(what),
            "{what}: {error}"
        );
    }
}

#[test]
fn models_of_bundler_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    save_images(root, [60, 40]);
    let lens = Lens::perspective([-0.1, 0.02, 0.0, 0.0], [0.0; 2], [0.0; 3]);
    let all = cameras(Intrinsics { width: 60, height: 40, fx: 51.5, fy: 51.5, cx: 30.0, cy: 20.0, lens });
    let mut text = "# Bundle file v0.3\n10 2\n".to_string();
    for camera in &all {
        let to_camera = camera.rotation.transpose();
        writeln!(text, "51.5 -0.1 0.02").unwrap();
        (0..3).for_each(|i| {
            writeln!(text, "{} {} {}", to_camera.row(i).x, to_camera.row(i).y, to_camera.row(i).z).unwrap();
        });
        let t = -(to_camera * camera.origin);
        writeln!(text, "{} {} {}", t.x, t.y, t.z).unwrap();
    }
    // The last camera was not placed.
    text += "0 0 0\n0 0 0\n0 0 0\n0 0 0\n0 0 0\n";
    text += "0.5 0.25 -1\n9 99 199\n2 0 3 1.5 -2.5 1 4 2 -3\n1 2 3\n0 0 255\n0\n";
    fs::write(root.join("bundle.out"), &text).unwrap();
    let error = open(&settings(root, 1)).unwrap_err();
    assert!(
        error.kind() == trimip_core::ErrorKind::Input
            && error.message().contains("has no list of photographs"),
        "{error}"
    );
    let list: String = (0..10).map(|index| format!("./{} 0 51.5\n", name(index))).collect();
    fs::write(root.join("list.txt"), &list).unwrap();
    let scene = open(&settings(root, 1)).unwrap();
    assert_cameras(&scene, &all);
    assert!(
        scene.warnings.iter().any(|w| w.contains("cameras of 9 of 10 photographs")),
        "{:?}",
        scene.warnings
    );
    assert_eq!(
        (scene.points[0].position, scene.points[0].color, scene.points[0].seen),
        ([0.5, 0.25, -1.0], [9, 99, 199], Some(2))
    );
    assert_eq!(scene.points.len(), 2);
    for (broken, what) in [
        (text.replace("10 2\n", "10 3\n"), "is missing: the file ends there"),
        (text.replace("10 2\n", "1e9 2\n"), "is a count that the file cannot hold"),
        (text.replacen("51.5 -0.1", "-51.5 -0.1", 1), "camera 0: has the focal length -51.5"),
        (text.replacen("51.5 -0.1", "51.5 wide", 1), "number 4: is not a finite number"),
    ] {
        fs::write(root.join("bundle.out"), broken).unwrap();
        let error = open(&settings(root, 1)).unwrap_err();
        assert!(
            error.kind() == trimip_core::ErrorKind::Input && error.message().contains(what),
            "{what}: {error}"
        );
    }
    fs::write(root.join("bundle.out"), &text).unwrap();
    fs::write(root.join("list.txt"), "images/0.png\n").unwrap();
    assert!(
        open(&settings(root, 1)).unwrap_err().message().contains("camera 1: has no photograph in the list")
    );
}

#[test]
fn raw_exports_of_polycam_are_read() {
    let lens = Lens::default();
    let all = cameras(Intrinsics { width: 60, height: 40, fx: 51.5, fy: 52.5, cx: 29.0, cy: 21.0, lens });
    for kind in ["", "corrected_"] {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("keyframes");
        polycam(folder.path(), &all, kind);
        let scene = open(&settings(folder.path(), 1)).unwrap();
        assert_cameras(&scene, &all);
        let path = root.join(format!("{kind}cameras/3.json"));
        let mut document: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        document.as_object_mut().unwrap().remove("t_21");
        write(&path, &document);
        let error = open(&settings(folder.path(), 1)).unwrap_err();
        assert!(
            error.kind() == trimip_core::ErrorKind::Input
                && error.message().contains("3.json: has no \"t_21\""),
            "{error}"
        );
    }
}

#[test]
fn the_layout_of_nsvf_is_read_with_its_splits_and_its_box() {
    let all = cameras(Intrinsics {
        width: 60,
        height: 40,
        fx: 51.5,
        fy: 52.5,
        cx: 29.0,
        cy: 21.0,
        lens: Lens::default(),
    });
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    fs::create_dir(root.join("pose")).unwrap();
    for (index, camera) in all.iter().enumerate() {
        let axes = camera.rotation * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let rows: String = (0..3)
            .map(|i| format!("{} {} {} {}\n", axes.row(i).x, axes.row(i).y, axes.row(i).z, camera.origin[i]))
            .collect();
        // Seven photographs are for training, two for validation.
        let name = format!("{}_{index:04}", index / 7);
        fs::write(root.join(format!("pose/{name}.txt")), rows + "0 0 0 1\n").unwrap();
        save_image(&root.join(format!("rgb/{name}.png")), 60, 40);
    }
    let matrix = "51.5 0 29 0\n0 52.5 21 0\n0 0 1 0\n0 0 0 1\n";
    fs::write(root.join("intrinsics.txt"), matrix).unwrap();
    fs::write(root.join("bbox.txt"), "-1 -2 -3 1 2 3 0.4\n").unwrap();
    let scene = open(&settings(root, 1)).unwrap();
    assert_eq!((scene.train.views.len(), scene.test.len()), (7, 2));
    for (view, expected) in scene.train.views.iter().zip(&all) {
        assert!((view.camera.origin - expected.origin).length() < 1e-9);
        let apart = view.camera.rotation - expected.rotation;
        assert!(apart.to_cols_array().iter().all(|entry| entry.abs() < 1e-9));
        assert_eq!(view.camera.intrinsics, expected.intrinsics);
    }
    let stated = scene.stated.unwrap();
    assert_eq!((stated.aabb.min, stated.aabb.max), ([-1.0, -2.0, -3.0], [1.0, 2.0, 3.0]));
    assert!(scene.warnings.iter().any(|w| w.contains("\"val\" is the test split")), "{:?}", scene.warnings);
    for (text, fx) in
        [("44.5 30 20 0.\n0. 0. 0.\n0.\n1.\n40 60\n", 44.5), ("45.5 0 30 0 45.5 20 0 0 1\n", 45.5)]
    {
        fs::write(root.join("intrinsics.txt"), text).unwrap();
        let k = open(&settings(root, 1)).unwrap().train.views[0].camera.intrinsics;
        assert_eq!((k.fx, k.fy, k.cx, k.cy), (fx, fx, 30.0, 20.0), "{text}");
    }
    fs::write(root.join("bbox.txt"), "-1 -2 -3 1 -2 3\n").unwrap();
    assert!(open(&settings(root, 1)).unwrap_err().message().contains("bbox.txt: states the corners"));
    fs::write(root.join("bbox.txt"), "-1 -2 wide\n").unwrap();
    assert!(
        open(&settings(root, 1))
            .unwrap_err()
            .message()
            .contains("bbox.txt:1: \"wide\" is not a finite number")
    );
    fs::write(root.join("intrinsics.txt"), "0\n").unwrap();
    assert!(open(&settings(root, 1)).unwrap_err().message().contains("states neither a matrix nor"));
}

/// Returns Metashape's export; photograph 9 was not placed.
fn metashape(all: &[Camera], kind: &str, terms: &str) -> String {
    let cameras: String = all
        .iter()
        .enumerate()
        .map(|(index, camera)| {
            let axes = camera.rotation * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
            let rows: String = (0..3)
                .map(|i| format!("{} {} {} {} ", axes.row(i).x, axes.row(i).y, axes.row(i).z, camera.origin[i]))
                .collect();
            format!("<camera id=\"{index}\" sensor_id=\"3\" label=\"{index}\"><transform>{rows}0 0 0 1</transform></camera>\n")
        })
        .collect();
    let initial = format!(
        "<calibration type=\"{kind}\" class=\"initial\"><resolution width=\"60\" height=\"40\"/><f>7</f></calibration>"
    );
    let adjusted = format!(
        "<calibration type=\"{kind}\" class=\"adjusted\"><resolution width=\"60\" height=\"40\"/>{terms}</calibration>"
    );
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"2.0.0\">\n <chunk label=\"Chunk 1\">\n  <sensors next_id=\"4\">\
         <sensor id=\"3\" label=\"unknown\" type=\"{kind}\"><resolution width=\"60\" height=\"40\"/>{initial}{adjusted}</sensor></sensors>\n\
         <cameras><group label=\"walk\">{cameras}</group><camera id=\"9\" sensor_id=\"3\" label=\"9\"/></cameras></chunk></document>"
    )
}

#[test]
fn camera_exports_of_metashape_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    save_images(root, [60, 40]);
    let path = root.join("my export.xml");
    let radial = [-0.1, 0.02, 0.003, -0.0004];
    let size =
        |lens: Lens| Intrinsics { width: 60, height: 40, fx: 51.75, fy: 51.5, cx: 29.0, cy: 21.5, lens };
    let terms = "<f>51.5</f><cx>-1</cx><cy>1.5</cy><k1>-0.1</k1><k2>0.02</k2><k3>0.003</k3><k4>-0.0004</k4><p1>0.002</p1>\
                 <p2>-0.003</p2><b1>0.25</b1>";
    // Metashape's p1 bends along x, OpenCV's along y.
    for (kind, lens) in [
        ("frame", Lens::perspective(radial, [-0.003, 0.002], [0.0; 3])),
        ("fisheye", Lens::fisheye(radial, [-0.003, 0.002], [0.0; 2])),
    ] {
        let all = cameras(size(lens));
        fs::write(&path, metashape(&all, kind, terms)).unwrap();
        let scene = open(&settings(root, 1)).unwrap();
        assert_cameras(&scene, &all);
        assert!(
            scene.warnings.iter().any(|w| w.contains("Metashape placed 9 of 10")),
            "{:?}",
            scene.warnings
        );
    }
    let all = cameras(size(Lens::default()));
    let whole = metashape(&all, "frame", terms);
    fs::write(&path, metashape(&all, "frame", "<f>51.5</f><b2>0.5</b2>")).unwrap();
    let scene = open(&settings(root, 1)).unwrap();
    assert!(scene.warnings.iter().any(|w| w.contains("skew b2")), "{:?}", scene.warnings);
    for (broken, what) in [
        (whole.replace("</chunk>", ""), "invalid XML"),
        (whole.replace("<f>51.5</f>", ""), "sensor 3: has no positive focal length f"),
        (whole.replace("<f>51.5</f>", "<f>wide</f>"), "sensor 3: f is \"wide\", not a finite number"),
        (
            whole.replace("sensor_id=\"3\" label=\"4\"", "sensor_id=\"5\" label=\"4\""),
            "camera 4: has the unknown sensor 5",
        ),
        (
            whole.replacen("0 0 0 1</transform>", "</transform>", 1),
            "camera 0: its transform is not 16 numbers",
        ),
        (whole.replace("\"frame\"", "\"rpc\""), "is of the type \"rpc\", which is not read"),
    ] {
        fs::write(&path, broken).unwrap();
        let error = open(&settings(root, 1)).unwrap_err();
        assert!(
            error.kind() == trimip_core::ErrorKind::Input && error.message().contains(what),
            "{what}: {error}"
        );
    }
}
