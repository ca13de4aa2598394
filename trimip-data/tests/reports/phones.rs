//! Exports of Polycam and captures of Record3D and ARKitScenes.

use super::Input;
use crate::common::{
    ring::{cameras, pinhole, vision},
    save_image, write,
};
use glam::DQuat;
use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_core::Camera;

pub const INPUTS: &[(&str, Input)] = &[
    ("polycam_corrected_without_size", corrected_without_size),
    ("polycam_corrected_in_part", corrected_in_part),
    ("polycam_raw", raw),
    ("polycam_without_time", without_time),
    ("record3d_unpacked", record3d_unpacked),
    ("record3d_without_tracking", record3d_without_tracking),
    ("record3d_without_photographs", record3d_without_photographs),
    ("arkitscenes_between_poses", arkitscenes_between_poses),
];

/// Writes the files of Polycam's cameras `from` to 9 to a folder; `change` alters a file.
fn polycam(root: &Path, kind: &str, all: &[Camera], from: usize, change: impl Fn(&mut Value)) {
    let folder = root.join("keyframes").join(format!("{kind}cameras"));
    fs::create_dir_all(&folder).unwrap();
    for (index, camera) in all.iter().enumerate().skip(from) {
        let [x, y, z] = camera.rotation.transpose().to_cols_array_2d();
        let o = camera.origin;
        let mut document = json!({ "fx": 51.5, "fy": 52.5, "cx": 29.0, "cy": 21.0, "width": 60, "height": 40,
            "blur_score": 90.0, "timestamp": 17 + index });
        // ARKit's axes x, y, z are y, z, x here.
        for (i, (axes, at)) in [(y, o.y), (z, o.z), (x, o.x)].iter().enumerate() {
            (0..3).for_each(|j| document[format!("t_{i}{j}")] = json!(axes[j]));
            document[format!("t_{i}3")] = json!(at);
        }
        change(&mut document);
        write(&folder.join(format!("{index}.json")), &document);
        save_image(&root.join(format!("keyframes/{kind}images/{index}.png")), 60, 40);
    }
}

fn without(key: &'static str) -> impl Fn(&mut Value) {
    move |document| drop(document.as_object_mut().unwrap().remove(key))
}

fn corrected_without_size(root: &Path) -> Vec<Camera> {
    let all = cameras(pinhole());
    polycam(root, "", &all, 0, |_| {});
    polycam(root, "corrected_", &all, 0, |document| {
        without("width")(document);
        without("height")(document);
    });
    all
}

fn corrected_in_part(root: &Path) -> Vec<Camera> {
    let all = cameras(pinhole());
    polycam(root, "", &all, 0, |_| {});
    polycam(root, "corrected_", &all, 4, |_| {});
    Vec::new()
}

fn raw(root: &Path) -> Vec<Camera> {
    let all = cameras(pinhole());
    polycam(root, "", &all, 0, |_| {});
    // A file that macOS adds when it copies a folder.
    fs::write(root.join("keyframes/cameras/._0.json"), b"\0\x05\x16\x07").unwrap();
    all
}

fn without_time(root: &Path) -> Vec<Camera> {
    let all = cameras(pinhole());
    polycam(root, "", &all, 0, without("timestamp"));
    all
}

/// Writes an unpacked `.r3d` file: `metadata` has no ending, and depths lie next to the photographs.
fn record3d_unpacked(root: &Path) -> Vec<Camera> {
    let all = cameras(pinhole());
    let pose = |camera: &Camera| {
        let (q, o) = (DQuat::from_mat3(&camera.rotation), camera.origin);
        json!([q.x, q.y, q.z, q.w, o.x, o.y, o.z])
    };
    let document = json!({
        "w": 60, "h": 40, "K": [51.5, 0, 0, 0, 52.5, 0, 29.0, 21.0, 1],
        "poses": all.iter().map(pose).collect::<Vec<_>>(), "initPose": [0, 0, 0, 1, 0, 0, 0],
    });
    write(&root.join("metadata"), &document);
    for index in 0..9 {
        save_image(&root.join(format!("rgbd/{index}.png")), 60, 40);
        fs::write(root.join(format!("rgbd/{index}.depth")), b"bvx2").unwrap();
    }
    all
}

/// Writes the poses of a recording without tracking.
fn record3d_without_tracking(root: &Path) -> Vec<Camera> {
    record3d_unpacked(root);
    let path = root.join("metadata");
    let mut document: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    document["poses"].as_array_mut().unwrap().fill(json!([0, 0, 0, 0, 0, 0, 0]));
    write(&path, &document);
    Vec::new()
}

/// Writes an export that has depths but no photographs.
fn record3d_without_photographs(root: &Path) -> Vec<Camera> {
    record3d_unpacked(root);
    (0..9).for_each(|index| fs::remove_file(root.join(format!("rgbd/{index}.png"))).unwrap());
    Vec::new()
}

/// Writes a scene like those of the raw set, which has six photographs for each pose.
fn arkitscenes_between_poses(root: &Path) -> Vec<Camera> {
    let all = cameras(pinhole());
    let mut poses = String::new();
    fs::create_dir(root.join("lowres_wide_intrinsics")).unwrap();
    for (index, camera) in all.iter().enumerate() {
        let (rotation, t) = vision(camera);
        let (axis, angle) = DQuat::from_mat3(&rotation).to_axis_angle();
        let r = axis * angle;
        poses +=
            &format!("{:.1} {} {} {} {} {} {}\n", 7.0 + 0.1 * index as f64, r.x, r.y, r.z, t.x, t.y, t.z);
        for step in [0.0, 0.017, 0.033, 0.05, 0.067, 0.083] {
            let name = format!("42897688_{:.3}", 7.0 + 0.1 * index as f64 + step);
            save_image(&root.join(format!("lowres_wide/{name}.png")), 60, 40);
            fs::write(root.join(format!("lowres_wide_intrinsics/{name}.pincam")), "60 40 51.5 52.5 29 21")
                .unwrap();
        }
    }
    fs::write(root.join("lowres_wide.traj"), poses).unwrap();
    all
}
