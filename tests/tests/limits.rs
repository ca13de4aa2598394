//! Checks of the limits of numbers and memory: every setting at its edges, files with false numbers, and a system that grants no
//! more memory. The program reports an error in one line, and takes no more memory than the test states.

use image::{GrayImage, Luma};
use serde_json::{Value, json};
use std::{fs, path::Path, process::Command};
use tempfile::TempDir;
use trimip_core::{
    Config, DocumentedSetting,
    field::tensors::{TensorFile, Values},
};
use trimip_tests::binary::{Answer, command, program, run, tiny, tiny_and};

/// Numbers at which programs often fail, and values that are no numbers.
const EDGES: [&str; 12] = [
    "0",
    "-1",
    "1e308",
    "nan",
    "inf",
    "4294967295",
    "9007199254740992",
    "9223372036854775807",
    "\"\"",
    "[]",
    "true",
    "{ a = 1 }",
];

/// Largest memory of a tiny run in bytes, whatever its settings.
const MOST_OF_A_TINY_RUN: f64 = 400e6;

/// Returns the edge as a value of a setting: a single value, each number of a list, or the value of a schedule.
fn edge_of(setting: &DocumentedSetting, edge: &str) -> String {
    let numbers = setting.default.matches(',').count() + 1;
    match setting.default.as_bytes() {
        _ if edge.starts_with(['"', '[', '{']) => edge.to_string(),
        [b'[', b'[', ..] => format!("[[0.0, {edge}]]"),
        [b'[', ..] => format!("[{}]", vec![edge; numbers].join(", ")),
        _ => edge.to_string(),
    }
}

/// Returns the settings of the encoder that a section belongs to, at a tiny size.
fn encoder_of(section: &str) -> &'static [&'static str] {
    match section {
        "hash_grid" => &["encoder.kind=hash-grid", "hash_grid.log2_entries=8", "hash_grid.levels=2"],
        "rip_map" => &["encoder.kind=rip-map", "rip_map.size=16", "rip_map.levels=3"],
        "tensor" => &[
            "encoder.kind=tensor",
            "field.density_layers=0",
            "tensor.sides=[[0.0, 6]]",
            "tensor.density_components=16",
            "tensor.color_components=16",
        ],
        "voxels" => &["encoder.kind=voxels", "voxels.sides=[[0.0, 6]]"],
        "frequencies" => &["encoder.kind=frequencies", "frequencies.count=3"],
        _ => &["encoder.plane_size=16", "encoder.levels=3"],
    }
}

/// Asserts an error message of one line, and one of the exit codes `codes`.
fn one_line(answer: &Answer, codes: &[i32], what: &str) {
    assert!(answer.code.is_some_and(|code| codes.contains(&code)), "{what}: {answer:?}");
    assert!(
        answer.err.starts_with("error: ") && answer.err.trim_end().lines().count() == 1,
        "{what}: {answer:?}"
    );
    assert!(answer.err.len() < 1500 && !answer.err.contains("stack backtrace"), "{what}: {answer:?}");
}

#[test]
fn every_setting_at_its_edges_is_refused_in_a_line_or_runs() {
    let folder = tempfile::tempdir().unwrap();
    let (mut refused, mut ran) = (0, 0);
    for section in trimip::settings::definitions().documented() {
        for (setting, edge) in section.settings.iter().flat_map(|setting| EDGES.map(|edge| (setting, edge))) {
            let path = match section.name.as_str() {
                "" => setting.key.clone(),
                name => format!("{name}.{}", setting.key),
            };
            let assignment = format!("{path}={}", edge_of(setting, edge));
            let tiny = tiny();
            let common = tiny.iter().filter(|text| **text != "--set" && !text.starts_with("encoder."));
            let mut all: Vec<&str> =
                common.copied().chain(encoder_of(&section.name).iter().copied()).collect();
            all.push(&assignment);
            let mut settings = trimip::settings::defaults();
            let applied = all.iter().try_for_each(|set| settings.apply_assignment(set));
            if let Err(error) = applied.and_then(|()| Config::from_settings(&settings).map(drop)) {
                refused += 1;
                let message = error.message();
                assert_eq!(error.kind(), trimip_core::ErrorKind::Input, "{message}");
                assert!(message.contains(&path) && message.len() < 1500, "{assignment}: {message}");
                assert!(!message.contains("untagged"), "{assignment}: {message}");
                // Errors about numbers do not mention Rust types. Choices may be named after such types.
                let number = !setting.range.is_empty();
                for word in ["u32", "u64", "f32", "f64", "i64"].into_iter().filter(|_| number) {
                    assert!(!message.contains(word), "{assignment}: `{word}` in {message}");
                }
                if !setting.range.is_empty()
                    && edge.parse::<f64>().is_ok()
                    && !setting.default.starts_with('[')
                {
                    // The message names the range, or another condition on the number.
                    assert!(message.contains("expected "), "{assignment}: {message}");
                }
                continue;
            }
            ran += 1;
            let set: Vec<&str> = all.iter().flat_map(|set| ["--set", set]).collect();
            let answer = run(folder.path(), &[&["--out", "run", "--fresh"], &set[..]].concat());
            match answer.code {
                Some(0) => {}
                // An accepted setting may fail later, for example an unknown backend.
                _ => one_line(&answer, &[1, 2], &assignment),
            }
            if let Some(used) = peak(&folder.path().join("run")) {
                assert!(used < MOST_OF_A_TINY_RUN, "{assignment} takes {used} bytes");
            }
        }
    }
    assert!(refused > 500 && ran > 20, "{refused} refused, {ran} ran");
}

/// Returns the last event of a kind in a run.
fn event(run: &Path, kind: &str) -> Option<Value> {
    let text = fs::read_to_string(run.join("metrics.jsonl")).ok()?;
    text.lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .rfind(|event| event["kind"] == kind)
}

/// Returns the peak memory of a run in bytes.
fn peak(run: &Path) -> Option<f64> {
    event(run, "session_ended")?["peak_memory_bytes"].as_f64()
}

/// The plan predicts the memory that a run with the finest marching step needs at its start, when nothing is opaque yet: for rays
/// that keep all their samples, and for rays whose samples merge.
#[test]
fn the_memory_of_long_rays_is_predicted() {
    for least in ["renderer.min_weight=0", "renderer.min_weight=0.01"] {
        memory_of_long_rays(least);
    }
}

fn memory_of_long_rays(least: &str) {
    let folder = tempfile::tempdir().unwrap();
    let settings =
        ["renderer.steps_per_diagonal=65536", least, "train.steps=3", "eval.points=0", "eval.final=false"];
    let set: Vec<&str> = settings.iter().flat_map(|set| ["--set", set]).collect();
    let answer = run(folder.path(), &tiny_and(&[&["--out", "run"], &set[..]].concat()));
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    let run = folder.path().join("run");
    let predicted = event(&run, "plan").unwrap()["memory_bytes"].as_f64().unwrap();
    let Some(used) = peak(&run) else {
        println!("skipped: this system does not tell the peak of a process");
        return;
    };
    println!("{least}: predicted {:.0} MB, used {:.0} MB", 1e-6 * predicted, 1e-6 * used);
    assert!((1.0..=2.5).contains(&(predicted / used)), "{least}: {predicted} predicted, {used} used");
}

#[test]
fn a_run_that_needs_more_memory_than_there_is_does_not_begin() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = tiny_and(&[
        "--out",
        "run",
        "--set",
        "encoder.plane_size=4096",
        "--set",
        "renderer.steps_per_diagonal=65536",
        "--set",
        "occupancy.resolution=1024",
        "--set",
        "field.hidden=512",
        "--set",
        "threads=1024",
    ]);
    let answer = run(folder.path(), &arguments);
    one_line(&answer, &[2], "more than there is");
    for part in ["memory", "needs about", "lower ", "memory = \"warn\""] {
        assert!(answer.err.contains(part), "{part}: {}", answer.err);
    }
    assert!(!folder.path().join("run/checkpoint.safetensors").exists());
}

/// Returns a folder with a finished tiny run.
fn trained() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let answer = run(folder.path(), &tiny_and(&["--out", "run"]));
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    folder
}

/// Changes a file of tensors.
fn edit(path: &Path, change: impl FnOnce(&mut TensorFile)) {
    let mut file = TensorFile::read(path).unwrap();
    change(&mut file);
    file.write(path, &[]).unwrap();
}

#[test]
fn a_checkpoint_whose_state_no_run_can_have_is_refused() {
    let folder = trained();
    let here = folder.path();
    let path = here.join("run/checkpoint.safetensors");
    fs::remove_file(here.join("run/model.safetensors")).unwrap();
    let whole = fs::read(&path).unwrap();
    for (key, value) in [
        ("halvings", json!(1)),
        ("halvings", json!(64)),
        ("moments_since", json!(1_u64 << 60)),
        ("step_scale", json!(1e-300)),
        ("step_scale", json!(-1.0)),
        ("rays_per_step", json!(1 << 20)),
        ("rays_per_step", json!(0)),
        ("marched_per_ray", json!(1e30)),
        ("marched_per_ray", json!(-1.0)),
        ("totals.seconds", json!(-5.0)),
        ("totals.samples", json!(u64::MAX)),
        ("totals.step", json!(u64::MAX)),
    ] {
        edit(&path, |file| {
            let state = file.metadata.get_mut("state").unwrap();
            let mut document: Value = serde_json::from_str(state).unwrap();
            match key.strip_prefix("totals.") {
                Some(key) => document["totals"][key] = value.clone(),
                None => document[key] = value.clone(),
            }
            *state = document.to_string();
        });
        let name = key.trim_start_matches("totals.");
        for arguments in
            [tiny_and(&["--out", "run"]), vec!["eval", "run"], vec!["render", "run", "--turntable", "1"]]
        {
            let answer = run(here, &arguments);
            one_line(&answer, &[2], &format!("{key} = {value}"));
            assert!(
                answer.err.contains("checkpoint.safetensors") && answer.err.contains(name),
                "{}",
                answer.err
            );
        }
        fs::write(&path, &whole).unwrap();
    }
    assert_eq!(run(here, &tiny_and(&["--out", "run"])).code, Some(0), "the whole file is read");
}

#[test]
fn numbers_that_are_not_finite_are_named_with_their_tensor() {
    let folder = trained();
    let here = folder.path();
    let spoil = |file: &mut TensorFile| match &mut file.tensors.get_mut("density.0.weight").unwrap().values {
        Values::F32(values) => values[7] = f32::NAN,
        other => panic!("{other:?}"),
    };
    let named = |answer: &Answer, file: &str| {
        one_line(answer, &[2], file);
        for part in [file, "density.0.weight", "NaN", "index 7"] {
            assert!(answer.err.contains(part), "{part}: {}", answer.err);
        }
    };
    edit(&here.join("run/model.safetensors"), spoil);
    named(&run(here, &["eval", "run"]), "model.safetensors");
    named(&run(here, &["render", "run", "--turntable", "1"]), "model.safetensors");
    edit(&here.join("run/checkpoint.safetensors"), spoil);
    named(&run(here, &tiny_and(&["--out", "run"])), "checkpoint.safetensors");
}

/// Runs the program with at most `kilobytes` of address space.
#[cfg(target_os = "linux")]
fn run_within(folder: &Path, kilobytes: u64, arguments: &[&str]) -> Answer {
    let output = Command::new("sh")
        .args(["-c", &format!("ulimit -v {kilobytes}; exec \"$0\" \"$@\"")])
        .arg(program())
        .args(arguments)
        .current_dir(folder)
        .env("XDG_RUNTIME_DIR", folder)
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    Answer { code: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
}

#[test]
#[cfg(target_os = "linux")]
fn a_small_file_that_states_a_large_model_is_refused_before_it_takes_memory() {
    let folder = trained();
    let here = folder.path();
    for (size, setting) in
        [("plane_size = 16", "plane_size = 4096"), ("resolution = 16", "resolution = 1024")]
    {
        let path = here.join("run/model.safetensors");
        let whole = fs::read(&path).unwrap();
        edit(&path, |file| {
            let config = file.metadata.get_mut("config").unwrap();
            assert!(config.contains(size), "{config}");
            *config = config.replace(size, setting);
        });
        // The address space is limited to 1 GB; a model of these sizes would take more.
        let answer = run_within(here, 1_000_000, &["eval", "run"]);
        one_line(&answer, &[2], setting);
        assert!(answer.err.contains("model.safetensors") && answer.err.contains("tensor"), "{}", answer.err);
        fs::write(&path, whole).unwrap();
    }
}

#[test]
#[cfg(target_os = "linux")]
fn where_the_system_gives_no_more_memory_the_program_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let large = tiny_and(&["--out", "run", "--fresh", "--set", "encoder.plane_size=1024"]);
    let careless = [&large[..], &["--set", "memory=warn"]].concat();
    for kilobytes in [60_000, 120_000, 250_000, 500_000, 800_000] {
        for arguments in [&large, &careless] {
            let answer = run_within(here, kilobytes, arguments);
            one_line(&answer, &[2, 3], &format!("{kilobytes} kB, {arguments:?}"));
        }
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_photograph_that_does_not_fit_into_memory_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    assert_eq!(run(here, &[&["data", "builtin", "scene"][..], &tiny()].concat()).code, Some(0));
    let path = here.join("scene/transforms_train.json");
    let mut document: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    (document["w"], document["h"]) = (Value::Null, Value::Null);
    fs::write(&path, document.to_string()).unwrap();
    GrayImage::from_pixel(8192, 8192, Luma([9])).save(here.join("scene/train/r_1.png")).unwrap();
    let arguments = tiny_and(&["--out", "run", "--set", "data.format=auto", "--set", "data.root=scene"]);
    let answer = run_within(here, 700_000, &arguments);
    one_line(&answer, &[2], "a large photograph");
    assert!(answer.err.contains("r_1.png") && answer.err.contains("8192x8192"), "{}", answer.err);
}

#[test]
fn messages_are_short_and_do_not_act_on_a_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let long = format!("data.root={}", "x".repeat(100_000));
    let answer = run(folder.path(), &["config", "--set", &format!("{long}\u{1b}[31m"), "--set", "threads=x"]);
    one_line(&answer, &[2], "a long value");
    let answer = run(folder.path(), &["config", "--set", &format!("threads={}", "9".repeat(100_000))]);
    one_line(&answer, &[2], "a long number");
    let answer = run(folder.path(), &["config", "--set", "thr\u{1b}[31meads=1"]);
    one_line(&answer, &[2], "an escape");
    assert!(!answer.err.contains('\u{1b}') && answer.err.contains("\\u{1b}"), "{}", answer.err);
}

#[test]
fn quantities_that_are_named_twice_are_written_once() {
    let folder = trained();
    for format in ["exr", "png"] {
        let arguments = ["render", "run", "--turntable", "1", "--width", "8", "--height", "8", "--fresh"];
        let answer =
            run(folder.path(), &[&arguments[..], &["--what", "color,color", "--format", format]].concat());
        assert_eq!(answer.code, Some(0), "{}", answer.err);
        assert_eq!(answer.out.lines().count(), 1, "{}", answer.out);
    }
}

#[test]
fn a_byte_order_mark_is_read_over_in_every_text() {
    let folder = trained();
    let here = folder.path();
    let marked = |name: &str, text: &str| fs::write(here.join(name), format!("\u{feff}{text}")).unwrap();
    marked("a.toml", "seed = 7\n");
    marked("a.csv", "seconds,psnr_mean\n1,20\n2,21\n");
    marked("pose.json", "[[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]");
    for arguments in [
        &["config", "--config", "a.toml"][..],
        &["compare", "a.csv"],
        &["render", "run", "--pose", "pose.json", "--width", "8", "--height", "8"],
    ] {
        let answer = command(here, arguments).output().unwrap();
        assert!(answer.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&answer.stderr));
    }
}
