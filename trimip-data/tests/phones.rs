//! Tests of captures of phones: the same cameras as Record3D, ARKitScenes and NeRFCapture write them, and broken files.

use crate::common::{
    ring::{arkitscenes, assert_cameras, cameras, pinhole, save_images},
    save_image, settings, write,
};
use glam::{DQuat, DVec3};
use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_core::Camera;
use trimip_data::open;

/// Returns the message with which a folder is refused.
fn refused(root: &Path) -> String {
    let error = open(&settings(root, 1)).unwrap_err();
    assert!(error.kind() == trimip_core::ErrorKind::Input && !error.message().contains('\n'), "{error}");
    error.message()
}

/// Returns the file of Record3D: `K` is written column by column.
fn record3d(all: &[Camera]) -> Value {
    let pose = |camera: &Camera| {
        let q = DQuat::from_mat3(&camera.rotation);
        let o = camera.origin;
        json!([q.x, q.y, q.z, q.w, o.x, o.y, o.z])
    };
    json!({
        "w": 60, "h": 40, "dw": 8, "dh": 6, "fps": 60,
        "K": [51.5, 0, 0, 0, 52.5, 0, 29.0, 21.0, 1], "poses": all.iter().map(pose).collect::<Vec<_>>(),
    })
}

#[test]
fn captures_of_record3d_are_read() {
    let all = cameras(pinhole());
    // The names of the file and of the folder, and the number of digits in names of photographs.
    for (file, folder, zeros) in [
        ("metadata.json", "rgb", 1),
        ("metadata", "rgbd", 1),
        ("metadata.json", "rgb", 5),
        ("metadata.json", "images", 1),
    ] {
        let root = tempfile::tempdir().unwrap();
        let root = root.path();
        (0..9).for_each(|i| save_image(&root.join(format!("{folder}/{i:0zeros$}.png")), 60, 40));
        write(&root.join(file), &record3d(&all));
        assert_cameras(&open(&settings(root, 1)).unwrap(), &all);
    }
    let root = tempfile::tempdir().unwrap();
    let root = root.path();
    (0..9).for_each(|i| save_image(&root.join(format!("rgb/{i}.png")), 60, 40));
    let mut own = record3d(&all);
    own["K"] = json!([7, 0, 0, 0, 7, 0, 7, 7, 1]);
    own["perFrameIntrinsicCoeffs"] = json!(vec![[51.5, 52.5, 29.0, 21.0]; 9]);
    write(&root.join("metadata.json"), &own);
    assert_cameras(&open(&settings(root, 1)).unwrap(), &all);
    // The photographs are half as large as the file states.
    (0..9).for_each(|i| save_image(&root.join(format!("rgb/{i}.png")), 30, 20));
    let scene = open(&settings(root, 1)).unwrap();
    assert_eq!(scene.train.views[0].camera.intrinsics.fx, 25.75);
    assert!(scene.warnings.iter().any(|w| w.contains("0.5000 times as wide")), "{:?}", scene.warnings);
}

#[test]
fn broken_captures_of_record3d_are_named() {
    let good = record3d(&cameras(pinhole()));
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let path = root.join("metadata.json");
    (0..9).for_each(|i| save_image(&root.join(format!("rgb/{i}.png")), 60, 40));
    type Change = fn(&mut Value);
    let table: [(Change, &str); 14] = [
        (|d| d["poses"][3] = json!([0, 0, 0, 1, 2, 3]), "pose 3: is not seven numbers"),
        (|d| d["poses"][3][1] = json!(null), "pose 3: is not seven numbers"),
        (|d| d["poses"][3][3] = json!(7), "pose 3: has a quaternion of the length 7."),
        (|d| d["poses"][3] = json!([0, 0, 0, 0, 0, 0, 0]), "pose 3: has a quaternion of the length 0."),
        (|d| d["poses"] = json!([]), "has no frame with a pose"),
        (|d| d["poses"] = json!(7), "\"poses\" is 7; expected an array"),
        (|d| d["K"] = json!([51.5, 0, 29, 0, 52.5, 21, 0, 0, 1]), "nine numbers column by column"),
        (|d| d["K"] = json!([51.5, 52.5, 29, 21]), "nine numbers column by column"),
        (|d| d["K"][0] = json!(-51.5), "pose 0: has the focal lengths -51.5 and 52.5"),
        (|d| drop(d.as_object_mut().unwrap().remove("w")), "has no \"w\" and \"h\""),
        (|d| d["h"] = json!(0.5), "\"h\" is 0.5; expected a whole number of pixels"),
        (|d| d["h"] = json!(50), "60x40 pixels, but the file states 60x50"),
        (
            |d| d["perFrameIntrinsicCoeffs"] = json!([[51, 52, 29, 21]]),
            "has 9 poses, but the intrinsics of 1 photograph",
        ),
        (
            |d| d["perFrameIntrinsicCoeffs"] = json!(vec![[51, 52, 29]; 9]),
            "pose 0: has intrinsics that are not four numbers",
        ),
    ];
    for (change, what) in table {
        let mut document = good.clone();
        change(&mut document);
        write(&path, &document);
        assert!(refused(root).contains(what), "{what}: {}", refused(root));
    }
    let text = good.to_string();
    fs::write(&path, text.replacen("51.5", "NaN", 1)).unwrap();
    assert!(refused(root).contains("NaN is not a finite number"), "{}", refused(root));
    fs::write(&path, &text[..text.len() - 20]).unwrap();
    assert!(refused(root).contains("metadata.json:1:"), "{}", refused(root));
    write(&path, &good);
    fs::remove_file(root.join("rgb/4.png")).unwrap();
    // A photograph that was deleted is left out of the scene.
    let scene = open(&settings(root, 1)).unwrap();
    assert_eq!(scene.train.views.len() + scene.test.len(), 8);
    assert!(
        scene.warnings.iter().any(|w| w.contains("1 of 9 photographs are missing")),
        "{:?}",
        scene.warnings
    );
    (0..6).for_each(|i| drop(fs::remove_file(root.join(format!("rgb/{i}.png")))));
    assert!(refused(root).contains("6 of 9 photographs are missing, the first is"), "{}", refused(root));
    (0..6).for_each(|i| save_image(&root.join(format!("rgb/{i}.png")), 60, 40));
    fs::write(root.join("rgb/4.png"), "no image").unwrap();
    assert!(refused(root).contains("rgb/4.png cannot be decoded"));
}

#[test]
fn scenes_of_arkitscenes_are_read() {
    let all = cameras(pinhole());
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let trajectory = arkitscenes(root, &all);
    assert_cameras(&open(&settings(root, 1)).unwrap(), &all);
    // Two photographs were taken between poses.
    for time in ["305.350", "305.750"] {
        save_image(&root.join(format!("lowres_wide/41069021_{time}.png")), 60, 40);
    }
    let scene = open(&settings(root, 1)).unwrap();
    assert_cameras(&scene, &all);
    assert!(
        scene.warnings.iter().any(|w| w.contains("has poses of 9 of 11 photographs")),
        "{:?}",
        scene.warnings
    );
    // A photograph that was deleted is left out of the scene.
    fs::remove_file(root.join("lowres_wide/41069021_305.400.png")).unwrap();
    assert_eq!(open(&settings(root, 1)).unwrap().train.views.len(), 7);
    let poses = root.join("lowres_wide.traj");
    let intrinsics = root.join("lowres_wide_intrinsics/41069021_305.300.pincam");
    let mut words: Vec<&str> = trajectory.splitn(3, ' ').collect();
    words[1] = "1e300";
    let far = words.join(" ");
    let broken: [(&Path, String, &str); 8] = [
        (&poses, trajectory.replacen('\n', " 1\n", 1), "pose 0: has 8 numbers instead of 7"),
        (&poses, trajectory[..trajectory.len() - 30].into(), "pose 8: has "),
        (&poses, trajectory.replacen(' ', " NaN ", 1), "lowres_wide.traj:1: \"NaN\" is not a finite number"),
        (&poses, far, "41069021_305.300.png: has a pose that is not finite"),
        (&poses, String::new(), "has no frame with a pose"),
        (&intrinsics, "60 40 51.5 52.5 29".into(), "holds 5 numbers instead of 6"),
        (&intrinsics, "60 40 0 52.5 29 21".into(), "states 60x40 pixels and the focal lengths 0 and 52.5"),
        (&intrinsics, "60.5 40 51.5 52.5 29 21".into(), "states 60.5x40 pixels"),
    ];
    for (path, text, what) in broken {
        let whole = fs::read(path).unwrap();
        fs::write(path, text).unwrap();
        assert!(refused(root).contains(what), "{what}: {}", refused(root));
        fs::write(path, whole).unwrap();
    }
    fs::remove_file(&intrinsics).unwrap();
    assert!(refused(root).contains("41069021_305.300.pincam: cannot be read"), "{}", refused(root));
    fs::write(&intrinsics, "60 40 51.5 52.5 29 21").unwrap();
    save_image(&root.join("lowres_wide/photo.png"), 60, 40);
    assert!(refused(root).contains("photo.png: is not named by video and time"), "{}", refused(root));
    fs::remove_dir_all(root.join("lowres_wide")).unwrap();
    assert!(refused(root).contains("has no frame with a pose"), "{}", refused(root));
}

/// Checks entries that name photographs without their ending, next to depth images with almost the same names.
#[test]
fn captures_of_nerfcapture_are_blender_layouts() {
    let all = cameras(pinhole());
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    save_images(root, [60, 40]);
    let frame = |(index, camera): (usize, &Camera)| {
        save_image(&root.join(format!("images/{index}.depth.png")), 8, 6);
        let column = |axis: DVec3, last: f64| [axis.x, axis.y, axis.z, last];
        let [x, y, z] = [camera.rotation.x_axis, camera.rotation.y_axis, camera.rotation.z_axis];
        let columns = [column(x, 0.0), column(y, 0.0), column(z, 0.0), column(camera.origin, 1.0)];
        let rows: Vec<Vec<f64>> = (0..4).map(|i| columns.iter().map(|column| column[i]).collect()).collect();
        json!({
            "transform_matrix": rows, "file_path": format!("images/{index}"), "depth_path": format!("images/{index}.depth.png"),
            "fl_x": 51.5, "fl_y": 52.5, "cx": 29.0, "cy": 21.0, "w": 60, "h": 40,
        })
    };
    let frames: Vec<Value> = all.iter().enumerate().map(frame).collect();
    let document = json!({
        "fl_x": 7.0, "fl_y": 7.0, "cx": 7.0, "cy": 7.0, "w": 60.0, "h": 40.0, "integer_depth_scale": 0.00015, "frames": frames,
    });
    write(&root.join("transforms.json"), &document);
    assert_cameras(&open(&settings(root, 1)).unwrap(), &all);
}
