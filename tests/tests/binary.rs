//! Checks of the program on the built-in scene, from the first command to the last picture: files, exit codes, and how
//! runs resume.

use serde_json::Value;
use std::{fs, path::Path, time::Duration};
use trimip_core::{
    engine::{checkpoint::Checkpoint, events::Event},
    field::model::Model,
};
use trimip_tests::{
    binary::{command, root, run, tiny, tiny_and},
    pages::expect_fits,
    zip::{Entry, archive, packed},
};

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display())))
        .unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Asserts the documented fields of the JSON report.
fn assert_report(report: &Value, steps: u64, scales: usize) {
    for key in ["backend", "scene"] {
        assert!(report[key].is_string(), "{key}: {}", report[key]);
    }
    for key in ["samples", "rays", "model_bytes"] {
        assert!(report[key].as_u64().is_some_and(|n| n > 0), "{key}: {}", report[key]);
    }
    assert_eq!(report["steps"], steps);
    assert!(report["train_seconds"].as_f64().is_some_and(|s| s > 0.0));
    // The peak memory is null if the system does not report it.
    assert!(report["peak_memory_bytes"].is_u64() || report["peak_memory_bytes"].is_null());
    let list = |key: &str| report[key].as_array().unwrap_or_else(|| panic!("{key}: {}", report[key])).clone();
    assert_eq!(list("scales").len(), scales);
    let mut sum = 0.0;
    for (i, scale) in list("scales").iter().enumerate() {
        assert_eq!(scale["scale"], 1 << i);
        assert_eq!(scale["images"], 2);
        assert!(scale["ssim"].is_f64());
        assert!(scale["flip"].as_f64().is_some_and(|flip| flip > 0.0 && flip < 1.0), "{scale}");
        assert!(
            scale["ms_ssim"].is_null() && scale["lpips"].is_null(),
            "too small, and without weights: {scale}"
        );
        assert_eq!(scale["perceptual_images"], 2);
        sum += scale["psnr"].as_f64().unwrap();
    }
    assert!((report["mean"]["psnr"].as_f64().unwrap() - sum / scales as f64).abs() < 1e-9);
    assert!(report["mean"]["ssim"].is_f64() && report["mean"]["flip"].is_f64());
    assert_eq!(report["measure"]["flip_pixels_per_degree"], 67.0);
    assert!(!list("curve").is_empty());
    for point in list("curve") {
        assert!(point["seconds"].is_f64() && point["step"].is_u64() && point["samples"].is_u64());
        assert_eq!(point["psnr"].as_array().unwrap().len(), scales);
    }
}

#[test]
fn a_run_leaves_a_whole_folder_and_is_not_run_twice() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = tiny_and(&["--out", "run"]);
    let answer = run(folder.path(), &arguments);
    assert_eq!((answer.code, answer.err.as_str()), (Some(0), ""));
    for line in answer.out.lines() {
        serde_json::from_str::<Event>(line).unwrap_or_else(|error| panic!("{error}: {line}"));
    }
    let run_folder = folder.path().join("run");
    assert_report(&json(&run_folder.join("report.json")), 20, 2);
    let views = json(&run_folder.join("views.json"));
    assert_eq!(views.as_array().map(Vec::len), Some(4));
    for view in views.as_array().unwrap() {
        let map = view["flip_map"].as_str().expect("every view has a picture");
        assert!(view["flip"].is_f64() && run_folder.join("images").join(map).is_file(), "{view}");
    }
    // Evaluations during the run have no FLIP.
    let events = fs::read_to_string(run_folder.join("metrics.jsonl")).unwrap();
    let first = events.lines().find(|line| line.contains("\"kind\":\"evaluation\"")).unwrap();
    assert!(first.contains("\"flip\":null") && first.contains("\"last\":false"), "{first}");
    for line in fs::read_to_string(run_folder.join("metrics.jsonl")).unwrap().lines() {
        serde_json::from_str::<Event>(line).unwrap_or_else(|error| panic!("{error}: {line}"));
    }
    let curve = fs::read_to_string(run_folder.join("error_vs_time.csv")).unwrap();
    let columns: Vec<usize> = curve.lines().map(|line| line.split(',').count()).collect();
    assert!(columns.len() >= 3 && columns.iter().all(|&count| count == columns[0]), "{curve}");
    let scalars = fs::read(run_folder.join("events.out.tfevents.run")).unwrap();
    for part in ["brain.Event:2", "train/loss", "eval/psnr_mean", "test/psnr_1", "test/flip_mean"] {
        assert!(scalars.windows(part.len()).any(|bytes| bytes == part.as_bytes()), "{part}");
    }
    assert!(!scalars.windows(5).any(|bytes| bytes == b"lpips"), "it was not measured");
    let html = fs::read_to_string(run_folder.join("report.html")).unwrap();
    assert!(html.starts_with("<!") && html.trim_end().ends_with("</html>") && !html.contains("src=\"http"));
    let config = fs::read_to_string(run_folder.join("config.toml")).unwrap();
    let config = trimip_core::Config::from_toml("config.toml", &config).unwrap();
    assert_eq!(Model::read(&run_folder.join("model.safetensors")).unwrap().config, config);
    let checkpoint = Checkpoint::read(&run_folder.join("checkpoint.safetensors")).unwrap();
    assert_eq!((checkpoint.state.totals.step, &checkpoint.config), (20, &config));
    let pictures: Vec<_> =
        fs::read_dir(run_folder.join("images")).unwrap().map(|e| e.unwrap().path()).collect();
    assert!(!pictures.is_empty());
    for path in pictures {
        image::open(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    }

    let model = fs::read(run_folder.join("model.safetensors")).unwrap();
    let again = run(folder.path(), &arguments);
    assert_eq!(again.code, Some(0));
    assert!(again.out.contains("finished") && again.out.contains("--fresh"), "{}", again.out);
    assert_eq!(fs::read(run_folder.join("model.safetensors")).unwrap(), model);
}

#[test]
fn a_stopped_run_goes_on_to_the_same_model() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(run(folder.path(), &tiny_and(&["--out", "whole"])).code, Some(0));
    for stop in ["3", "13"] {
        let stopped = run(folder.path(), &tiny_and(&["--out", stop, "--stop-after", stop]));
        assert_eq!(stopped.code, Some(0), "{}", stopped.err);
        let path = folder.path().join(stop);
        let checkpoint = Checkpoint::read(&path.join("checkpoint.safetensors")).unwrap();
        assert_eq!(checkpoint.state.totals.step.to_string(), stop);
        assert!(!path.join("model.safetensors").exists());
        let resumed = run(folder.path(), &tiny_and(&["--out", stop]));
        assert_eq!(resumed.code, Some(0), "{}", resumed.err);
        assert!(resumed.out.contains("\"resumed\""));
        let model = |path: &Path| Model::read(&path.join("model.safetensors")).unwrap();
        assert!(model(&path) == model(&folder.path().join("whole")), "stopped at {stop}: another model");
        let bytes = |path: &Path| fs::read(path.join("model.safetensors")).unwrap();
        assert!(bytes(&path) == bytes(&folder.path().join("whole")), "stopped at {stop}: other bytes");
        assert_report(&json(&path.join("report.json")), 20, 2);
    }
}

#[test]
fn a_fresh_run_that_cannot_begin_leaves_the_old_one() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(run(folder.path(), &tiny_and(&["--out", "run"])).code, Some(0));
    let files = ["model.safetensors", "checkpoint.safetensors", "config.toml", "plan.json", "metrics.jsonl"];
    let bytes = || files.map(|name| fs::read(folder.path().join("run").join(name)).unwrap());
    let before = bytes();
    let absent = ["--out", "run", "--fresh", "--set", "backend=wgpu", "--set", "wgpu.adapter=no such thing"];
    let answer = run(folder.path(), &tiny_and(&absent));
    assert!(answer.code.is_some_and(|code| code >= 2), "{:?}", answer.code);
    assert!(bytes() == before, "something is lost");
}

#[test]
fn a_missed_floor_fails_with_its_report_written() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = tiny_and(&["--out", "run", "--set", "eval.min_psnr=99"]);
    let path = folder.path().join("run");
    for attempt in ["first", "repeated"] {
        let answer = run(folder.path(), &arguments);
        assert_eq!(answer.code, Some(1), "{attempt}: {}", answer.err);
        assert!(answer.err.starts_with("error: ") && answer.err.lines().count() == 1, "{}", answer.err);
        assert!(answer.err.contains("eval.min_psnr"), "{}", answer.err);
        assert_report(&json(&path.join("report.json")), 20, 2);
        assert!(path.join("model.safetensors").exists());
    }
    assert_eq!(run(folder.path(), &["eval", "run"]).code, Some(1));
    assert_eq!(run(folder.path(), &["eval", "run", "--set", "eval.min_psnr=0"]).code, Some(0));
}

#[test]
fn a_killed_run_leaves_a_whole_checkpoint_and_the_same_command_finishes_it() {
    let folder = tempfile::tempdir().unwrap();
    // With a time budget, the run takes equally long on any machine.
    let more = ["--out", "run", "--set", "train.seconds=3", "--set", "train.checkpoint_seconds=0.02"];
    let arguments = tiny_and(&[&more[..], &["--set", "eval.points=0"]].concat());
    let checkpoint = folder.path().join("run/checkpoint.safetensors");
    for pause in [0, 37, 91] {
        let before = fs::metadata(&checkpoint).and_then(|m| m.modified()).ok();
        let mut child =
            command(folder.path(), &arguments).stdout(std::process::Stdio::null()).spawn().unwrap();
        for _ in 0..2000 {
            if fs::metadata(&checkpoint).and_then(|m| m.modified()).ok() != before {
                break;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        std::thread::sleep(Duration::from_millis(pause));
        assert!(child.try_wait().unwrap().is_none(), "the run is still under way");
        child.kill().unwrap();
        child.wait().unwrap();
        let saved =
            Checkpoint::read(&checkpoint).unwrap_or_else(|error| panic!("half a checkpoint: {error}"));
        assert!(saved.state.totals.step > 0);
    }
    let answer = run(folder.path(), &arguments);
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    assert!(answer.out.contains("\"resumed\""));
    let report = json(&folder.path().join("run/report.json"));
    assert!(report["train_seconds"].as_f64().is_some_and(|s| s >= 3.0), "{}", report["train_seconds"]);
}

#[test]
fn verbs_answer() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let good = |arguments: &[&str]| {
        let answer = run(here, arguments);
        assert_eq!(answer.code, Some(0), "{arguments:?}: {}", answer.err);
        // `render` also prints its speed; the other verbs print nothing on standard error.
        let mut aside = answer.err.lines();
        if arguments[0] == "render" {
            assert!(aside.next().is_some_and(|line| line.ends_with("frames/s")), "{}", answer.err);
        }
        assert_eq!(aside.next(), None, "{arguments:?}");
        answer.out
    };
    good(&tiny_and(&["--out", "run"]));

    let table = good(&["eval", "run", "--json", "eval.json"]);
    assert!(["full", "1/2", "mean", "FLIP"].iter().all(|row| table.contains(row)), "{table}");
    let (measured, reported) = (json(&here.join("eval.json")), json(&here.join("run/report.json")));
    assert_eq!(measured["scales"], reported["scales"], "eval measures what training reported");
    good(&["eval", "run", "--json", "black.json", "--set", "data.background=[0.0, 0.0, 0.0]"]);
    let black = json(&here.join("black.json"));
    let psnr = |report: &Value, key: &str| report["mean"][key].as_f64().unwrap();
    for (one, other) in [("psnr", "psnr_opposite"), ("psnr_opposite", "psnr")] {
        let (one, other) = (psnr(&measured, one), psnr(&black, other));
        assert!((one - other).abs() < 1e-3, "what is white to one is black to the other: {one} and {other}");
    }

    let compared =
        good(&["compare", "first=run", "run", "--reach", "1,99", "--svg", "plot.svg", "--json", "c.json"]);
    assert!(compared.contains("first") && compared.lines().count() == 3, "{compared}");
    assert!(
        compared.contains("SSIM") && compared.contains("FLIP") && !compared.contains("LPIPS"),
        "{compared}"
    );
    assert_eq!(json(&here.join("c.json"))[0]["mean"]["flip"], reported["mean"]["flip"]);
    assert_eq!(json(&here.join("c.json"))[0]["reaches"][1]["seconds"], Value::Null);
    assert!(fs::read_to_string(here.join("plot.svg")).unwrap().ends_with("</svg>\n"));

    let listed = good(&[
        "render",
        "run",
        "--turntable",
        "2",
        "--width",
        "24",
        "--height",
        "16",
        "--what",
        "color,depth,opacity",
    ]);
    let listed: Vec<&str> = listed.lines().collect();
    assert_eq!(listed.len(), 6);
    for path in &listed {
        let picture = image::open(here.join(path)).unwrap();
        assert_eq!((picture.width(), picture.height()), (24, 16), "{path}");
    }
    let exr = good(&[
        "render",
        "run",
        "--turntable",
        "1",
        "--width",
        "9",
        "--height",
        "8",
        "--format",
        "exr",
        "--out",
        "exr",
    ]);
    let bytes = fs::read(here.join(exr.trim())).unwrap();
    assert_eq!(bytes[..4], [0x76, 0x2f, 0x31, 0x01], "the magic number of OpenEXR");
    let again = good(&["render", "run", "--path", "run/renders/cameras.json", "--out", "path"]);
    let colors = listed.iter().filter(|path| path.ends_with("_color.png"));
    for (again, first) in again.lines().zip(colors) {
        let pixels = |path: &str| image::open(here.join(path)).unwrap();
        assert!(pixels(again) == pixels(first), "{again}: cameras are read back as they were written");
    }
    assert_eq!(again.lines().count(), 2);

    let shown = good(&[&["config"][..], &tiny()].concat());
    assert!(
        shown.lines().any(|line| line.starts_with("plane_size")
            && line.contains("16")
            && line.ends_with("command line"))
    );
    let config = trimip_core::Config::from_toml("shown", &shown).unwrap();
    assert_eq!((config.encoder.plane_size, config.train.steps), (16, 20));
    assert_eq!(good(&["config", "--defaults"]), trimip::settings::definitions().text());

    let facts = good(&["doctor"]);
    assert!(["version", "cores", "memory", "backend"].iter().all(|fact| facts.contains(fact)), "{facts}");
    assert!(good(&["--help"]).contains("Usage") && good(&["--version"]).contains("trimip-cli"));

    good(&[&["data", "builtin", "scene"][..], &tiny()].concat());
    let inspected = good(&["data", "inspect", "scene"]);
    assert!(inspected.contains("4 ") && inspected.contains("16x16"), "{inspected}");
    good(&["data", "multiscale", "scales", "--root", "scene", "--set", "data.scales=2"]);
    assert!(json(&here.join("scales/metadata.json")).is_object());
    // Training on the written files and on the scene itself gives the same model at the same settings.
    good(&tiny_and(&["--out", "written", "--set", "data.format=multiscale", "--set", "data.root=scales"]));
    let parameters =
        |name: &str| Model::read(&here.join(name).join("model.safetensors")).unwrap().file.tensors;
    assert!(parameters("written") == parameters("run"), "the written photographs are the rendered ones");
}

#[test]
fn an_archive_stands_for_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let good = |arguments: &[&str]| {
        let answer = run(here, arguments);
        assert_eq!(answer.code, Some(0), "{arguments:?}: {answer:?}");
        answer.out
    };
    good(&[&["data", "builtin", "scene"][..], &tiny()].concat());
    let filler = Entry::deflated("filler.bin", &vec![0; 64 << 20]);
    fs::write(here.join("a.zip"), archive(&[packed(&here.join("scene"), "lego/"), vec![filler]].concat()))
        .unwrap();
    // A killed extraction leaves a folder that no later command mistakes for a whole one.
    let mut killed = command(here, &["plan", "a.zip"]).spawn().unwrap();
    while !here.join("a.zip.tmp/filler.bin").exists() && killed.try_wait().unwrap().is_none() {
        std::thread::sleep(Duration::from_millis(1));
    }
    killed.kill().unwrap();
    let ended = killed.wait().unwrap();
    assert!(!ended.success() && here.join("a.zip.tmp").exists() && !here.join("a").exists(), "{ended:?}");
    let told = "a.zip is unpacked in a: 9 files, ";
    for arguments in [&["plan", "a.zip"][..], &["data", "inspect", "a.zip"]] {
        assert!(good(arguments).lines().any(|line| line.starts_with(told)), "{}", good(arguments));
    }
    assert!(!here.join("a.zip.tmp").exists());
    let training = |scene| [&[scene][..], &tiny(), &["--set", "data.format=auto"]].concat();
    (0..2).for_each(|_| drop(good(&training("a.zip"))));
    good(&training("scene"));
    good(&["eval", "runs/a"]);
    let parameters = |name: &str| Model::read(&here.join(name)).unwrap().file.tensors;
    assert!(parameters("runs/a/model.safetensors") == parameters("runs/scene/model.safetensors"));
}

#[test]
fn every_shipped_configuration_is_accepted() {
    let mut count = 0;
    let files = |folder: &str| fs::read_dir(root().join(folder)).unwrap();
    for entry in files("configs").chain(files("trimip/systems")) {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|end| end != "toml") {
            continue;
        }
        let answer = run(&root(), &["config", "--config", path.to_str().unwrap()]);
        assert_eq!((answer.code, answer.err.as_str()), (Some(0), ""), "{}", path.display());
        count += 1;
    }
    assert!(count >= 6, "{count} configurations");
}

#[test]
fn a_bench_lays_variants_and_seeds_beside_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let bench = |more: &[&str]| {
        let settings = tiny();
        run(folder.path(), &[&["bench", "--out", "b"], &settings[..], more].concat())
    };
    let variants = ["--try", "no mip: encoder.mipmap=false", "--vary", "field.hidden=16|32", "--seeds", "2"];
    let first = bench(&variants);
    assert_eq!(first.code, Some(0), "{}", first.err);
    for name in ["base", "no mip", "field.hidden=16", "field.hidden=32", "*"] {
        assert!(first.out.contains(name), "`{name}` in {}", first.out);
    }
    let table = json(&folder.path().join("b/bench.json"));
    let rows = table["variants"].as_array().unwrap();
    assert_eq!(rows.len(), 4);
    for row in rows {
        assert_eq!((row["seeds"].as_u64(), row["runs"].as_array().map(Vec::len)), (Some(2), Some(2)));
        assert!(row["spread"].as_f64().is_some_and(|spread| spread > 0.0), "two seeds are two runs: {row}");
        assert!(row["psnr"].is_f64() && row["seconds"].as_f64().is_some_and(|s| s > 0.0));
    }
    assert!(rows.iter().any(|row| row["pareto"] == true), "some variant is on the front");
    // The base is `hidden = 16` under another name, so both have the same bits and figures.
    assert_eq!(rows[0]["psnr"], rows[2]["psnr"]);
    let csv = fs::read_to_string(folder.path().join("b/bench.csv")).unwrap();
    assert_eq!(csv.lines().count(), 5);
    let latex = fs::read_to_string(folder.path().join("b/bench.tex")).unwrap();
    assert!(latex.contains("\\toprule") && latex.matches(r" \\").count() == 5, "{latex}");
    assert!(fs::read_to_string(folder.path().join("b/bench.svg")).unwrap().starts_with("<svg"));
    let page = fs::read_to_string(folder.path().join("b/bench.html")).unwrap();
    assert!(page.starts_with("<!doctype html>") && page.contains("<svg") && page.contains("no mip"));
    expect_fits(&folder.path().join("b/bench.html"));
    // Finished runs are not repeated.
    let model = folder.path().join("b/no-mip-1/model.safetensors");
    let before = fs::metadata(&model).unwrap().modified().unwrap();
    assert_eq!(bench(&variants).code, Some(0));
    assert_eq!(fs::metadata(&model).unwrap().modified().unwrap(), before);
    let wrong = bench(&["--vary", "field.hiden=16"]);
    assert_eq!(wrong.code, Some(2), "{}", wrong.out);
    assert!(wrong.err.contains("hiden") && wrong.err.lines().count() == 1, "{}", wrong.err);
}

#[test]
fn a_bench_of_rendering_converges_to_the_picture_in_f64() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(run(folder.path(), &tiny_and(&["--out", "run"])).code, Some(0));
    let answer = run(folder.path(), &["bench", "--render", "run", "--width", "12", "--out", "b"]);
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    let report = json(&folder.path().join("b/rendering.json"));
    let rows = report["rows"].as_array().unwrap();
    let errors: Vec<f64> = rows
        .iter()
        .filter(|row| row["varied"] == "steps along the diagonal")
        .map(|row| row["error"].as_f64().unwrap())
        .collect();
    assert_eq!(errors.len(), 7);
    // The model is barely trained, so sixty-four times shorter steps leave only the error of f32.
    assert!(errors[6] < 0.1 * errors[0] && errors[6] < 1e-3, "{errors:?}");
    let precisions = 1 + usize::from(trimip_cpu::simd::Simd::detect().has_bf16());
    assert_eq!(rows.iter().filter(|row| row["varied"] == "precision").count(), precisions, "f32, and bf16");
    assert!(rows.iter().all(|row| row["milliseconds"].as_f64().is_some_and(|ms| ms > 0.0)));
    assert_eq!(
        fs::read_to_string(folder.path().join("b/rendering.csv")).unwrap().lines().count(),
        rows.len() + 1
    );
}

#[test]
fn a_bench_of_cones_measures_every_scale_by_every_convention() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(run(folder.path(), &tiny_and(&["--out", "run"])).code, Some(0));
    let cones = ["bench", "--render", "run", "--cones", "--views", "1", "--out", "c"];
    let answer = run(folder.path(), &cones);
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    assert!(answer.out.contains("box filter") && answer.out.contains("8x8"), "{}", answer.out);
    let report = json(&folder.path().join("c/cones.json"));
    let rows = report["rows"].as_array().unwrap();
    let finest = rows.iter().take_while(|row| row["scale"] == 1).count();
    let scales: Vec<u64> = rows.iter().step_by(finest).map(|row| row["scale"].as_u64().unwrap()).collect();
    assert_eq!(rows.len(), finest * scales.len());
    assert_eq!(scales[..2], [1, 2]);
    for scale in rows.chunks(finest) {
        let sides: Vec<u64> = scale.iter().map(|row| row["side"].as_u64().unwrap()).collect();
        assert!(sides.is_sorted() && [1, 2, 4, 8].iter().all(|side| sides.contains(side)), "{sides:?}");
        let own = scale.iter().filter(|row| row["own"] == true).count();
        assert_eq!(own, 1, "the model's own number is among them: {scale:?}");
        // Pictures with more cones are closer to the picture with the most cones, which has no PSNR against itself.
        let converged = |i: usize| scale[i]["psnr_converged"].as_f64();
        assert!(converged(0) <= converged(finest - 2) && converged(finest - 1).is_none(), "{scale:?}");
        assert!(scale.iter().any(|row| row["pareto"] == true));
        assert!(scale.iter().all(|row| row["milliseconds"].as_f64().is_some_and(|ms| ms > 0.0)));
    }
    // The finest photographs are their own box filter, and have no edge exponent.
    assert!((0..finest).all(|i| rows[i]["psnr"] == rows[i]["psnr_plain"]), "{rows:?}");
    let csv = fs::read_to_string(folder.path().join("c/cones.csv")).unwrap();
    assert_eq!(csv.lines().count(), rows.len() + 1);
    assert!(fs::read_to_string(folder.path().join("c/cones.svg")).unwrap().contains("seconds a view"));
    // With one cone, the figures are those of `eval` at every scale.
    let one = ["eval", "run", "--stride", "1000", "--set", "renderer.cones=1", "--json", "eval.json"];
    assert_eq!(run(folder.path(), &one).code, Some(0));
    let measured = json(&folder.path().join("eval.json"));
    for (scale, row) in measured["scales"].as_array().unwrap().iter().zip(rows.iter().step_by(finest)) {
        for key in ["psnr", "psnr_plain", "psnr_box"] {
            let (a, b) = (scale[key].as_f64().unwrap(), row[key].as_f64().unwrap());
            assert!((a - b).abs() < 1e-9, "{key}: {a} and {b}");
        }
    }
    assert_eq!(run(folder.path(), &["bench", "--cones"]).code, Some(2), "--cones needs --render");
}
