//! Checks of the verb `paper` on small scenes: its page shows every system, the means match those computed here, a failing run
//! does not stop the others, and a killed job continues to the same runs.

use serde_json::Value;
use std::{fs, path::Path, process::Stdio, time::Duration};
use trimip::systems::SYSTEMS;
use trimip_core::field::model::Model;
use trimip_tests::binary::{Answer, command, refuses, run};
use trimip_tests::pages::expect_fits;

/// Writes small scenes under the names of two Blender scenes.
fn scenes(here: &Path) {
    for (name, finish) in [("chair", "matt"), ("lego", "mixed")] {
        let finish = format!("data.builtin_finish={finish}");
        let sizes = [
            "data.builtin_size=16",
            "data.builtin_train=4",
            "data.builtin_test=2",
            "data.builtin_supersampling=2",
        ];
        let mut arguments = vec!["data".to_string(), "builtin".into(), format!("scenes/{name}")];
        for setting in sizes.into_iter().chain([finish.as_str()]) {
            arguments.extend(["--set".into(), setting.into()]);
        }
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        assert_eq!(run(here, &arguments).code, Some(0));
    }
}

/// Settings that give every system its smallest model and ten steps.
const SETTINGS: [&str; 21] = [
    "encoder.plane_size=16",
    "encoder.levels=3",
    "hash_grid.levels=4",
    "hash_grid.finest=64",
    "hash_grid.log2_entries=8",
    "rip_map.size=16",
    "rip_map.levels=2",
    "tensor.sides=[[0.0, 6.0]]",
    "tensor.density_components=16",
    "tensor.color_components=16",
    "voxels.sides=[[0.0, 6.0]]",
    "field.hidden=16",
    "occupancy.resolution=16",
    "renderer.steps_per_diagonal=64",
    "train.samples_per_step=512",
    "train.steps=10",
    "eval.points=2",
    "eval.min_gain=0",
    "plan.detail=off",
    "plan.schedule=off",
    "threads=2",
];

/// Returns `paper`, the arguments `more` and [`SETTINGS`], without the settings that begin with one of `others`.
fn arguments<'a>(others: &[&str], more: &[&'a str]) -> Vec<&'a str> {
    let own = SETTINGS.into_iter().filter(|setting| !others.iter().any(|other| setting.starts_with(other)));
    ["paper"].into_iter().chain(more.iter().copied()).chain(own.flat_map(|set| ["--set", set])).collect()
}

fn json(here: &Path) -> Value {
    serde_json::from_slice(&fs::read(here.join("out/paper.json")).unwrap()).unwrap()
}

fn page(here: &Path) -> String {
    fs::read_to_string(here.join("out/paper.html")).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn every_system_is_on_the_page_with_the_means_of_its_runs() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    scenes(here);
    let all = arguments(&[], &["scenes", "--out", "out", "--stride", "1", "--scales", "four,one"]);
    let answer = run(here, &all);
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    for told in
        ["scenes: chair, lego", "missing: drums, ficus, hotdog, materials, mic, ship", "expected time"]
    {
        assert!(answer.err.contains(told), "no `{told}` in {}", answer.err);
    }
    expect_fits(&here.join("out/paper.html"));
    let (html, report) = (page(here), json(here));
    let markdown = fs::read_to_string(here.join("out/paper.md")).unwrap();
    let latex = fs::read_to_string(here.join("out/paper.tex")).unwrap();
    assert_eq!(
        latex.matches("\\begin{tabular}").count(),
        2 * 3,
        "the mean and two scenes, at four scales and at one"
    );
    for system in SYSTEMS {
        assert!(html.contains(&escaped(system.title)) && markdown.contains(system.title), "{}", system.name);
    }
    assert!(html.starts_with("<!doctype html>") && html.trim_end().ends_with("</html>"));
    assert!(!["http:", "https:", "<link", "@import"].iter().any(|fetching| html.contains(fetching)));
    // The page has the notes that published figures require.
    for part in ["35.72", "3.4 of the 3.57 dB", "46.5 MiB", "LPIPS", "black"] {
        assert!(html.contains(part) && markdown.contains(part), "{part}");
    }

    // Computes the means from the reports of the runs.
    for (table, folder, scales) in [(0, "", 4), (1, "single-scale/", 1)] {
        let rows = report["tables"][table]["mean"].as_array().unwrap();
        assert_eq!(rows.len(), SYSTEMS.len());
        for (row, system) in rows.iter().zip(SYSTEMS) {
            assert_eq!(row["system"], system.name);
            let of = |scene: &str| {
                let path = here.join(format!("out/{folder}{scene}/{}/42/report.json", system.name));
                serde_json::from_slice::<Value>(&fs::read(path).unwrap()).unwrap()
            };
            let reports = [of("chair"), of("lego")];
            assert_eq!(reports[0]["steps"], 10);
            let mut sum = 0.0;
            for i in 0..scales {
                let psnr = |report: &Value| number(&report["scales"][i]["psnr"]);
                let mean = (psnr(&reports[0]) + psnr(&reports[1])) / 2.0;
                assert!((number(&row["scales"][i][1]) - mean).abs() < 1e-9, "{}", system.name);
                sum += mean;
            }
            assert!((number(&row["psnr"]) - sum / scales as f64).abs() < 1e-9, "{}", system.name);
            assert_eq!(reports[0]["scales"].as_array().unwrap().len(), scales);
            let model =
                fs::metadata(here.join(format!("out/{folder}chair/{}/42/model.safetensors", system.name)));
            assert_eq!(reports[0]["model_bytes"].as_u64(), Some(model.unwrap().len()));
            assert!(number(&row["parameters"]) > 0.0);
        }
    }
    // A mean over two of the eight scenes has no published counterpart; lego has a published figure.
    let ngp = SYSTEMS.iter().position(|system| system.name == "ngp").unwrap();
    assert_eq!(report["tables"][0]["mean"][ngp]["published"], Value::Null);
    assert_eq!(report["tables"][0]["scenes"][1]["rows"][ngp]["published"], 31.83);

    // The same command finds all runs finished.
    let before = fs::metadata(here.join("out/lego/ngp/42/model.safetensors")).unwrap().modified().unwrap();
    let again = run(here, &all);
    assert!(again.code == Some(0) && again.err.contains("56 finished"), "{}", again.err);
    assert_eq!(
        fs::metadata(here.join("out/lego/ngp/42/model.safetensors")).unwrap().modified().unwrap(),
        before
    );
    // Other settings are refused before any run.
    refuses(
        here,
        &[&all[..], &["--set", "train.steps=11"]].concat(),
        &[&format!("out/chair/{}/42", SYSTEMS[0].name), "train.steps", "--out"],
    );
}

/// Escapes text as pages do.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

#[test]
fn a_run_that_fails_is_reported_and_ends_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    scenes(here);
    let job = arguments(
        &["rip_map.", "tensor.", "voxels."],
        &["scenes/lego", "--out", "out", "--systems", "tri-mip,ngp,ngp-17"],
    );
    // The folder of one run contains a foreign file.
    fs::create_dir_all(here.join("out/lego/ngp-17/42")).unwrap();
    fs::write(here.join("out/lego/ngp-17/42/model.safetensors"), "theirs").unwrap();
    let answer = run(here, &job);
    assert_eq!(answer.code, Some(1), "{}", answer.err);
    assert!(
        answer.err.contains("failed: lego, ngp-17, seed 42: ") && answer.err.contains("1 of 3 runs failed")
    );
    let report = json(here);
    let states: Vec<&Value> = report["runs"].as_array().unwrap().iter().map(|run| &run["status"]).collect();
    assert_eq!(states, ["finished", "failed", "finished"]);
    assert_eq!(report["tables"][0]["scenes"][0]["rows"][1]["psnr"], Value::Null);
    assert!(page(here).contains("no run wrote this folder"), "the page says why");
    assert_eq!(fs::read_to_string(here.join("out/lego/ngp-17/42/model.safetensors")).unwrap(), "theirs");
    // Once the cause is gone, the same command completes the job.
    fs::remove_dir_all(here.join("out/lego/ngp-17/42")).unwrap();
    let mended = run(here, &job);
    assert!(mended.code == Some(0) && mended.err.contains("2 finished"), "{}", mended.err);
}

#[test]
fn a_job_that_is_killed_goes_on_to_the_same_runs() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    scenes(here);
    let more = ["scenes/lego", "--systems", "tri-mip-paper,ngp", "--seeds", "2", "--out"];
    let every = ["--set", "train.checkpoint_seconds=0.001", "--set", "train.steps=200"];
    let job = |out: &'static str| {
        [&arguments(&["rip_map.", "tensor.", "voxels."], &[&more[..], &[out]].concat())[..], &every].concat()
    };
    let whole = run(here, &job("whole"));
    assert_eq!(whole.code, Some(0), "{}", whole.err);

    // The job is killed within its first run, then within a later one.
    let wait_for = |name: &str| {
        for _ in 0..4000 {
            if here.join("out/lego").join(name).join("checkpoint.safetensors").exists() {
                return;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        panic!("{name} does not begin");
    };
    for name in ["ngp/42", "tri-mip-paper/42"] {
        let mut child =
            command(here, &job("out")).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        wait_for(name);
        child.kill().unwrap();
        child.wait().unwrap();
    }
    let resumed: Answer = run(here, &job("out"));
    assert_eq!(resumed.code, Some(0), "{}", resumed.err);
    assert!(!resumed.err.contains(" 0 finished"), "{}", resumed.err);
    for name in ["ngp/42", "ngp/43", "tri-mip-paper/42", "tri-mip-paper/43"] {
        let model = |out: &str| {
            Model::read(&here.join(out).join("lego").join(name).join("model.safetensors")).unwrap()
        };
        assert!(model("whole") == model("out"), "{name}: another model");
    }
    assert!(here.join("out/paper.html").is_file());
}

#[test]
fn what_is_wrong_is_found_before_the_first_run() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    scenes(here);
    let refused =
        |arguments: &[&str], parts: &[&str]| refuses(here, &[&["paper"], arguments].concat(), parts);
    refused(&["scenes", "--systems", "nerf"], &["nerf", "tri-mip-paper"]);
    refused(&["scenes", "--split", "trainval"], &["\"val\"", "--split train"]);
    refused(&["absent"], &["absent", "neither a verb nor a folder"]);
    refused(&["scenes", "scenes/lego"], &["second scene `lego`"]);
    refused(&["scenes", "--seconds", "-1"], &["--seconds", "above 0"]);
    refused(&["scenes", "--seconds", "5", "--schedule", "own"], &["--schedule own"]);
    refused(
        &["scenes", "--systems", "ngp", "--set", "encoder.levels=3"],
        &["encoder.levels=3", "none of these systems"],
    );
    refused(&["scenes", "--set", "train.stepz=3"], &["train.stepz"]);
    fs::create_dir(here.join("empty")).unwrap();
    refused(&["empty"], &["holds no scene", "transforms_train.json"]);

    let list = run(here, &["paper", "--list"]);
    assert_eq!(list.code, Some(0));
    assert!(SYSTEMS.iter().all(|system| list.out.contains(system.name)), "{}", list.out);
}

#[test]
fn one_system_is_trained_by_its_name_and_settings_lie_over_it() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let shown = run(here, &["config", "--system", "ngp", "--set", "hash_grid.log2_entries=15"]);
    assert_eq!(shown.code, Some(0), "{}", shown.err);
    let value = |key: &str| {
        let line = shown.out.lines().find(|line| line.starts_with(key)).unwrap_or_else(|| panic!("{key}"));
        line.split_once('=').unwrap().1.trim().to_string()
    };
    assert!(value("log2_entries").starts_with("15") && value("log2_entries").contains("command line"));
    assert!(value("kind").contains("hash-grid") && value("kind").contains("trimip/systems/ngp.toml"));
    refuses(here, &["config", "--system", "nerf"], &["system `nerf`", "ngp-17"]);
    scenes(here);
    let mut train =
        arguments(&["encoder.", "rip_map.", "tensor.", "voxels."], &["scenes/lego", "--system", "ngp"]);
    train[0] = "train";
    let answer = run(here, &train);
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    let model = Model::read(&here.join("runs/lego-ngp/model.safetensors")).unwrap();
    assert_eq!(model.config.optimizer.learning_rate, 1e-2);
}
