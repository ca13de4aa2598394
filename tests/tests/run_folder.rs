//! Checks of the protection of a run folder: foreign files are refused, two processes are kept apart, a stale report is rebuilt. Another
//! test compares the memory of a run with the plan's prediction.

use std::{fs, path::Path, process::Stdio, time::Duration};
use trimip_tests::{
    binary::{command, program, run, tiny, tiny_and},
    files::files,
};

/// Asserts that the program refuses with an error of one line that contains `parts`, and leaves the folder unchanged.
fn refuses(here: &Path, arguments: &[&str], parts: &[&str]) {
    let before = files(here);
    let answer = run(here, arguments);
    assert_eq!((answer.code, answer.out.as_str()), (Some(2), ""), "{}", answer.err);
    assert_eq!(answer.err.lines().count(), 1, "{}", answer.err);
    assert!(parts.iter().all(|part| answer.err.contains(part)), "{parts:?} in {}", answer.err);
    assert!(files(here) == before, "{arguments:?} touched the folder");
}

#[test]
fn a_folder_that_no_run_wrote_keeps_its_files() {
    for name in
        ["config.toml", "report.html", "model.safetensors", "metrics.jsonl", "images/0000_r_0_scale1.png"]
    {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        fs::create_dir(here.join("images")).unwrap();
        fs::write(here.join(name), "mine").unwrap();
        fs::write(here.join("notes.txt"), "mine too").unwrap();
        for more in [&[][..], &["--fresh"]] {
            refuses(here, &tiny_and(&[&["--out", "."], more].concat()), &[name, "no run wrote", "--out"]);
        }
    }
}

#[test]
fn a_folder_without_files_of_a_runs_names_becomes_a_run_folder_and_is_used_again() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    fs::write(here.join("notes.txt"), "mine").unwrap();
    for more in [&[][..], &["--fresh"], &["--fresh", "--set", "seed=3"]] {
        let answer = run(here, &tiny_and(&[&["--out", "."], more].concat()));
        assert_eq!(answer.code, Some(0), "{more:?}: {}", answer.err);
    }
    assert_eq!(fs::read_to_string(here.join("notes.txt")).unwrap(), "mine");
    assert!(!here.join("run.lock").exists(), "the lock goes with its process");
}

#[test]
fn two_processes_are_kept_apart_and_a_killed_one_leaves_no_lock() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let long = ["--out", "run", "--set", "train.seconds=120", "--set", "train.checkpoint_seconds=0.02"];
    let long = tiny_and(&[&long[..], &["--set", "eval.points=0"]].concat());
    let mut first = command(here, &long).stdout(Stdio::null()).spawn().unwrap();
    let checkpoint = here.join("run/checkpoint.safetensors");
    for _ in 0..6000 {
        if checkpoint.exists() {
            break;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    let plan = fs::read(here.join("run/plan.json")).unwrap();
    for more in [&[][..], &["--fresh"]] {
        let answer = run(here, &[&long[..], more].concat());
        assert_eq!((answer.code, answer.out.as_str()), (Some(2), ""), "{}", answer.err);
        assert_eq!(answer.err.lines().count(), 1, "{}", answer.err);
        for part in ["run", "another process", "--out"] {
            assert!(answer.err.contains(part), "{part} in {}", answer.err);
        }
    }
    assert_eq!(fs::read(here.join("run/plan.json")).unwrap(), plan);
    // Baking is refused, because it changes the model.
    fs::copy(here.join("run/checkpoint.safetensors"), here.join("run/model.safetensors")).unwrap();
    for arguments in
        [&["run"][..], &["run/model.safetensors"], &["run", "--out", "run/checkpoint.safetensors"]]
    {
        let bake = run(here, &[&["bake"], arguments].concat());
        assert!(bake.code == Some(2) && bake.err.contains("another process"), "{}", bake.err);
    }
    fs::remove_file(here.join("run/model.safetensors")).unwrap();
    // Verbs that only read need no lock.
    let eval = run(here, &["eval", "run"]);
    assert_eq!(eval.code, Some(0), "{}", eval.err);
    assert!(first.try_wait().unwrap().is_none(), "the first process goes on");
    first.kill().unwrap();
    first.wait().unwrap();
    let answer = run(here, &tiny_and(&["--out", "run", "--fresh"]));
    assert_eq!(answer.code, Some(0), "{}", answer.err);
}

#[test]
fn the_report_of_a_finished_run_is_what_the_run_is_now() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let with = |floor: &str| {
        let answer = run(here, &tiny_and(&["--out", "run", "--set", floor]));
        (answer.code, fs::read_to_string(here.join("run/report.json")).unwrap())
    };
    let says = |text: &str, status: &str| text.contains(&format!("\"status\": \"{status}\""));
    let (code, report) = with("eval.min_psnr=60");
    assert!(code == Some(1) && says(&report, "failed"), "{report}");
    let (code, report) = with("eval.min_psnr=0");
    assert!(code == Some(0) && says(&report, "finished"), "the floor is gone: {report}");
    let (code, report) = with("eval.min_psnr=61");
    assert!(code == Some(1) && says(&report, "failed"), "it is missed again: {report}");
    with("eval.min_psnr=0");

    let whole = files(&here.join("run"));
    for name in whole.keys() {
        let path = here.join("run").join(name);
        let text = name.to_string_lossy();
        // Without these files the folder holds another run, or none. A finished run of the built-in scene takes its cameras from
        // `cameras.json`, not from the photographs.
        if ["config.toml", "plan.json", "metrics.jsonl", "cameras.json"].iter().any(|kept| text == *kept)
            || text.ends_with(".safetensors")
        {
            continue;
        }
        for torn in [true, false] {
            match torn && !text.ends_with(".png") {
                true => fs::write(&path, &whole[name][..whole[name].len() / 2]).unwrap(),
                false => fs::remove_file(&path).unwrap(),
            }
            let (code, _) = with("eval.min_psnr=0");
            assert_eq!(code, Some(0), "{text}");
            let now = files(&here.join("run"));
            assert!(now.keys().eq(whole.keys()), "{text} is missing: {:?}", now.keys());
            if ["views.json", "error_vs_time.csv", "report.md", "report.tex", "events.out.tfevents.run"]
                .contains(&text.as_ref())
            {
                assert!(now[name] == whole[name], "{text} is not what it was");
            }
            let page = String::from_utf8_lossy(&now[Path::new("report.html")]);
            assert!(page.trim_end().ends_with("</html>") && page.contains(">finished</b>"), "{text}");
            assert!(says(&String::from_utf8_lossy(&now[Path::new("report.json")]), "finished"), "{text}");
        }
    }
}

#[test]
fn a_finished_run_of_other_photographs_is_not_this_one() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    for (scene, finish) in [("a/scene", "matt"), ("b/scene", "lacquered")] {
        fs::create_dir_all(here.join(scene).parent().unwrap()).unwrap();
        let finish = format!("data.builtin_finish={finish}");
        let answer = run(here, &[&["data", "builtin", scene, "--set", &finish][..], &tiny()].concat());
        assert_eq!(answer.code, Some(0), "{answer:?}");
    }
    let of = |scene: &'static str, more: &[&'static str]| {
        let format = ["--set", "data.format=auto", "--set", "eval.min_psnr=0"];
        run(here, &[&[scene][..], &tiny(), &format, more].concat())
    };
    assert_eq!(of("a/scene", &[]).code, Some(0));
    let told = [
        "runs/scene",
        "holds a run of other photographs: other pixels of the training views",
        "--out",
        "--fresh",
    ];
    of("b/scene", &[]).expect_error(2, &told);
    let answer = of("a/scene", &[]);
    assert!(
        answer.code == Some(0) && answer.out.contains("finished: runs/scene holds this run"),
        "{answer:?}"
    );
    assert_eq!(of("b/scene", &["--fresh"]).code, Some(0));
    of("a/scene", &[]).expect_error(2, &told);
}

/// On a scene of medium size, the peak resident memory of the process is within a quarter of the memory that the plan predicts. The system
/// decides how many pages of the program's own file are resident, so the process may use up to that file's length more.
#[test]
fn predicted_memory_is_within_a_quarter_of_what_is_used() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let settings = [
        "data.format=builtin",
        "data.builtin_size=96",
        "data.builtin_train=24",
        "data.builtin_test=2",
        "data.builtin_supersampling=1",
        "encoder.levels=6",
        "occupancy.resolution=64",
        "train.steps=25",
        "eval.min_gain=0",
        "plan.schedule=off",
        "plan.detail=off",
        "eval.points=0",
        "eval.final=1",
        "threads=2",
    ];
    for size in [
        &["encoder.plane_size=128", "train.samples_per_step=16384", "field.hidden=64"][..],
        &["encoder.plane_size=512", "train.samples_per_step=16384", "field.hidden=64"],
        &["encoder.plane_size=256", "train.samples_per_step=65536", "field.hidden=64"],
    ] {
        let set: Vec<&str> = settings.iter().chain(size).flat_map(|setting| ["--set", setting]).collect();
        let answer = run(here, &[&["--out", "run", "--fresh"], &set[..]].concat());
        assert_eq!(answer.code, Some(0), "{}", answer.err);
        let report: serde_json::Value =
            serde_json::from_slice(&fs::read(here.join("run/report.json")).unwrap()).unwrap();
        let Some(used) = report["peak_memory_bytes"].as_f64() else {
            println!("skipped: this system does not tell the peak of a process");
            return;
        };
        let predicted = report["predicted_memory_bytes"].as_f64().unwrap();
        println!("{size:?}: predicted {:.0} MB, used {:.0} MB", predicted * 1e-6, used * 1e-6);
        let file = fs::metadata(program()).unwrap().len() as f64;
        assert!(
            (0.75 * predicted..=1.25 * predicted + file).contains(&used),
            "{size:?}: {predicted} predicted, {used} used, {file} in the program's file"
        );
    }
}
