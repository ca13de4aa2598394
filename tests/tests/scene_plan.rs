//! Checks of the scene plan: the parts that it leaves out, the plan that a run keeps, and the quality of a model
//! without those parts.

use serde_json::Value;
use std::{fs, path::Path};
use trimip_core::scene_plan::{self, Compute, Facts};
use trimip_core::{
    Config, Settings,
    config::{FilePrecision, PlaneShape},
    field::model::Model,
    scene::origin::LocalOrigin,
};
use trimip_tests::binary::{run, tiny_and};

fn json(path: &Path) -> Value {
    let bytes = fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_slice(&bytes).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Returns the decisions of a `plan.json` that leave something out.
fn left_out(findings: &Value) -> Vec<&str> {
    let findings = findings.as_array().expect("a list");
    findings.iter().filter(|f| f["left_out"] == true).map(|f| f["decision"].as_str().unwrap()).collect()
}

const OFF: [&str; 20] = [
    "--set",
    "plan.background=off",
    "--set",
    "plan.solids=off",
    "--set",
    "plan.aabb=off",
    "--set",
    "plan.levels=off",
    "--set",
    "plan.occupancy=off",
    "--set",
    "plan.directions=off",
    "--set",
    "plan.file=off",
    "--set",
    "plan.edges=off",
    "--set",
    "plan.cones=off",
    "--set",
    "plan.hull=off",
];

#[test]
fn a_run_is_planned_once_and_its_model_is_what_was_measured() {
    let folder = tempfile::tempdir().unwrap();
    let wide = "--set=scene.aabb_min=[-4.0,-4.0,-4.0]";
    // A corner set by the user is kept, and the rest of the box is not fitted either.
    let answer = run(folder.path(), &tiny_and(&["--out", "own", wide]));
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    assert_eq!(left_out(&json(&folder.path().join("own/plan.json"))), ["file"]);

    let arguments = tiny_and(&["--out", "run", "--stop-after", "7"]);
    assert_eq!(run(folder.path(), &arguments).code, Some(0));
    let path = folder.path().join("run");
    let plan = fs::read(path.join("plan.json")).unwrap();
    assert_eq!(run(folder.path(), &tiny_and(&["--out", "run"])).code, Some(0));
    assert_eq!(fs::read(path.join("plan.json")).unwrap(), plan, "a run that goes on is not planned again");
    let text = fs::read_to_string(path.join("config.toml")).unwrap();
    let config = Config::from_toml("config.toml", &text).unwrap();
    let model = Model::read(&path.join("model.safetensors")).unwrap();
    assert_eq!(model.config, config);
    assert_eq!(config.file.planes, FilePrecision::F16);
    // `eval` on the model file gives the PSNR that the run measured before it wrote the file, also with f16 texels.
    let answer = run(folder.path(), &["eval", "run", "--json", "eval.json"]);
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    let measured = json(&path.join("report.json"))["mean"]["psnr"].as_f64().unwrap();
    let read = json(&folder.path().join("eval.json"))["mean"]["psnr"].as_f64().unwrap();
    assert_eq!(measured, read, "what training reported, and what the file gives");
    // The error names an unreadable plan, and a fresh run needs no plan.
    fs::write(path.join("plan.json"), "[{").unwrap();
    let answer = run(folder.path(), &tiny_and(&["--out", "run"]));
    assert!(answer.code == Some(2) && answer.err.contains("--fresh"), "{answer:?}");
    let answer = run(folder.path(), &tiny_and(&["--out", "run", "--fresh"]));
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    assert_eq!(fs::read(path.join("plan.json")).unwrap(), plan);
    // Other settings make another run, whatever the plan.
    let answer = run(folder.path(), &tiny_and(&["--out", "run", "--set", "encoder.plane_size=32"]));
    assert_eq!(answer.code, Some(2), "{}", answer.err);
    assert!(answer.err.contains("encoder.plane_size"), "{}", answer.err);
    let answer = run(folder.path(), &tiny_and(&[&["--out", "run"], &OFF[..]].concat()));
    assert_eq!(answer.code, Some(if config.encoder.shape == PlaneShape::Box { 2 } else { 0 }));
}

#[test]
fn everything_off_is_the_configuration_as_written() {
    let folder = tempfile::tempdir().unwrap();
    let answer = run(folder.path(), &tiny_and(&[&["--out", "run"], &OFF[..]].concat()));
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    let path = folder.path().join("run");
    assert!(left_out(&json(&path.join("plan.json"))).is_empty());
    let model = Model::read(&path.join("model.safetensors")).unwrap();
    assert_eq!(model.config.scene, Config::default().scene);
    assert_eq!((model.config.encoder.plane_size, model.config.occupancy.resolution), (16, 16));
    assert_eq!(model.file.tensors["planes"].shape, [3, 16, 16, 16]);
}

#[test]
fn a_plan_says_what_why_and_at_what_cost() {
    let folder = tempfile::tempdir().unwrap();
    let mut arguments = vec![
        "plan",
        "--json",
        "plan.json",
        "--measure",
        "--samples",
        "0.02",
        "--seeds",
        "2",
        "--out",
        "trials",
    ];
    arguments.extend(tiny_and(&["--set", "data.builtin_train=8"]));
    let answer = run(folder.path(), &arguments);
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    let report = json(&folder.path().join("plan.json"));
    for finding in report["findings"].as_array().unwrap() {
        let (decision, reason) = (finding["decision"].as_str().unwrap(), finding["reason"].as_str().unwrap());
        assert!(answer.out.contains(&format!("plan.{decision}: ")) && answer.out.contains(reason));
        for change in finding["changes"].as_array().unwrap() {
            assert!(answer.out.contains(change["path"].as_str().unwrap()), "{}", answer.out);
        }
    }
    let effects = report["effects"].as_array().unwrap();
    assert_eq!(effects[0]["plan"], "nothing left out");
    assert_eq!(effects.last().unwrap()["plan"], "and directions");
    assert_eq!(effects.len(), left_out(&report["findings"]).len() + 2);
    for effect in effects {
        for key in ["psnr", "psnr_change", "psnr_spread", "seconds", "seconds_share", "model_bytes"] {
            assert!(effect[key].is_f64(), "{key}: {effect}");
        }
    }
    let last = effects.last().unwrap();
    let (change, spread) = (last["psnr_change"].as_f64().unwrap(), last["psnr_spread"].as_f64().unwrap());
    let told = change.abs() > spread.max(0.05);
    assert_eq!(report["directions_needed"].as_bool(), told.then_some(change < 0.0), "{last}");
    assert!(answer.out.contains("plan.directions: ") && answer.out.contains("dB apart"), "{}", answer.out);
    // Half the bits per texel make the file at least a tenth smaller.
    let bytes = |name: &str| {
        let at = effects.iter().position(|effect| effect["plan"] == name).unwrap();
        (effects[at - 1]["model_bytes"].as_f64().unwrap(), effects[at]["model_bytes"].as_f64().unwrap())
    };
    let (before, after) = bytes("and file");
    assert!(after < 0.9 * before, "{before} to {after} bytes");

    for broken in [&["--samples", "0"][..], &["--samples", "nan"], &["--set", "plan.aabb=maybe"]] {
        let answer =
            run(folder.path(), &[&["plan", "--measure", "--out", "x"], &tiny_and(broken)[..]].concat());
        assert_eq!(answer.code, Some(2), "{broken:?}: {answer:?}");
    }
}

/// The built-in scene needs only the part of the box that its cameras see. It needs all of the planned box, so planning
/// a second time leaves nothing out.
#[test]
fn a_plan_of_what_was_planned_leaves_nothing_out() {
    for scales in [4, 1] {
        plan_twice(scales, &["aabb", "levels", "occupancy", "file"]);
    }
}

fn plan_twice(scales: u32, expected: &[&str]) {
    let mut settings = trimip::settings::defaults();
    let scales = format!("data.scales={scales}");
    for assignment in ["data.format=builtin", "data.builtin_size=128", "data.builtin_train=24", &scales] {
        settings.apply_assignment(assignment).unwrap();
    }
    let config = Config::from_settings(&settings).unwrap();
    let scene = trimip_data::open(&config.section().unwrap()).unwrap();
    let compute = Compute::one_thread();
    let facts = Facts {
        train: &scene.train,
        test: &scene.test.cameras(),
        stated: None,
        origin: LocalOrigin::default(),
        compute: &compute,
    };
    let decided = |settings: &mut Settings| {
        let findings = scene_plan::make(settings, &facts).unwrap();
        findings.into_iter().filter(|f| f.left_out).map(|f| f.decision).collect::<Vec<_>>()
    };
    assert_eq!(decided(&mut settings), expected, "{scales}");
    let planned = Config::from_settings(&settings).unwrap();
    let mut again = trimip::settings::defaults();
    again.apply_file("planned", &planned.to_toml()).unwrap();
    for key in scene_plan::keys().filter(|key| *key != "directions") {
        again.apply_assignment(&format!("plan.{key}=on")).unwrap();
    }
    assert_eq!(decided(&mut again), Vec::<String>::new(), "{scales}: {planned:?}");

    // A model of the fitted box and one of the whole box look the same: no test view shows anything outside the fitted
    // box.
    let aabb = trimip_core::Aabb::<f64>::new(&planned.scene);
    for index in 0..scene.test.len() {
        let view = scene.test.load(index).unwrap();
        let camera = view.views[0].camera;
        for (i, pixel) in view.pixels_of(0).iter().enumerate() {
            let (x, y) = (i as u32 % camera.intrinsics.width, i as u32 / camera.intrinsics.width);
            let cone = camera.cone::<f64>(x, y);
            let (enter, leave) = aabb.intersect(cone.origin, cone.direction);
            assert!(
                enter < leave || pixel[3] < 128,
                "view {index}: pixel {x}, {y} shows what the box has not"
            );
        }
    }
}
