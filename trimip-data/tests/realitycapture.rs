//! Tests of camera parameters of RealityCapture and RealityScan: a line is read as RealityCapture's own formulas say,
//! and errors name what is broken.

use crate::common::{save_image, settings};
use glam::{DMat3, DVec3};
use std::{fs, path::Path};
use trimip_core::{Intrinsics, Lens};
use trimip_data::open;

const HEADER: &str = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2";

/// Returns position, heading, pitch and roll of one of nine cameras.
fn placed(index: usize) -> [f64; 6] {
    let i = index as f64;
    [40.0 + i, 130.0 - 2.0 * i, 6.5 + 0.25 * i, 170.0 - 25.0 * i, 85.0 + i, -22.5 + 3.0 * i]
}

/// Returns the world-to-camera rotation with x right, y down and z forward, from yaw, pitch and roll in degrees: the
/// matrix that RealityCapture's support gives.
fn formula([yaw, pitch, roll]: [f64; 3]) -> DMat3 {
    let [(sx, cx), (sy, cy), (sz, cz)] = [roll, pitch, yaw].map(|angle: f64| angle.to_radians().sin_cos());
    DMat3::from_cols_array(&[
        cx * cz + sx * sy * sz,
        -cx * sz + cz * sx * sy,
        -cy * sx,
        -cy * sz,
        -cy * cz,
        -sy,
        cx * sy * sz - cz * sx,
        cx * cz * sy + sx * sz,
        -cx * cy,
    ])
    .transpose()
}

/// Returns a file with these last columns.
fn export(header: &str, tail: &str) -> String {
    let row = |index: usize| {
        let numbers = placed(index).map(|number| number.to_string()).join(",");
        format!("{index}.png,{numbers},{tail}\n")
    };
    format!("{header}\n{}", (0..9).map(row).collect::<String>())
}

fn save_images(root: &Path, size: [u32; 2]) {
    (0..9).for_each(|index| save_image(&root.join(format!("{index}.png")), size[0], size[1]));
}

#[test]
fn camera_parameters_are_read_by_the_formulas_of_realitycapture() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let path = root.join("my export.CSV");
    let lens = Lens::perspective([0.01, -0.002, 0.001, -0.0004], [0.0003, -0.0002], [0.0; 3]);
    let tail = "24.5,-9.5e-004,2e-3,0.01,-0.002,1e-003,-4e-4,3e-4,-2e-4";
    let short = "#name,x,y,alt,heading,pitch,roll,f";
    for (size, text, expected, centre) in [
        ([60, 40], export(HEADER, tail), lens, [-9.5e-4, 2e-3]),
        ([40, 60], export(&format!("#cameras 9\n{HEADER}"), tail), lens, [-9.5e-4, 2e-3]),
        ([60, 40], export(HEADER, tail).replace(',', ";"), lens, [-9.5e-4, 2e-3]),
        ([60, 40], export(HEADER, tail).replace('\n', "\r\n"), lens, [-9.5e-4, 2e-3]),
        ([60, 40], export(short, "24.5"), Lens::default(), [0.0; 2]),
        ([60, 40], export(HEADER, "24.5,0,0,0,0,0,0,0,0"), Lens::default(), [0.0; 2]),
    ] {
        save_images(root, size);
        fs::write(&path, &text).unwrap();
        let scene = open(&settings(root, 1)).unwrap();
        assert_eq!((scene.train.views.len(), scene.test.len()), (7, 2));
        for (view, index) in scene.train.views.iter().zip(1..8) {
            let [x, y, alt, heading, pitch, roll] = placed(index);
            assert!((view.camera.origin - DVec3::new(x, y, alt)).length() < 1e-9);
            let to_camera = formula([heading, pitch, roll]);
            let own = view.camera.rotation * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
            let apart = own.transpose() - to_camera;
            assert!(apart.to_cols_array().iter().all(|entry| entry.abs() < 1e-9), "{own:?} {to_camera:?}");
            let Intrinsics { width, height, fx, fy, cx, cy, lens } = view.camera.intrinsics;
            assert_eq!(([width, height], lens), (size, expected));
            // The longer side is 60 pixels, which stand for 36 millimetres of film.
            let found = [fx, fy, cx - 0.5 * f64::from(width), cy - 0.5 * f64::from(height)];
            let stated = [24.5 * 60.0 / 36.0, 24.5 * 60.0 / 36.0, centre[0] * 60.0, centre[1] * 60.0];
            assert!(found.iter().zip(stated).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?} {stated:?}");
        }
    }
}

#[test]
fn broken_camera_parameters_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    save_images(root, [60, 40]);
    let path = root.join("cameras.csv");
    let refused = || {
        let error = open(&settings(root, 1)).unwrap_err();
        assert!(error.kind() == trimip_core::ErrorKind::Input && !error.message().contains('\n'), "{error}");
        error.message()
    };
    let whole = export(HEADER, "24.5,0,0,0.01,0.02,0,0,0,0");
    for (text, what) in [
        (whole.replacen(",24.5", "", 1), "cameras.csv:2: has 15 columns, but the header names 16"),
        (whole[..whole.len() - 12].into(), "cameras.csv:10: has "),
        (whole.replacen("24.5", "NaN", 1), "cameras.csv:2: f: \"NaN\" is not a finite number"),
        (whole.replacen("24.5", "24m", 1), "cameras.csv:2: f: \"24m\" is not a finite number"),
        (whole.replacen("24.5", "-24.5", 1), "cameras.csv:2: f: the focal length is -24.5"),
        (whole.replacen("0.02", "0", 1), "k1: a single coefficient is that of the division model"),
        (whole.replacen("24.5,0", "24.5,1e308", 1), "cameras.csv:2: px, py: the principal point is 1000"),
        (whole.replacen("4.png", "", 1), "cameras.csv:6: names no photograph"),
        (whole.replace(".png", ".exr"), "9 of 9 photographs are missing, the first is"),
        (format!("{HEADER}\n"), "has no frame with a pose"),
        (whole.replacen("heading", "omega", 1), "holds no scene"),
    ] {
        fs::write(&path, text).unwrap();
        assert!(refused().contains(what), "{what}: {}", refused());
    }
    fs::write(&path, &whole).unwrap();
    fs::write(root.join("again.csv"), &whole).unwrap();
    assert!(
        refused().contains("again.csv: holds camera parameters, and so does ")
            && refused().contains("keep only one of them"),
        "{}",
        refused()
    );
}
