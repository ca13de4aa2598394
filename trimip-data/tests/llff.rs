//! Tests of LLFF captures: the rays of `poses_bounds.npy` are those of the same cameras in `transforms.json`, and data
//! that do not fit are refused with their place.

use crate::common::{assert_same, save_image, settings, write};
use glam::{DMat3, DVec3};
use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_data::open;
use trimip_data::settings::DataConfig;

/// Number of photographs of a capture.
const FRAMES: usize = 10;

/// Width and height of the photographs, and their focal length in pixels.
const SIZE: [u32; 2] = [16, 12];
const FOCAL: f64 = 20.5;

/// Returns the rotation and the position of a camera, OpenGL axes: right, up, backwards.
fn pose(index: usize) -> (DMat3, DVec3) {
    let turn = DMat3::from_rotation_y(0.1 * index as f64) * DMat3::from_rotation_x(0.3);
    (turn, DVec3::new(index as f64, -0.5, 4.25))
}

/// Returns the row of a camera, as LLFF writes it: `[R | t | (h, w, f)]` row by row, then the bounds. The columns of R
/// are down, right, backwards.
fn row(index: usize) -> Vec<f64> {
    let (rotation, place) = pose(index);
    let [right, up, back] = [rotation.x_axis, rotation.y_axis, rotation.z_axis];
    let last = [f64::from(SIZE[1]), f64::from(SIZE[0]), FOCAL];
    let rows = (0..3).flat_map(|i| [-up[i], right[i], back[i], place[i], last[i]]);
    rows.chain([1.5, 30.0]).collect()
}

/// Returns a file of rows of f64.
fn npy(rows: &[Vec<f64>]) -> Vec<u8> {
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, 17), }}\n", rows.len());
    let start = [b"\x93NUMPY\x01\0", &(header.len() as u16).to_le_bytes()[..], header.as_bytes()].concat();
    start.into_iter().chain(rows.iter().flatten().flat_map(|value| value.to_le_bytes())).collect()
}

/// Writes a capture with photographs in a folder; their size is `SIZE` divided by `by`.
fn capture(root: &Path, folder: &str, by: u32) {
    let rows: Vec<Vec<f64>> = (0..FRAMES).map(row).collect();
    fs::write(root.join("poses_bounds.npy"), npy(&rows)).unwrap();
    for index in 0..FRAMES {
        save_image(&root.join(folder).join(format!("IMG_{index:02}.png")), SIZE[0] / by, SIZE[1] / by);
    }
}

#[test]
fn rays_are_those_of_the_same_cameras_in_a_transforms_file() {
    let (llff, ngp) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    capture(llff.path(), "images", 1);
    capture(ngp.path(), "images", 1);
    fs::remove_file(ngp.path().join("poses_bounds.npy")).unwrap();
    let frames: Vec<Value> = (0..FRAMES)
        .map(|index| {
            let (r, t) = pose(index);
            let row = |i: usize| json!([r.x_axis[i], r.y_axis[i], r.z_axis[i], t[i]]);
            json!({
                "file_path": format!("images/IMG_{index:02}.png"),
                "transform_matrix": [row(0), row(1), row(2), [0, 0, 0, 1]],
            })
        })
        .collect();
    let document = json!({ "fl_x": FOCAL, "w": SIZE[0], "h": SIZE[1], "frames": frames });
    write(&ngp.path().join("transforms.json"), &document);
    let [ours, theirs] = [&llff, &ngp].map(|folder| open(&settings(folder.path(), 2)).unwrap());
    assert_same(&ours.train, &theirs.train);
    assert_eq!((ours.test.len(), theirs.test.len()), (2, 2));
    for index in 0..2 {
        let [ours, theirs] = [&ours, &theirs].map(|scene| scene.test.load(index).unwrap());
        assert_same(&ours, &theirs);
        for (ours, theirs) in ours.views.iter().zip(&theirs.views) {
            let k = ours.camera.intrinsics;
            for (x, y) in [(0, 0), (k.width - 1, 0), (k.width / 2, k.height - 1)] {
                let [a, b] = [ours, theirs].map(|view| view.camera.cone::<f64>(x, y));
                assert_eq!((a.origin, a.direction), (b.origin, b.direction));
            }
        }
    }
    assert!(ours.description[0].contains("LLFF capture"), "{:?}", ours.description);
    assert!(ours.description.iter().any(|line| line.contains("1.500 to 30.000")), "{:?}", ours.description);
}

/// Checks a ray against the written-out equations of NeRF's `load_llff.py` and `get_rays`: the columns of the matrix
/// become right, up, backwards, and a pixel's direction is that of ((x − w/2) / f, −(y − h/2) / f, −1).
#[test]
fn rays_are_those_of_the_code_of_nerf() {
    let folder = tempfile::tempdir().unwrap();
    capture(folder.path(), "images", 1);
    let scene = open(&settings(folder.path(), 1)).unwrap();
    // The first photograph is a test frame.
    let cone = scene.train.views[0].camera.cone::<f64>(3, 2);
    let own = row(1);
    let matrix: Vec<&[f64]> = own.chunks(5).take(3).collect();
    let local = [(3.5 - 8.0) / FOCAL, -(2.5 - 6.0) / FOCAL, -1.0];
    let turned = |i: usize| matrix[i][1] * local[0] - matrix[i][0] * local[1] + matrix[i][2] * local[2];
    let direction = DVec3::new(turned(0), turned(1), turned(2)).normalize();
    assert!((DVec3::from(cone.direction) - direction).length() < 1e-12);
    assert_eq!(cone.origin, [matrix[0][3], matrix[1][3], matrix[2][3]]);
}

#[test]
fn every_eighth_photograph_is_tested_on_unless_settings_say_otherwise() {
    let folder = tempfile::tempdir().unwrap();
    capture(folder.path(), "images", 1);
    let data = settings(folder.path(), 1);
    let tested = |data: &DataConfig| {
        let test = open(data).unwrap().test;
        (0..test.len()).map(|index| test.load(index).unwrap().views[0].name.clone()).collect::<Vec<_>>()
    };
    assert_eq!(tested(&data), ["IMG_00", "IMG_08"]);
    fs::write(folder.path().join("test.txt"), "IMG_03.png\nIMG_05\n").unwrap();
    assert_eq!(tested(&DataConfig { test_list: "test.txt".into(), ..data.clone() }), ["IMG_03", "IMG_05"]);
    assert_eq!(tested(&DataConfig { format: "llff".into(), ..data.clone() }), ["IMG_00", "IMG_08"]);
    let lines = open(&data).unwrap().description;
    assert!(lines.iter().any(|line| line.contains("every 8th frame in order of their names")));
}

#[test]
fn photographs_in_another_size_have_their_focal_length_scaled() {
    let folder = tempfile::tempdir().unwrap();
    capture(folder.path(), "images_4", 4);
    let scene = open(&settings(folder.path(), 1)).unwrap();
    let k = scene.train.views[0].camera.intrinsics;
    assert_eq!((k.width, k.height, k.fx, k.fy, k.cx, k.cy), (4, 3, FOCAL / 4.0, FOCAL / 4.0, 2.0, 1.5));
    assert!(scene.warnings.iter().any(|w| w.contains("0.2500 times as wide")), "{:?}", scene.warnings);
    // The named folder is the one that is read.
    capture(folder.path(), "images", 1);
    capture(folder.path(), "small", 2);
    let width = |images: &str| {
        let data = DataConfig { images: images.into(), ..settings(folder.path(), 1) };
        open(&data).unwrap().train.views[0].camera.intrinsics.width
    };
    assert_eq!(["", "images_4", "small"].map(width), [16, 4, 8]);
}

#[test]
fn what_does_not_fit_is_refused_with_its_place() {
    type Break = fn(&Path);
    fn rows(root: &Path, change: fn(&mut Vec<Vec<f64>>)) {
        let mut rows: Vec<Vec<f64>> = (0..FRAMES).map(row).collect();
        change(&mut rows);
        fs::write(root.join("poses_bounds.npy"), npy(&rows)).unwrap();
    }
    let file = "ROOT/poses_bounds.npy: ";
    let cases: [(Break, &str, &str); 9] = [
        (
            |root| fs::remove_file(root.join("images/IMG_04.png")).unwrap(),
            file,
            "holds 10 poses, but ROOT/images holds 9",
        ),
        (
            |root| fs::remove_dir_all(root.join("images")).unwrap(),
            "ROOT: ",
            "holds no photographs of poses_bounds.npy",
        ),
        (
            |root| save_image(&root.join("images/IMG_01.png"), 16, 16),
            "ROOT/poses_bounds.npy: pose 1 (IMG_01.png): ",
            "16x16",
        ),
        (|root| fs::write(root.join("poses_bounds.npy"), "").unwrap(), file, "is not a table of NumPy"),
        (|root| rows(root, |rows| rows.clear()), file, "holds 0 x 17 numbers"),
        (|root| rows(root, |rows| rows[2][16] = f64::NAN), file, "not finite in row 2"),
        (
            |root| rows(root, |rows| rows[2][0] = 9.0),
            "ROOT/poses_bounds.npy: pose 2 (IMG_02.png): ",
            "is not a rotation",
        ),
        (
            |root| rows(root, |rows| rows[3][14] = 0.0),
            "ROOT/poses_bounds.npy: pose 3 (IMG_03.png): ",
            "focal length 0",
        ),
        (
            |root| rows(root, |rows| rows[3][4] = -12.0),
            "ROOT/poses_bounds.npy: pose 3 (IMG_03.png): ",
            "16 x -12 pixels",
        ),
    ];
    for (breaking, place, what) in cases {
        let folder = tempfile::tempdir().unwrap();
        capture(folder.path(), "images", 1);
        breaking(folder.path());
        let error = open(&settings(folder.path(), 1)).expect_err(what);
        let message = error.message().replace(folder.path().to_str().unwrap(), "ROOT");
        assert_eq!(error.kind(), trimip_core::ErrorKind::Input, "{message}");
        assert!(message.starts_with(place) && message.contains(what) && message.contains("; "), "{message}");
    }
}
