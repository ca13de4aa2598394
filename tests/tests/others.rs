//! Checks that no verb replaces a file that the user does not expect it to replace.

use std::{fs, path::Path};
use trimip_tests::{
    binary::{refuses, run, tiny, tiny_and},
    files::files,
};

fn done(here: &Path, arguments: &[&str]) {
    let answer = run(here, arguments);
    assert_eq!(answer.code, Some(0), "{arguments:?}: {}", answer.err);
}

#[test]
fn pictures_do_not_replace_those_of_others() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    done(here, &tiny_and(&["--out", "run"]));
    for name in ["cameras.json", "0000_r_0_color.png", "0000_r_0_depth.png"] {
        let out = here.join("mine");
        fs::create_dir(&out).unwrap();
        fs::write(out.join(name), "{\"frames\": []}").unwrap();
        refuses(here, &["render", "run", "--what", "color,depth", "--out", "mine"], &[name, "--out"]);
        fs::remove_dir_all(out).unwrap();
    }
    // `render` does not replace the cameras of a run's photographs either, whose file has the same name.
    let cameras = fs::read(here.join("run/cameras.json")).unwrap();
    refuses(here, &["render", "run", "--out", "run"], &["cameras.json", "--out"]);
    assert_eq!(fs::read(here.join("run/cameras.json")).unwrap(), cameras);
    // `render` replaces its own pictures.
    (0..2).for_each(|_| done(here, &["render", "run", "--out", "mine"]));
}

#[test]
fn a_file_of_another_kind_is_no_place_for_a_page() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    done(here, &tiny_and(&["--out", "run"]));
    fs::copy(here.join("run/error_vs_time.csv"), here.join("peer.csv")).unwrap();
    for option in ["--html", "--svg", "--json"] {
        refuses(here, &["compare", "run", option, "peer.csv"], &["peer.csv", option]);
    }
    refuses(here, &["eval", "run", "--json", "peer.csv"], &["peer.csv", ".json"]);
    refuses(here, &["bake", "run", "--out", "peer.csv"], &["peer.csv", ".safetensors"]);
}

#[test]
fn a_written_set_replaces_nothing_and_one_that_was_stopped_is_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let builtin = [&["data", "builtin", "scene"][..], &tiny()].concat();
    done(here, &builtin);
    let whole = files(here);
    refuses(here, &builtin, &["scene", "exists already"]);
    // The folder contains a foreign picture, but no data set.
    fs::remove_file(here.join("scene/transforms_train.json")).unwrap();
    fs::write(here.join("scene/train/r_1.png"), "mine").unwrap();
    refuses(here, &builtin, &["train/r_1.png"]);
    fs::remove_file(here.join("scene/train/r_1.png")).unwrap();
    // An interrupted set is completed, however much of it was written: the files that are written last are missing, and
    // one is half written.
    let order = ["test/r_1.png", "transforms_test.json", "transforms_train.json"];
    for missing in 0..order.len() {
        for name in order[missing..].iter().chain(&["transforms_train.json"]) {
            let _ = fs::remove_file(here.join("scene").join(name));
        }
        fs::write(here.join("scene/transforms_train.json.trimip.tmp"), "{").unwrap();
        done(here, &builtin);
        assert!(files(here) == whole, "without {}", order[missing]);
    }
    // A set written into the folder of its source would hide the source.
    refuses(here, &["data", "multiscale", "scene", "--root", "scene"], &["scene", "exists already"]);
    refuses(here, &["data", "multiscale", "./scene/../scene", "--root", "scene"], &["exists already"]);
    done(here, &["data", "multiscale", "levels", "--root", "scene"]);
    refuses(here, &[&["data", "builtin", "levels"][..], &tiny()].concat(), &["levels", "exists already"]);
    fs::remove_file(here.join("levels/metadata.json")).unwrap();
    done(here, &["data", "multiscale", "levels", "--root", "scene"]);
}
