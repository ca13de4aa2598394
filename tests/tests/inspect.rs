//! Checks of `data inspect`: its lines, its page, and its warnings about scenes with wrong poses or a wrong box.

use serde_json::Value;
use std::{fs, path::Path};
use trimip_tests::binary::{Answer, run};

/// Writes the built-in scene of 24 training and 4 test photographs of 64 pixels to `folder`/scene.
fn scene(folder: &Path) {
    let sets = [
        "data.builtin_size=64",
        "data.builtin_train=24",
        "data.builtin_test=4",
        "data.builtin_supersampling=2",
    ];
    let mut arguments = vec!["data", "builtin", "scene"];
    sets.iter().for_each(|set| arguments.extend(["--set", set]));
    done(&run(folder, &arguments));
}

fn done(answer: &Answer) {
    assert_eq!(answer.code, Some(0), "{answer:?}");
}

/// Changes the poses of the training frames.
fn spoil(folder: &Path, change: impl Fn(&mut Vec<Value>)) {
    let path = folder.join("scene/transforms_train.json");
    let mut file: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    let frames = file["frames"].as_array_mut().unwrap();
    let mut poses: Vec<Value> = frames.iter().map(|frame| frame["transform_matrix"].clone()).collect();
    change(&mut poses);
    frames.iter_mut().zip(poses).for_each(|(frame, pose)| frame["transform_matrix"] = pose);
    fs::write(path, file.to_string()).unwrap();
}

/// Returns the warnings of an inspection.
fn warnings(folder: &Path, more: &[&str]) -> Vec<String> {
    let answer = run(folder, &[&["data", "inspect", "scene"], more].concat());
    done(&answer);
    answer.out.lines().filter(|line| line.starts_with("warning: ")).map(String::from).collect()
}

#[test]
fn a_page_is_one_file_and_the_lines_stay() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    scene(folder);
    let plain = run(folder, &["data", "inspect", "scene"]);
    done(&plain);
    assert!(!plain.out.contains("warning"), "{}", plain.out);
    // A file of the scene is accepted in place of its folder, as in the verbs that train and plan.
    let by_file = run(folder, &["data", "inspect", "scene/transforms_train.json"]);
    done(&by_file);
    assert_eq!(by_file.out, plain.out);
    for (name, said) in [("scene/train/r_0.png", "is a file"), ("absent", "does not exist")] {
        let refused = run(folder, &["data", "inspect", name]);
        assert!(refused.code == Some(2) && refused.err.contains(said), "{name}: {refused:?}");
    }
    let told = run(folder, &["data", "inspect", "scene", "--html", "pages/scene.html"]);
    done(&told);
    assert_eq!(told.out, plain.out);
    let page = fs::read_to_string(folder.join("pages/scene.html")).unwrap();
    assert!(page.starts_with("<!doctype html>") && page.ends_with("</html>\n"));
    assert!(!page.contains("http:") && !page.contains("https:") && !page.contains("<link"));
    for part in ["nothing suspicious", "24 training views", "64×64", "r_0", "All checks", "</svg>"] {
        assert!(page.contains(part), "{part}");
    }
    assert_eq!(fs::read_dir(folder.join("pages")).unwrap().count(), 1);
    // A page cannot replace a folder, whatever the folder's name.
    fs::create_dir(folder.join("folder.html")).unwrap();
    for name in ["pages", "folder.html"] {
        let refused = run(folder, &["data", "inspect", "scene", "--html", name]);
        assert_eq!((refused.code, refused.err.trim_end().lines().count()), (Some(2), 1), "{refused:?}");
    }
}

#[test]
fn spoiled_scenes_are_told() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    scene(folder);
    let of =
        |warnings: &[String], name: &str| warnings.iter().any(|w| w.starts_with(&format!("warning: {name}")));
    let small = ["--set", "scene.aabb_min=[-0.4, -0.4, -0.4]", "--set", "scene.aabb_max=[0.4, 0.4, 0.4]"];
    let cut = warnings(folder, &small);
    assert!(of(&cut, "the box covers only") && of(&cut, "box around the object"), "{cut:?}");
    assert_eq!(cut.len(), 2, "the plan's and the check's: {cut:?}");
    // Puts the poses in another order. A cyclic shift would only turn the spiral of the cameras, so the order has steps
    // of 7. Applied twice, it restores the poses, because 7·7 = 49 = 2·24 + 1.
    let shuffle = |poses: &mut Vec<Value>| *poses = (0..24).map(|i| poses[7 * i % 24].clone()).collect();
    spoil(folder, shuffle);
    let shuffled = warnings(folder, &[]);
    assert!(of(&shuffled, "silhouettes and poses"), "{shuffled:?}");
    spoil(folder, shuffle);
    assert!(warnings(folder, &[]).is_empty());
    // Gives the poses OpenCV's axes.
    spoil(folder, |poses| {
        for pose in poses.iter_mut() {
            for row in pose.as_array_mut().unwrap().iter_mut().take(3) {
                for axis in [1, 2] {
                    row[axis] = (-row[axis].as_f64().unwrap()).into();
                }
            }
        }
    });
    let turned = warnings(folder, &["--html", "turned.html"]);
    assert!(of(&turned, "axes of cameras"), "{turned:?}");
    assert!(
        fs::read_to_string(folder.join("turned.html")).unwrap().contains("are the axes those of OpenCV?")
    );
}
