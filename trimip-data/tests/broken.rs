//! Tests of broken input: each case gives an error of one line that names the place, and nothing panics.

use crate::common::{blender_scene, frame, save_image, settings, write};
use proptest::prelude::*;
use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_core::ErrorKind;
use trimip_data::settings::DataConfig;
use trimip_data::{inspect, open};

const TRAIN: &str = "transforms_train.json";

/// Returns the error of the small scene after `breaking` it.
fn error_after(scales: u32, breaking: impl Fn(&Path)) -> String {
    let folder = tempfile::tempdir().unwrap();
    blender_scene(folder.path());
    breaking(folder.path());
    error_of(folder.path(), scales)
}

/// Returns the error of a folder, with the path of the folder written as `ROOT`.
fn error_of(root: &Path, scales: u32) -> String {
    let error = open(&settings(root, scales)).expect_err("this input is broken");
    assert_eq!(error.kind(), ErrorKind::Input, "{error}");
    assert!(!error.message().contains('\n'), "{error}");
    error.message().replace(root.to_str().unwrap(), "ROOT")
}

/// Edits the training file.
fn edit(root: &Path, change: impl Fn(&mut Value)) {
    let path = root.join(TRAIN);
    let mut document: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    change(&mut document);
    write(&path, &document);
}

#[test]
fn each_broken_frame_is_named() {
    type Change = fn(&mut Value);
    let second = "ROOT/transforms_train.json: frame 1 (./train/r_1): ";
    let file = "ROOT/transforms_train.json: ";
    let cases: [(Change, &str, &str); 20] = [
        (|d| d["frames"] = json!([]), file, "has no frame"),
        (|d| d["frames"] = json!({}), file, "\"frames\" is an object; expected an array"),
        (|d| *d = json!([]), file, "expected an object, found an array of 0"),
        (|d| drop(d.as_object_mut().unwrap().remove("frames")), file, "has no \"frames\""),
        (|d| drop(d.as_object_mut().unwrap().remove("camera_angle_x")), file, "has no focal length"),
        (|d| d["camera_angle_x"] = json!(0), file, "\"camera_angle_x\" is 0"),
        (|d| d["camera_angle_x"] = json!(4.0), file, "\"camera_angle_x\" is 4"),
        (|d| d["camera_angle_x"] = json!("wide"), file, "is the text \"wide\"; expected a number"),
        (|d| d["fl_x"] = json!(-3.0), file, "\"fl_x\" is -3, which gives no positive focal length"),
        (|d| d["frames"][1]["fl_x"] = json!(0.0), second, "\"fl_x\" is 0"),
        (|d| d["frames"][1]["w"] = json!(17), second, "16x12 pixels, but the file states 17x12"),
        (|d| d["h"] = json!(12.5), file, "\"h\" is 12.5"),
        (|d| d["frames"][1]["h"] = json!(0), second, "\"h\" is 0"),
        (|d| d["frames"][1] = json!(7), "ROOT/transforms_train.json: frame 1: ", "found 7"),
        (
            |d| d["frames"][1]["file_path"] = json!(3),
            "ROOT/transforms_train.json: frame 1: ",
            "is 3; expected a text",
        ),
        (
            |d| d["frames"][1]["file_path"] = json!("./train/x"),
            "ROOT/transforms_train.json: frame 1 (./train/x): ",
            "does not exist",
        ),
        (|d| d["frames"][1]["transform_matrix"] = json!(null), second, "has no \"transform_matrix\""),
        (|d| d["frames"][1]["transform_matrix"][0][0] = json!(null), second, "is not a 4x4 or 3x4 matrix"),
        (
            |d| d["frames"][1]["transform_matrix"][0][0] = json!(1.1),
            second,
            "is not a rotation: |R R^T - I| is 2.1e-1",
        ),
        (|d| d["frames"][1]["transform_matrix"][0][0] = json!(-1.0), second, "mirrors the scene"),
    ];
    for (change, place, what) in cases {
        let message = error_after(2, |root| edit(root, change));
        assert!(message.starts_with(place) && message.contains(what), "{place}{what}:\n{message}");
    }
}

#[test]
fn syntax_errors_have_line_and_column() {
    let message = error_after(1, |root| fs::write(root.join(TRAIN), "{\n  \"frames\": [,]\n}").unwrap());
    assert!(message.starts_with("ROOT/transforms_train.json:2:14: invalid JSON: "), "{message}");
    let message = error_after(1, |root| {
        let text = fs::read_to_string(root.join(TRAIN)).unwrap().replacen("-4.0", "NaN", 1);
        fs::write(root.join(TRAIN), text).unwrap();
    });
    assert!(message.contains("NaN is not a finite number; export the camera again"), "{message}");
    assert!(
        error_after(1, |root| fs::write(root.join(TRAIN), "").unwrap()).contains(":1:0: invalid JSON: EOF")
    );
}

#[test]
fn broken_images_are_named() {
    let second = "ROOT/transforms_train.json: frame 1 (./train/r_1): image ROOT/./train/r_1.png ";
    let image = |root: &Path| root.join("train/r_1.png");
    let message = error_after(1, |root| fs::remove_file(image(root)).unwrap());
    assert!(
        message.contains("frame 1 (./train/r_1): image ROOT/./train/r_1 does not exist (nor with"),
        "{message}"
    );
    let message = error_after(1, |root| fs::write(image(root), "no image").unwrap());
    assert!(message.starts_with(second) && message.contains("cannot be decoded"), "{message}");
    let message = error_after(1, |root| {
        let whole = fs::read(image(root)).unwrap();
        fs::write(image(root), &whole[..whole.len() / 2]).unwrap();
    });
    assert!(message.starts_with(second) && message.contains("cannot be decoded"), "{message}");
    let message = error_after(5, |_| {});
    assert!(
        message.contains("16x12 pixels is too small for 5 scales; set data.scales to 4 or less"),
        "{message}"
    );
    // A focal length in pixels for all frames is valid for one size only, an angle of view for any size.
    let message = error_after(1, |root| {
        save_image(&image(root), 20, 12);
        edit(root, |document| document["fl_x"] = json!(20.0));
    });
    assert!(
        message.starts_with(second) && message.contains("20x12 pixels, but the file states 16x12"),
        "{message}"
    );
}

#[test]
fn folders_without_a_scene_say_what_was_looked_for() {
    let folder = tempfile::tempdir().unwrap();
    assert!(
        error_of(&folder.path().join("gone"), 1)
            .ends_with("does not exist; set data.root to the folder of a scene")
    );
    assert!(
        error_of(folder.path(), 1)
            .contains("looked for metadata.json, transforms_train.json, transforms.json")
    );
    let message = open(&settings(Path::new(""), 1)).unwrap_err().message();
    assert_eq!(
        message,
        "data.root: is empty; set it to the folder of a scene, or data.format to \"builtin\""
    );
    blender_scene(folder.path());
    let mut data = settings(folder.path(), 1);
    data.train = vec!["train".into(), "val".into()];
    assert!(open(&data).unwrap_err().message().contains("has no split \"val\", only test, train"));
    assert!(error_of(&folder.path().join(TRAIN), 1).contains("is not a folder"));
    write(
        &folder.path().join("transforms.json"),
        &json!({ "camera_angle_x": 0.7, "frames": [frame("train/r_0")] }),
    );
    for split in ["train", "test"] {
        fs::remove_file(folder.path().join(format!("transforms_{split}.json"))).unwrap();
    }
    assert!(error_of(folder.path(), 1).contains("at least two are needed"));
}

#[test]
fn settings_out_of_range_are_errors() {
    let mut data = settings(Path::new(""), 1);
    data.format = "builtin".into();
    let changes: [fn(&mut DataConfig); 6] = [
        |data| data.scales = 0,
        |data| data.scales = 40,
        |data| data.builtin_size = 0,
        |data| data.builtin_supersampling = 0,
        |data| data.train.clear(),
        |data| data.test = "val".into(),
    ];
    for change in changes {
        let mut data = data.clone();
        change(&mut data);
        assert_eq!(open(&data).unwrap_err().kind(), ErrorKind::Input);
    }
}

/// Generates random changes to the text of a JSON file.
fn mutated(text: String) -> impl Strategy<Value = Vec<u8>> {
    let length = text.len();
    let snippet = prop::sample::select(vec![
        "",
        "0",
        "-1",
        "1e308",
        "NaN",
        "null",
        "[]",
        "{}",
        "\"",
        ",",
        "[[",
        "]",
        "é",
        "4294967296",
        "\"file_path\"",
        "../",
    ]);
    prop::collection::vec((0..length, 0..12_usize, snippet), 1..4).prop_map(move |edits| {
        let mut bytes = text.clone().into_bytes();
        for (at, cut, snippet) in edits {
            let at = at.min(bytes.len());
            let end = (at + cut).min(bytes.len());
            bytes.splice(at..end, snippet.bytes());
        }
        bytes
    })
}

/// Returns the document with `with` in place of value number `nth`.
fn with_replaced_value(document: &Value, nth: usize, with: &Value) -> Value {
    fn replace(value: &mut Value, left: &mut usize, with: &Value) {
        if *left == 0 {
            *value = with.clone();
        }
        *left = left.wrapping_sub(1);
        match value {
            Value::Array(values) => values.iter_mut().for_each(|value| replace(value, left, with)),
            Value::Object(map) => map.values_mut().for_each(|value| replace(value, left, with)),
            _ => {}
        }
    }
    let (mut document, mut left) = (document.clone(), nth);
    replace(&mut document, &mut left, with);
    document
}

fn opens_or_tells(root: &Path) {
    if let Err(error) = inspect(&settings(root, 2), &trimip_data::unwatched) {
        assert!(!error.message().is_empty() && !error.message().contains('\n'), "{error}");
    }
}

#[test]
fn wrong_kinds_of_values_never_panic() {
    let folder = tempfile::tempdir().unwrap();
    blender_scene(folder.path());
    let set = tempfile::tempdir().unwrap();
    trimip_data::write_multiscale(&settings(folder.path(), 2), set.path(), &trimip_data::unwatched).unwrap();
    for (root, name) in [(folder.path(), TRAIN), (set.path(), "metadata.json")] {
        let path = root.join(name);
        let document: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        for nth in 0..400 {
            for with in
                [json!(null), json!(-1), json!(1e300), json!("a\nb"), json!([]), json!({}), json!([[1]])]
            {
                fs::write(&path, with_replaced_value(&document, nth, &with).to_string()).unwrap();
                opens_or_tells(root);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn mutated_text_never_panics(
        blender in mutated(common_text(TRAIN)), metadata in mutated(common_text("metadata.json")),
    ) {
        let folder = tempfile::tempdir().unwrap();
        blender_scene(folder.path());
        fs::write(folder.path().join(TRAIN), blender).unwrap();
        opens_or_tells(folder.path());
        fs::write(folder.path().join("metadata.json"), metadata).unwrap();
        opens_or_tells(folder.path());
    }
}

/// Returns the text of a whole file, to be mutated.
fn common_text(name: &str) -> String {
    let (folder, set) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    blender_scene(folder.path());
    if name == TRAIN {
        return fs::read_to_string(folder.path().join(name)).unwrap();
    }
    trimip_data::write_multiscale(&settings(folder.path(), 2), set.path(), &trimip_data::unwatched).unwrap();
    fs::read_to_string(set.path().join(name)).unwrap()
}
