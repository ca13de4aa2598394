//! Any bytes: valid files of each format are changed at random, and nothing panics, every failure is an input error that names a
//! file, and memory stays within twice the size of the files of a COLMAP model. `TRIMIP_FUZZ_CASES` is the number of cases of
//! the parsers, of which scenes on disk have a fiftieth.

mod common;

use common::{
    colmap::{FILES, Sparse, capture},
    frame, save_image, settings, shared, write,
};
use proptest::{prelude::*, sample::Index, test_runner::TestRunner};
use serde_json::{Value, json};
use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    fs,
    path::Path,
};
use trimip_core::{Error, ErrorKind, config::Format};
use trimip_data::{
    colmap::{Encoding, File, Model},
    open, unwatched, write_multiscale,
};

/// Memory beside the entries of a model: messages, and the first entries of lists that grow.
const FIXED: usize = 4096;

thread_local! {
    /// Bytes that this thread has allocated and not freed, and the most it had.
    static HELD: Cell<(isize, isize)> = const { Cell::new((0, 0)) };
}

/// The system's allocator, which counts.
struct Counting;

fn held(change: isize) {
    // Threads that end free memory after their variables are gone.
    let _ = HELD.try_with(|held| {
        let (now, most) = held.get();
        held.set((now + change, most.max(now + change)));
    });
}

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        held(layout.size() as isize);
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        held(-(layout.size() as isize));
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(at, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The most memory that `work` held at a time, in bytes, and its result.
fn measured<T>(work: impl FnOnce() -> T) -> (T, usize) {
    HELD.set((0, 0));
    let result = work();
    (result, HELD.get().1 as usize)
}

/// A change of a file.
#[derive(Clone, Debug)]
enum Edit {
    Flip(Index, u8),
    Truncate(Index),
    Remove(Index, usize),
    /// A text or the bytes of a number, over what is there.
    Put(Index, Vec<u8>),
    /// As `Put`, instead of a word or a line.
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
                // Counts and numbers of binary files begin at multiples of 4 for the most part.
                let at = if with.len() == 8 { at / 4 * 4 } else { at };
                bytes.splice(at..(at + with.len()).min(end), with.iter().copied());
            }
            Edit::Word(at, with) => {
                instead(&mut bytes, at.index(end), with, |byte| byte.is_ascii_whitespace())
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

/// The stated number of cases, or one that takes a few seconds.
fn cases(share: u32, otherwise: u32) -> u32 {
    let stated = std::env::var("TRIMIP_FUZZ_CASES").ok().and_then(|cases| cases.parse::<u32>().ok());
    stated.map_or(otherwise, |cases| (cases / share).max(1))
}

/// Runs `law` on changes of one of `files` files.
fn fuzz(cases: u32, files: usize, law: impl Fn(usize, Vec<Edit>) -> Result<(), TestCaseError>) {
    let config = ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() };
    let run = TestRunner::new(config).run(&(0..files, edits()), |(file, edits)| law(file, edits));
    run.unwrap_or_else(|failure| panic!("{failure}"));
}

/// An error that a person can act on.
fn assert_told(error: &Error, names: &[&str]) -> Result<(), TestCaseError> {
    prop_assert_eq!(error.kind, ErrorKind::Input);
    prop_assert_eq!(error.exit_code(), 2);
    prop_assert!(!error.message.contains('\n'), "{}", error);
    prop_assert!(names.iter().any(|name| error.message.contains(name)), "{}", error);
    Ok(())
}

fn models(encoding: Encoding, files: [Vec<u8>; 3], extension: &str) {
    let names = FILES.map(|name| format!("{name}.{extension}"));
    let parsed = |files: &[Vec<u8>; 3]| {
        let file = |i: usize| File { name: &names[i], bytes: &files[i] };
        measured(|| Model::parse(encoding, file(0), file(1), Some(file(2))))
    };
    parsed(&files).0.expect("the file is valid before it is changed");
    fuzz(cases(1, 3000), 3, |changed, edits| {
        let mut files = files.clone();
        files[changed] = edited(&files[changed], &edits);
        let (model, most) = parsed(&files);
        let size: usize = files.iter().map(Vec::len).sum();
        prop_assert!(most <= 2 * size + FIXED, "{most} bytes for files of {size}");
        match model {
            Err(error) => assert_told(&error, &names.each_ref().map(String::as_str)),
            Ok(_) => Ok(()),
        }
    });
}

#[test]
fn binary_models_of_any_bytes_are_read_or_refused_within_memory() {
    models(Encoding::Binary, capture().binary(), "bin");
}

#[test]
fn text_models_of_any_bytes_are_read_or_refused_within_memory() {
    models(Encoding::Text, capture().text().map(String::into_bytes), "txt");
}

/// Writes changes of `files` in the scene at `root` and opens it.
fn scenes(root: &Path, files: &[&str]) {
    let whole: Vec<Vec<u8>> = files.iter().map(|name| fs::read(root.join(name)).unwrap()).collect();
    open(&settings(root, 1)).expect("the scene is valid before it is changed");
    fuzz(cases(50, 150), files.len(), |changed, edits| {
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
    data.format = Format::Builtin;
    (data.builtin_size, data.builtin_train, data.builtin_test) = (8, 2, 1);
    write_multiscale(&data, root.path(), &unwatched).unwrap();
    scenes(root.path(), &["metadata.json"]);
}

/// Entries as short as they can be, whose memory is the most for their bytes.
#[test]
fn the_shortest_entries_take_twice_their_bytes_in_binary_files_and_six_times_in_text() {
    let many = 90_000_u32;
    let mut sparse = Sparse::default();
    for id in 10_000..many {
        let pinhole = (0, "SIMPLE_PINHOLE", vec![1.0; 3]);
        sparse.cameras.push((id, pinhole.0, pinhole.1, [1, 1], pinhole.2));
        sparse.images.push((id, [1.0; 4], [0.0; 3], 10_000, format!("{id:x}"), Vec::new()));
        sparse.points.push((u64::from(id), [0.0; 3], [0; 3], 0.0, Vec::new()));
    }
    let parsed = |encoding, files: [&[u8]; 3]| {
        let file = |i: usize| File { name: FILES[i], bytes: files[i] };
        let (model, most) = measured(|| Model::parse(encoding, file(0), file(1), Some(file(2))));
        model.unwrap();
        most as f64 / files.iter().map(|bytes| bytes.len()).sum::<usize>() as f64
    };
    let files = sparse.binary();
    let binary = parsed(Encoding::Binary, files.each_ref().map(Vec::as_slice));
    // Each file without the others.
    let one = Sparse { cameras: sparse.cameras[..1].to_vec(), ..Sparse::default() }.binary();
    let cameras = parsed(Encoding::Binary, [&files[0], &one[1], &one[2]]);
    let images = parsed(Encoding::Binary, [&one[0], &files[1], &one[2]]);
    let points = parsed(Encoding::Binary, [&one[0], &one[1], &files[2]]);
    println!("binary {binary:.2}: cameras {cameras:.2}, images {images:.2}, points {points:.2}");
    assert!([binary, cameras, images, points].iter().all(|times| *times <= 2.0));

    let row = |id: u32, rest: &str| format!("{id} {rest}\n");
    let text = |rest: &str| (10_000..many).map(|id| row(id, rest)).collect::<String>();
    let named = |id: u32| row(id, &format!("1 0 0 0 0 0 0 1 {id:x}\n"));
    let files = [text("PINHOLE 1 1 1 1 0 0"), (10_000..many).map(named).collect(), text("0 0 0 0 0 0 0")];
    let one = "1 PINHOLE 1 1 1 1 0 0\n";
    let cameras = parsed(Encoding::Text, [files[0].as_bytes(), b"", b""]);
    let images = parsed(Encoding::Text, [one.as_bytes(), files[1].as_bytes(), b""]);
    let points = parsed(Encoding::Text, [one.as_bytes(), b"", files[2].as_bytes()]);
    println!("text: cameras {cameras:.2}, images {images:.2}, points {points:.2}");
    assert!([cameras, images, points].iter().all(|times| *times <= 6.0));
}

#[test]
fn a_real_model_takes_less_than_twice_the_size_of_its_files() {
    let Some(fox) = shared("fox") else { return };
    for (encoding, extension) in [(Encoding::Binary, "bin"), (Encoding::Text, "txt")] {
        let names = FILES.map(|name| format!("{name}.{extension}"));
        let files =
            names.each_ref().map(|name| fs::read(fox.join("colmap").join(extension).join(name)).unwrap());
        let file = |i: usize| File { name: &names[i], bytes: &files[i] };
        let (model, most) = measured(|| Model::parse(encoding, file(0), file(1), Some(file(2))));
        let size: usize = files.iter().map(Vec::len).sum();
        println!("{extension}: {:.2} times {size} bytes", most as f64 / size as f64);
        assert_eq!(model.unwrap().images.len(), 50);
        assert!(most <= 2 * size + FIXED);
    }
    let text = fs::read(fox.join("transforms.json")).unwrap();
    let (document, most) = measured(|| serde_json::from_slice::<Value>(&text).unwrap());
    println!("json: {:.2} times {} bytes", most as f64 / text.len() as f64, text.len());
    let (document, most) = (document.to_string(), most);
    println!(
        "json without white space: {:.2} times {} bytes",
        most as f64 / document.len() as f64,
        document.len()
    );
}
