//! Tests of data as users have it: written by other programs, copied from other machines, with deleted photographs.
//! Each kind is read correctly, with a warning where something was left out or found elsewhere.

use crate::common::{
    assert_same, blender_scene,
    colmap::{Sparse, capture},
    frame, save_image, settings, write,
};
use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_data::{Scene, open};

/// Writes `transforms.json` with frames of these paths and of 16 × 12 pixels.
fn transforms(root: &Path, paths: &[String]) {
    let frames: Vec<Value> = (0..)
        .zip(paths)
        .map(|(i, path)| {
            let mut frame = frame(path);
            frame["transform_matrix"][0][3] = json!(0.1 * f64::from(i));
            frame
        })
        .collect();
    let document =
        json!({ "fl_x": 20.0, "fl_y": 22.0, "cx": 8.5, "cy": 5.5, "w": 16, "h": 12, "frames": frames });
    write(&root.join("transforms.json"), &document);
}

/// Opens a scene of ten frames. Frame i has the path `named(i)` in its entry, and a photograph of `size` at `stored(i)`.
fn scene_of(
    named: &dyn Fn(usize) -> String,
    stored: &dyn Fn(usize) -> String,
    size: [u32; 2],
) -> Result<Scene, String> {
    let folder = tempfile::tempdir().unwrap();
    (0..10).for_each(|i| save_image(&folder.path().join(stored(i)), size[0], size[1]));
    transforms(folder.path(), &(0..10).map(named).collect::<Vec<_>>());
    open(&settings(folder.path(), 1)).map_err(|error| error.message())
}

fn warned(scene: &Scene, what: &str) {
    assert!(scene.warnings.iter().any(|warning| warning.contains(what)), "{what}: {:?}", scene.warnings);
}

#[test]
fn photographs_are_found_by_the_end_of_their_path() {
    let usual = scene_of(&|i| format!("images/{i}.png"), &|i| format!("images/{i}.png"), [16, 12]).unwrap();
    assert!(!usual.warnings.iter().any(|warning| warning.contains("not where")), "{:?}", usual.warnings);
    let named: [&dyn Fn(usize) -> String; 6] = [
        &|i| format!("/home/someone/scene/images/{i}.png"),
        &|i| format!("D:\\data\\scene\\images\\{i}.png"),
        &|i| format!("./..\\scene\\images/{i}.png"),
        &|i| format!("undistorted/{i}.png"),
        &|i| format!("IMAGES/{i}.PNG"),
        &|i| format!("images/{i}.jpg"),
    ];
    for named in named {
        let found = scene_of(named, &|i| format!("images/{i}.png"), [16, 12]).unwrap();
        assert_same(&found.train, &usual.train);
        warned(&found, &format!("of 8 photographs are not where the file says: {} is at ", named(1)));
    }
}

#[test]
fn smaller_copies_have_scaled_cameras() {
    let images = |i: usize| format!("images/{i}.png");
    let whole = scene_of(&images, &images, [16, 12]).unwrap();
    for stored in ["images", "images_2"] {
        let half = scene_of(&images, &|i| format!("{stored}/{i}.png"), [8, 6]).unwrap();
        warned(&half, "0.5000 times as wide as the file states");
        for (ours, theirs) in half.train.views.iter().zip(&whole.train.views) {
            assert_eq!(ours.camera.intrinsics, theirs.camera.intrinsics.reduced(1));
            assert_eq!(ours.camera.origin, theirs.camera.origin);
        }
    }
    let message = scene_of(&images, &images, [16, 10]).unwrap_err();
    assert!(message.contains("is 16x10 pixels, but the file states 16x12"), "{message}");
}

#[test]
fn missing_photographs_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    transforms(folder.path(), &(0..10).map(|i| format!("images/{i}.png")).collect::<Vec<_>>());
    (0..6).for_each(|i| save_image(&folder.path().join(format!("images/{i}.png")), 16, 12));
    let message = open(&settings(folder.path(), 1)).unwrap_err().message();
    assert!(message.contains("images/6.png does not exist"), "{message}");
    assert!(message.ends_with("; 2 more of 8 photographs are missing"), "{message}");
}

#[test]
fn test_frames_that_were_never_rendered_are_held_out_of_training() {
    let folder = tempfile::tempdir().unwrap();
    blender_scene(folder.path());
    fs::remove_dir_all(folder.path().join("test")).unwrap();
    let scene = open(&settings(folder.path(), 1)).unwrap();
    assert_eq!((scene.train.views.len(), scene.test.len()), (1, 1));
    warned(&scene, "has no photographs of a split \"test\": every 8th training frame is held out");
    // If only some of the test photographs exist, it is an error: the others may be missing by accident.
    save_image(&folder.path().join("test/r_0.png"), 16, 12);
    assert!(open(&settings(folder.path(), 1)).unwrap_err().message().contains("test/r_1 does not exist"));
    // The validation frames are tested on instead.
    fs::remove_file(folder.path().join("transforms_test.json")).unwrap();
    fs::copy(folder.path().join("transforms_train.json"), folder.path().join("transforms_val.json")).unwrap();
    let scene = open(&settings(folder.path(), 1)).unwrap();
    assert_eq!((scene.train.views.len(), scene.test.len()), (2, 2));
    warned(&scene, "\"val\" is the test split");
}

#[test]
fn files_beside_transforms_json_are_other_versions_of_it() {
    let images = |i: usize| format!("images/{i}.png");
    let usual = scene_of(&images, &images, [16, 12]).unwrap();
    for beside in ["transforms_backup.json", "transforms_test_video.json", "transforms_ego.json"] {
        let folder = tempfile::tempdir().unwrap();
        (0..10).for_each(|i| save_image(&folder.path().join(images(i)), 16, 12));
        transforms(folder.path(), &(0..10).map(images).collect::<Vec<_>>());
        write(&folder.path().join(beside), &json!({ "camera_path": [], "frames": [] }));
        let found = open(&settings(folder.path(), 1)).unwrap();
        assert_same(&found.train, &usual.train);
    }
}

#[test]
fn names_and_encodings_of_transforms_files_vary() {
    let folder = tempfile::tempdir().unwrap();
    blender_scene(folder.path());
    let usual = open(&settings(folder.path(), 2)).unwrap();
    for split in ["train", "test"] {
        let path = |s: &str| folder.path().join(format!("transform{s}_{split}.json"));
        let text = fs::read_to_string(path("s")).unwrap();
        fs::remove_file(path("s")).unwrap();
        let units = std::iter::once(0xfeff).chain(text.encode_utf16());
        fs::write(path(""), units.flat_map(u16::to_le_bytes).collect::<Vec<u8>>()).unwrap();
    }
    let found = open(&settings(folder.path(), 2)).unwrap();
    assert_same(&found.train, &usual.train);
    assert_eq!(found.test.len(), usual.test.len());
}

/// Saves the photographs of a model.
fn save_images(folder: &Path, sparse: &Sparse) {
    sparse.images.iter().for_each(|(.., name, _)| save_image(&folder.join(name), 60, 40));
}

#[test]
fn photographs_of_a_model_are_found_by_the_end_of_their_path() {
    let sparse = capture();
    let root = tempfile::tempdir().unwrap();
    save_images(&root.path().join("images"), &sparse);
    let model = root.path().join("sparse/0");
    sparse.write_binary(&model);
    let usual = open(&settings(root.path(), 1)).unwrap();
    let others: [&dyn Fn(&str) -> String; 4] = [
        &|name| format!("/home/someone/images/{name}"),
        &|name| format!("undistorted/images/{name}"),
        &|name| name.replace(".png", ".jpg"),
        &|name| name.to_uppercase(),
    ];
    for other in others {
        let mut renamed = sparse.clone();
        renamed.images.iter_mut().for_each(|image| image.4 = other(&image.4));
        for binary in [false, true] {
            fs::remove_dir_all(&model).unwrap();
            if binary {
                renamed.write_binary(&model);
            } else {
                renamed.write_text(&model);
            }
            let found = open(&settings(root.path(), 1)).unwrap();
            assert_same(&found.train, &usual.train);
            warned(&found, "10 of 10 photographs are not where the file says: ");
        }
    }
}

#[test]
fn photographs_deleted_after_the_model_was_made_are_left_out() {
    let sparse = capture();
    let root = tempfile::tempdir().unwrap();
    save_images(&root.path().join("images"), &sparse);
    let model = root.path().join("sparse/0");
    sparse.write_binary(&model);
    let whole = open(&settings(root.path(), 1)).unwrap();
    let gone = &sparse.images[2].4;
    fs::remove_file(root.path().join("images").join(gone)).unwrap();
    let found = open(&settings(root.path(), 1)).unwrap();
    assert_eq!(found.train.views.len() + found.test.len(), 9);
    warned(
        &found,
        &format!(
            "1 of 10 photographs are missing, the first is {}",
            root.path().join("images").join(gone).display()
        ),
    );
    // The observations of the deleted image are missing from the tracks, and the other observations are correct.
    assert!(found.points.iter().all(|point| point.track.len() < 10));
    let seen = |scene: &Scene, point: usize, name: &str| {
        let at =
            scene.points[point].track.iter().find(|seen| scene.train.views[seen.view as usize].name == name);
        at.map(|seen| seen.at)
    };
    let kept = &found.train.views[3].name;
    assert!(seen(&whole, 5, kept).is_some());
    assert_eq!(seen(&found, 5, kept), seen(&whole, 5, kept));
    // The same image was also deleted from the model.
    save_images(&root.path().join("images"), &sparse);
    let mut fewer = sparse.clone();
    fewer.images.remove(2);
    for binary in [false, true] {
        fs::remove_dir_all(&model).unwrap();
        if binary {
            fewer.write_binary(&model);
        } else {
            fewer.write_text(&model);
        }
        let same = open(&settings(root.path(), 1)).unwrap();
        assert_same(&same.train, &found.train);
        assert!(same.points.iter().zip(&found.points).all(|(ours, theirs)| ours.track == theirs.track));
    }
    // If most photographs are missing, the folder is probably the wrong one.
    fs::remove_dir_all(root.path().join("images/left")).unwrap();
    fs::remove_dir_all(root.path().join("images/right side")).unwrap();
    save_image(&root.path().join("images").join(&sparse.images[0].4), 60, 40);
    let message = open(&settings(root.path(), 1)).unwrap_err().message();
    assert!(message.contains("8 of 9 photographs are missing, the first is"), "{message}");
}

#[test]
fn a_camera_whose_calibration_failed_is_left_out() {
    let sparse = capture();
    let root = tempfile::tempdir().unwrap();
    save_images(&root.path().join("images"), &sparse);
    let model = root.path().join("sparse/0");
    for broken in [f64::NAN, f64::INFINITY] {
        let mut failed = sparse.clone();
        failed.cameras[1].4[0] = broken;
        for binary in [false, true] {
            let _ = fs::remove_dir_all(&model);
            if binary {
                failed.write_binary(&model);
            } else {
                failed.write_text(&model);
            }
            let found = open(&settings(root.path(), 1)).unwrap();
            assert_eq!(found.train.views.len() + found.test.len(), 9);
            warned(&found, "camera 2 of image ");
        }
    }
    // NaN as the C library of another system writes it.
    fs::remove_dir_all(&model).unwrap();
    sparse.write_text(&model);
    let path = model.join("cameras.txt");
    let text = fs::read_to_string(&path).unwrap();
    let line = text.lines().find(|line| line.starts_with("2 ")).unwrap();
    let words: Vec<&str> = line.split(' ').collect();
    let failed = [&words[..4], &["-nan(ind)"; 4]].concat().join(" ");
    let sized = failed.replace(" 60 40 ", " 60.0 40.0 ");
    fs::write(&path, text.replace(line, &sized)).unwrap();
    let found = open(&settings(root.path(), 1)).unwrap();
    assert_eq!(found.train.views.len() + found.test.len(), 9);
}

#[test]
fn points_that_are_not_there_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    blender_scene(folder.path());
    let path = folder.path().join("transforms_train.json");
    let mut document: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    document["ply_file_path"] = json!("sparse_pc.ply");
    write(&path, &document);
    let scene = open(&settings(folder.path(), 1)).unwrap();
    warned(&scene, "sparse_pc.ply cannot be read");
    assert!(scene.points.is_empty());
}
