//! Builds the program once and runs it as a user does, on the smallest useful scene and model.

use crate::files::files;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Mutex, OnceLock, PoisonError};

/// Output and exit code of a process.
#[derive(Debug)]
pub struct Answer {
    /// Exit code; `None` if a signal ended the process.
    pub code: Option<i32>,
    /// Standard output.
    pub out: String,
    /// Standard error.
    pub err: String,
}

impl Answer {
    /// Asserts exit code `code` and an error message of one line that contains all `parts`.
    ///
    /// # Panics
    /// If the exit code or the message differs.
    #[track_caller]
    pub fn expect_error(&self, code: i32, parts: &[&str]) {
        assert_eq!(self.code, Some(code), "{self:?}");
        let is_line = self.err.starts_with("error: ") && self.err.trim_end().lines().count() == 1;
        assert!(is_line, "{}", self.err);
        for part in parts {
            assert!(self.err.contains(part), "no `{part}` in {}", self.err);
        }
    }
}

/// Asserts that the program fails with an error message of one line that contains all `parts`, and that it changes, removes and
/// writes no file.
///
/// # Panics
/// If the program does anything else.
#[track_caller]
pub fn refuses(folder: &Path, arguments: &[&str], parts: &[&str]) {
    let before = files(folder);
    run(folder, arguments).expect_error(2, parts);
    let after = files(folder);
    for (path, bytes) in &before {
        assert!(after.get(path) == Some(bytes), "{arguments:?}: {} was changed", path.display());
    }
    let grown: Vec<_> = after.keys().filter(|path| !before.contains_key(*path)).collect();
    assert!(grown.is_empty(), "{arguments:?}: wrote {grown:?}");
}

/// Returns the path of `trimip-cli`, built in the profile and the target folder of the running test.
///
/// # Panics
/// If the program does not build.
pub fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| build("plain", &[]))
}

/// Returns the folder of the build outputs for the profile of the running test.
fn built() -> PathBuf {
    // <target>/<profile>/deps/<test>
    let test = std::env::current_exe().expect("a test knows its own path");
    test.ancestors().nth(2).expect("tests lie in <profile>/deps").into()
}

/// Returns the target folder of the running test.
///
/// # Panics
/// If the test does not lie in a target folder.
pub fn target() -> PathBuf {
    built().parent().expect("profiles lie in a target folder").into()
}

/// Returns the profile of the running test.
pub fn profile() -> String {
    match built().file_name().and_then(|name| name.to_str()) {
        Some("debug") | None => "dev".into(),
        Some(profile) => profile.into(),
    }
}

/// Builds `trimip-cli` with additional arguments for cargo. Returns a separate path for each `name`, because the next build with
/// other arguments replaces the file that cargo writes.
///
/// # Panics
/// If the program does not build.
pub fn build(name: &str, arguments: &[&str]) -> PathBuf {
    static BUILDING: Mutex<()> = Mutex::new(());
    let _building = BUILDING.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = built();
    // An example is built too, so that cargo selects the same features for the dependencies as for the tests, and compiles
    // nothing twice.
    let built = Command::new(env!("CARGO"))
        .args(["build", "--quiet", "--locked", "--workspace", "--bin", "trimip-cli", "--example", "corpus"])
        .args(["--profile", &profile(), "--target-dir"])
        .arg(target())
        .args(arguments)
        .current_dir(root())
        .status();
    assert!(built.is_ok_and(|status| status.success()), "cargo builds trimip-cli");
    let built = folder.join("trimip-cli").with_extension(std::env::consts::EXE_EXTENSION);
    let own = folder.join("tested").join(name);
    std::fs::create_dir_all(&own).expect("the target folder can be written");
    let own = own.join(built.file_name().expect("a program has a name"));
    let _ = std::fs::remove_file(&own);
    // A hard link is safe: cargo replaces a built program and never changes it in place.
    std::fs::hard_link(&built, &own)
        .or_else(|_| std::fs::copy(&built, &own).map(drop))
        .expect("room for a copy of the program");
    own
}

/// Returns the root of the workspace.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Returns the command that runs the program with arguments in a working directory.
pub fn command(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(program());
    // Without this variable, a software Vulkan driver writes to standard error.
    command.args(arguments).current_dir(folder).env("XDG_RUNTIME_DIR", folder);
    command
}

/// Runs the program to its end and asserts that it does not panic.
///
/// # Panics
/// If the program cannot be started, or if it panicked.
pub fn run(folder: &Path, arguments: &[&str]) -> Answer {
    let Output { status, stdout, stderr } = command(folder, arguments).output().expect("the program starts");
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    let answer = Answer { code: status.code(), out: text(stdout), err: text(stderr) };
    for sign in ["panicked", "RUST_BACKTRACE", "internal error"] {
        assert!(!answer.err.contains(sign) && !answer.out.contains(sign), "{arguments:?}: {answer:?}");
    }
    answer
}

/// Returns the settings of a run that takes a tenth of a second: the built-in scene at 16 pixels, 20 steps.
pub fn tiny() -> Vec<&'static str> {
    [
        "data.format=builtin",
        "data.builtin_size=16",
        "data.builtin_train=4",
        "data.builtin_test=2",
        "data.builtin_supersampling=2",
        "data.scales=2",
        "encoder.plane_size=16",
        "encoder.levels=3",
        "field.hidden=16",
        "occupancy.resolution=16",
        "renderer.steps_per_diagonal=64",
        "train.samples_per_step=512",
        "train.steps=20",
        "eval.points=2",
        "eval.stride=1",
        "eval.time_fraction=0",
        "eval.min_gain=0",
        "plan.detail=off",
        "plan.schedule=off",
        "threads=2",
    ]
    .into_iter()
    .flat_map(|setting| ["--set", setting])
    .collect()
}

/// Returns [`tiny`] with additional arguments.
pub fn tiny_and<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&tiny()[..], more].concat()
}
