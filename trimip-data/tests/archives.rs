//! Tests of scenes in zip archives: their views equal those of the packed folder, they are unpacked to the right place,
//! and bad archives are refused.

use crate::common::{
    assert_same, blender_scene,
    ring::{assert_cameras, cameras, pinhole},
    save_image, settings, write,
    zip::{DEFLATE, Entry, STORED, archive, packed},
};
use glam::DQuat;
use serde_json::json;
use std::{
    fs,
    path::{Path, PathBuf},
};
use tempfile::TempDir;
use trimip_data::{Scene, has_split, is_archive, open, open_test};

/// Returns a folder that holds a scene in its subfolder `scene`, and the files of the scene as entries.
fn scene() -> (TempDir, Vec<Entry>) {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("scene");
    fs::create_dir(&root).unwrap();
    blender_scene(&root);
    let entries = packed(&root, "");
    (folder, entries)
}

/// Returns the names of the files and folders in a folder.
fn names(folder: &Path) -> Vec<String> {
    let entries =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = entries.collect();
    names.sort();
    names
}

fn assert_same_scene(a: &Scene, b: &Scene) {
    assert_same(&a.train, &b.train);
    assert_eq!(a.test.len(), b.test.len());
    (0..a.test.len()).for_each(|i| assert_same(&a.test.load(i).unwrap(), &b.test.load(i).unwrap()));
    assert_eq!(a.stated, b.stated);
}

/// Returns the message with which an archive is refused. Checks that the archive leaves nothing behind.
fn refused(path: &Path) -> String {
    let before = names(path.parent().unwrap());
    let error = open(&settings(path, 1)).unwrap_err();
    assert!(error.kind() == trimip_core::ErrorKind::Input && !error.message().contains('\n'), "{error}");
    assert!(error.message().contains("; "), "nothing to do: {error}");
    assert_eq!(names(path.parent().unwrap()), before, "{error}");
    error.message()
}

#[test]
fn a_scene_in_an_archive_has_the_views_of_its_folder() {
    let (folder, entries) = scene();
    let here = folder.path();
    let whole = open(&settings(&here.join("scene"), 2)).unwrap();
    let stored = entries.iter().map(|entry| match entry.name.ends_with(b"/") {
        true => entry.clone(),
        false => {
            let path = here.join("scene").join(std::str::from_utf8(&entry.name).unwrap());
            Entry::stored(std::str::from_utf8(&entry.name).unwrap(), &fs::read(path).unwrap())
        }
    });
    // Files that macOS adds, and files next to a scene.
    let mac = [Entry::stored("__MACOSX/scene/._r_0.png", b"x"), Entry::stored("scene/.DS_Store", b"x")];
    let inner = [packed(&here.join("scene"), "scene/"), mac.to_vec()].concat();
    let deep = [packed(&here.join("scene"), "a b/c/"), vec![Entry::stored("read me.txt", b"x")]].concat();
    let mut windows = packed(&here.join("scene"), "export\\");
    windows
        .iter_mut()
        .for_each(|entry| entry.name.iter_mut().filter(|byte| **byte == b'/').for_each(|byte| *byte = b'\\'));
    for (name, entries, root) in [
        ("deflated.zip", entries.clone(), "deflated"),
        ("stored.ZIP", stored.collect(), "stored"),
        ("version 1.2.zip", inner, "version 1.2/scene"),
        ("deep.zip", deep, "deep/a b/c"),
        ("windows.zip", windows, "windows/export"),
        ("dots.r3d", packed(&here.join("scene"), "./"), "dots"),
    ] {
        let path = here.join(name);
        assert!(is_archive(&path), "{name}");
        fs::write(&path, archive(&entries)).unwrap();
        let config = settings(&path, 2);
        let scene = open(&config).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_same_scene(&scene, &whole);
        assert_eq!(scene.name, Path::new(root).file_name().unwrap().to_str().unwrap());
        assert!(here.join(root).join("transforms_train.json").is_file(), "{name}");
        let told = scene.unpacked.as_deref().unwrap();
        let stem = here.join(Path::new(root).components().next().unwrap());
        assert!(
            told.starts_with(&format!("{} is unpacked in {}: ", path.display(), stem.display())),
            "{told}"
        );
        assert!(scene.description.iter().any(|line| line == told), "{:?}", scene.description);
        // The archive is unpacked only once, so later changes to the folder stay.
        fs::write(here.join(root).join("mine.txt"), "mine").unwrap();
        let again = open(&config).unwrap();
        assert_same_scene(&again, &whole);
        assert_eq!(again.unpacked.as_deref(), Some(told));
        assert!(here.join(root).join("mine.txt").is_file());
        assert_eq!(open_test(&config).unwrap().frames.len(), 2);
        assert!(has_split(&config, "test").unwrap() && !has_split(&config, "val").unwrap());
    }
    assert!(names(here).iter().all(|name| !name.ends_with(".tmp")));
    assert!(
        !here.join("version 1.2/__MACOSX").exists() && !here.join("version 1.2/scene/.DS_Store").exists()
    );
    // The built-in scene needs no archive.
    let mut config = settings(&here.join("gone.zip"), 1);
    (config.format, config.builtin_size) = ("builtin".into(), 8);
    (config.builtin_train, config.builtin_test) = (2, 1);
    open(&config).unwrap();
}

#[test]
fn a_file_of_record3d_is_read_as_it_is() {
    let all = cameras(pinhole());
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let root = here.join("files");
    (0..9).for_each(|i| save_image(&root.join(format!("rgbd/{i}.png")), 60, 40));
    (0..9).for_each(|i| fs::write(root.join(format!("rgbd/{i}.depth")), b"bvx2").unwrap());
    let pose = |camera: &trimip_core::Camera| {
        let (q, o) = (DQuat::from_mat3(&camera.rotation), camera.origin);
        json!([q.x, q.y, q.z, q.w, o.x, o.y, o.z])
    };
    let poses: Vec<_> = all.iter().map(pose).collect();
    write(
        &root.join("metadata"),
        &json!({ "w": 60, "h": 40, "K": [51.5, 0, 0, 0, 52.5, 0, 29.0, 21.0, 1], "poses": poses }),
    );
    let path = here.join("walk.r3d");
    fs::write(&path, archive(&packed(&root, ""))).unwrap();
    for format in ["auto", "record3d"] {
        let mut config = settings(&path, 1);
        config.format = format.into();
        let scene = open(&config).unwrap();
        assert_cameras(&scene, &all);
        assert_same_scene(&scene, &open(&settings(&root, 1)).unwrap());
    }
    // With the format of another kind of scene, the archive is refused, and nothing of it is left.
    let mut config = settings(&path, 1);
    config.format = "polycam".into();
    fs::remove_dir_all(here.join("walk")).unwrap();
    let error = open(&config).unwrap_err();
    assert!(error.message().contains("holds no scene: looked for keyframes/cameras"), "{error}");
    assert_eq!(names(here), ["files", "walk.r3d"]);
}

#[test]
fn archives_that_are_broken_or_not_to_be_trusted_are_refused() {
    let (folder, whole) = scene();
    let here = folder.path();
    fs::remove_dir_all(here.join("scene")).unwrap();
    let path = here.join("a.zip");
    let place = format!("{}: ", path.display());
    let name = |name: &str| Entry::stored(name, b"x");
    let zeros = Entry::deflated("zeros.txt", &[0; 100_000]);
    let bytes = "x".repeat(3000);
    let deep = "d/".repeat(32) + "x.txt";
    let beyond =
        "leads out of the folder; if you trust it, unpack it with another program and name the folder";
    let table: Vec<(Entry, &str)> = vec![
        (name("../x.txt"), beyond),
        (name("a/../../x.txt"), beyond),
        (name("a/.. /x.txt"), beyond),
        (name("a\\..\\..\\x.txt"), beyond),
        (name("/etc/x.txt"), beyond),
        (name("\\\\server\\x.txt"), beyond),
        (name("C:\\x.txt"), beyond),
        (name("c:x.txt"), beyond),
        (name("../"), beyond),
        (name("../.hidden"), beyond),
        (name("a\nb.txt"), "name is not a valid file name"),
        (name("a\0.txt"), "name is not a valid file name"),
        (name(""), "a.zip: has an entry without a name"),
        (name("."), "name is not a valid file name"),
        (name(&deep), "lies in more than 31 folders"),
        (name("train/r_0.png"), "train/r_0.png: is in the archive twice"),
        (name("./train//r_0.png"), "train/r_0.png: is in the archive twice"),
        (name("train"), "train: is both a file and a folder"),
        (Entry { name: b"\xb2\xe2.txt".to_vec(), flags: 0, ..name("") }, "its name is not UTF-8"),
        (Entry { mode: 0o120_777, ..name("link.png") }, "link.png: is a symbolic link"),
        (Entry { flags: 1, ..name("x.txt") }, "x.txt: is encrypted; unpack it with its password"),
        (Entry { flags: 1, method: 99, ..name("x.txt") }, "x.txt: is encrypted"),
        (
            Entry { method: 14, ..name("x.txt") },
            "x.txt: is compressed by method 14 (LZMA), but only 8 (DEFLATE)",
        ),
        (Entry { method: 777, ..name("x.txt") }, "x.txt: is compressed by method 777 (UNKNOWN)"),
        (Entry { bytes: 70, ..zeros.clone() }, "zeros.txt: unpacks to more than the stated 70 bytes"),
        (Entry { bytes: 0, ..zeros.clone() }, "zeros.txt: unpacks to more than the stated 0 bytes"),
        (
            Entry { bytes: 100_001, ..zeros.clone() },
            "zeros.txt: is damaged: ends after 100000 of 100001 bytes",
        ),
        (Entry { checksum: 7, ..zeros.clone() }, "zeros.txt: is damaged: its checksum is wrong"),
        (Entry { packed_bytes: 40, ..zeros.clone() }, "zeros.txt: is damaged: "),
        (Entry { packed: vec![0xff; 40], packed_bytes: 40, ..zeros.clone() }, "zeros.txt: is damaged: "),
        (Entry { method: DEFLATE, ..name("x.txt") }, "x.txt: is damaged: "),
        (Entry { method: STORED, ..zeros.clone() }, "zeros.txt: is damaged: ends after"),
        (Entry { bytes: 2_000_000_000, ..zeros.clone() }, "states files of more than 1.1 GB, but has"),
        (Entry { packed_bytes: 2_000_000_000, ..Entry::stored("x.txt", bytes.as_bytes()) }, "x.txt: "),
    ];
    for (entry, what) in table {
        fs::write(&path, archive(&[&whole[..], &[entry]].concat())).unwrap();
        let message = refused(&path);
        assert!(message.starts_with(&place) && message.contains(what), "{what}: {message}");
    }
    let good = archive(&whole);
    let mut short = good.clone();
    let end = short.len();
    short[end - 14..end - 10].copy_from_slice(&[7, 0, 7, 0]);
    let half = [Entry::stored("x.txt", b"x")];
    for (bytes, what) in [
        (good[..good.len() - 1].to_vec(), "is no zip archive, or its end is missing; copy or download"),
        (good[..good.len() / 2].to_vec(), "is no zip archive, or its end is missing"),
        (b"<html>".to_vec(), "is no zip archive, or its end is missing"),
        (Vec::new(), "is no zip archive, or its end is missing"),
        // The beginning of the archive is missing.
        (good[500..].to_vec(), "is damaged: "),
        (short, "states 7 entries but lists"),
        (archive(&[]), "holds no file; name another archive, or the folder of a scene"),
        (archive(&[Entry::stored("a/", b"")]), "holds no file"),
        (archive(&half), "and found x.txt; name an archive or a folder with one of these files"),
    ] {
        fs::write(&path, bytes).unwrap();
        let message = refused(&path);
        assert!(message.starts_with(&place) && message.contains(what), "{what}: {message}");
    }
    fs::write(&path, good).unwrap();
    open(&settings(&path, 1)).unwrap();
}

#[test]
fn an_archive_without_a_scene_says_what_it_holds() {
    let (folder, _) = scene();
    let here = folder.path();
    let path = here.join("walk.zip");
    let file = |name: &str| Entry::stored(name, b"");
    let of = |names: &[&str]| names.iter().map(|name| file(name)).collect::<Vec<_>>();
    let root = here.join("scene");
    let several =
        [packed(&root, "set/lego/"), packed(&root, "set/chair/"), packed(&root, "set/ship/")].concat();
    for (entries, what) in [
        (
            of(&["images/0.jpg", "images/1.jpg"]),
            "; its 2 pictures need cameras, which this command finds: trimip-cli capture HERE/walk.zip",
        ),
        (of(&["images/0.jpg"]), "; its picture needs cameras"),
        (of(&["scan.mp4"]), "HERE/walk/scan.mp4 is a film"),
        (of(&["scan.mp4"]), "of its frames: trimip-cli capture HERE/walk.zip"),
        (of(&["0.cr2"]), "unpack it to HERE/walk: HERE/walk/0.cr2 is a camera's raw image"),
        (of(&["lego.zip"]), "unpack it to HERE/walk: name HERE/walk/lego.zip, which is then unpacked"),
        (of(&["a.tar.gz"]), "unpack it to HERE/walk: unpack HERE/walk/a.tar.gz, and name the folder in it"),
        (of(&["a.doc", "b/c.doc", "d.doc", "e.doc"]), "and found a.doc, b, d.doc and 1 more"),
        (
            several,
            "holds several scenes: HERE/walk/set/chair, HERE/walk/set/lego, …; unpack it and name one of them",
        ),
    ] {
        fs::write(&path, archive(&entries)).unwrap();
        let message = refused(&path).replace(here.to_str().unwrap(), "HERE");
        assert!(message.starts_with("HERE/walk.zip: holds ") && message.contains(what), "{what}: {message}");
    }
}

#[test]
fn folders_of_others_stay_as_they_are() {
    let (folder, entries) = scene();
    let here = folder.path();
    let [path, at, left] = ["a.zip", "a", "a.zip.tmp"].map(|name| here.join(name));
    fs::write(&path, archive(&entries)).unwrap();
    let expect = |what: &str| {
        let message = refused(&path);
        assert!(message.contains(what), "{what}: {message}");
    };
    // In place of the unpacked folder: an empty folder, a folder with a file, a folder with a scene, then with an
    // invalid mark too, and a file.
    fs::create_dir(&at).unwrap();
    expect("cannot be unpacked there; rename one of the two, or name ");
    fs::write(at.join("mine.txt"), "mine").unwrap();
    expect("was not made by this program");
    blender_scene(&at);
    expect("cannot be unpacked there; name ");
    fs::write(at.join(".unpacked.json"), "{}").unwrap();
    expect("already holds a scene, so ");
    assert!(at.join("mine.txt").is_file());
    fs::remove_dir_all(&at).unwrap();
    fs::write(&at, "mine").unwrap();
    expect("was not made by this program");
    fs::remove_file(&at).unwrap();
    // In place of the temporary folder.
    fs::create_dir(&left).unwrap();
    fs::write(left.join("mine.txt"), "mine").unwrap();
    expect("is in the way of unpacking");
    fs::remove_file(left.join("mine.txt")).unwrap();
    fs::remove_dir(&left).unwrap();
    fs::write(&left, "mine").unwrap();
    expect("is in the way of unpacking");
    fs::remove_file(&left).unwrap();
    // An archive with the name of another one that was unpacked.
    open(&settings(&path, 1)).unwrap();
    fs::write(here.join("a.r3d"), archive(&entries[1..])).unwrap();
    let message = refused(&here.join("a.r3d"));
    assert!(message.contains("/a: was unpacked from another archive (\"a.zip\"), not from "), "{message}");
    // An archive whose name is too long for the name of the temporary folder.
    let long = here.join("x".repeat(251) + ".zip");
    fs::copy(&path, &long).unwrap();
    let message = refused(&long);
    assert!(
        message.contains("cannot write") && message.contains("unpack it elsewhere and name the folder"),
        "{message}"
    );
}

#[cfg(unix)]
#[test]
fn links_are_not_followed() {
    use std::os::unix::fs::symlink;
    let (folder, entries) = scene();
    let here = folder.path();
    let (path, target) = (here.join("a.zip"), here.join("target"));
    fs::write(&path, archive(&entries)).unwrap();
    fs::create_dir(&target).unwrap();
    for (link, to, what) in [
        ("a", PathBuf::from("gone"), "was not made by this program"),
        ("a", target.clone(), "was not made by this program"),
        ("a.zip.tmp", target.clone(), "is in the way"),
    ] {
        symlink(to, here.join(link)).unwrap();
        assert!(refused(&path).contains(what), "{}", refused(&path));
        fs::remove_file(here.join(link)).unwrap();
    }
    assert!(names(&target).is_empty());
}

#[test]
fn what_a_killed_process_leaves_is_unpacked_again() {
    let (folder, entries) = scene();
    let here = folder.path();
    let whole = open(&settings(&here.join("scene"), 1)).unwrap();
    let [path, at, left] = ["a.zip", "a", "a.zip.tmp"].map(|name| here.join(name));
    fs::write(&path, archive(&entries)).unwrap();
    open(&settings(&path, 1)).unwrap();
    let mark = fs::read(at.join(".unpacked.json")).unwrap();
    // The process was killed before it wrote the mark, while it wrote the mark, and after some files.
    for (mark, files) in [(None, false), (Some(&mark[..9]), false), (Some(&mark[..]), true)] {
        fs::remove_dir_all(&at).unwrap();
        fs::create_dir_all(left.join("train")).unwrap();
        match files {
            true => fs::write(left.join("train/r_0.png"), "half").unwrap(),
            false => fs::remove_dir(left.join("train")).unwrap(),
        }
        mark.into_iter().for_each(|mark| fs::write(left.join(".unpacked.json"), mark).unwrap());
        assert_same_scene(&open(&settings(&path, 1)).unwrap(), &whole);
        assert!(at.is_dir() && !left.exists());
    }
}

#[test]
fn several_processes_unpack_an_archive_once() {
    let (folder, entries) = scene();
    let here = folder.path();
    let whole = open(&settings(&here.join("scene"), 1)).unwrap();
    for round in 0..10 {
        let path = here.join(format!("{round}.zip"));
        fs::write(&path, archive(&entries)).unwrap();
        std::thread::scope(|scope| {
            let opening: Vec<_> = (0..4).map(|_| scope.spawn(|| open(&settings(&path, 1)))).collect();
            opening.into_iter().for_each(|one| assert_same_scene(&one.join().unwrap().unwrap(), &whole));
        });
    }
    assert!(names(here).iter().all(|name| !name.ends_with(".tmp")));
}
