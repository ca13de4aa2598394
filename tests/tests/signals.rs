//! Checks of signals: a signal that was ignored when the program began stays ignored, and one that arrives before the first step
//! ends the program at once.

#![cfg(unix)]

use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
};
use trimip_tests::{
    binary::{command, program, tiny_and},
    files::files,
};

fn send(signal: &str, child: &Child) {
    let status = Command::new("kill").args([signal, &child.id().to_string()]).status();
    assert!(status.is_ok_and(|status| status.success()), "the process is there");
}

/// Sends SIGHUP to a run after its first step. Returns the run's exit code and its later events.
fn hang_up(mut command: Command) -> (Option<i32>, String) {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("it starts");
    let mut lines = BufReader::new(child.stdout.take().expect("a pipe")).lines().map_while(Result::ok);
    assert!(lines.by_ref().any(|line| line.contains("\"kind\":\"step\"")), "it trains");
    send("-HUP", &child);
    let rest: Vec<String> = lines.collect();
    (child.wait().expect("a process").code(), rest.join("\n"))
}

/// Restores the default action of SIGHUP. Tests that were started with `nohup` ignore SIGHUP, and so would the programs that they
/// start.
fn restore_hang_up() {
    use nix::sys::signal::{SigHandler, Signal, signal};
    // SAFETY: the default action installs no handler, so no code of ours runs inside a signal.
    unsafe { signal(Signal::SIGHUP, SigHandler::SigDfl) }.expect("a signal that can be set");
}

#[test]
fn a_hang_up_stops_a_run_unless_it_was_started_with_nohup() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let arguments = |out| {
        let long = ["train.steps=2000", "train.log_seconds=0.001", "eval.points=0"];
        let long: Vec<&str> = long.into_iter().flat_map(|setting| ["--set", setting]).collect();
        tiny_and(&[&long[..], &["--out", out]].concat())
    };
    restore_hang_up();
    let (code, events) = hang_up(command(here, &arguments("plain")));
    assert!(code == Some(130) && events.contains("\"stopped\""), "{code:?}: {events}");
    let mut nohup = Command::new("nohup");
    nohup.arg(program()).args(arguments("nohup")).current_dir(here).env("XDG_RUNTIME_DIR", here);
    let (code, events) = hang_up(nohup);
    assert!(
        code == Some(0) && events.contains("\"finished\"") && !events.contains("\"stopped\""),
        "{code:?}: {events}"
    );
}

/// Planning for a grid of 1024³ cells takes minutes. Nothing is lost if it is stopped, so the program does not wait for it.
#[test]
fn a_run_that_is_stopped_while_it_plans_ends_soon() {
    let folder = tempfile::tempdir().unwrap();
    let here: &Path = folder.path();
    let large = ["--set", "occupancy.resolution=1024", "--set", "plan.occupancy=off", "--out", "run"];
    let mut child =
        command(here, &tiny_and(&large)).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    while !here.join("run/run.lock").exists() {
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    std::thread::sleep(std::time::Duration::from_secs(1));
    assert_eq!(child.try_wait().unwrap(), None, "it plans");
    let stopped = std::time::Instant::now();
    send("-TERM", &child);
    assert_eq!(child.wait().unwrap().code(), Some(130));
    // Two seconds of grace, and the time that the system needs to take the memory back.
    assert!(stopped.elapsed().as_secs() < 20, "{:?}", stopped.elapsed());
}

#[test]
fn a_run_that_is_stopped_while_it_reads_ends_without_a_trace() {
    let folder = tempfile::tempdir().unwrap();
    let here: &Path = folder.path();
    // Rendering these photographs takes seconds on any machine.
    let large = ["data.builtin_size=256", "data.builtin_train=200", "data.builtin_supersampling=4"];
    let large: Vec<&str> = large.into_iter().flat_map(|setting| ["--set", setting]).collect();
    let arguments = tiny_and(&[&large[..], &["--out", "run"]].concat());
    let mut child = command(here, &arguments).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    while !here.join("run/run.lock").exists() {
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    send("-TERM", &child);
    let told = BufReader::new(child.stdout.take().unwrap()).lines().map_while(Result::ok).count();
    assert_eq!((child.wait().unwrap().code(), told), (Some(130), 0));
    assert!(files(here).is_empty(), "{:?}", files(here).keys());
}
