//! Tests of photographs as cameras store them: orientation tags, formats that are not read, names with the extension of another format.

use crate::common::{blender_scene, frame, save_image, settings, write};
use image::{
    DynamicImage, ImageBuffer, ImageEncoder, Rgb,
    codecs::{jpeg::JpegEncoder, png::PngEncoder},
};
use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_data::{Scene, inspect, open, unwatched};

/// Returns an EXIF block with nothing but an orientation.
fn exif(orientation: u8) -> Vec<u8> {
    [&b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0"[..], &[orientation], &[0; 6]].concat()
}

/// Returns a picture whose pixel (x, y) is (x, y, 9).
fn picture(width: u32, height: u32) -> DynamicImage {
    ImageBuffer::from_fn(width, height, |x, y| Rgb([x as u8, y as u8, 9])).into()
}

fn save(path: &Path, width: u32, height: u32, orientation: u8) {
    let mut bytes = Vec::new();
    let image = picture(width, height);
    if path.extension().is_some_and(|extension| extension == "jpg") {
        let mut encoder = JpegEncoder::new_with_quality(&mut bytes, 100);
        encoder.set_exif_metadata(exif(orientation)).unwrap();
        image.write_with_encoder(encoder).unwrap();
    } else {
        let mut encoder = PngEncoder::new(&mut bytes);
        encoder.set_exif_metadata(exif(orientation)).unwrap();
        image.write_with_encoder(encoder).unwrap();
    }
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

/// Opens a scene of three photographs of one stored size and tag; `stated` is their size in the file.
fn scene(root: &Path, extension: &str, stored: (u32, u32), orientation: u8, stated: Value) -> Scene {
    let names: Vec<String> = (0..3).map(|i| format!("images/{i}.{extension}")).collect();
    names.iter().for_each(|name| save(&root.join(name), stored.0, stored.1, orientation));
    let mut document =
        json!({ "camera_angle_x": 0.7, "frames": names.iter().map(|name| frame(name)).collect::<Vec<_>>() });
    stated.as_object().unwrap().iter().for_each(|(key, value)| document[key] = value.clone());
    write(&root.join("transforms.json"), &document);
    open(&settings(root, 1)).unwrap()
}

/// Returns width, height, and the pixel of the upper left corner.
fn corner(scene: &Scene) -> (u32, u32, [u8; 4]) {
    let k = &scene.train.views[0].camera.intrinsics;
    (k.width, k.height, scene.train.pixels_of(0)[0])
}

#[test]
fn a_photograph_is_turned_only_if_the_stated_size_asks_for_it() {
    let told = |scene: &Scene| scene.warnings.iter().any(|warning| warning.contains("EXIF orientation"));
    // Orientation 6: the stored picture is to be turned by 90° clockwise, which moves its lower left corner to the upper left.
    let cases = [
        (6, json!({ "w": 20, "h": 12 }), (20, 12, [0, 0, 9, 255]), false),
        (6, json!({ "w": 12, "h": 20 }), (12, 20, [0, 11, 9, 255]), false),
        (8, json!({ "w": 12, "h": 20 }), (12, 20, [19, 0, 9, 255]), false),
        (6, json!({}), (20, 12, [0, 0, 9, 255]), true),
        (3, json!({ "w": 20, "h": 12 }), (20, 12, [0, 0, 9, 255]), true),
        (1, json!({}), (20, 12, [0, 0, 9, 255]), false),
    ];
    for (orientation, stated, expected, warned) in cases {
        let folder = tempfile::tempdir().unwrap();
        let scene = scene(folder.path(), "png", (20, 12), orientation, stated.clone());
        assert_eq!(corner(&scene), expected, "{orientation} {stated}");
        assert_eq!(told(&scene), warned, "{orientation} {stated}: {:?}", scene.warnings);
    }
    let folder = tempfile::tempdir().unwrap();
    let square = scene(folder.path(), "png", (16, 16), 6, json!({ "w": 16, "h": 16 }));
    assert_eq!(corner(&square).2, [0, 0, 9, 255]);
    let warning = square.warnings.iter().find(|warning| warning.contains("EXIF")).unwrap();
    assert!(warning.starts_with("3 photographs") && warning.contains("images/1.png"), "{warning}");
}

#[test]
fn jpegs_are_turned_as_pngs_are() {
    let folder = tempfile::tempdir().unwrap();
    let turned = scene(folder.path(), "jpg", (32, 16), 6, json!({ "w": 16, "h": 32 }));
    let (width, height, [x, y, ..]) = corner(&turned);
    assert_eq!((width, height), (16, 32));
    // Equal up to the loss of the format.
    assert!(x.abs_diff(0) <= 4 && y.abs_diff(15) <= 4, "{x} {y}");
}

#[test]
fn formats_that_are_not_read_are_named_with_what_converts_them() {
    let error = |breaking: &dyn Fn(&Path)| {
        let folder = tempfile::tempdir().unwrap();
        blender_scene(folder.path());
        breaking(folder.path());
        let error = open(&settings(folder.path(), 1)).unwrap_err();
        assert!(error.kind() == trimip_core::ErrorKind::Input && !error.message().contains('\n'), "{error}");
        error.message()
    };
    let heic = b"\0\0\0\x18ftypheic\0\0\0\0mif1heic";
    let inside = error(&|root| fs::write(root.join("train/r_1.png"), heic).unwrap());
    for part in ["frame 1 (./train/r_1)", "r_1.png is a HEIC image, which is not read", "heif-convert"] {
        assert!(inside.contains(part), "{part}: {inside}");
    }
    // Phones write IMG.HEIC, but the entries name files that were converted on another machine.
    let beside = error(&|root| {
        fs::remove_file(root.join("train/r_1.png")).unwrap();
        fs::write(root.join("train/r_1.HEIC"), heic).unwrap();
    });
    for part in ["frame 1 (./train/r_1)", "does not exist", "r_1.HEIC in its folder is a HEIC image"] {
        assert!(beside.contains(part), "{part}: {beside}");
    }
}

#[test]
fn sizes_and_kinds_of_files_may_be_mixed() {
    let folder = tempfile::tempdir().unwrap();
    blender_scene(folder.path());
    let train = folder.path().join("train");
    // A JPEG under the name of a PNG, and a PNG of 16 bits and another size.
    picture(16, 12).save(train.join("r_0.jpg")).unwrap();
    fs::rename(train.join("r_0.jpg"), train.join("r_0.png")).unwrap();
    let deep = ImageBuffer::from_fn(10, 14, |x, y| Rgb([257 * x as u16, 257 * y as u16 + 100, 65_535]));
    DynamicImage::from(deep).save(train.join("r_1.png")).unwrap();
    let scene = open(&settings(folder.path(), 2)).unwrap();
    assert_eq!(scene.train.pixels_of(1)[10 * 3 + 7], [7, 3, 255, 255]);
    assert_eq!(scene.train.pixels_of(1).len(), 140);
    let lines = inspect(&settings(folder.path(), 2), &unwatched).unwrap().join("\n");
    assert!(lines.contains("2 sizes from 10x14 to 16x12"), "{lines}");
    save_image(&train.join("r_0.png"), 16, 12);
    assert!(open(&settings(folder.path(), 2)).is_ok());
}
