//! Tells the program which commit it is built from, for the figures it reports. Without git it is told nothing.

use std::path::Path;
use std::process::Command;

fn main() {
    let repository = Path::new("../.git");
    println!("cargo::rerun-if-changed=build.rs");
    // Unpacked inside of somebody else's repository, that one's commit would be a wrong answer.
    if !repository.exists() {
        return;
    }
    // Whatever moves when a commit is made or a file is staged; a path that is not there would mean "always".
    for path in ["HEAD", "refs/heads", "packed-refs", "index"] {
        if repository.join(path).exists() {
            println!("cargo::rerun-if-changed=../.git/{path}");
        }
    }
    let described = Command::new("git").args(["describe", "--always", "--dirty=+", "--abbrev=10"]).output();
    if let Some(output) = described.ok().filter(|output| output.status.success()) {
        println!("cargo::rustc-env=TRIMIP_COMMIT={}", String::from_utf8_lossy(&output.stdout).trim());
    }
}
