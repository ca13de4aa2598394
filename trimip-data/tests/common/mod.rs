//! Small scenes on disk, and the folder of the shared photographs.
#![allow(dead_code, missing_docs)] // each test file uses its part

pub mod colmap;
pub mod ring;
pub mod zip;

use image::{DynamicImage, ImageBuffer, Rgba};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use trimip_core::ViewSet;
use trimip_data::settings::DataConfig;

/// Returns the settings for the scene in a folder.
pub fn settings(root: &Path, scales: u32) -> DataConfig {
    let root = root.to_str().expect("folders of tests are UTF-8").into();
    DataConfig { root, scales, ..DataConfig::default() }
}

/// Saves an RGBA image without two equal pixels.
pub fn save_image(path: &Path, width: u32, height: u32) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let pixel = |x, y| Rgba([(x * 7 + y) as u8, (y * 11) as u8, (x ^ y) as u8, (x * y * 5) as u8]);
    DynamicImage::from(ImageBuffer::from_fn(width, height, pixel)).save(path).unwrap();
}

pub fn frame(path: &str) -> Value {
    json!({
        "file_path": path,
        "transform_matrix": [[1.0, 0.0, 0.0, 0.1], [0.0, 0.0, -1.0, -4.0], [0.0, 1.0, 0.0, 0.3], [0, 0, 0, 1]],
    })
}

/// Writes `transforms_{train,test}.json` with two frames of 16 × 12 pixels each, and their photographs.
pub fn blender_scene(root: &Path) {
    for split in ["train", "test"] {
        let paths = [0, 1].map(|i| format!("./{split}/r_{i}"));
        for path in &paths {
            save_image(&root.join(format!("{path}.png")), 16, 12);
        }
        let document = json!({ "camera_angle_x": 0.7, "frames": paths.iter().map(|path| frame(path)).collect::<Vec<_>>() });
        write(&root.join(format!("transforms_{split}.json")), &document);
    }
}

pub fn write(path: &Path, document: &Value) {
    std::fs::write(path, serde_json::to_string_pretty(document).unwrap()).unwrap();
}

/// Asserts that two sets are equal for training: cameras, pixels, scales, meaning of alpha.
pub fn assert_same(a: &ViewSet, b: &ViewSet) {
    assert_eq!(a.scales, b.scales);
    assert_eq!(a.alpha, b.alpha);
    assert_eq!(a.views.len(), b.views.len());
    for (a, b) in a.views.iter().zip(&b.views) {
        assert_eq!((a.camera, a.offset), (b.camera, b.offset), "{} {}", a.name, b.name);
    }
    assert!(a.pixels == b.pixels, "pixels differ");
}

/// Returns the folder of a shared data set, or `None` after printing why the test does nothing.
pub fn shared(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("TRIMIP_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    let folder = root.join("data").join(name);
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: {} is not there; set TRIMIP_SHARED to the folder that holds data/", folder.display());
    None
}
