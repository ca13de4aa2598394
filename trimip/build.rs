//! Passes the commit to the program, for the reports. Without git it passes nothing.

use std::path::Path;
use std::process::Command;

fn main() {
    let repository = Path::new("../.git");
    println!("cargo::rerun-if-changed=build.rs");
    // Inside another repository, that repository's commit would be wrong.
    if !repository.exists() {
        return;
    }
    // Files that change when a commit is made or a file is staged. A missing path would rerun the script always.
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
