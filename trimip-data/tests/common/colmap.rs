//! Writes COLMAP models from one description, as text and binary files (COLMAP's documentation, Output format).

use std::{fmt::Write, path::Path};

/// A camera: number, model by number and name, size, parameters.
pub type CameraRow = (u32, i32, &'static str, [u64; 2], Vec<f64>);
/// An image: number, quaternion, translation, camera, name, features with the numbers of their points.
pub type ImageRow = (u32, [f64; 4], [f64; 3], u32, String, Vec<([f64; 2], i64)>);
/// A point: number, position, colour, error, track.
pub type PointRow = (u64, [f64; 3], [u8; 3], f64, Vec<[u32; 2]>);

/// Cameras, images and points as the files hold them.
#[derive(Clone, Default)]
pub struct Sparse {
    pub cameras: Vec<CameraRow>,
    pub images: Vec<ImageRow>,
    pub points: Vec<PointRow>,
}

/// The names of the three files.
pub const FILES: [&str; 3] = ["cameras", "images", "points3D"];

impl Sparse {
    /// Returns the text files, with COLMAP's comments.
    pub fn text(&self) -> [String; 3] {
        let joined = |values: &[f64]| values.iter().map(|v| format!("{v:e}")).collect::<Vec<_>>().join(" ");
        let mut cameras =
            "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH\n".to_string();
        for (id, _, name, [width, height], parameters) in &self.cameras {
            writeln!(cameras, "{id} {name} {width} {height} {}", joined(parameters)).unwrap();
        }
        let mut images = "# Image list with two lines of data per image:\n".to_string();
        for (id, q, t, camera, name, features) in &self.images {
            writeln!(images, "{id} {} {} {camera} {name}", joined(q), joined(t)).unwrap();
            let features = features.iter().map(|([x, y], point)| format!("{x} {y} {point}"));
            writeln!(images, "{}", features.collect::<Vec<_>>().join(" ")).unwrap();
        }
        let mut points = "# 3D point list\n".to_string();
        for (id, p, [r, g, b], error, track) in &self.points {
            write!(points, "{id} {} {r} {g} {b} {error}", joined(p)).unwrap();
            track.iter().for_each(|[image, feature]| write!(points, " {image} {feature}").unwrap());
            points.push('\n');
        }
        [cameras, images, points]
    }

    /// Returns the binary files.
    pub fn binary(&self) -> [Vec<u8>; 3] {
        let head = |count: usize| (count as u64).to_le_bytes().to_vec();
        let mut cameras = head(self.cameras.len());
        for (id, model, _, size, parameters) in &self.cameras {
            cameras.extend(id.to_le_bytes());
            cameras.extend(model.to_le_bytes());
            size.iter().for_each(|side| cameras.extend(side.to_le_bytes()));
            parameters.iter().for_each(|value| cameras.extend(value.to_le_bytes()));
        }
        let mut images = head(self.images.len());
        for (id, q, t, camera, name, features) in &self.images {
            images.extend(id.to_le_bytes());
            q.iter().chain(t).for_each(|value| images.extend(value.to_le_bytes()));
            images.extend(camera.to_le_bytes());
            images.extend(name.bytes());
            images.push(0);
            images.extend((features.len() as u64).to_le_bytes());
            for (place, point) in features {
                place.iter().for_each(|value| images.extend(value.to_le_bytes()));
                images.extend(point.to_le_bytes());
            }
        }
        let mut points = head(self.points.len());
        for (id, position, color, error, track) in &self.points {
            points.extend(id.to_le_bytes());
            position.iter().for_each(|value| points.extend(value.to_le_bytes()));
            points.extend(color);
            points.extend(error.to_le_bytes());
            points.extend((track.len() as u64).to_le_bytes());
            track.iter().flatten().for_each(|value| points.extend(value.to_le_bytes()));
        }
        [cameras, images, points]
    }

    /// Writes the text files to a folder.
    pub fn write_text(&self, folder: &Path) {
        std::fs::create_dir_all(folder).unwrap();
        for (name, text) in FILES.iter().zip(self.text()) {
            std::fs::write(folder.join(format!("{name}.txt")), text).unwrap();
        }
    }

    /// Writes the binary files to a folder.
    pub fn write_binary(&self, folder: &Path) {
        std::fs::create_dir_all(folder).unwrap();
        for (name, bytes) in FILES.iter().zip(self.binary()) {
            std::fs::write(folder.join(format!("{name}.bin")), bytes).unwrap();
        }
    }
}

/// Returns every camera model: number, name, parameters for an image of 60 × 40 pixels.
pub fn models() -> Vec<(i32, &'static str, Vec<f64>)> {
    vec![
        (0, "SIMPLE_PINHOLE", vec![41.5, 28.7, 21.3]),
        (1, "PINHOLE", vec![41.5, 39.25, 28.7, 21.3]),
        (2, "SIMPLE_RADIAL", vec![41.5, 28.7, 21.3, -0.11]),
        (3, "RADIAL", vec![41.5, 28.7, 21.3, -0.11, 0.03]),
        (4, "OPENCV", vec![41.5, 39.25, 28.7, 21.3, -0.11, 0.03, 0.002, -0.003]),
        (5, "OPENCV_FISHEYE", vec![31.5, 29.25, 28.7, 21.3, -0.02, 0.004, -0.002, 0.0003]),
        (6, "FULL_OPENCV", vec![41.5, 39.25, 28.7, 21.3, 0.1, 0.02, 0.002, -0.003, 0.003, 0.2, 0.02, 0.001]),
        (8, "SIMPLE_RADIAL_FISHEYE", vec![31.5, 28.7, 21.3, -0.03]),
        (9, "RADIAL_FISHEYE", vec![31.5, 28.7, 21.3, -0.03, 0.005]),
        (
            10,
            "THIN_PRISM_FISHEYE",
            vec![31.5, 29.25, 28.7, 21.3, 0.03, -0.01, 0.001, -0.0005, 0.002, -0.0002, 0.002, -0.001],
        ),
    ]
}

/// Returns the camera models that only later versions have.
pub fn later_models() -> Vec<(i32, &'static str, Vec<f64>)> {
    vec![(14, "SIMPLE_FISHEYE", vec![31.5, 28.7, 21.3]), (15, "FISHEYE", vec![31.5, 29.25, 28.7, 21.3])]
}

/// Returns the rotation by a quaternion w, x, y, z of length 1, as rows.
pub fn rotation([w, x, y, z]: [f64; 4]) -> [[f64; 3]; 3] {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Returns the world-to-camera rotation and translation of the n-th camera of a ring that looks roughly at the origin.
pub fn placed(n: u32) -> ([f64; 4], [f64; 3]) {
    let angle = 0.5 * f64::from(n);
    let q = [angle.cos(), 0.1 * angle.sin(), 0.9 * angle.sin(), 0.2 * (angle + 1.0).cos()];
    let length = q.iter().map(|part| part * part).sum::<f64>().sqrt();
    (q.map(|part| part / length), [0.1, -0.2 + 0.05 * f64::from(n), 4.0])
}

/// Returns a capture of one image per camera model, in two folders, with a grid of points that all images see. The
/// positions of features identify their images and are no projections of the points.
pub fn capture() -> Sparse {
    capture_by(models())
}

/// Returns such a capture with one image for each of these camera models.
pub fn capture_by(models: Vec<(i32, &'static str, Vec<f64>)>) -> Sparse {
    let mut sparse = Sparse::default();
    for (n, (model, name, parameters)) in (0_u32..).zip(models) {
        sparse.cameras.push((n + 1, model, name, [60, 40], parameters));
        let (q, t) = placed(n);
        let features =
            (0..125).map(|i| ([f64::from(i) * 0.4, f64::from(n) + 0.5], i64::from(i) + 1)).collect();
        let folder = if n % 2 == 0 { "left" } else { "right side" };
        sparse.images.push((n + 1, q, t, n + 1, format!("{folder}/{:04}.png", n / 2), features));
    }
    for i in 0..125_u32 {
        let at = [i % 5, i / 5 % 5, i / 25].map(|step| 0.4 * f64::from(step) - 0.8);
        let track = (1..=10).map(|image| [image, i]).collect();
        sparse.points.push((u64::from(i) + 1, at, [i as u8, 7, 200], 0.5, track));
    }
    sparse
}
