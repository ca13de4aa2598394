//! Checks of the program with `backend = "wgpu"`, the only setting that a user changes to train on a GPU.

use serde_json::Value;
use std::{fs, path::Path};
use trimip_core::field::model::Model;
use trimip_tests::{
    binary::{run, tiny_and},
    gpu,
};

/// Runs the test in a temporary folder if the machine has an adapter.
fn on_a_gpu(test: impl Fn(&Path)) {
    gpu::reproducibly(|_| {
        test(tempfile::tempdir().expect("a temporary folder").path());
        Ok(())
    });
}

fn mean_psnr(folder: &Path) -> f64 {
    let report = fs::read(folder.join("report.json")).expect("a report");
    let report: Value = serde_json::from_slice(&report).expect("JSON");
    assert_eq!(report["backend"], "wgpu");
    report["mean"]["psnr"].as_f64().expect("a number")
}

#[test]
fn a_run_stops_goes_on_and_is_evaluated_on_either_backend() {
    on_a_gpu(|folder| {
        let on = |out: &'static str, more: &[&'static str]| {
            let arguments = [&["--set", "backend=wgpu", "--out", out], more].concat();
            let answer = run(folder, &tiny_and(&arguments));
            assert_eq!((answer.code, answer.err.as_str()), (Some(0), ""), "{out} {more:?}");
            answer
        };
        let first = on("whole", &[]);
        assert!(first.out.contains("backend wgpu") && first.out.contains("memory:"), "{}", first.out);
        on("parts", &["--stop-after", "7"]);
        assert!(on("parts", &[]).out.contains("\"resumed\""));
        let model = |name: &str| fs::read(folder.join(name).join("model.safetensors")).expect("a model");
        assert!(model("whole") == model("parts"), "a stopped run goes on with the same bits");
        let trained = mean_psnr(&folder.join("whole"));
        let config = Model::read(&folder.join("whole/model.safetensors")).expect("a model").config;
        assert_eq!(config.backend, "wgpu");
        for backend in ["backend=wgpu", "backend=cpu"] {
            let answer = run(folder, &["eval", "whole", "--set", backend, "--json", "psnr.json"]);
            assert_eq!(answer.code, Some(0), "{}", answer.err);
            let written = fs::read(folder.join("psnr.json")).expect("a file");
            let found: Value = serde_json::from_slice(&written).expect("JSON");
            let psnr = found["mean"]["psnr"].as_f64().expect("a number");
            assert!((psnr - trained).abs() < 0.02, "{backend}: {psnr} dB, trained with {trained} dB");
        }
        // A run that began on the CPU resumes on the GPU.
        let began = run(folder, &tiny_and(&["--out", "moved", "--stop-after", "5"]));
        assert_eq!(began.code, Some(0), "{}", began.err);
        assert!(on("moved", &[]).out.contains("\"resumed\""));
    });
}

#[test]
fn what_a_gpu_takes_otherwise_is_said_and_a_wrong_adapter_is_refused() {
    on_a_gpu(|folder| {
        let arguments = ["--set", "backend=wgpu", "--set", "field.precision=bf16", "--out", "run"];
        let answer = run(folder, &tiny_and(&arguments));
        assert_eq!(answer.code, Some(0), "{}", answer.err);
        assert!(answer.out.contains("field.precision") && answer.out.contains("warning"), "{}", answer.out);
        let arguments = ["--set", "backend=wgpu", "--set", "wgpu.adapter=no such thing", "--out", "none"];
        let answer = run(folder, &tiny_and(&arguments));
        assert_eq!(answer.code, Some(2), "{}", answer.out);
        assert!(
            answer.err.contains("wgpu.adapter") && answer.err.contains("choose one of"),
            "{}",
            answer.err
        );
        assert_eq!(answer.err.lines().count(), 1, "{}", answer.err);
        let doctor = run(folder, &["doctor"]);
        for part in ["largest binding", "atomic f32 additions", "cooperative matrices"] {
            assert!(doctor.out.contains(part), "`{part}` in {}", doctor.out);
        }
    });
}
