//! A run that is killed at any moment continues to the same end. The test kills the program at random moments of every
//! stage: before its first step, between steps, at a checkpoint, in an evaluation, after its last step, in its report.
//! The remaining files have to be whole, and the same command has to end with the bits, the curve and the files of an
//! uninterrupted run.
//!
//! This is a test instead of a script, because it builds the program, reads its files and names any difference. It tries a dozen
//! moments on the CPU; `TRIMIP_KILLS=100` tries a hundred on each backend and prints the stages in which the runs were killed:
//!
//!     TRIMIP_KILLS=100 cargo test -p trimip-tests --test program kills -- --nocapture

use std::{
    collections::BTreeMap,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Stdio},
    time::Duration,
};
use trimip_tests::{
    binary::{command, run, tiny_and},
    files::files,
    whole::{Whole, is_sound},
};

/// Number of moments if `TRIMIP_KILLS` is not set.
const FEW: usize = 12;

/// The stages of a run, named by the event before each; no event precedes the first.
const STAGES: [&str; 6] = ["", "step", "checkpoint", "evaluation_progress", "finished", "session_ended"];

/// Random numbers of a trial (splitmix64, Steele et al. 2014).
struct Random(u64);

impl Random {
    /// Returns a number below `bound`.
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ mixed >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ mixed >> 31) % bound
    }
}

/// Returns the arguments of every run: a checkpoint after almost every step, an event after each.
fn arguments(backend: &'static str) -> Vec<&'static str> {
    let more =
        ["--out", "run", "--progress", "json", "--set", backend, "--set", "train.checkpoint_seconds=0.001"];
    tiny_and(&[&more[..], &["--set", "train.log_seconds=0.000001", "--set", "eval.points=4"]].concat())
}

/// Ends the process with SIGKILL, as the system does when memory is short, or `gently` with SIGTERM, so that the program can save
/// first.
fn end(child: &mut Child, gently: bool) {
    if gently && cfg!(unix) {
        let mut kill = std::process::Command::new("kill");
        let sent = kill.arg(child.id().to_string()).stderr(Stdio::null()).status();
        assert!(sent.is_ok(), "there is a command `kill`");
    } else {
        // A failure to kill is ignored: the process may have ended.
        let _ = child.kill();
    }
}

/// Starts the command and ends it at a random moment after a random event of a stage. Returns the stage, or `ended` if the run
/// ended before that.
fn interrupt(
    here: &Path,
    arguments: &[&str],
    stage: &'static str,
    gently: bool,
    random: &mut Random,
) -> &'static str {
    let mut child = command(here, arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("the program starts");
    // Every bound is at most the number of such events in a run.
    let count = random.below(match stage {
        "step" => 20,
        "checkpoint" | "evaluation_progress" => 3,
        _ => 1,
    });
    let sign = format!("\"kind\":\"{stage}\"");
    let mut lines = BufReader::new(child.stdout.take().expect("a pipe")).lines().map_while(Result::ok);
    let met =
        stage.is_empty() || lines.by_ref().filter(|line| line.contains(&sign)).nth(count as usize).is_some();
    // Short delays are as frequent as long ones, because the work after an event may take one microsecond or many.
    let most = random.below(if stage.is_empty() { 17 } else { 13 });
    std::thread::sleep(Duration::from_micros(random.below(1 << most)));
    let running = child.try_wait().expect("a process").is_none();
    end(&mut child, gently);
    // A pipe that is not read would block the program while it saves.
    lines.for_each(drop);
    let code = child.wait().expect("a process").code();
    assert!(!gently || matches!(code, Some(0 | 130) | None), "a run that is stopped ends with {code:?}");
    match (met && running, stage) {
        (false, _) => "ended",
        (true, "") => "beginning",
        (true, stage) => stage,
    }
}

fn survives(backend: &'static str, moments: usize) {
    let temporary = tempfile::tempdir().unwrap();
    let arguments = arguments(backend);
    let undisturbed = temporary.path().join("undisturbed");
    std::fs::create_dir(&undisturbed).unwrap();
    assert_eq!(run(&undisturbed, &arguments).code, Some(0));
    let whole = Whole::of(&undisturbed.join("run"));
    let mut met: BTreeMap<&str, usize> = BTreeMap::new();
    let (mut half, mut trial) = (0, 0);
    // A run that ended before its signal was not killed.
    while met.iter().filter(|(stage, _)| **stage != "ended").map(|(_, count)| count).sum::<usize>() < moments
    {
        let mut random = Random(trial);
        let here = temporary.path().join(trial.to_string());
        std::fs::create_dir(&here).unwrap();
        // Every third run is interrupted again, in any stage.
        for again in 0..if trial % 3 == 2 { 2 } else { 1 } {
            let stage = STAGES[((trial + again * random.below(6)) % STAGES.len() as u64) as usize];
            let gently = random.below(4) == 0;
            *met.entry(interrupt(&here, &arguments, stage, gently, &mut random)).or_default() += 1;
            if here.join("run").exists() {
                let left = files(&here.join("run"));
                half += usize::from(left.keys().any(|name| name.to_string_lossy().ends_with(".tmp")));
                assert_eq!(is_sound(&here.join("run")), Ok(()), "{backend}, moment {trial}");
            }
        }
        let answer = run(&here, &arguments);
        assert_eq!((answer.code, answer.err.as_str()), (Some(0), ""), "{backend}, moment {trial}");
        assert_eq!(whole.is_ended_by(&here.join("run")), Ok(()), "{backend}, moment {trial}");
        std::fs::remove_dir_all(here).unwrap();
        trial += 1;
    }
    println!("{backend}, {trial} runs: {met:?}; {half} left a file half written");
}

#[test]
fn a_killed_run_goes_on_to_the_same_end() {
    let moments =
        std::env::var("TRIMIP_KILLS").ok().map(|text| text.parse().expect("TRIMIP_KILLS is a number"));
    survives("backend=cpu", moments.unwrap_or(FEW));
    let Some(moments) = moments else { return };
    if trimip_wgpu::adapters().is_empty() {
        println!("wgpu is skipped: this machine has no adapter");
        return;
    }
    survives("backend=wgpu", moments);
}
