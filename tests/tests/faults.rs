//! Checks of failing disks: full, read-only, or with missing data. The program reports the failure in one line and keeps its
//! results. Once the disk works again, the same command ends as if nothing had failed.

use std::{
    fs,
    path::Path,
    process::{Command, Stdio},
};
use trimip_tests::{
    binary::{Answer, command, program, run, tiny, tiny_and},
    files::{copy, files},
    whole::{Whole, is_sound},
};

/// Runs a shell script in its own mount namespace, with the program as `$0` and `arguments` as `$@`; the mounts end with the
/// script. If the system does not allow that, prints a line and returns `None`.
fn mounted(here: &Path, script: &str, arguments: &[&str]) -> Option<Answer> {
    let shell = |script: &str, arguments: &[&str]| {
        let mut shell = Command::new("unshare");
        shell.args(["--map-root-user", "--mount", "sh", "-c", script]).arg(program()).args(arguments);
        shell.current_dir(here).env("XDG_RUNTIME_DIR", here).output()
    };
    let probe = shell("mount -t tmpfs none . && mount --bind -o ro . .", &[]);
    if !probe.is_ok_and(|output| output.status.success()) {
        println!("skipped: this system lets no test mount a file system");
        return None;
    }
    let output = shell(script, arguments).expect("a shell");
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    Some(Answer { code: output.status.code(), out: text(output.stdout), err: text(output.stderr) })
}

/// Writes the built-in scene to `scene`; returns the arguments that train on it.
fn scene(here: &Path) -> Vec<&'static str> {
    let answer = run(here, &[&["data", "builtin", "scene"][..], &tiny()].concat());
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    tiny_and(&["--out", "run", "--set", "data.format=auto", "--set", "data.root=scene"])
}

/// Returns the total size of the files in a folder, in bytes.
fn size(folder: &Path) -> usize {
    files(folder).values().map(Vec::len).sum()
}

#[test]
fn a_disk_that_is_full_anywhere_costs_nothing_once_it_has_room() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let checkpoints = ["--set", "train.checkpoint_seconds=0.001", "--out"];
    let arguments = |out| tiny_and(&[&checkpoints[..], &[out]].concat());
    assert_eq!(run(here, &arguments("whole")).code, Some(0));
    let whole = Whole::of(&here.join("whole"));
    fs::create_dir(here.join("disk")).unwrap();
    // Number of 4 KiB blocks for the files, and for the `.tmp` files that are written before a rename.
    let needed = size(&here.join("whole")) * 3 / 2 / 4096;
    let mut failed = 0;
    for twentieth in 1..=20 {
        let script = format!(
            "mount -t tmpfs -o size={}k none disk && \"$0\" \"$@\" >/dev/null; code=$?; \
             mount -o remount,size=64m disk && cp -r disk/run full && \
             {{ \"$0\" \"$@\" || \"$0\" \"$@\" --fresh; }} >/dev/null 2>&1 && cp -r disk/run well; exit $code",
            4 * (needed * twentieth / 20).max(1)
        );
        let Some(answer) = mounted(here, &script, &arguments("disk/run")) else { return };
        if answer.code != Some(0) {
            failed += 1;
            answer.expect_error(2, &[]);
        } else {
            assert_eq!(answer.err, "");
        }
        assert_eq!(is_sound(&here.join("full")), Ok(()), "{twentieth}/20 of the room: {}", answer.err);
        // If no checkpoint ever had room, only the model is kept, and no run continues from it.
        let kept = |name: &str| fs::read(here.join("full").join(name)).ok();
        if let Some(model) = kept("model.safetensors").filter(|_| kept("checkpoint.safetensors").is_none()) {
            assert!(
                Some(model) == fs::read(here.join("whole/model.safetensors")).ok(),
                "it is the model of the run"
            );
        }
        assert_eq!(
            whole.is_ended_by(&here.join("well")),
            Ok(()),
            "{twentieth}/20 of the room: {}",
            answer.err
        );
        fs::remove_dir_all(here.join("full")).unwrap();
        fs::remove_dir_all(here.join("well")).unwrap();
    }
    println!("20 disks, {failed} of them too small");
    assert!(failed >= 5, "only {failed} of these disks were too small");
}

#[test]
fn a_disk_that_cannot_be_written_is_refused_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    assert_eq!(run(here, &tiny_and(&["--out", "disk/run", "--stop-after", "5"])).code, Some(0));
    let before = files(here);
    let (again, new) = (tiny_and(&["--out", "disk/run"]), tiny_and(&["--out", "disk/new"]));
    let data = [&["data", "builtin", "disk/scene"][..], &tiny()].concat();
    let render = ["render", "disk/run", "--turntable", "1", "--out", "disk/pictures"];
    for arguments in [&again[..], &new, &data, &render, &["bake", "disk/run"]] {
        let script = "mount --bind disk disk && mount -o remount,bind,ro disk && exec \"$0\" \"$@\"";
        let Some(answer) = mounted(here, script, arguments) else { return };
        answer.expect_error(2, &["disk"]);
        assert!(files(here) == before, "{arguments:?}");
    }
    assert_eq!(run(here, &again).code, Some(0));
}

#[test]
fn data_that_vanish_cost_neither_steps_nor_points() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let arguments = scene(here);
    assert_eq!(run(here, &arguments).code, Some(0));
    let whole = Whole::of(&here.join("run"));
    copy(&here.join("scene"), &here.join("kept"));
    let stop = [&arguments[..], &["--stop-after", "10"]].concat();
    type Break = fn(&Path);
    let torn: Break = |scene| {
        let path = scene.join("test/r_1.png");
        let bytes = fs::read(&path).unwrap();
        fs::write(path, &bytes[..bytes.len() - 20]).unwrap();
    };
    // The evaluation finds the photograph that is torn after its header; opening the scene finds the other faults.
    let breaks: [(&str, Break, i32); 4] = [
        ("r_1", torn, 2),
        ("r_1", |scene| fs::remove_file(scene.join("test/r_1.png")).unwrap(), 2),
        ("r_2", |scene| fs::remove_file(scene.join("train/r_2.png")).unwrap(), 2),
        ("scene", |scene| fs::remove_dir_all(scene).unwrap(), 2),
    ];
    for (named, breaking, code) in breaks {
        // The data vanish before the first point of the curve, or before the last.
        for first in [&arguments, &stop] {
            fs::remove_dir_all(here.join("run")).unwrap();
            if first.len() > arguments.len() {
                assert_eq!(run(here, first).code, Some(0));
            }
            breaking(&here.join("scene"));
            run(here, &arguments).expect_error(code, &[named]);
            if here.join("scene").exists() {
                fs::remove_dir_all(here.join("scene")).unwrap();
            }
            copy(&here.join("kept"), &here.join("scene"));
            assert_eq!(run(here, &arguments).code, Some(0));
            assert_eq!(whole.is_ended_by(&here.join("run")), Ok(()), "{named}");
            fs::create_dir_all(here.join("run")).unwrap();
        }
    }
}

#[test]
fn a_run_goes_on_with_its_own_photographs_alone() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let arguments = scene(here);
    let stop = [&arguments[..], &["--stop-after", "10"]].concat();
    assert_eq!(run(here, &stop).code, Some(0));
    copy(&here.join("scene"), &here.join("moved"));
    fs::copy(here.join("scene/train/r_1.png"), here.join("scene/train/r_2.png")).unwrap();
    let before = files(here);
    run(here, &arguments).expect_error(2, &["photographs", "pixels", "--fresh", "--out"]);
    let poses = here.join("scene/transforms_train.json");
    let text = fs::read_to_string(&poses).unwrap();
    assert!(files(here) == before, "nothing is touched");
    fs::copy(here.join("moved/train/r_2.png"), here.join("scene/train/r_2.png")).unwrap();
    fs::write(&poses, text.replacen("\"camera_angle_x\":0.", "\"camera_angle_x\":0.1", 1)).unwrap();
    run(here, &arguments).expect_error(2, &["photographs", "cameras"]);
    // The same photographs in another folder are accepted.
    let elsewhere = [&arguments[..], &["--set", "data.root=moved"]].concat();
    assert_eq!(run(here, &elsewhere).code, Some(0));
}

#[cfg(target_os = "linux")]
#[test]
fn what_cannot_be_printed_is_an_error_and_what_nobody_reads_is_none() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let training = tiny_and(&["--out", "run"]);
    assert_eq!(run(here, &training).code, Some(0));
    let whole = Whole::of(&here.join("run"));
    fs::remove_dir_all(here.join("run")).unwrap();
    let plan = [&["plan"][..], &tiny()].concat();
    for arguments in [
        &["config"][..],
        &["config", "--defaults"],
        &["--help"],
        &["--version"],
        &["doctor"],
        &plan,
        &training,
    ] {
        let full = fs::File::options().write(true).open("/dev/full").unwrap();
        let output = command(here, arguments).stdout(full).output().unwrap();
        let err = String::from_utf8_lossy(&output.stderr).into_owned();
        Answer { code: output.status.code(), out: String::new(), err }.expect_error(2, &["standard output"]);
        // The reader of the output is gone.
        let mut child = command(here, arguments).stdout(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        assert_eq!(child.wait().unwrap().code(), Some(0), "{arguments:?}");
    }
    assert_eq!(whole.is_ended_by(&here.join("run")), Ok(()), "the run is none the worse");
}
