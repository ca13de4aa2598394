//! The first hour of a user, as a script of commands whose answers are checked: a folder of photographs, default
//! settings.

use serde_json::Value;
use std::{fs, path::Path, time::Instant};
use trimip_tests::binary::{Answer, run};

/// Writes a scene of 16 training and 4 test photographs of 64 pixels to `folder`/scene.
fn scene(folder: &Path) {
    let sets = [
        "data.builtin_size=64",
        "data.builtin_train=16",
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

/// Asserts exit code 2 and an error message of one line that contains each of `parts`.
fn refused(answer: &Answer, parts: &[&str]) {
    assert_eq!(answer.code, Some(2), "{answer:?}");
    assert_eq!(answer.err.trim_end().lines().count(), 1, "{}", answer.err);
    for part in parts {
        assert!(answer.err.contains(part), "`{part}` in {}", answer.err);
    }
}

fn report(folder: &Path) -> Value {
    let bytes = fs::read(folder.join("report.json")).expect("a report");
    serde_json::from_slice(&bytes).expect("a report that is JSON")
}

fn psnr(report: &Value) -> f64 {
    report["mean"]["psnr"].as_f64().expect("a mean PSNR")
}

#[test]
fn a_folder_is_all_that_a_user_types() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    // Without arguments, or with an argument that is no scene, the program suggests the next command.
    let bare = run(folder, &[]);
    assert_eq!(bare.code, Some(2));
    for next in ["trimip-cli FOLDER", "configs/quickstart.toml", "--help"] {
        assert!(bare.err.contains(next), "{}", bare.err);
    }
    refused(&run(folder, &["scene"]), &["scene: ", "neither a verb nor a folder", "--help"]);
    // Errors for typing mistakes name the mistyped word and the intended one.
    refused(&run(folder, &["trian"]), &["trian: ", "`trimip-cli train`"]);
    refused(&run(folder, &["trian", "capture"]), &["trian: ", "`trimip-cli train`"]);
    refused(&run(folder, &["--minute", "5"]), &["'--minute' found; a similar argument exists: '--minutes'"]);
    for verb in [&["render"][..], &["eval"], &["view"], &["bake"], &["export", "mesh"]] {
        let answer = run(folder, &[verb, &["runs/lego"]].concat());
        refused(&answer, &["runs/lego: there is no run or model", "name the folder of a run"]);
    }
    fs::create_dir(folder.join("empty")).unwrap();
    refused(&run(folder, &["empty"]), &["empty", "transforms"]);
    refused(&run(folder, &["empty", "--minutes", "0"]), &["--minutes 0"]);
    refused(&run(folder, &["empty", "--minutes", "-1"]), &["--minutes -1", "is not a duration"]);
    assert!(!folder.join("runs/empty/metrics.jsonl").exists());

    // For a film, and for photographs without cameras, the program suggests the command that finds cameras.
    fs::write(folder.join("walk.mp4"), "a film").unwrap();
    refused(&run(folder, &["walk.mp4"]), &["walk.mp4: is a file", "trimip-cli capture walk.mp4"]);
    fs::create_dir(folder.join("walk")).unwrap();
    for name in ["0.png", "1.png", "2.png"] {
        image::RgbImage::from_pixel(8, 8, image::Rgb([90, 80, 70]))
            .save(folder.join("walk").join(name))
            .unwrap();
    }
    refused(&run(folder, &["walk"]), &["walk: holds no scene", "its 3 pictures", "trimip-cli capture walk"]);

    scene(folder);
    // A folder within a folder is detected. A file of the scene is accepted like its folder.
    fs::create_dir(folder.join("outer")).unwrap();
    fs::rename(folder.join("scene"), folder.join("outer/scene")).unwrap();
    refused(&run(folder, &["outer"]), &["outer/scene"]);
    fs::rename(folder.join("outer/scene"), folder.join("scene")).unwrap();

    // A run of 7.998 seconds of training stays within a limit of wall time, writes its files, and its model has
    // learned.
    let started = Instant::now();
    let answer = run(folder, &["scene/transforms_train.json", "--minutes", "0.1333"]);
    done(&answer);
    let wall = started.elapsed().as_secs_f64();
    assert!(wall <= 1.4 * 8.0 + 60.0, "{wall} s for 8 s of training");
    let path = folder.join("runs/scene");
    let first = report(&path);
    assert!((7.998..12.0).contains(&first["train_seconds"].as_f64().unwrap()), "{}", first["train_seconds"]);
    let constant = first["mean"]["psnr_constant"].as_f64().unwrap();
    assert!(psnr(&first) > constant + 3.0, "{} where a mean colour has {constant}", psnr(&first));
    for file in
        ["report.html", "report.md", "report.tex", "metrics.csv", "error_vs_time.csv", "model.safetensors"]
    {
        assert!(fs::metadata(path.join(file)).is_ok_and(|data| data.len() > 0), "{file}");
    }
    for decision in ["aabb", "solids", "schedule", "detail"] {
        assert!(answer.out.contains(&format!("plan.{decision}: ")), "{decision}");
    }

    // The same command finds the run finished. Another duration is refused with a list of options. `--continue-for`
    // extends the run.
    let again = run(folder, &["scene", "--minutes", "0.1333"]);
    done(&again);
    assert!(again.out.contains("finished") && again.out.contains("--fresh"), "{}", again.out);
    let ways = ["train.seconds", "--continue-for", "--fresh", "--out"];
    refused(&run(folder, &["scene", "--minutes", "0.3"]), &ways);
    refused(&run(folder, &["scene", "--continue-for", "soon"]), &["--continue-for", "5m"]);
    refused(&run(folder, &["--out", "runs/other", "--continue-for", "1m"]), &["runs/other"]);
    let longer = run(folder, &["scene", "--continue-for", "4s"]);
    done(&longer);
    assert!(
        longer.out.contains("extended: ") && longer.out.contains("the schedule is stretched"),
        "{}",
        longer.out
    );
    let second = report(&path);
    assert!(
        second["train_seconds"].as_f64().unwrap() >= 12.0
            && second["steps"].as_u64() > first["steps"].as_u64()
    );
    assert!(psnr(&second) > psnr(&first) - 1.0, "{} after {}", psnr(&second), psnr(&first));
    let again = run(folder, &["scene", "--minutes", "0.1333"]);
    done(&again);
    assert!(again.out.contains("finished"), "the command that began it finds it finished: {}", again.out);
    refused(&run(folder, &["scene", "--minutes", "1"]), &ways);
    refused(&run(folder, &["runs/scene"]), &["holds a run", "eval", "render"]);

    // Evaluate, render and compare the existing run.
    done(&run(folder, &["eval", "runs/scene", "--json", "eval.json"]));
    let one = run(folder, &["render", "runs/scene", "--views", "1"]);
    done(&one);
    assert!(one.err.contains("1 view rendered"), "{}", one.err);
    let circle =
        run(folder, &["render", "runs/scene", "--turntable", "3", "--width", "40", "--height", "24"]);
    done(&circle);
    assert!(circle.err.contains("3 views rendered"), "{}", circle.err);
    done(&run(folder, &["compare", "runs/scene", "--reach", "5,99"]));
}

#[test]
fn photographs_without_alpha_find_their_box_and_say_what_is_behind_it() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    scene(folder);
    for entry in fs::read_dir(folder.join("scene/train"))
        .unwrap()
        .chain(fs::read_dir(folder.join("scene/test")).unwrap())
    {
        let path = entry.unwrap().path();
        image::open(&path).unwrap().to_rgb8().save(&path).unwrap();
    }
    // The budget is in steps, not seconds, so the result does not depend on the load of the machine.
    let steps = ["--set", "train.steps=150", "--set", "train.samples_per_step=16384"];
    let answer = run(folder, &[&["scene"], &steps[..]].concat());
    done(&answer);
    let first = report(&folder.join("runs/scene"));
    let constant = first["mean"]["psnr_constant"].as_f64().unwrap();
    assert!(psnr(&first) > constant + 2.0, "{} where a mean colour has {constant}", psnr(&first));
    // Without alpha, transparent pixels are black. The plan takes them for a plain background and bounds the scene.
    for part in [
        "no alpha",
        "plan.background: set: the borders of all photographs have one colour",
        "plan.aabb: set: the photographs have no silhouettes; the box is the one around what the cameras look at",
    ] {
        assert!(answer.out.contains(part), "{part}: {}", answer.out);
    }
    let bounded = ["--set", "loss.opacity=0.1", "--set", "scene.contraction=none"];
    refused(&run(folder, &[&["scene", "--out", "b"][..], &bounded].concat()), &["loss.opacity", "alpha"]);
    // If the box misses the scene, the program warns before the training, and the model learns nothing.
    let beside = ["scene.aabb_min=[50.0,50.0,50.0]", "scene.aabb_max=[51.0,51.0,51.0]"];
    let mut arguments = vec!["scene", "--out", "beside", "--minutes", "0.1"];
    beside.iter().for_each(|set| arguments.extend(["--set", set]));
    let answer = run(folder, &arguments);
    assert_eq!(answer.code, Some(1), "{answer:?}");
    assert!(
        answer.out.contains("covers only 0 %") && answer.err.contains("no ray hits anything"),
        "{answer:?}"
    );
    assert_ne!(report(&folder.join("beside"))["status"], "finished");
}

#[test]
fn a_model_that_shows_nothing_is_not_finished() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    scene(folder);
    // The visual hull is off, because within a hull even fog has a silhouette.
    let hull = ["--set", "plan.hull=off"];
    let arguments = ["scene", "--set", "train.steps=2", "--set", "optimizer.learning_rate=1e-9"];
    let arguments = [&arguments[..], &hull[..]].concat();
    for _ in 0..2 {
        let answer = run(folder, &arguments);
        assert_eq!(answer.code, Some(1), "{answer:?}");
        assert!(
            answer.err.contains("failed to learn") && answer.err.contains("mean colour"),
            "{}",
            answer.err
        );
        assert_ne!(report(&folder.join("runs/scene"))["status"], "finished");
    }
}

#[test]
fn training_views_are_kept_back_where_there_is_no_test_split() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    scene(folder);
    fs::remove_file(folder.join("scene/transforms_test.json")).unwrap();
    let answer = run(folder, &["scene", "--set", "train.steps=20", "--set", "eval.min_gain=0"]);
    done(&answer);
    assert!(answer.out.contains("every 8th training frame is held out"), "{}", answer.out);
    let data = report(&folder.join("runs/scene"));
    assert_eq!(data["scales"][0]["images"], 2, "of 16 views");
}

#[test]
fn photographs_that_are_too_many_are_halved_aloud() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path();
    scene(folder);
    let small = ["--set", "data.most_pixels=30000", "--set", "train.steps=20", "--set", "eval.min_gain=0"];
    let answer = run(folder, &[&["scene"], &small[..]].concat());
    done(&answer);
    assert!(answer.out.contains("1/2 of their width"), "{}", answer.out);
    let images = fs::read_dir(folder.join("runs/scene/images")).unwrap();
    let sizes: Vec<u32> = images
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.to_string_lossy().ends_with("scale1.png"))
        .map(|path| image::open(path).unwrap().width())
        .collect();
    assert!(!sizes.is_empty() && sizes.iter().all(|&width| width == 32), "{sizes:?}");
}
