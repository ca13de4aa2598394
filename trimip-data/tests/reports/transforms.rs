//! Files of Instant-NGP and nerfstudio, as their own scripts, other programs and users write them.

use super::Input;
use crate::common::{
    ring::{cameras, name, pinhole, save_images},
    save_image, write,
};
use glam::{DMat3, DVec3};
use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_core::{Camera, Intrinsics, Lens};

pub const INPUTS: &[(&str, Input)] = &[
    ("ngp_without_focal_length", without_focal_length),
    ("transforms_without_endings", without_endings),
    ("transforms_jpg_for_png", jpg_for_png),
    ("transforms_own_intrinsics", own_intrinsics),
    ("transforms_numbers_as_texts", numbers_as_texts),
    ("transforms_wild_lens", wild_lens),
    ("transforms_masks_in_folders", masks_in_folders),
    ("ngp_dynamic_masks", dynamic_masks),
    ("transforms_of_nerfcapture", of_nerfcapture),
    ("transforms_scaled_camera", scaled_camera),
    ("transforms_stretched_camera", stretched_camera),
    ("transforms_camera_at_the_origin", camera_at_the_origin),
];

/// Returns the rows of a camera's pose.
fn matrix(camera: &Camera) -> Value {
    let (r, o) = (camera.rotation, camera.origin);
    let row = |i: usize| json!([r.x_axis[i], r.y_axis[i], r.z_axis[i], o[i]]);
    json!([row(0), row(1), row(2), [0, 0, 0, 1]])
}

/// Returns a transforms file with these frames; `named` returns the names of photographs.
fn document(all: &[Camera], named: impl Fn(usize) -> String) -> Value {
    let frame = |(index, camera): (usize, &Camera)| json!({ "file_path": named(index), "transform_matrix": matrix(camera) });
    let frames: Vec<Value> = all.iter().enumerate().map(frame).collect();
    json!({ "fl_x": 51.5, "fl_y": 52.5, "cx": 29.0, "cy": 21.0, "w": 60, "h": 40, "frames": frames })
}

fn without_focal_length(root: &Path) -> Vec<Camera> {
    save_images(root, [60, 40]);
    let focal = 30.0 / (0.5 * std::f64::consts::FRAC_PI_4).tan();
    let all = cameras(Intrinsics { fx: focal, fy: focal, cx: 30.0, cy: 20.0, ..pinhole() });
    let frames = document(&all, name)["frames"].take();
    let document = json!({
        "camera_angle_x": std::f64::consts::FRAC_PI_4, "aabb_scale": 16, "scale": 0.15, "offset": [0.5, 1.3, 0.2], "frames": frames,
    });
    write(&root.join("transforms.json"), &document);
    all
}

fn without_endings(root: &Path) -> Vec<Camera> {
    let all = cameras(pinhole());
    (0..9).for_each(|i| save_image(&root.join(format!("output_rendering/rendering_{i:04}.png")), 60, 40));
    write(&root.join("transforms.json"), &document(&all, |i| format!("output_rendering/rendering_{i:04}")));
    all
}

fn jpg_for_png(root: &Path) -> Vec<Camera> {
    let all = cameras(pinhole());
    fs::create_dir(root.join("images")).unwrap();
    for index in 0..9 {
        let picture = image::ImageBuffer::from_fn(60, 40, |x, y| image::Rgb([x as u8, y as u8, 9]));
        image::DynamicImage::from(picture).save(root.join(format!("images/{index}.jpg"))).unwrap();
    }
    write(&root.join("transforms.json"), &document(&all, |index| format!("./images/{index}.png")));
    all
}

fn own_intrinsics(root: &Path) -> Vec<Camera> {
    let mut all = cameras(pinhole());
    let mut document = document(&all, name);
    for (index, camera) in all.iter_mut().enumerate() {
        let [w, h] = [60 + 2 * index as u32, 40];
        save_image(&root.join(name(index)), w, h);
        let k1 = 0.01 * index as f64;
        let lens = if index == 0 {
            Lens::default()
        } else {
            Lens::perspective([k1, 0.0, 0.0, 0.0], [0.0; 2], [0.0; 3])
        };
        camera.intrinsics =
            Intrinsics { width: w, height: h, fx: 50.0 + index as f64, fy: 52.5, cx: 30.5, cy: 21.0, lens };
        let frame = &mut document["frames"][index];
        (frame["fl_x"], frame["fl_y"]) = (json!(50.0 + index as f64), json!(52.5));
        (frame["cx"], frame["w"], frame["k1"]) = (json!(30.5), json!(w), json!(k1));
    }
    write(&root.join("transforms.json"), &document);
    all
}

fn numbers_as_texts(root: &Path) -> Vec<Camera> {
    save_images(root, [60, 40]);
    let all = cameras(Intrinsics {
        lens: Lens::perspective([-0.01, 2e-3, 0.0, 0.0], [1e-4, 0.0], [0.0; 3]),
        ..pinhole()
    });
    let mut document = document(&all, name);
    for frame in document["frames"].as_array_mut().unwrap() {
        for (key, text) in
            [("k1", "-1e-002"), ("k2", "0.002"), ("k3", "0"), ("k4", "0"), ("p1", "1e-4"), ("p2", "0")]
        {
            frame[key] = json!(text);
        }
    }
    write(&root.join("transforms.json"), &document);
    all
}

/// Writes a failed calibration from two photographs, scaled to a tenth of their size.
fn wild_lens(root: &Path) -> Vec<Camera> {
    (0..9).for_each(|index| save_image(&root.join(name(index)), 64, 48));
    let mut document = document(&cameras(pinhole()), name);
    for (key, value) in [
        ("w", 64.0),
        ("h", 48.0),
        ("fl_x", 260.57),
        ("fl_y", 313.45),
        ("cx", 19.95),
        ("cy", 16.23),
        ("k1", -44.85),
        ("k2", 1017.4),
        ("p1", 0.621),
        ("p2", 0.9398),
    ] {
        document[key] = json!(value);
    }
    write(&root.join("transforms.json"), &document);
    Vec::new()
}

/// Saves a mask that is black where x is at least 30.
fn save_mask(path: &Path) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let half = image::ImageBuffer::from_fn(60, 40, |x, _| image::Luma([if x < 30 { 255_u8 } else { 0 }]));
    image::DynamicImage::from(half).save(path).unwrap();
}

fn save_opaque(path: &Path) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let picture = image::ImageBuffer::from_fn(60, 40, |x, y| image::Rgb([x as u8, y as u8, 9]));
    image::DynamicImage::from(picture).save(path).unwrap();
}

/// Writes photographs of the two cameras of a rig, which have the same names.
fn masks_in_folders(root: &Path) -> Vec<Camera> {
    let all = cameras(pinhole());
    let path = |index: usize| format!("{}/{:06}", if index < 5 { "back" } else { "front" }, index % 5);
    let mut document = document(&all, |index| format!("images/{}.png", path(index)));
    for index in 0..9 {
        save_opaque(&root.join(format!("images/{}.png", path(index))));
        save_mask(&root.join(format!("masks/{}.png", path(index))));
        document["frames"][index]["mask_path"] = json!(format!("masks/{}.png", path(index)));
    }
    write(&root.join("transforms.json"), &document);
    all
}

fn dynamic_masks(root: &Path) -> Vec<Camera> {
    let all = cameras(pinhole());
    for index in 0..9 {
        save_opaque(&root.join(name(index)));
        save_mask(&root.join(format!("images/dynamic_mask_{index}.png")));
    }
    write(&root.join("transforms.json"), &document(&all, name));
    all
}

/// Writes depth images that have almost the names of the photographs.
fn of_nerfcapture(root: &Path) -> Vec<Camera> {
    save_images(root, [60, 40]);
    let all = cameras(pinhole());
    let mut document = document(&all, |index| format!("images/{index}"));
    for index in 0..9 {
        save_image(&root.join(format!("images/{index}.depth.png")), 8, 6);
        document["frames"][index]["depth_path"] = json!(format!("images/{index}.depth.png"));
    }
    (document["w"], document["h"]) = (json!(60.0), json!(40.0));
    document["integer_depth_scale"] = json!(0.000_152_6);
    write(&root.join("transforms.json"), &document);
    all
}

/// Writes the poses of a scaled camera object: all axes are longer than 1 by the same factor.
fn scaled_camera(root: &Path) -> Vec<Camera> {
    save_images(root, [60, 40]);
    let all = cameras(pinhole());
    let mut document = document(&all, name);
    for (index, camera) in all.iter().enumerate() {
        let long = Camera { rotation: camera.rotation * 2.5, ..*camera };
        document["frames"][index]["transform_matrix"] = matrix(&long);
    }
    write(&root.join("transforms.json"), &document);
    all
}

/// Writes a pose whose right and up axes were not normalised: they are shorter than the viewing axis.
fn stretched_camera(root: &Path) -> Vec<Camera> {
    save_images(root, [60, 40]);
    let all = cameras(pinhole());
    let mut document = document(&all, name);
    let shrunk = DMat3::from_diagonal(DVec3::new(0.8, 0.8, 1.0));
    let stretched = Camera { rotation: all[4].rotation * shrunk, ..all[4] };
    document["frames"][4]["transform_matrix"] = matrix(&stretched);
    write(&root.join("transforms.json"), &document);
    Vec::new()
}

fn camera_at_the_origin(root: &Path) -> Vec<Camera> {
    save_images(root, [60, 40]);
    let mut all = cameras(pinhole());
    all[4].origin = DVec3::ZERO;
    write(&root.join("transforms.json"), &document(&all, name));
    all
}
