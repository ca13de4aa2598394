//! Fuzz tests: a scene on disk with one file changed at random either opens or gives an input error that names a file.
//! `TRIMIP_FUZZ_CASES` is the number of cases of each test. `tests/tests/formats.rs` tests the readers on bytes in memory.

use crate::common::{
    blender_scene,
    colmap::capture,
    frame, save_image, settings, write,
    zip::{archive, packed},
};
use proptest::{prelude::*, sample::Index, test_runner::TestRunner};
use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_core::{Error, ErrorKind};
use trimip_data::{open, unwatched, write_multiscale};

/// A change of a file.
#[derive(Clone, Debug)]
enum Edit {
    Flip(Index, u8),
    Truncate(Index),
    Remove(Index, usize),
    /// Overwrites bytes with a text or the bytes of a number.
    Put(Index, Vec<u8>),
    /// Like `Put`, but replaces a word or a line.
    Word(Index, Vec<u8>),
    Line(Index, Vec<u8>),
    Double(Index, usize),
}

fn edits() -> impl Strategy<Value = Vec<Edit>> {
    let words = [
        "nan",
        "-inf",
        "1e999",
        "0",
        "-1",
        "18446744073709551615",
        "4294967296",
        "x",
        "",
        "#",
        "\"",
        "[",
        "é",
    ];
    let numbers =
        [f64::NAN.to_bits(), f64::INFINITY.to_bits(), 0, 1, 1 << 32, 1 << 62, u64::MAX, 1e300_f64.to_bits()];
    let texts: Vec<Vec<u8>> = words.iter().map(|word| word.as_bytes().to_vec()).collect();
    let all: Vec<Vec<u8>> = texts.iter().cloned().chain(numbers.map(|n| n.to_le_bytes().to_vec())).collect();
    let at = any::<Index>;
    let edit = prop_oneof![
        (at(), 0..8_u8).prop_map(|(at, bit)| Edit::Flip(at, bit)),
        at().prop_map(Edit::Truncate),
        (at(), 1..40_usize).prop_map(|(at, length)| Edit::Remove(at, length)),
        (at(), prop::sample::select(all)).prop_map(|(at, bytes)| Edit::Put(at, bytes)),
        (at(), prop::sample::select(texts.clone())).prop_map(|(at, bytes)| Edit::Word(at, bytes)),
        (at(), prop::sample::select(texts)).prop_map(|(at, bytes)| Edit::Line(at, bytes)),
        (at(), 1..200_usize).prop_map(|(at, length)| Edit::Double(at, length)),
    ];
    prop::collection::vec(edit, 1..4)
}

fn edited(bytes: &[u8], edits: &[Edit]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for edit in edits {
        if bytes.is_empty() {
            break;
        }
        let end = bytes.len();
        let instead = |bytes: &mut Vec<u8>, at: usize, with: &[u8], ends: fn(u8) -> bool| {
            let start = bytes[..at].iter().rposition(|&byte| ends(byte)).map_or(0, |before| before + 1);
            let stop = bytes[at..].iter().position(|&byte| ends(byte)).map_or(end, |length| at + length);
            bytes.splice(start..stop.max(start), with.iter().copied());
        };
        match edit {
            Edit::Flip(at, bit) => bytes[at.index(end)] ^= 1 << bit,
            Edit::Truncate(at) => bytes.truncate(at.index(end)),
            Edit::Remove(at, length) => {
                let at = at.index(end);
                bytes.drain(at..(at + length).min(end));
            }
            Edit::Put(at, with) => {
                let at = at.index(end);
                // Most counts and numbers of binary files begin at multiples of 4.
                let at = if with.len() == 8 { at / 4 * 4 } else { at };
                bytes.splice(at..(at + with.len()).min(end), with.iter().copied());
            }
            Edit::Word(at, with) => {
                instead(&mut bytes, at.index(end), with, |byte| byte.is_ascii_whitespace());
            }
            Edit::Line(at, with) => instead(&mut bytes, at.index(end), with, |byte| byte == b'\n'),
            Edit::Double(at, length) => {
                let at = at.index(end);
                let part = bytes[at..(at + length).min(end)].to_vec();
                bytes.splice(at..at, part);
            }
        }
    }
    bytes
}

/// Returns the stated number of cases, or a number that takes a few seconds.
fn cases() -> u32 {
    std::env::var("TRIMIP_FUZZ_CASES").ok().and_then(|cases| cases.parse().ok()).unwrap_or(150)
}

/// Runs `law` on random edits of one of `files` files.
fn fuzz(cases: u32, files: usize, law: impl Fn(usize, Vec<Edit>) -> Result<(), TestCaseError>) {
    let config = ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() };
    let run = TestRunner::new(config).run(&(0..files, edits()), |(file, edits)| law(file, edits));
    run.unwrap_or_else(|failure| panic!("{failure}"));
}

/// Asserts that an error is of kind `Input`, has one line, and contains one of `names`.
fn assert_told(error: &Error, names: &[&str]) -> Result<(), TestCaseError> {
    prop_assert_eq!(error.kind(), ErrorKind::Input);
    prop_assert!(!error.message().contains('\n'), "{}", error);
    prop_assert!(names.iter().any(|name| error.message().contains(name)), "{}", error);
    Ok(())
}

/// Opens the scene at `root` with random edits of one of `files`.
fn scenes(root: &Path, files: &[&str]) {
    let whole: Vec<Vec<u8>> = files.iter().map(|name| fs::read(root.join(name)).unwrap()).collect();
    open(&settings(root, 1)).expect("the scene is valid before it is changed");
    fuzz(cases(), files.len(), |changed, edits| {
        let path = root.join(files[changed]);
        fs::write(&path, edited(&whole[changed], &edits)).unwrap();
        let opened = open(&settings(root, 1));
        fs::write(&path, &whole[changed]).unwrap();
        match opened {
            Err(error) => assert_told(&error, files),
            Ok(_) => Ok(()),
        }
    });
}

#[test]
fn scenes_of_a_changed_model_open_or_tell() {
    let root = tempfile::tempdir().unwrap();
    let mut sparse = capture();
    sparse.images.iter_mut().for_each(|image| image.5.truncate(5));
    sparse.points.truncate(5);
    for image in &sparse.images {
        save_image(&root.path().join("images").join(&image.4), 60, 40);
    }
    sparse.write_text(root.path());
    scenes(root.path(), &["cameras.txt", "images.txt", "points3D.txt"]);
    sparse.write_binary(root.path());
    scenes(root.path(), &["cameras.bin", "images.bin", "points3D.bin"]);
}

#[test]
fn scenes_of_changed_transforms_lists_and_points_open_or_tell() {
    let root = tempfile::tempdir().unwrap();
    let paths: Vec<String> = (0..4).map(|i| format!("images/{i}.png")).collect();
    paths.iter().for_each(|path| save_image(&root.path().join(path), 8, 6));
    let frames: Vec<Value> = paths.iter().map(|path| frame(path)).collect();
    let document = json!({
        "fl_x": 9.0, "fl_y": 8.5, "cx": 4.1, "cy": 3.0, "w": 8, "h": 6, "k1": 0.01, "camera_model": "OPENCV",
        "applied_transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "applied_scale": 0.5, "aabb_scale": 4,
        "train_filenames": paths[..2], "test_filenames": paths[2..], "ply_file_path": "points.ply",
        "frames": frames,
    });
    write(&root.path().join("transforms.json"), &document);
    let head = "ply\nformat ascii 1.0\nelement vertex 120\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    let rows: String = (0..120).map(|i| format!("{i} {} 0.5\n", i % 7)).collect();
    fs::write(root.path().join("points.ply"), format!("{head}{rows}")).unwrap();
    scenes(root.path(), &["transforms.json", "points.ply"]);
    let mut body: Vec<u8> = head.replace("ascii", "binary_little_endian").into_bytes();
    (0..360_u16).for_each(|i| body.extend(f32::from(i).to_le_bytes()));
    fs::write(root.path().join("points.ply"), body).unwrap();
    scenes(root.path(), &["transforms.json", "points.ply"]);
}

#[test]
fn scenes_of_changed_metadata_open_or_tell() {
    let root = tempfile::tempdir().unwrap();
    let mut data = settings(root.path(), 2);
    data.format = "builtin".into();
    (data.builtin_size, data.builtin_train, data.builtin_test) = (8, 2, 1);
    write_multiscale(&data, root.path(), &unwatched).unwrap();
    scenes(root.path(), &["metadata.json"]);
}

#[test]
fn scenes_of_a_changed_trajectory_open_or_tell() {
    let root = tempfile::tempdir().unwrap();
    let root = root.path();
    fs::create_dir(root.join("lowres_wide_intrinsics")).unwrap();
    let mut poses = String::new();
    for i in 0..4 {
        save_image(&root.join(format!("lowres_wide/7_10.{i}00.png")), 8, 6);
        fs::write(root.join(format!("lowres_wide_intrinsics/7_10.{i}00.pincam")), "8 6 9 9.5 4.1 3\n")
            .unwrap();
        poses += &format!("10.{i} 0.1 0.2 0.{i} {i} 0.5 4\n");
    }
    fs::write(root.join("lowres_wide.traj"), poses).unwrap();
    scenes(root, &["lowres_wide.traj", "lowres_wide_intrinsics/7_10.200.pincam"]);
}

#[test]
fn scenes_of_a_changed_raw_export_open_or_tell() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("keyframes");
    fs::create_dir_all(root.join("cameras")).unwrap();
    let mut files = Vec::new();
    for i in 0..4 {
        save_image(&root.join(format!("images/{i}.png")), 8, 6);
        let document = json!({
            "fx": 9.0, "fy": 8.5, "cx": 4.1, "cy": 3.0, "width": 8, "height": 6, "blur_score": 90.0,
            "t_00": 1.0, "t_01": 0.0, "t_02": 0.0, "t_03": 0.5 * f64::from(i),
            "t_10": 0.0, "t_11": 0.0, "t_12": -1.0, "t_13": 0.25,
            "t_20": 0.0, "t_21": 1.0, "t_22": 0.0, "t_23": -2.0,
        });
        write(&root.join(format!("cameras/{i}.json")), &document);
        files.push(format!("keyframes/cameras/{i}.json"));
    }
    scenes(folder.path(), &[&files[0], &files[2]]);
}

#[test]
fn scenes_of_a_changed_nsvf_layout_open_or_tell() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    fs::create_dir(root.join("pose")).unwrap();
    for i in 0..4 {
        let name = format!("{}_{i:04}", i / 3);
        save_image(&root.join(format!("rgb/{name}.png")), 8, 6);
        let rows = format!("1 0 0 {}\n0 0 1 -2\n0 -1 0 0.25\n0 0 0 1\n", 0.5 * f64::from(i));
        fs::write(root.join(format!("pose/{name}.txt")), rows).unwrap();
    }
    fs::write(root.join("intrinsics.txt"), "9 0 4.1 0\n0 8.5 3 0\n0 0 1 0\n0 0 0 1\n").unwrap();
    fs::write(root.join("bbox.txt"), "-1 -2 -3 1 2 3 0.4\n").unwrap();
    scenes(root, &["intrinsics.txt", "bbox.txt", "pose/0_0001.txt"]);
}

/// Checks an archive of a scene with some bytes changed. If the archive is refused, nothing of it is left, and nothing
/// is ever written outside of its folder.
#[test]
fn scenes_of_a_changed_archive_open_or_tell() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("scene");
    fs::create_dir(&root).unwrap();
    blender_scene(&root);
    let whole = archive(&packed(&root, "scene/"));
    let here = folder.path().join("here");
    fs::create_dir(&here).unwrap();
    let path = here.join("a.zip");
    fuzz(cases(), 1, |_, edits| {
        fs::write(&path, edited(&whole, &edits)).unwrap();
        let opened = open(&settings(&path, 1));
        let mut names: Vec<_> =
            fs::read_dir(&here).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        let expected: &[&str] = match here.join("a").is_dir() {
            true => &["a", "a.zip"],
            false => &["a.zip"],
        };
        prop_assert_eq!(&names, expected);
        prop_assert!(opened.is_err() || names.len() == 2);
        let _ = fs::remove_dir_all(here.join("a"));
        // If names were changed, the unpacked scene may be refused instead.
        let unpacked = here.join("a").display().to_string();
        opened.map_or_else(|error| assert_told(&error, &["a.zip", &unpacked]), |_| Ok(()))
    });
}
