//! Measures the memory of every reader for the shortest possible entries, which need the most memory per byte of file. Each
//! reader stays within the multiple that its format states ([`trimip_tests::formats`]); `--nocapture` prints the measured values.

use std::{collections::HashMap, fmt::Write};
use trimip_data::colmap::{Encoding, File, Model};
use trimip_tests::formats::{
    Format, Sparse,
    memory::{Counting, measured},
};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Size of each file in bytes.
const SIZE: usize = 100_000;

/// Returns `head`, then `unit` repeated up to `SIZE` bytes, with a number in place of `#`, then `tail`.
fn many(head: &str, unit: &str, tail: &str) -> Vec<u8> {
    let mut text = head.to_string();
    let mut number = 0_u32;
    while text.len() < SIZE {
        match unit.split_once('#') {
            Some((before, after)) => write!(text, "{before}{number:x}{after}").expect("memory takes it"),
            None => text += unit,
        }
        number += 1;
    }
    (text.trim_end_matches(',').to_string() + tail).into_bytes()
}

/// Returns a safetensors file with the given header.
fn with_header(header: Vec<u8>) -> Vec<u8> {
    [&(header.len() as u64).to_le_bytes()[..], &header].concat()
}

/// Returns a safetensors file with the given metadata.
fn with_metadata(format: &str, config: &str) -> Vec<u8> {
    let own: HashMap<&str, &str> = [("format", format), ("config", config), ("state", "{}")].into();
    let own = serde_json::to_string(&own).expect("texts are JSON");
    with_header(serde_json::json!({ "__metadata__": { "trimip": own } }).to_string().into_bytes())
}

/// Returns a zip archive whose entries have the shortest distinct names and share one file.
fn short_archive() -> Vec<u8> {
    let local = [&b"PK\x03\x04"[..], &[0; 26]].concat();
    let names = (0..SIZE / 50).map(|number| format!("{number:x}"));
    let entry = |name: String| {
        let mut entry = b"PK\x01\x02".to_vec();
        entry.extend([0; 24]);
        entry.extend((name.len() as u16).to_le_bytes());
        entry.extend([0; 16]);
        entry.extend(name.bytes());
        entry
    };
    let directory: Vec<u8> = names.flat_map(entry).collect();
    let mut end = b"PK\x05\x06\0\0\0\0".to_vec();
    (0..2).for_each(|_| end.extend(((SIZE / 50) as u16).to_le_bytes()));
    end.extend((directory.len() as u32).to_le_bytes());
    end.extend((local.len() as u32).to_le_bytes());
    end.extend([0; 2]);
    [local, directory, end].concat()
}

#[test]
fn the_shortest_entries_stay_within_what_each_format_states() {
    let json = ["0,", "[],", "{},", "\"\",", "{\"\":0},", "{\"\":[0]},", "[[[[[[0]]]]]],"];
    let toml = [
        ("", "a#=0\n", ""),
        ("", "[a#]\n", ""),
        ("", "[[a#]]\n", ""),
        ("", "[[a]]\n", ""),
        ("a = [", "0,", "]"),
        ("a = [", "{},", "]"),
        ("a = [", "{a=0},", "]"),
        ("a = [", "\"\",", "]"),
        ("", "a.b#.c=0\n", ""),
        ("a = ", "[", ""),
        ("", "=\n", ""),
    ];
    let mut files: Vec<(&str, String, Vec<u8>)> = Vec::new();
    for name in ["transforms", "metadata", "path", "views", "plan", "opensfm", "record3d", "polycam"] {
        for unit in json {
            files.push((name, format!("[{unit}"), many("[", unit, "]")));
            let frames = if name == "metadata" { "{\"train\":{\"file_path\":[" } else { "{\"frames\":[" };
            let tail = if name == "metadata" { "]}}" } else { "]}" };
            files.push((name, format!("frames: [{unit}"), many(frames, unit, tail)));
        }
        files.push((name, "\"a1\":0,".into(), many("{", "\"#\":0,", "}")));
    }
    for (head, unit, tail) in toml {
        let text = many(head, unit, tail);
        files.push(("configuration", format!("{head}{unit}"), text.clone()));
        let value = text.strip_prefix(b"a = ").unwrap_or(&text);
        files.push(("assignment", format!("{head}{unit}"), [b"data.train=", value].concat()));
        let text = String::from_utf8(text).expect("a text");
        files.push(("model", format!("config: {head}{unit}"), with_metadata("trimip-model-1", &text)));
        files.push((
            "checkpoint",
            format!("config: {head}{unit}"),
            with_metadata("trimip-checkpoint-1", &text),
        ));
    }
    for name in ["model", "checkpoint"] {
        for (head, unit, tail) in [
            ("{", "\"#\":{\"dtype\":\"U8\",\"shape\":[0],\"data_offsets\":[0,0]},", "}"),
            ("{\"a\":{\"dtype\":\"U8\",\"shape\":[", "0,", "],\"data_offsets\":[0,0]}}"),
            ("{\"__metadata__\":{", "\"#\":\"\",", "}}"),
            ("{\"__metadata__\":{\"trimip\":\"{", "\\\"#\\\":\\\"\\\",", "}\"}}"),
        ] {
            files.push((name, format!("{head}{unit}"), with_header(many(head, unit, tail))));
        }
    }
    for (which, unit) in [
        (b"\0", "# PINHOLE 1 1 1 1 0 0\n"),
        (b"\x01", "# 1 0 0 0 0 0 0 1 #\n\n"),
        (b"\x02", "# 0 0 0 0 0 0 0\n"),
    ] {
        files.push(("colmap-text", unit.into(), [&which[..], &many("", unit, "")].concat()));
    }
    let ascii = "ply\nformat ascii 1.0\n";
    let vertices = format!(
        "{ascii}element vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
        (SIZE - 105) / 6
    );
    files.push(("ply", "rows".into(), many(&vertices, "0 0 0\n", "")));
    files.push((
        "ply",
        "properties".into(),
        many(&format!("{ascii}element vertex 0\n"), "property int8 a\n", ""),
    ));
    files.push(("ply", "elements".into(), many(ascii, "element a 0\n", "")));
    files.push(("curve", "rows".into(), many("seconds,psnr_mean,stride,last\n", "1,1,1\n", "")));
    files.push(("curve", "columns".into(), many("seconds,psnr_mean", ",", "\n1,1\n")));
    files.push(("events", "lines".into(), many("", "{\"kind\":\"warning\",\"message\":\"#\"}\n", "")));
    files.push((
        "events",
        "plans".into(),
        many("{\"kind\":\"plan\",\"memory_bytes\":1,\"lines\":[", "\"\",", "]}\n"),
    ));
    let totals = "\"totals\":{\"step\":1,\"seconds\":1,\"samples\":1,\"marched\":1,\"rays\":1,\"empty_batches\":1,\"non_finite\":1}";
    let evaluation = format!(
        "{{\"kind\":\"evaluation\",{totals},\"stride\":1,\"last\":false,\"psnr\":1,\"ssim\":1,\"seconds\":1,\"scales\":["
    );
    let scale = "{\"scale\":1,\"images\":1,\"psnr\":1,\"ssim\":1},";
    files.push(("events", "scales".into(), many(&evaluation, scale, "]}\n")));
    let view = "{\"index\":0,\"name\":\"\",\"scale\":1,\"psnr\":null,\"ssim\":null,\"comparison\":null},";
    files.push(("views", "views".into(), many("[", view, "]")));
    let finding = "[{\"decision\":\"\",\"choice\":\"auto\",\"left_out\":true,\"reason\":\"\",\"changes\":[";
    files.push((
        "plan",
        "changes".into(),
        many(finding, "{\"path\":\"\",\"from\":\"\",\"to\":\"\"},", "]}]"),
    ));
    let record3d = "{\"w\":1,\"h\":1,\"K\":[1,0,0,0,1,0,0,0,1],\"poses\":[";
    files.push(("record3d", "poses".into(), many(record3d, "[0,0,0,1,0,0,0],", "]}")));
    files.push((
        "realitycapture",
        "lines".into(),
        many("#name,x,y,alt,heading,pitch,roll,f\n", "a,0,0,0,0,0,0,1\n", ""),
    ));
    // Files of numbers that blanks separate: empty lines, lines of one number, one long line, lines of seven numbers.
    for name in
        ["nsvf-pose", "nsvf-intrinsics", "arkitscenes-trajectory", "arkitscenes-intrinsics", "bundler"]
    {
        for unit in ["\n", "0\n", "0 ", "0 0 0 0 0 0 0\n"] {
            files.push((name, unit.into(), many("", unit, "")));
        }
    }
    let bundle = format!("# Bundle file v0.3\n{} 0\n", SIZE / 30);
    files.push(("bundler", "cameras".into(), many(&bundle, "1 0 0\n1 0 0\n0 1 0\n0 0 1\n0 0 0\n", "")));
    for unit in ["<a/>", "<a>b</a>", "<a b=\"\"/>", "<camera/>"] {
        files.push(("metashape", unit.into(), many("<document>", unit, "</document>")));
    }
    files.push(("archive", "entries".into(), short_archive()));
    let mut worst: HashMap<&str, (f64, String)> = HashMap::new();
    for (name, unit, bytes) in &files {
        let multiple = Format::of(name).memory(bytes) as f64 / bytes.len() as f64;
        let known = worst.entry(name).or_default();
        if multiple > known.0 {
            *known = (multiple, unit.clone());
        }
    }
    let mut worst: Vec<_> = worst.into_iter().collect();
    worst.sort_by_key(|(name, _)| *name);
    worst.iter().for_each(|(name, (multiple, unit))| println!("{name}: {multiple:.1} times, {unit:?}"));
    for (name, _, bytes) in &files {
        Format::of(name).check(bytes);
    }
}

#[test]
fn the_shortest_entries_of_models_take_twice_their_bytes_in_binary_files_and_six_times_in_text() {
    let many = 90_000_u32;
    let mut sparse = Sparse::default();
    for id in 10_000..many {
        let pinhole = (0, "SIMPLE_PINHOLE", vec![1.0; 3]);
        sparse.cameras.push((id, pinhole.0, pinhole.1, [1, 1], pinhole.2));
        sparse.images.push((id, [1.0; 4], [0.0; 3], 10_000, format!("{id:x}"), Vec::new()));
        sparse.points.push((u64::from(id), [0.0; 3], [0; 3], 0.0, Vec::new()));
    }
    let parsed = |encoding, files: [&[u8]; 3]| {
        let file = |i: usize| File { name: "file", bytes: files[i] };
        let (model, most) = measured(|| Model::parse(encoding, file(0), file(1), Some(file(2))));
        model.unwrap();
        most as f64 / files.iter().map(|bytes| bytes.len()).sum::<usize>() as f64
    };
    let files = sparse.binary();
    let binary = parsed(Encoding::Binary, files.each_ref().map(Vec::as_slice));
    // Each file is measured without the entries of the other two.
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

/// Reads files that COLMAP wrote for a capture, which is not part of this repository.
#[test]
fn a_real_model_takes_less_than_twice_the_size_of_its_files() {
    let root = std::env::var_os("TRIMIP_SHARED")
        .map_or_else(|| trimip_tests::binary::root().join("shared"), Into::into);
    let fox = root.join("data/fox/colmap");
    if !fox.is_dir() {
        println!("skipped: {} is not there; set TRIMIP_SHARED to the folder that holds data/", fox.display());
        return;
    }
    for (encoding, extension) in [(Encoding::Binary, "bin"), (Encoding::Text, "txt")] {
        let names = ["cameras", "images", "points3D"].map(|name| format!("{name}.{extension}"));
        let files =
            names.each_ref().map(|name| std::fs::read(fox.join(extension).join(name)).expect("it is there"));
        let file = |i: usize| File { name: &names[i], bytes: &files[i] };
        let (model, most) = measured(|| Model::parse(encoding, file(0), file(1), Some(file(2))));
        let size: usize = files.iter().map(Vec::len).sum();
        println!("{extension}: {:.2} times {size} bytes", most as f64 / size as f64);
        assert_eq!(model.expect("a valid model").images.len(), 50);
        assert!(most <= 2 * size + 4096);
    }
}
