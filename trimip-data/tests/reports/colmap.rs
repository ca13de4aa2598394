//! Models of COLMAP as COLMAP, RealityScan, Metashape and BlenderNeRF write them.

use super::Input;
use crate::common::{
    colmap::Sparse,
    ring::{cameras, pinhole, vision},
    save_image,
};
use glam::DQuat;
use std::{fs, path::Path};
use trimip_core::{Camera, Intrinsics, Lens};

pub const INPUTS: &[(&str, Input)] = &[
    ("colmap_subfolders", subfolders),
    ("colmap_blanks_in_names", blanks_in_names),
    ("colmap_realityscan", realityscan),
    ("colmap_text_alone", text_alone),
    ("colmap_simple_radial", simple_radial),
    ("colmap_simple_radial_fisheye", simple_radial_fisheye),
    ("colmap_full_opencv", full_opencv),
    ("colmap_rigs", rigs),
    ("colmap_points_blank", points_blank),
    ("colmap_cameras_blank", cameras_blank),
    ("colmap_several_sizes", several_sizes),
    ("colmap_few_masks", few_masks),
    ("colmap_masks_of_metashape", masks_of_metashape),
    ("colmap_masks_with_two_endings", masks_with_two_endings),
    ("colmap_blendernerf", blendernerf),
];

fn plain(index: usize) -> String {
    format!("{index}.png")
}

/// Returns a model of these cameras, and saves their photographs.
fn model(
    root: &Path,
    all: &[Camera],
    parameters: (i32, &'static str, Vec<f64>),
    name: fn(usize) -> String,
) -> Sparse {
    let size = [all[0].intrinsics.width, all[0].intrinsics.height];
    let mut sparse = Sparse::default();
    sparse.cameras.push((1, parameters.0, parameters.1, size.map(u64::from), parameters.2));
    for (index, camera) in all.iter().enumerate() {
        let (rotation, t) = vision(camera);
        let q = DQuat::from_mat3(&rotation);
        let named = name(index);
        save_image(&root.join("images").join(&named), size[0], size[1]);
        sparse.images.push((index as u32 + 1, [q.w, q.x, q.y, q.z], t.to_array(), 1, named, Vec::new()));
    }
    sparse
}

fn pinholes(root: &Path, name: fn(usize) -> String) -> (Vec<Camera>, Sparse) {
    let all = cameras(pinhole());
    let sparse = model(root, &all, (1, "PINHOLE", vec![51.5, 52.5, 29.0, 21.0]), name);
    (all, sparse)
}

fn subfolders(root: &Path) -> Vec<Camera> {
    let (all, sparse) =
        pinholes(root, |index| format!("{}/{index}.png", if index < 5 { "a left" } else { "b" }));
    sparse.write_binary(&root.join("sparse/0"));
    all
}

fn blanks_in_names(root: &Path) -> Vec<Camera> {
    let (all, sparse) = pinholes(root, |index| format!("A-DJI_000{index}_V_map-plan 670f-wp-2 (402).png"));
    sparse.write_text(&root.join("sparse/0"));
    all
}

/// Writes exponents of three digits, line ends of Windows, features after each image, and no line break at the end.
fn realityscan(root: &Path) -> Vec<Camera> {
    let (all, mut sparse) = pinholes(root, plain);
    let observed = |image: u32| [image, 0];
    sparse.points.push((8574, [0.1, 0.2, 0.3], [9, 99, 199], 0.5, (1..=9).map(observed).collect()));
    sparse.images.iter_mut().for_each(|image| image.5.push(([7.5, 10.25], 8574)));
    let folder = root.join("sparse/0");
    fs::create_dir_all(&folder).unwrap();
    for (name, text) in ["cameras", "images", "points3D"].iter().zip(sparse.text()) {
        let exponents = |word: &str| {
            let Some((digits, power)) = word.split_once('e') else { return word.to_string() };
            match (digits.parse::<f64>(), power.parse::<i32>()) {
                (Ok(_), Ok(power)) => {
                    format!("{digits}e{}{:03}", if power < 0 { '-' } else { '+' }, power.abs())
                }
                _ => word.to_string(),
            }
        };
        let line = |line: &str| line.split(' ').map(exponents).collect::<Vec<_>>().join(" ");
        let lines: Vec<String> = text.lines().map(line).collect();
        fs::write(folder.join(format!("{name}.txt")), lines.join("\r\n").trim_end()).unwrap();
    }
    all
}

fn text_alone(root: &Path) -> Vec<Camera> {
    let (all, sparse) = pinholes(root, plain);
    sparse.write_text(&root.join("sparse/0"));
    all
}

/// Writes a model of nine cameras with this lens.
fn of_lens(
    root: &Path,
    lens: Lens,
    focal: [f64; 2],
    parameters: (i32, &'static str, Vec<f64>),
) -> Vec<Camera> {
    let all = cameras(Intrinsics { fx: focal[0], fy: focal[1], lens, ..pinhole() });
    model(root, &all, parameters, plain).write_binary(&root.join("sparse/0"));
    all
}

fn simple_radial(root: &Path) -> Vec<Camera> {
    let lens = Lens::perspective([-0.11, 0.0, 0.0, 0.0], [0.0; 2], [0.0; 3]);
    of_lens(root, lens, [41.5; 2], (2, "SIMPLE_RADIAL", vec![41.5, 29.0, 21.0, -0.11]))
}

fn simple_radial_fisheye(root: &Path) -> Vec<Camera> {
    let lens = Lens::fisheye([-0.03, 0.0, 0.0, 0.0], [0.0; 2], [0.0; 2]);
    of_lens(root, lens, [31.5; 2], (8, "SIMPLE_RADIAL_FISHEYE", vec![31.5, 29.0, 21.0, -0.03]))
}

fn full_opencv(root: &Path) -> Vec<Camera> {
    let lens = Lens::perspective([0.1, 0.02, 0.003, 0.0], [0.002, -0.003], [0.2, 0.02, 0.001]);
    let terms = vec![41.5, 39.25, 29.0, 21.0, 0.1, 0.02, 0.002, -0.003, 0.003, 0.2, 0.02, 0.001];
    of_lens(root, lens, [41.5, 39.25], (6, "FULL_OPENCV", terms))
}

/// Writes the two additional files of COLMAP 3.12.
fn rigs(root: &Path) -> Vec<Camera> {
    let (all, sparse) = pinholes(root, |index| format!("pano_camera{}/frame{index}.png", index / 5));
    let folder = root.join("sparse/0");
    sparse.write_binary(&folder);
    for name in ["rigs.bin", "frames.bin"] {
        fs::write(folder.join(name), 1_u64.to_le_bytes()).unwrap();
    }
    all
}

fn points_blank(root: &Path) -> Vec<Camera> {
    let all = text_alone(root);
    fs::write(root.join("sparse/0/points3D.txt"), "").unwrap();
    all
}

fn cameras_blank(root: &Path) -> Vec<Camera> {
    text_alone(root);
    fs::write(root.join("sparse/0/cameras.txt"), "").unwrap();
    Vec::new()
}

/// Writes a model in which every second photograph is from another camera.
fn several_sizes(root: &Path) -> Vec<Camera> {
    let (mut all, mut sparse) = pinholes(root, plain);
    let other =
        Intrinsics { width: 30, height: 44, fx: 33.0, fy: 33.0, cx: 15.0, cy: 22.0, lens: Lens::default() };
    sparse.cameras.push((7, 0, "SIMPLE_PINHOLE", [30, 44], vec![33.0, 15.0, 22.0]));
    for index in (1..9).step_by(2) {
        all[index].intrinsics = other;
        sparse.images[index].3 = 7;
        save_image(&root.join("images").join(plain(index)), 30, 44);
    }
    sparse.write_text(&root.join("sparse/0"));
    all
}

/// Saves a mask whose left half is kept.
fn save_mask(path: &Path) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    let half = image::ImageBuffer::from_fn(60, 40, |x, _| image::Luma([if x < 30 { 255_u8 } else { 0 }]));
    image::DynamicImage::from(half).save(path).unwrap();
}

/// Saves opaque photographs, to which masks may apply.
fn opaque(root: &Path, name: fn(usize) -> String) {
    for index in 0..9 {
        let picture = image::ImageBuffer::from_fn(60, 40, |x, y| image::Rgb([x as u8, y as u8, 9]));
        image::DynamicImage::from(picture).save(root.join("images").join(name(index))).unwrap();
    }
}

fn few_masks(root: &Path) -> Vec<Camera> {
    let all = text_alone(root);
    opaque(root, plain);
    (2..5).for_each(|index| save_mask(&root.join("masks").join(plain(index))));
    all
}

fn masks_of_metashape(root: &Path) -> Vec<Camera> {
    let name = |index: usize| format!("_091-frame001_{index}_mask_{index}.jpg");
    let (all, sparse) = pinholes(root, name);
    sparse.write_text(&root.join("sparse/0"));
    opaque(root, name);
    (0..9).for_each(|index| save_mask(&root.join("masks").join(name(index).replace(".jpg", ".png"))));
    all
}

fn masks_with_two_endings(root: &Path) -> Vec<Camera> {
    let all = text_alone(root);
    opaque(root, plain);
    (0..9).for_each(|index| save_mask(&root.join("masks").join(format!("{}.png", plain(index)))));
    all
}

/// Writes BlenderNeRF's own comments, and an additional PLY file.
fn blendernerf(root: &Path) -> Vec<Camera> {
    let all = text_alone(root);
    let path = root.join("sparse/0/images.txt");
    let text = fs::read_to_string(&path).unwrap();
    let head = "# Image list with two lines of data per image:\n# IMAGE_ID, QVEC (w, x, y, z), TVEC (x, y, z), CAMERA_ID, NAME\n";
    fs::write(path, format!("{head}{text}")).unwrap();
    fs::write(root.join("sparse/0/points3D.ply"), "ply\nformat ascii 1.0\nelement vertex 0\nend_header\n")
        .unwrap();
    all
}
