//! Checks of the program on several ranks, started by `mpirun`. Without Open MPI these tests are skipped with a message; with
//! `TRIMIP_REQUIRE_MPI=1` they fail instead.

use serde_json::Value;
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};
use trimip_tests::binary::{Answer, build, command, run, tiny, tiny_and};
use trimip_tests::files::files;
use trimip_tests::whole::{Whole, is_sound};

/// Builds the program with the feature `mpi`. If Open MPI is not installed, prints a line and returns `None`.
fn program_of_ranks() -> Option<&'static Path> {
    static PROGRAM: OnceLock<Option<PathBuf>> = OnceLock::new();
    let built = PROGRAM.get_or_init(|| {
        let has = |name: &str| Command::new(name).arg("--version").output().is_ok_and(|o| o.status.success());
        if !has("mpirun") || !has("mpicc") {
            assert!(std::env::var_os("TRIMIP_REQUIRE_MPI").is_none(), "Open MPI is not installed");
            return None;
        }
        Some(build("mpi", &["--features", "trimip-cli/mpi"]))
    });
    if built.is_none() {
        eprintln!("skipped: Open MPI is not installed");
    }
    built.as_deref()
}

/// Returns a command that runs the program on `count` ranks, with arguments and a working directory.
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

/// Runs the program on `count` ranks to its end.
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
        assert!(answer.err.contains(&format!("{count} ranks: rank 0 sent")), "{}", answer.err);
        assert_eq!(whole.is_ended_by(&here.join(&out)), Ok(()), "{count} ranks");
    }
    // A run can be continued with another number of ranks, and with one process.
    let stopped = [&tiny_and(&["--out", "parts"])[..], &["--stop-after", "7"]].concat();
    assert_eq!(answer(2, here, &stopped).unwrap().code, Some(0));
    assert_eq!(answer(3, here, &stopped).unwrap().code, Some(0));
    assert_eq!(run(here, &tiny_and(&["--out", "parts"])).code, Some(0));
    assert_eq!(whole.is_ended_by(&here.join("parts")), Ok(()));
    // The same command succeeds on a finished run.
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
        let mut report: Value = serde_json::from_str(&text).unwrap();
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
    let [alone, together] = ["alone", "together"].map(|out| models(&here.join(out)));
    assert_eq!(alone.len(), 4);
    assert!(alone == together, "the same models");
}

/// Returns the models below a folder, with their relative paths as keys.
fn models(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut models = files(folder);
    models.retain(|path, _| path.ends_with("model.safetensors"));
    models
}

/// Returns the value of the key `psnr` in each row of a table of a report.
fn qualities(report: &Path, table: &str) -> Vec<f64> {
    let report: Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
    let rows = report.pointer(table).and_then(Value::as_array).expect("a table");
    rows.iter().map(|row| row["psnr"].as_f64().expect("a number")).collect()
}

#[test]
fn systems_and_decisions_are_measured_by_all_ranks() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    assert_eq!(run(here, &[&["data", "builtin", "scene"], &tiny()[..]].concat()).code, Some(0));
    let on_files: Vec<&str> = tiny().into_iter().filter(|set| *set != "data.format=builtin").collect();
    let on_files: Vec<&str> = on_files[1..].to_vec();
    let paper = ["paper", "scene", "--systems", "tri-mip,tri-mip-paper", "--seeds", "2"];
    let plan = ["plan", "scene", "--measure", "--samples", "0.01", "--json"];
    for ranks in [1, 2] {
        let (paper_out, plan_out, json) = match ranks {
            1 => ("paper1", "plan1", "plan1.json"),
            _ => ("paper2", "plan2", "plan2.json"),
        };
        let jobs = [
            [&paper[..], &["--out", paper_out], &on_files].concat(),
            [&plan[..], &[json, "--out", plan_out], &on_files].concat(),
        ];
        for job in jobs {
            let done = if ranks == 1 { Some(run(here, &job)) } else { answer(ranks, here, &job) };
            let Some(done) = done else { return };
            assert_eq!(done.code, Some(0), "{done:?}");
        }
    }
    let [alone, together] = ["paper1", "paper2"].map(|out| models(&here.join(out)));
    assert!(alone.len() == 4 && alone == together, "{} models of systems", alone.len());
    let [alone, together] = ["plan1", "plan2"].map(|out| models(&here.join(out)));
    assert!(alone.len() > 2 && alone == together, "{} models of decisions", alone.len());
    for (alone, together, table) in [
        ("paper1/paper.json", "paper2/paper.json", "/tables/0/mean"),
        ("plan1.json", "plan2.json", "/effects"),
    ] {
        let [alone, together] = [alone, together].map(|report| qualities(&here.join(report), table));
        assert!(alone.len() > 1 && alone == together, "{alone:?} and {together:?}");
    }
}

#[test]
fn a_plan_counts_all_ranks() {
    let folder = tempfile::tempdir().unwrap();
    let budget = ["train.steps=0", "train.seconds=0.5", "plan.schedule=on", "threads=1"];
    let budget: Vec<&str> = budget.into_iter().flat_map(|setting| ["--set", setting]).collect();
    let arguments = [&tiny_and(&budget)[..], &["--progress", "json", "--out", "run"]].concat();
    let Some(answer) = answer(2, folder.path(), &arguments) else { return };
    assert_eq!(answer.code, Some(0), "{answer:?}");
    assert!(answer.out.contains("on 2 ranks, each 1 thread of"), "{}", answer.out);
}

#[test]
fn wrong_input_is_one_error_for_all() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    for (arguments, part) in [
        (vec!["render", "nothing"], "nothing"),
        (vec!["trian"], "trian"),
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
    for [rank, of] in [
        ["OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"],
        ["PMI_RANK", "PMI_SIZE"],
        ["PMIX_RANK", "SLURM_STEP_NUM_TASKS"],
    ] {
        for number in ["0", "1"] {
            let mut command = command(folder.path(), &tiny_and(&["--out", "run"]));
            let output = command.env(rank, number).env(of, "2").output().unwrap();
            let err = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(2), "{err}");
            // Only rank 0 prints the error.
            let told = err.contains("2 processes") && err.contains("--features mpi");
            assert!(if number == "0" { told } else { err.is_empty() }, "{err}");
            assert!(files(folder.path()).is_empty());
        }
    }
}

/// Returns the process numbers of the children of a process.
fn children(parent: &str) -> Vec<String> {
    let output = Command::new("pgrep").args(["-P", parent]).output().expect("pgrep");
    String::from_utf8_lossy(&output.stdout).lines().map(String::from).collect()
}

/// Returns the process numbers of the ranks that an `mpirun` started. Each rank is the child of the process that guards it.
fn ranks_of(mpirun: &Child) -> Vec<String> {
    children(&mpirun.id().to_string()).iter().flat_map(|guard| children(guard)).collect()
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
    let mut killed = 0;
    for trial in 0..8 {
        let Some(mut command) = ranks(2, here, &arguments("killed")) else { return };
        let mut mpirun = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(mpirun.stdout.take().unwrap()).lines().map_while(Result::ok);
        let (sign, rank) = (["step", "checkpoint", "evaluation_progress", "plan"][trial % 4], trial / 4);
        lines.by_ref().find(|line| line.contains(&format!("\"kind\":\"{sign}\"")));
        std::thread::sleep(Duration::from_micros(300 * trial as u64));
        let guard = children(&mpirun.id().to_string()).into_iter().nth(rank);
        if let Some(process) = guard.and_then(|guard| children(&guard).pop()) {
            let _ = Command::new("kill").args(["-9", &process]).stderr(Stdio::null()).status();
        }
        lines.for_each(drop);
        let Output { status, stderr, .. } = mpirun.wait_with_output().unwrap();
        let err = String::from_utf8_lossy(&stderr);
        if status.success() {
            assert!(here.join("killed/report.html").exists(), "it had ended: {err}");
        } else {
            killed += 1;
            assert_eq!(status.code(), Some(3), "{sign}: {err}");
            let told = format!("error: rank {rank} was killed");
            assert_eq!(err.lines().filter(|line| line.starts_with(&told)).count(), 1, "{sign}: {err}");
            assert_eq!(err.lines().filter(|line| line.starts_with("error: ")).count(), 1, "{sign}: {err}");
        }
        if here.join("killed").exists() {
            assert_eq!(is_sound(&here.join("killed")), Ok(()), "{sign}, rank {rank}");
        }
        // The run is resumed with two ranks, or with one process.
        let ended = if trial % 2 == 0 {
            answer(2, here, &arguments("killed")).unwrap().code
        } else {
            run(here, &arguments("killed")).code
        };
        assert_eq!(ended, Some(0));
        assert_eq!(whole.is_ended_by(&here.join("killed")), Ok(()), "{sign}, rank {rank}");
        std::fs::remove_dir_all(here.join("killed")).unwrap();
    }
    assert!(killed >= 4, "only {killed} of 8 were killed before their end");
}

/// Starts two ranks that train into `run` without end. Returns them after their first step, with the lines that they still
/// write.
fn endless(here: &Path) -> Option<(Child, impl Iterator<Item = String> + Send + use<>)> {
    let arguments = tiny_and(&["--progress", "json", "--set", "train.steps=10000000", "--out", "run"]);
    let mut command = ranks(2, here, &arguments)?;
    // Seconds between the signal that asks a rank to stop and the one that kills it.
    command.env("OMPI_MCA_odls_base_sigkill_timeout", "20");
    let mut mpirun = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let mut lines = BufReader::new(mpirun.stdout.take().unwrap()).lines().map_while(Result::ok);
    assert!(lines.by_ref().any(|line| line.contains("\"kind\":\"step\"")), "it trains");
    Some((mpirun, lines))
}

/// Returns true while a process exists and is no zombie.
fn lives(process: &str) -> bool {
    let output = Command::new("ps").args(["-o", "stat=", "-p", process]).output().expect("ps");
    let state = String::from_utf8_lossy(&output.stdout);
    !state.trim().is_empty() && !state.trim().starts_with('Z')
}

#[test]
fn nothing_outlives_its_launcher() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    for victim in ["a guard", "mpirun"] {
        let Some((mut mpirun, lines)) = endless(here) else { return };
        std::thread::spawn(move || lines.for_each(drop));
        let (guards, ranks) = (children(&mpirun.id().to_string()), ranks_of(&mpirun));
        assert_eq!((guards.len(), ranks.len()), (2, 2));
        let killed = match victim {
            "mpirun" => mpirun.id().to_string(),
            _ => guards[1].clone(),
        };
        assert!(Command::new("kill").args(["-9", &killed]).status().unwrap().success());
        let deadline = Instant::now() + Duration::from_secs(100);
        while mpirun.try_wait().unwrap().is_none()
            || guards.iter().chain(&ranks).any(|process| lives(process))
        {
            assert!(Instant::now() < deadline, "{victim} was killed, and a process lives on");
            std::thread::sleep(Duration::from_millis(20));
        }
        assert_ne!(mpirun.wait().unwrap().code(), Some(0));
    }
}

#[test]
fn an_interrupted_run_is_saved() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let Some((mut mpirun, lines)) = endless(here) else { return };
    assert!(Command::new("kill").args(["-INT", &mpirun.id().to_string()]).status().unwrap().success());
    let rest: Vec<String> = lines.collect();
    assert_ne!(mpirun.wait().unwrap().code(), Some(0));
    assert!(rest.iter().any(|line| line.contains("\"kind\":\"stopped\"")), "{rest:?}");
    assert!(here.join("run/checkpoint.safetensors").exists());
    assert_eq!(is_sound(&here.join("run")), Ok(()));
}

/// A guard passes signals on to its rank, because some launchers signal only the processes that they started.
#[test]
fn a_guard_passes_a_stop_on() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let Some((mut mpirun, lines)) = endless(here) else { return };
    for guard in children(&mpirun.id().to_string()) {
        assert!(Command::new("kill").args(["-TERM", &guard]).status().unwrap().success());
    }
    let rest: Vec<String> = lines.collect();
    assert_eq!(mpirun.wait().unwrap().code(), Some(130));
    assert!(rest.iter().any(|line| line.contains("\"kind\":\"stopped\"")), "{rest:?}");
    assert_eq!(is_sound(&here.join("run")), Ok(()));
}

/// Rank 0's arguments count on every rank; other ones are not ignored in silence.
#[test]
fn other_arguments_of_a_rank_are_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let started = |own: &[&str], other: &[&str]| {
        let mut command = ranks(1, here, own)?;
        command.args([":", "-n", "1"]).arg(program_of_ranks()?).args(other);
        let Output { status, stderr, .. } = command.output().expect("mpirun starts");
        let err = String::from_utf8_lossy(&stderr).into_owned();
        assert_eq!(status.code(), Some(0), "{err}");
        Some(err)
    };
    let [one, two] = ["1", "2"].map(|seed| format!("seed={seed}"));
    let own = tiny_and(&["--out", "run", "--fresh", "--set", &one]);
    let other = tiny_and(&["--out", "run", "--fresh", "--set", &two]);
    let Some(err) = started(&own, &own) else { return };
    assert!(!err.contains("rank 1"), "{err}");
    let err = started(&own, &other).expect("as before");
    assert!(
        err.contains("rank 1") && err.contains("seed=2") && err.contains("those of rank 0 count"),
        "{err}"
    );
}

/// Two ranks with separate working directories are refused if they find different files under the same paths.
#[test]
fn ranks_with_other_photographs_or_models_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = ["a", "b"].map(|name| folder.path().join(name));
    let on_files: Vec<&str> = tiny().into_iter().filter(|word| *word != "data.format=builtin").collect();
    // The first word is the `--set` of the format.
    let on_files = &on_files[1..];
    for (here, seed) in here.iter().zip(["seed=1", "seed=2"]) {
        std::fs::create_dir(here).unwrap();
        assert_eq!(run(here, &[&["data", "builtin", "scene"], &tiny()[..]].concat()).code, Some(0));
        let train = [&["train", "scene", "--out", "run", "--set", seed], on_files].concat();
        assert_eq!(run(here, &train).code, Some(0));
    }
    let [a, b] = &here;
    let photographs = b.join("scene/train");
    std::fs::copy(photographs.join("r_1.png"), photographs.join("r_0.png")).unwrap();
    let out = folder.path().join("out").display().to_string();
    let bench = ["bench", "--set", "data.root=scene", "--seeds", "4", "--out", &out];
    let renders = folder.path().join("renders").display().to_string();
    for (arguments, part) in [
        (vec!["eval", "run"], "not those of rank 0"),
        (vec!["render", "run", "--turntable", "3", "--out", &renders], "not those of rank 0"),
        (
            [&["train", "scene", "--out", &out], on_files].concat(),
            "holds other photographs than rank 0: other pixels",
        ),
        ([&bench[..], on_files].concat(), "was trained on other photographs than"),
    ] {
        let Some(mut command) = ranks(1, a, &arguments) else { return };
        let program = program_of_ranks().expect("it is there");
        command.args([":", "-n", "1", "--wdir"]).arg(b).arg(program).args(&arguments);
        let Output { status, stderr, .. } = command.output().expect("mpirun starts");
        let err = String::from_utf8_lossy(&stderr);
        assert!(status.code() == Some(2) && err.contains(part), "{arguments:?}: {status} {err}");
    }
}
