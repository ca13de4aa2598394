//! Photographs of kinds that some programs do not read.

use super::Input;
use crate::common::{
    frame,
    ring::{cameras, pinhole},
    write,
};
use image::{DynamicImage, ImageBuffer, Luma, LumaA, Rgb};
use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_core::Camera;

pub const INPUTS: &[(&str, Input)] = &[
    ("photographs_tif", tif),
    ("photographs_grey", grey),
    ("photographs_grey_with_alpha", grey_with_alpha),
    ("photographs_heic", heic),
];

/// Writes a scene of nine frames with the same picture.
fn scene(root: &Path, ending: &str, picture: &DynamicImage) -> Vec<Camera> {
    fs::create_dir(root.join("images")).unwrap();
    let named = |index: usize| format!("images/{index}.{ending}");
    (0..9).for_each(|index| picture.save(root.join(named(index))).unwrap());
    let all = cameras(pinhole());
    let frames: Vec<Value> = all
        .iter()
        .enumerate()
        .map(|(index, camera)| {
            let (r, o) = (camera.rotation, camera.origin);
            let row = |i: usize| json!([r.x_axis[i], r.y_axis[i], r.z_axis[i], o[i]]);
            let mut frame = frame(&named(index));
            frame["transform_matrix"] = json!([row(0), row(1), row(2)]);
            frame
        })
        .collect();
    let document =
        json!({ "fl_x": 51.5, "fl_y": 52.5, "cx": 29.0, "cy": 21.0, "w": 60, "h": 40, "frames": frames });
    write(&root.join("transforms.json"), &document);
    all
}

fn color() -> DynamicImage {
    ImageBuffer::from_fn(60, 40, |x, y| Rgb([x as u8, y as u8, 9])).into()
}

fn tif(root: &Path) -> Vec<Camera> {
    scene(root, "tif", &color())
}

fn grey(root: &Path) -> Vec<Camera> {
    scene(root, "png", &ImageBuffer::from_fn(60, 40, |x, y| Luma([(x + y) as u8])).into())
}

fn grey_with_alpha(root: &Path) -> Vec<Camera> {
    scene(root, "png", &ImageBuffer::from_fn(60, 40, |x, y| LumaA([x as u8, y as u8])).into())
}

/// Writes HEIC photographs of a phone, under the names that the transforms file states.
fn heic(root: &Path) -> Vec<Camera> {
    scene(root, "jpg", &color());
    for index in 0..9 {
        fs::write(root.join(format!("images/{index}.jpg")), b"\0\0\0\x18ftypheic\0\0\0\0mif1heic").unwrap();
    }
    Vec::new()
}
