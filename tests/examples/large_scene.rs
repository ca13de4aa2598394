//! Writes a capture of any size: ray-traced pictures of the built-in scene, enlarged to JPEG photographs, and their
//! `transforms.json`. The capture tests how the program copes with size; the photographs show no more detail than the
//! ray-traced pictures.
//!
//!     cargo run --release -p trimip-tests --example large_scene -- FOLDER COUNT WIDTH HEIGHT

use image::{DynamicImage, RgbImage, codecs::jpeg::JpegEncoder, imageops::FilterType};
use serde_json::json;
use std::{fs, io::BufWriter, path::PathBuf};
use trimip_core::{Alpha, Camera, Intrinsics, scene::views::composite_pixel};
use trimip_data::builtin;
use trimip_data::settings::Finish;

/// Largest width of a ray-traced picture in pixels.
const TRACED: u32 = 500;
/// Horizontal field of view of a photograph in radians.
const ANGLE: f64 = 0.7;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, count, width, height] = &arguments[..] else {
        return Err("expected FOLDER COUNT WIDTH HEIGHT".into());
    };
    let (folder, count) = (PathBuf::from(folder), count.parse::<usize>()?);
    let (width, height): (u32, u32) = (width.parse()?, height.parse()?);
    let traced = Intrinsics::from_angle(TRACED.min(width), TRACED.min(width) * height / width, ANGLE);
    let full = Intrinsics::from_angle(width, height, ANGLE);
    fs::create_dir_all(folder.join("images"))?;
    let mut frames = Vec::new();
    for (i, camera) in builtin::train_cameras(traced, count).into_iter().enumerate() {
        let pixels = builtin::render(&camera, 1, Finish::Mixed, &|| ());
        let bytes = pixels.iter().flat_map(|&p| {
            composite_pixel(p, Alpha::Straight, [1.0; 3]).map(|channel| (255.0 * channel).round() as u8)
        });
        let picture = RgbImage::from_raw(traced.width, traced.height, bytes.collect()).ok_or("a size")?;
        let picture = DynamicImage::from(picture).resize_exact(width, height, FilterType::Triangle);
        let name = format!("images/{i:05}.jpg");
        let file = BufWriter::new(fs::File::create(folder.join(&name))?);
        picture.write_with_encoder(JpegEncoder::new_with_quality(file, 90))?;
        frames.push(json!({ "file_path": name, "transform_matrix": pose(&camera) }));
    }
    let scene = json!({
        "w": width, "h": height, "fl_x": full.fx, "fl_y": full.fy, "cx": full.cx, "cy": full.cy,
        "aabb_scale": 1, "frames": frames,
    });
    fs::write(folder.join("transforms.json"), scene.to_string())?;
    Ok(())
}

/// Returns the camera-to-world matrix, row by row.
fn pose(camera: &Camera) -> [[f64; 4]; 4] {
    let row = |i| {
        let [x, y, z] = camera.rotation.row(i).to_array();
        [x, y, z, camera.origin[i]]
    };
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}
