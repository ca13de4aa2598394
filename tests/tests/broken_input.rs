//! On broken input the program exits with code 2, prints one line that begins with `error:` and names the location, and
//! overwrites nothing.

use serde_json::{Value, json};
use std::{fs, path::Path};
use tempfile::TempDir;
use trimip_tests::{
    binary::{refuses, run, tiny, tiny_and},
    zip::{Entry, archive, packed},
};

/// Writes the built-in scene to `scene` in a new folder.
fn scene() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let answer = run(folder.path(), &[&["data", "builtin", "scene"][..], &tiny()].concat());
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    folder
}

/// Returns the arguments that train on that scene.
fn training() -> Vec<&'static str> {
    tiny_and(&["--out", "run", "--set", "data.format=auto", "--set", "data.root=scene"])
}

/// A pipe without a writer and a device without an end.
#[cfg(target_os = "linux")]
#[test]
fn pipes_and_devices_are_refused_at_once() {
    let folder = scene();
    let here = folder.path();
    let pipe = here.join("pipe.safetensors");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    for file in ["pipe.safetensors", "/dev/zero"] {
        for arguments in [&["eval", file][..], &["render", file], &["--config", file], &["compare", file]] {
            let answer = run(here, arguments);
            assert_eq!(answer.code, Some(2), "{arguments:?}: {}", answer.err);
            assert!(answer.err.contains("not a plain file"), "{arguments:?}: {}", answer.err);
        }
    }
    for file in ["scene/transforms_train.json", "scene/train/r_1.png"] {
        let away = here.join("away");
        fs::rename(here.join(file), &away).unwrap();
        fs::hard_link(&pipe, here.join(file)).unwrap();
        let answer = run(here, &training());
        assert!(answer.code == Some(2) && answer.err.contains("not a plain file"), "{file}: {}", answer.err);
        fs::rename(&away, here.join(file)).unwrap();
    }
}

#[test]
fn broken_scenes_are_refused() {
    const FILE: &str = "scene/transforms_train.json";
    type Break = fn(&Path);
    fn edit(folder: &Path, change: impl Fn(&mut Value)) {
        let path = folder.join(FILE);
        let mut document = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        change(&mut document);
        fs::write(path, document.to_string()).unwrap();
    }
    let cases: [(&str, Break, &[&str]); 9] = [
        (
            "missing folder",
            |f| fs::rename(f.join("scene"), f.join("away")).unwrap(),
            &["scene", "does not exist"],
        ),
        (
            "JSON syntax",
            |f| fs::write(f.join(FILE), "{\n \"frames\": [,]}").unwrap(),
            &["transforms_train.json:2:"],
        ),
        (
            "missing image",
            |f| edit(f, |d| d["frames"][2]["file_path"] = json!("./train/gone")),
            &["transforms_train.json", "frame 2", "gone"],
        ),
        (
            "image of another size",
            |f| {
                edit(f, |d| {
                    (d["w"], d["h"]) = (json!(16), json!(16));
                });
                image::RgbaImage::new(20, 12).save(f.join("scene/train/r_1.png")).unwrap();
            },
            &["frame 1", "20x12", "16x16"],
        ),
        (
            "truncated image",
            |f| {
                let path = f.join("scene/train/r_1.png");
                let whole = fs::read(&path).unwrap();
                fs::write(path, &whole[..whole.len() / 2]).unwrap();
            },
            &["frame 1", "r_1.png"],
        ),
        (
            "NaN in a pose",
            |f| {
                edit(f, |d| d["frames"][1]["transform_matrix"][0][3] = json!(123.5));
                let text = fs::read_to_string(f.join(FILE)).unwrap().replace("123.5", "NaN");
                fs::write(f.join(FILE), text).unwrap();
            },
            &["transforms_train.json", "NaN"],
        ),
        (
            "pose that is no rotation",
            |f| {
                edit(f, |d| {
                    let x = d["frames"][1]["transform_matrix"][0][0].as_f64().unwrap();
                    d["frames"][1]["transform_matrix"][0][0] = json!(x + 0.3);
                });
            },
            &["transforms_train.json", "frame 1", "rotation"],
        ),
        ("no frames", |f| edit(f, |d| d["frames"] = json!([])), &["transforms_train.json", "frame"]),
        (
            "folder without a scene",
            |f| fs::remove_dir_all(f.join("scene")).and_then(|()| fs::create_dir(f.join("scene"))).unwrap(),
            &["scene"],
        ),
    ];
    for (name, breaking, places) in cases {
        println!("{name}");
        let folder = scene();
        breaking(folder.path());
        refuses(folder.path(), &training(), places);
    }
}

#[test]
fn broken_archives_are_refused() {
    let folder = scene();
    let here = folder.path();
    let whole = packed(&here.join("scene"), "");
    let with = |entry: Entry| archive(&[&whole[..], &[entry]].concat());
    let good = archive(&whole);
    let film = Entry::stored("walk.mp4", b"");
    for (bytes, places) in [
        (good[..good.len() / 2].to_vec(), ["a.zip: is no zip archive", "copy or download the archive again"]),
        (with(Entry::stored("../../x.png", b"x")), ["a.zip: ../../x.png: ", "leads out of the folder"]),
        (with(Entry { checksum: 7, ..film.clone() }), ["a.zip: walk.mp4: ", "is damaged"]),
        (with(Entry { flags: 1, ..film.clone() }), ["a.zip: walk.mp4: ", "is encrypted"]),
        (
            archive(&[film]),
            [
                "a.zip: holds no scene",
                "a/walk.mp4 is a film, and this command finds the cameras of its frames: trimip-cli capture a.zip",
            ],
        ),
        (archive(&[]), ["a.zip: ", "holds no file"]),
    ] {
        fs::write(here.join("a.zip"), bytes).unwrap();
        refuses(here, &["plan", "a.zip"], &places);
        refuses(here, &["data", "inspect", "a.zip"], &places);
        let training = tiny_and(&["--out", "run", "--set", "data.format=auto", "--set", "data.root=a.zip"]);
        refuses(here, &training, &places);
        assert!(!here.join("a").exists() && !here.join("a.zip.tmp").exists());
    }
    // The folder `scene` exists, but was not unpacked from this archive.
    fs::write(here.join("scene.zip"), good).unwrap();
    refuses(here, &["plan", "scene.zip"], &["scene: already holds a scene, so scene.zip", "name scene"]);
    fs::write(here.join("scene.tar"), "").unwrap();
    refuses(here, &["plan", "scene.tar"], &["is a file, not the folder of a scene"]);
    refuses(here, &["data", "inspect", "gone.zip"], &["gone.zip: does not exist"]);
}

#[test]
fn wrong_settings_and_arguments_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    fs::write(here.join("wrong.toml"), "seed = 1\n[train]\n  stepz = 3\n").unwrap();
    fs::write(here.join("broken.toml"), "[train\n").unwrap();
    let cases: [(&[&str], &[&str]); 16] = [
        (&["--config", "wrong.toml"], &["wrong.toml:3:3", "train.stepz", "train.steps"]),
        (&["--config", "broken.toml"], &["broken.toml:1:"]),
        (&["--config", "gone.toml"], &["gone.toml"]),
        (&["--set", "train.stepz=3"], &["train.stepz", "train.steps"]),
        (&["--set", "train.steps"], &["--set train.steps", "="]),
        (&["--set", "train.steps=many"], &["train.steps", "many", "whole number"]),
        (&["--set", "encoder.plane_size=100"], &["encoder.plane_size", "multiple of 128"]),
        (&["--set", "backend=cuda"], &["cuda", "cpu"]),
        (&["--set"], &["--set"]),
        (&["--frobnicate"], &["--frobnicate"]),
        (&["--stop-after", "soon"], &["--stop-after", "soon"]),
        // The missing file is reported before any photograph is read, whether or not the build has LPIPS.
        (
            &["--set", "data.format=builtin", "--set", "eval.lpips=gone.onnx"],
            &["gone.onnx", "eval.lpips = \"\""],
        ),
        (&["eval"], &["MODEL"]),
        (&["eval", "gone"], &["gone"]),
        (&["render", "gone", "--turntable", "0"], &["--turntable"]),
        (&["data", "inspect", "gone"], &["gone"]),
    ];
    for (arguments, places) in cases {
        refuses(here, arguments, places);
    }
    refuses(here, &["config", "--config", "wrong.toml"], &["wrong.toml:3:3"]);
    // Without arguments the program suggests commands; these lines are not an error.
    let answer = run(here, &[]);
    assert!(answer.code == Some(2) && answer.err.contains("trimip-cli FOLDER") && answer.out.is_empty());
}

#[test]
fn the_wgpu_backend_is_refused_where_it_is_not_built_in() {
    let folder = tempfile::tempdir().unwrap();
    let facts = run(folder.path(), &["doctor"]).out;
    if facts.lines().any(|line| line.starts_with("backend") && line.contains("wgpu")) {
        println!("skipped: this build has a wgpu backend");
        return;
    }
    refuses(folder.path(), &tiny_and(&["--out", "run", "--set", "backend=wgpu"]), &["wgpu", "cpu"]);
}

#[test]
fn places_that_cannot_be_written_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    fs::write(here.join("file"), "mine").unwrap();
    refuses(here, &tiny_and(&["--out", "file"]), &["file"]);
    refuses(here, &tiny_and(&["--out", "file/run"]), &["file/run"]);
    refuses(here, &[&["data", "builtin", "file"][..], &tiny()].concat(), &["file"]);
}

#[test]
fn files_of_a_run_that_do_not_fit_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    assert_eq!(run(here, &tiny_and(&["--out", "run"])).code, Some(0));
    let other = tiny_and(&["--out", "run", "--set", "seed=7"]);
    refuses(here, &other, &["other settings", "seed", "--fresh", "--out"]);

    let path = here.join("run/checkpoint.safetensors");
    let whole = fs::read(&path).unwrap();
    for length in [0, 4, 100, whole.len() / 2, whole.len() - 1] {
        fs::write(&path, &whole[..length]).unwrap();
        refuses(here, &tiny_and(&["--out", "run"]), &["checkpoint.safetensors"]);
    }
    fs::write(&path, &whole).unwrap();
    let path = here.join("run/model.safetensors");
    let model = fs::read(&path).unwrap();
    for length in [0, 9, model.len() / 2, model.len() - 1] {
        fs::write(&path, &model[..length]).unwrap();
        refuses(here, &["eval", "run"], &["model.safetensors"]);
        refuses(
            here,
            &["render", "run/model.safetensors", "--turntable", "1", "--out", "pictures"],
            &["model.safetensors"],
        );
    }
    // The checkpoint takes the place of the model, and vice versa.
    fs::write(&path, &whole).unwrap();
    refuses(here, &["eval", "run"], &["model.safetensors", "trimip-checkpoint"]);
    fs::write(here.join("run/checkpoint.safetensors"), &model).unwrap();
    refuses(here, &tiny_and(&["--out", "run"]), &["checkpoint.safetensors", "trimip-model"]);
    // A model without its run is not overwritten.
    fs::remove_file(here.join("run/checkpoint.safetensors")).unwrap();
    refuses(here, &tiny_and(&["--out", "run"]), &["model.safetensors", "--fresh"]);
    assert_eq!(run(here, &tiny_and(&["--out", "run", "--fresh"])).code, Some(0));
    // Settings of a trained model cannot be changed afterwards.
    refuses(here, &["eval", "run", "--set", "encoder.plane_size=32"], &["encoder.plane_size"]);
}
