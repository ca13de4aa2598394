//! Checks of the reader of cameras on a rail: the rays of `dummy.txt` match those of the same cameras in `transforms.json`, and
//! the error for an invalid line names the file and the line.

use crate::common::{assert_same, save_image, settings, write};
use serde_json::json;
use std::{fs, path::Path};
use trimip_data::open;

/// Number of photographs in a scene, and their focal length in pixels.
const FRAMES: usize = 10;
const FOCAL: f64 = 20.5;

fn photographs(root: &Path) {
    (0..FRAMES).for_each(|index| save_image(&root.join(format!("{index}.png")), 16, 12));
}

/// Writes a scene whose last line is `last`.
fn rail(root: &Path, last: &str) {
    photographs(root);
    let lines = (0..FRAMES - 1).map(|index| format!("{index}.png {FOCAL} {index} -0.5 4.25\n"));
    fs::write(root.join("dummy.txt"), lines.collect::<String>() + last).unwrap();
}

#[test]
fn rays_are_those_of_the_same_cameras_in_a_transforms_file() {
    let (own, other) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    rail(own.path(), &format!("9.png {FOCAL} 9 -0.5 4.25"));
    photographs(other.path());
    let frame = |index: usize| {
        let pose = json!([[1, 0, 0, index], [0, 1, 0, -0.5], [0, 0, 1, 4.25], [0, 0, 0, 1]]);
        json!({ "file_path": format!("{index}.png"), "transform_matrix": pose })
    };
    let frames: Vec<_> = (0..FRAMES).map(frame).collect();
    let document = json!({ "fl_x": FOCAL, "w": 16, "h": 12, "frames": frames });
    write(&other.path().join("transforms.json"), &document);
    let [own, other] = [&own, &other].map(|folder| open(&settings(folder.path(), 2)).unwrap());
    assert_same(&own.train, &other.train);
    assert_eq!((own.test.len(), other.test.len()), (2, 2));
    assert_same(&own.test.load(1).unwrap(), &other.test.load(1).unwrap());
    // Pixel (3, 2) lies to the left of the principal point and above it.
    let cone = own.train.views[0].camera.cone::<f64>(3, 2);
    let ([x, y, z], side) = (cone.direction, [(3.5 - 8.0) / FOCAL, (6.0 - 2.5) / FOCAL]);
    assert!((x / -z - side[0]).abs() < 1e-12 && (y / -z - side[1]).abs() < 1e-12, "{cone:?}");
}

#[test]
fn what_does_not_fit_is_refused_with_its_place() {
    for (line, what) in [
        ("9.png 20 1 2", "four numbers"),
        ("9.png 20 1 2 3 4", "four numbers"),
        ("9.png 20 one 2 3", "four numbers"),
        ("9.png 20 nan 2 3", "not finite"),
        ("9.png 0 1 2 3", "focal length"),
        ("11.png 20 1 2 3", "does not exist"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        rail(folder.path(), line);
        let error = open(&settings(folder.path(), 1)).expect_err(line);
        let place = format!("{}:10: ", folder.path().join("dummy.txt").display());
        assert_eq!(error.kind(), trimip_core::ErrorKind::Input, "{error}");
        assert!(error.message().starts_with(&place), "{error}");
        assert!(error.message().contains(what), "{line}: {error}");
    }
}
