//! The program on several ranks, as `mpirun` starts it. Where there is no Open MPI these tests are skipped, and say so; with
//! `TRIMIP_REQUIRE_MPI=1` they fail instead.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::Duration;
use trimip_tests::binary::{Answer, command, program, root, run, tiny, tiny_and};
use trimip_tests::files::files;
use trimip_tests::whole::{Whole, is_sound};

/// The program with the feature `mpi`, or `None`, with a line that says so, where it cannot be built.
fn program_of_ranks() -> Option<&'static Path> {
    static PROGRAM: OnceLock<Option<PathBuf>> = OnceLock::new();
    let built = PROGRAM.get_or_init(|| {
        let has = |name: &str| Command::new(name).arg("--version").output().is_ok_and(|o| o.status.success());
        if !has("mpirun") || !has("mpicc") {
            assert!(std::env::var_os("TRIMIP_REQUIRE_MPI").is_none(), "Open MPI is not installed");
            return None;
        }
        let usual = program();
        let folder = usual.parent().expect("a program lies in a folder");
        let profile = match folder.file_name().and_then(|name| name.to_str()) {
            Some("debug") | None => "dev",
            Some(profile) => profile,
        };
        let target = folder.parent().expect("profiles lie in a target folder");
        let status = Command::new(env!("CARGO"))
            .args(["build", "--quiet", "--locked", "--package", "trimip-cli", "--features", "mpi"])
            .args(["--profile", profile, "--target-dir"])
            .arg(target)
            .current_dir(root())
            .status();
        assert!(status.is_ok_and(|status| status.success()), "cargo builds trimip-cli with the feature mpi");
        // The next build without the feature replaces it.
        let own = folder.join("trimip-cli-of-ranks");
        std::fs::copy(usual, &own).expect("room for a copy");
        Some(own)
    });
    if built.is_none() {
        eprintln!("skipped: Open MPI is not installed");
    }
    built.as_deref()
}

/// The program on `ranks` ranks, with arguments and a working directory.
fn ranks(count: usize, here: &Path, arguments: &[&str]) -> Option<Command> {
    let mut command = Command::new("mpirun");
    command
        .args(["--oversubscribe", "--bind-to", "none", "-n", &count.to_string()])
        .arg(program_of_ranks()?)
        .args(arguments)
        .current_dir(here)
        .env("XDG_RUNTIME_DIR", here)
        .env("OMPI_ALLOW_RUN_AS_ROOT", "1")
        .env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1");
    Some(command)
}

/// Runs it to its end.
fn answer(count: usize, here: &Path, arguments: &[&str]) -> Option<Answer> {
    let Output { status, stdout, stderr } = ranks(count, here, arguments)?.output().expect("mpirun starts");
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    Some(Answer { code: status.code(), out: text(stdout), err: text(stderr) })
}

#[test]
fn any_number_of_ranks_writes_the_run_of_one() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    assert_eq!(run(here, &tiny_and(&["--out", "whole"])).code, Some(0));
    let whole = Whole::of(&here.join("whole"));
    for count in [2, 3, 4] {
        let out = format!("ranks{count}");
        let Some(answer) = answer(count, here, &tiny_and(&["--out", &out])) else { return };
        assert_eq!(answer.code, Some(0), "{answer:?}");
        assert!(answer.err.contains(&format!("{count} ranks: a step sent")), "{}", answer.err);
        assert_eq!(whole.is_ended_by(&here.join(&out)), Ok(()), "{count} ranks");
    }
    // A run goes on with another number of ranks, and with one process.
    let stopped = [&tiny_and(&["--out", "parts"])[..], &["--stop-after", "7"]].concat();
    assert_eq!(answer(2, here, &stopped).unwrap().code, Some(0));
    assert_eq!(answer(3, here, &stopped).unwrap().code, Some(0));
    assert_eq!(run(here, &tiny_and(&["--out", "parts"])).code, Some(0));
    assert_eq!(whole.is_ended_by(&here.join("parts")), Ok(()));
    // What is finished is not done again.
    let again = answer(2, here, &tiny_and(&["--out", "parts"])).unwrap();
    assert_eq!(again.code, Some(0), "{again:?}");
}

#[test]
fn views_are_rendered_and_measured_by_all_ranks() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    assert_eq!(run(here, &tiny_and(&["--out", "run"])).code, Some(0));
    for (name, arguments) in [
        ("turntable", vec!["render", "run", "--turntable", "7", "--what", "color,depth"]),
        ("one view", vec!["render", "run", "--views", "0"]),
    ] {
        let [alone, together] = ["alone", "together"].map(|out| [&arguments[..], &["--out", out]].concat());
        assert_eq!(run(here, &alone).code, Some(0));
        let Some(answer) = answer(3, here, &together) else { return };
        assert_eq!(answer.code, Some(0), "{answer:?}");
        assert!(files(&here.join("alone")) == files(&here.join("together")), "{name}");
        assert_eq!(
            answer.out.lines().filter(|line| line.ends_with(".png")).count(),
            run(here, &[&alone[..], &["--fresh"]].concat()).out.lines().count(),
            "{name}: every picture is named once"
        );
        for out in ["alone", "together"] {
            std::fs::remove_dir_all(here.join(out)).unwrap();
        }
    }
    let numbers = |path: &str| {
        let text = std::fs::read_to_string(here.join(path)).unwrap();
        let mut report: serde_json::Value = serde_json::from_str(&text).unwrap();
        report["seconds"].take();
        report
    };
    assert_eq!(run(here, &["eval", "run", "--json", "alone.json"]).code, Some(0));
    let answer = answer(2, here, &["eval", "run", "--json", "together.json"]).unwrap();
    assert_eq!(answer.code, Some(0), "{answer:?}");
    assert_eq!(numbers("alone.json"), numbers("together.json"));
}

#[test]
fn runs_are_trained_by_all_ranks() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let bench = [
        &["bench", "--seeds", "2", "--vary", "optimizer.learning_rate=0.001|0.002", "--no-base"][..],
        &tiny(),
    ]
    .concat();
    assert_eq!(run(here, &[&bench[..], &["--out", "alone"]].concat()).code, Some(0));
    let Some(answer) = answer(2, here, &[&bench[..], &["--out", "together"]].concat()) else { return };
    assert_eq!(answer.code, Some(0), "{answer:?}");
    let models = |out: &str| {
        let mut models = files(&here.join(out));
        models.retain(|path, _| path.ends_with("model.safetensors"));
        models
    };
    assert_eq!(models("alone").len(), 4);
    assert!(models("alone") == models("together"), "the same models");
}

#[test]
fn wrong_input_is_one_error_for_all() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    for (arguments, part) in [
        (vec!["render", "nothing"], "nothing"),
        (vec!["train", "nothing", "--out", "run"], "nothing"),
        (tiny_and(&["--out", "run", "--set", "optimizer.learning_rate=-1"]), "optimizer.learning_rate"),
    ] {
        let Some(answer) = answer(2, here, &arguments) else { return };
        assert_eq!(answer.code, Some(2), "{answer:?}");
        let errors: Vec<_> = answer.err.lines().filter(|line| line.starts_with("error: ")).collect();
        assert!(errors.len() == 1 && errors[0].contains(part), "{arguments:?}: {}", answer.err);
    }
    assert!(files(here).is_empty(), "nothing was written");
}

#[test]
fn a_build_without_ranks_refuses_them() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = command(folder.path(), &tiny_and(&["--out", "run"]));
    let output = command.env("OMPI_COMM_WORLD_SIZE", "2").output().unwrap();
    let err = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{err}");
    assert!(err.contains("--features mpi"), "{err}");
    assert!(files(folder.path()).is_empty());
}

/// Process numbers of the ranks that an `mpirun` started.
fn ranks_of(mpirun: &Child) -> Vec<String> {
    let output = Command::new("pgrep").args(["-P", &mpirun.id().to_string()]).output().expect("pgrep");
    String::from_utf8_lossy(&output.stdout).lines().map(String::from).collect()
}

#[test]
fn a_rank_that_is_killed_ends_the_run_and_loses_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let more = [
        "--progress",
        "json",
        "--set",
        "train.checkpoint_seconds=0.001",
        "--set",
        "train.log_seconds=0.000001",
        "--out",
    ];
    let arguments = |out| tiny_and(&[&more[..], &[out]].concat());
    assert_eq!(run(here, &arguments("whole")).code, Some(0));
    let whole = Whole::of(&here.join("whole"));
    for trial in 0..8 {
        let Some(mut command) = ranks(2, here, &arguments("killed")) else { return };
        let mut mpirun = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut lines = BufReader::new(mpirun.stdout.take().unwrap()).lines().map_while(Result::ok);
        let sign = ["step", "checkpoint", "evaluation_progress", "plan"][trial % 4];
        lines.by_ref().find(|line| line.contains(&format!("\"kind\":\"{sign}\"")));
        std::thread::sleep(Duration::from_micros(300 * trial as u64));
        let pids = ranks_of(&mpirun);
        if let Some(pid) = pids.get(trial / 4) {
            let _ = Command::new("kill").args(["-9", pid]).stderr(Stdio::null()).status();
        }
        lines.for_each(drop);
        let code = mpirun.wait().unwrap().code();
        assert!(code != Some(0) || here.join("killed/report.html").exists(), "{sign}: {code:?}");
        if here.join("killed").exists() {
            assert_eq!(is_sound(&here.join("killed")), Ok(()), "{sign}, rank {}", trial / 4);
        }
        // With two ranks, or alone.
        let ended = if trial % 2 == 0 {
            answer(2, here, &arguments("killed")).unwrap().code
        } else {
            run(here, &arguments("killed")).code
        };
        assert_eq!(ended, Some(0));
        assert_eq!(whole.is_ended_by(&here.join("killed")), Ok(()), "{sign}, rank {}", trial / 4);
        std::fs::remove_dir_all(here.join("killed")).unwrap();
    }
}
