//! Passes the git commit of the repository or the package to the program, for its reports. Passes nothing if the commit is unknown.

use std::path::Path;
use std::process::Command;

/// File in which cargo records the repository's commit when it makes a package.
const PACKAGED: &str = ".cargo_vcs_info.json";

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let commit = if Path::new(PACKAGED).exists() { of_package() } else { of_repository() };
    if let Some(commit) = commit {
        println!("cargo::rustc-env=TRIMIP_COMMIT={commit}");
    }
}

/// Returns the commit recorded in a package, shortened to 10 digits as in [`of_repository`].
fn of_package() -> Option<String> {
    println!("cargo::rerun-if-changed={PACKAGED}");
    let note = std::fs::read_to_string(PACKAGED).ok()?;
    let (_, tail) = note.split_once("\"sha1\"")?;
    let hash = tail.split('"').nth(1)?;
    (hash.len() >= 10 && hash.bytes().all(|byte| byte.is_ascii_hexdigit())).then(|| hash[..10].into())
}

/// Returns the commit of the workspace's repository; `None` elsewhere, because a surrounding repository has unrelated commits.
fn of_repository() -> Option<String> {
    let repository = Path::new("../.git");
    if !repository.exists() || !Path::new("../trimip-core/Cargo.toml").exists() {
        return None;
    }
    // Rerun when a commit is made or a file is staged, which changes these files. A missing path would rerun the script on every build.
    for path in ["HEAD", "refs/heads", "packed-refs", "index"] {
        if repository.join(path).exists() {
            println!("cargo::rerun-if-changed=../.git/{path}");
        }
    }
    let described = Command::new("git").args(["describe", "--always", "--dirty=+", "--abbrev=10"]).output();
    let output = described.ok().filter(|output| output.status.success())?;
    Some(String::from_utf8_lossy(&output.stdout).trim().into())
}
