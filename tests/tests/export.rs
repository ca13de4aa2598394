//! Checks of the verb `export`: other programs can read its files, and it reports errors for models that it cannot
//! export.

use std::{fs, path::Path};
use trimip_tests::binary::{run, tiny_and};

/// Trains the smallest model into `run`.
fn train(here: &Path) {
    let answer = run(here, &tiny_and(&["--out", "run"]));
    assert_eq!(answer.code, Some(0), "{}", answer.err);
}

/// Returns the vertices and triangles of an OBJ file.
fn read_obj(path: &Path) -> (Vec<[f64; 3]>, Vec<[usize; 3]>) {
    let text = fs::read_to_string(path).unwrap();
    let lines = |key: &'static str| text.lines().filter_map(move |line| line.strip_prefix(key));
    let vertices: Vec<[f64; 3]> = lines("v ")
        .map(|line| {
            let numbers: Vec<f64> = line.split(' ').map(|number| number.parse().unwrap()).collect();
            assert_eq!(numbers.len(), 6, "a place and a colour");
            assert!(numbers[3..].iter().all(|color| (0.0..=1.0).contains(color)));
            [numbers[0], numbers[1], numbers[2]]
        })
        .collect();
    let triangles = lines("f ")
        .map(|line| {
            let corners: Vec<usize> = line
                .split(' ')
                .map(|corner| corner.split("//").next().unwrap().parse::<usize>().unwrap() - 1)
                .collect();
            corners.try_into().unwrap()
        })
        .collect();
    assert_eq!(lines("vn ").count(), vertices.len());
    (vertices, triangles)
}

/// Returns the vertices and triangles of a binary PLY file with positions, normals and triangles, with or without colours.
fn read_ply(path: &Path) -> (Vec<[f64; 3]>, Vec<[usize; 3]>) {
    let bytes = fs::read(path).unwrap();
    let end = b"end_header\n";
    let start = bytes.windows(end.len()).position(|window| window == end).unwrap() + end.len();
    let header = std::str::from_utf8(&bytes[..start]).unwrap();
    let count = |name: &str| -> usize {
        header.lines().find_map(|line| line.strip_prefix(name)).unwrap().trim().parse().unwrap()
    };
    let (vertices, triangles) = (count("element vertex"), count("element face"));
    let colors = if header.contains("uchar red") { 3 } else { 0 };
    let (vertex, triangle) = (6 * 4 + colors, 1 + 3 * 4);
    assert_eq!(bytes.len(), start + vertices * vertex + triangles * triangle);
    let word = |at: usize| <[u8; 4]>::try_from(&bytes[at..at + 4]).unwrap();
    let place =
        |i: usize| [0, 4, 8].map(|offset| f64::from(f32::from_le_bytes(word(start + i * vertex + offset))));
    let first = start + vertices * vertex;
    let corners = |i: usize| {
        assert_eq!(bytes[first + i * triangle], 3);
        [1, 5, 9].map(|offset| u32::from_le_bytes(word(first + i * triangle + offset)) as usize)
    };
    ((0..vertices).map(place).collect(), (0..triangles).map(corners).collect())
}

/// Returns the vertices and triangles of a GLB file, read as its JSON chunk describes them.
fn read_glb(path: &Path) -> (Vec<[f64; 3]>, Vec<[usize; 3]>) {
    let bytes = fs::read(path).unwrap();
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
    let length = word(12);
    assert_eq!((&bytes[16..20], length % 4), (&b"JSON"[..], 0));
    let json: serde_json::Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
    let data = &bytes[28 + length..];
    assert_eq!((&bytes[24 + length..28 + length], word(20 + length)), (&b"BIN\0"[..], data.len()));
    let primitive = &json["meshes"][0]["primitives"][0];
    let values = |accessor: &serde_json::Value, width: usize| -> Vec<[u8; 4]> {
        let accessor = &json["accessors"][accessor.as_u64().unwrap() as usize];
        let view = &json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let [start, length] = ["byteOffset", "byteLength"].map(|key| view[key].as_u64().unwrap() as usize);
        assert_eq!(length, 4 * width * accessor["count"].as_u64().unwrap() as usize);
        data[start..start + length].chunks_exact(4).map(|word| word.try_into().unwrap()).collect()
    };
    let floats = |name: &str| -> Vec<f64> {
        values(&primitive["attributes"][name], 3)
            .into_iter()
            .map(|word| f32::from_le_bytes(word).into())
            .collect()
    };
    let places: Vec<[f64; 3]> =
        floats("POSITION").chunks_exact(3).map(|place| place.try_into().unwrap()).collect();
    assert_eq!(floats("NORMAL").len(), 3 * places.len());
    assert!(floats("COLOR_0").iter().all(|color| (0.0..=1.0).contains(color)));
    let bounds = &json["accessors"][primitive["attributes"]["POSITION"].as_u64().unwrap() as usize];
    for axis in 0..3 {
        let all = || places.iter().map(|place| place[axis]);
        assert_eq!(bounds["min"][axis].as_f64(), all().reduce(f64::min));
        assert_eq!(bounds["max"][axis].as_f64(), all().reduce(f64::max));
    }
    let indices: Vec<usize> =
        values(&primitive["indices"], 1).into_iter().map(|word| u32::from_le_bytes(word) as usize).collect();
    (places, indices.chunks_exact(3).map(|corners| corners.try_into().unwrap()).collect())
}

/// Returns the files of a USDZ: an archive without compression.
fn unpack(path: &Path) -> Vec<(String, Vec<u8>)> {
    let bytes = fs::read(path).unwrap();
    let half = |at: usize| usize::from(u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap()));
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let (mut files, mut at) = (Vec::new(), 0);
    while &bytes[at..at + 4] == b"PK\x03\x04" {
        let (name, extra, length) = (half(at + 26), half(at + 28), word(at + 18));
        let first = at + 30 + name + extra;
        let name = String::from_utf8(bytes[at + 30..][..name].to_vec()).unwrap();
        files.push((name, bytes[first..first + length].to_vec()));
        at = first + length;
    }
    files
}

/// Returns the numbers of an array in the layer of a USDZ.
fn numbers(layer: &str, name: &str) -> Vec<f64> {
    let (_, rest) = layer.split_once(&format!("{name} = [")).unwrap_or_else(|| panic!("{name}"));
    let (list, _) = rest.split_once(']').unwrap();
    let parts = list.split(|c: char| "(), ".contains(c)).filter(|part| !part.is_empty());
    parts.map(|part| part.parse().unwrap()).collect()
}

/// Returns the vertices and triangles of a USDZ file.
fn read_usdz(path: &Path) -> (Vec<[f64; 3]>, Vec<[usize; 3]>) {
    let files = unpack(path);
    let layer = String::from_utf8(files[0].1.clone()).unwrap();
    assert_eq!((files.len(), files[0].0.as_str()), (1, "surface.usda"));
    let places: Vec<[f64; 3]> =
        numbers(&layer, "points").chunks_exact(3).map(|place| place.try_into().unwrap()).collect();
    for name in ["normals", "primvars:displayColor"] {
        assert_eq!(numbers(&layer, name).len(), 3 * places.len(), "{name}");
    }
    let indices: Vec<usize> =
        numbers(&layer, "faceVertexIndices").into_iter().map(|index| index as usize).collect();
    assert!(numbers(&layer, "faceVertexCounts").iter().all(|count| *count == 3.0));
    (places, indices.chunks_exact(3).map(|corners| corners.try_into().unwrap()).collect())
}

#[test]
fn every_format_holds_the_same_closed_mesh() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here);
    // After twenty training steps the whole visual hull is a fog of low density, so the mesh is the surface of the
    // hull.
    let export = |out: &str| {
        let answer = run(
            here,
            &[
                "export",
                "mesh",
                "run",
                "--out",
                out,
                "--resolution",
                "32",
                "--level",
                "0.01",
                "--silhouettes",
            ],
        );
        assert_eq!(answer.code, Some(0), "{}", answer.err);
        assert!(answer.out.contains("closed and manifold"), "{}", answer.out);
        assert!(answer.out.contains("masks of 2 test views"), "{}", answer.out);
    };
    ["mesh.obj", "out/mesh.ply", "mesh.GLB", "mesh.usdz"].into_iter().for_each(export);
    let (places, triangles) = read_obj(&here.join("mesh.obj"));
    assert!(triangles.len() > 100, "{} triangles", triangles.len());
    let mut edges = std::collections::BTreeMap::new();
    for [a, b, c] in &triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *edges.entry((*from.min(to), *from.max(to))).or_insert(0) += if from < to { 1 } else { -1 };
        }
    }
    assert!(edges.values().all(|sum| *sum == 0), "every edge is passed both ways");
    for (found, name) in [
        (read_ply(&here.join("out/mesh.ply")), "PLY"),
        (read_glb(&here.join("mesh.GLB")), "GLB"),
        (read_usdz(&here.join("mesh.usdz")), "USDZ"),
    ] {
        assert!(found.1 == triangles && found.0.len() == places.len(), "{name}");
        let same = |a: &[f64; 3], b: &[f64; 3]| (0..3).all(|axis| (a[axis] - b[axis]).abs() < 1e-6);
        assert!(found.0.iter().zip(&places).all(|(a, b)| same(a, b)), "{name}");
    }
}

#[test]
fn a_mesh_for_collisions_is_coarse_and_closed() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here);
    let export = ["export", "mesh", "run", "--resolution", "32", "--level", "0.01", "--out", "mesh.ply"];
    let answer = run(here, &[&export[..], &["--collision", "400"]].concat());
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    assert!(answer.out.contains("mesh_collision.ply"), "{}", answer.out);
    let (fine, coarse) = (read_ply(&here.join("mesh.ply")), read_ply(&here.join("mesh_collision.ply")));
    assert!(
        fine.1.len() > 800 && (4..=440).contains(&coarse.1.len()),
        "{} of {}",
        coarse.1.len(),
        fine.1.len()
    );
    let mut edges = std::collections::BTreeMap::new();
    for [a, b, c] in &coarse.1 {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *edges.entry((*from.min(to), *from.max(to))).or_insert(0) += if from < to { 1 } else { -1 };
        }
    }
    assert!(edges.values().all(|sum| *sum == 0), "closed");
    // It lies about where the fine mesh lies.
    for axis in 0..3 {
        let end = |places: &[[f64; 3]], pick: fn(f64, f64) -> f64| {
            places.iter().map(|place| place[axis]).reduce(pick).unwrap()
        };
        for pick in [f64::min, f64::max] {
            assert!((end(&fine.0, pick) - end(&coarse.0, pick)).abs() < 0.3, "axis {axis}");
        }
    }
}

#[test]
fn a_model_file_alone_is_enough_and_the_mesh_lies_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here);
    fs::create_dir(here.join("alone")).unwrap();
    fs::copy(here.join("run/model.safetensors"), here.join("alone/my.safetensors")).unwrap();
    let alone =
        ["export", "mesh", "alone/my.safetensors", "--resolution", "24", "--level", "0.01", "--no-colors"];
    let answer = run(here, &[&alone[..], &["--triangles", "0"]].concat());
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    let header = fs::read(here.join("alone/mesh.ply")).unwrap();
    let header = String::from_utf8_lossy(&header[..300]).into_owned();
    assert!(header.starts_with("ply\n") && header.contains("nx") && !header.contains("red"), "{header}");
    // A repeated export writes the same bytes.
    let before = fs::read(here.join("alone/mesh.ply")).unwrap();
    assert_eq!(run(here, &[&alone[..], &["--triangles", "0"]].concat()).code, Some(0));
    assert_eq!(before, fs::read(here.join("alone/mesh.ply")).unwrap());
}

#[test]
fn what_cannot_be_exported_is_refused_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here);
    fs::write(here.join("mesh.ply"), "mine").unwrap();
    fs::write(here.join("file"), "").unwrap();
    for (arguments, code, part) in [
        (&["--out", "mesh.stl"][..], 2, "end it in .ply, .obj, .glb or .usdz"),
        (&["--out", "mesh"], 2, "end it in .ply, .obj, .glb or .usdz"),
        (&["--out", "file/mesh.ply"], 2, "file"),
        (&["--resolution", "7"], 2, "8..=2048"),
        (&["--level=-1"], 2, "positive density"),
        (&["--level", "nan"], 2, "positive density"),
        (&["--specks", "1.5"], 2, "specks"),
        (&["--error", "0"], 2, "error"),
        (&["--error", "0.1", "--triangles", "5"], 2, "cannot be used with"),
        (&["--set", "encoder.levels=2"], 2, "encoder.levels"),
        (&["--set", "data.root=elsewhere", "--set", "data.format=blender", "--silhouettes"], 2, "elsewhere"),
        (
            &[
                "--set",
                "data.root=elsewhere",
                "--set",
                "data.format=blender",
                "--out",
                "m.glb",
                "--texture",
                "128",
                "--texture-source",
                "photographs",
            ],
            2,
            "elsewhere",
        ),
        (&["--texture-source", "field"], 2, "--texture"),
        (&["--crop", "half 0,0,9,0,0,1"], 2, "lies on this side"),
        (&["--level", "1e9", "--resolution", "16", "--out", "mesh.ply"], 1, "no surface of density"),
    ] {
        let answer = run(here, &[&["export", "mesh", "run"], arguments].concat());
        assert_eq!((answer.code, answer.out.as_str()), (Some(code), ""), "{arguments:?}: {}", answer.err);
        assert!(answer.err.contains(part), "{arguments:?}: {}", answer.err);
    }
    assert!(run(here, &["export", "mesh", "nothing"]).err.contains("nothing"));
    assert_eq!(fs::read(here.join("mesh.ply")).unwrap(), b"mine");
    assert!(!here.join("run/mesh.ply").exists());
}

/// Returns the positions of the cameras of a `cameras.json` by the names of their photographs, without folder and extension.
fn positions(path: &Path) -> std::collections::BTreeMap<String, [f64; 3]> {
    let document: serde_json::Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    let frames = document["frames"].as_array().unwrap().iter().map(|frame| {
        let name = Path::new(frame["file_path"].as_str().unwrap()).file_stem().unwrap();
        let at = [0, 1, 2].map(|row: usize| frame["transform_matrix"][row][3].as_f64().unwrap());
        (name.to_string_lossy().into_owned(), at)
    });
    frames.collect()
}

#[test]
fn exported_cameras_are_read_again_from_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let small =
        ["--set", "data.builtin_size=16", "--set", "data.builtin_train=9", "--set", "data.builtin_test=2"];
    assert_eq!(run(here, &[&["data", "builtin", "scene"][..], &small].concat()).code, Some(0));
    let of = |root: &'static str, out: &'static str| {
        let root = format!("data.root={root}");
        let arguments = ["--set", "data.format=auto", "--set", &root, "--out", out];
        let answer = run(here, &tiny_and(&arguments));
        assert_eq!(answer.code, Some(0), "{}", answer.err);
        positions(&here.join(out).join("cameras.json"))
    };
    let first = of("scene", "run");
    assert_eq!(first.len(), 9);

    // A COLMAP model and a transforms file, each with the photographs beside it, are data sets with the same cameras.
    for (root, out) in [("colmap", "colmap/sparse/0"), ("json", "json/transforms.json")] {
        let answer = run(here, &["export", "cameras", "run", "--out", out]);
        assert_eq!(answer.code, Some(0), "{}", answer.err);
        let images = here.join(root).join("images");
        fs::create_dir_all(&images).unwrap();
        for entry in fs::read_dir(here.join("scene/train")).unwrap() {
            let path = entry.unwrap().path();
            fs::copy(&path, images.join(path.file_name().unwrap())).unwrap();
        }
        let run = if root == "colmap" { "run2" } else { "run3" };
        let again = of(root, run);
        assert!(again.len() >= 7, "{root}: {again:?}");
        for (name, at) in &again {
            let expected = first[name];
            assert!((0..3).all(|axis| (at[axis] - expected[axis]).abs() < 1e-9), "{root}, {name}: {at:?}");
        }
    }

    // Test cameras, both, a path, and what is refused.
    let count = |arguments: &[&str], expected: &str| {
        let answer = run(here, &[&["export", "cameras", "run"], arguments].concat());
        assert!(answer.code == Some(0) && answer.out.contains(expected), "{arguments:?}: {answer:?}");
    };
    count(&["--views", "test", "--out", "test.json"], "2 cameras");
    count(&["--views", "all", "--out", "all.gltf"], "11 cameras");
    count(&["--path", "test.json", "--out", "path.gltf"], "2 cameras");
    for (arguments, expected) in [
        (&["--out", "cameras.txt"][..], "names no format of cameras"),
        (&["--path", "nowhere.json", "--out", "a.json"], "nowhere.json"),
        (&["--path", "test.json", "--views", "all"], "cannot be used with"),
    ] {
        let answer = run(here, &[&["export", "cameras", "run"], arguments].concat());
        assert!(answer.code == Some(2) && answer.err.contains(expected), "{arguments:?}: {answer:?}");
    }
    fs::copy(here.join("run/model.safetensors"), here.join("alone.safetensors")).unwrap();
    let answer = run(here, &["export", "cameras", "alone.safetensors", "--out", "a.json"]);
    assert!(answer.code == Some(2) && answer.err.contains("name the folder of a run"), "{answer:?}");
}

#[test]
fn a_texture_belongs_to_its_mesh_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here);
    let export = |arguments: &[&str]| {
        let mesh = ["export", "mesh", "run", "--resolution", "24", "--triangles", "300", "--level", "0.5"];
        run(here, &[&mesh[..], arguments].concat())
    };
    let answer = export(&["--texture", "128", "--out", "field.glb", "--texture-source", "field"]);
    assert!(answer.code == Some(0) && answer.out.contains(", colours of the field; "), "{answer:?}");
    // Photographs of more pixels, which show the surface away from its borders.
    let answer = export(&["--texture", "128", "--out", "fitted.glb", "--set", "data.builtin_size=96"]);
    assert!(
        answer.code == Some(0) && answer.out.contains(" photographs, the others of the field"),
        "{answer:?}"
    );
    assert!(fs::read(here.join("fitted.glb")).unwrap() != fs::read(here.join("field.glb")).unwrap());
    let answer = export(&["--texture", "128", "--out", "mesh.glb", "--psnr"]);
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    for part in [" of the texels show the surface", " dB on 2 test views"] {
        assert!(answer.out.contains(part), "{part} in {}", answer.out);
    }
    let bytes = fs::read(here.join("mesh.glb")).unwrap();
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((word(0), word(8)), (0x4654_6c67, bytes.len()));
    let json: serde_json::Value = serde_json::from_slice(&bytes[20..20 + word(12)]).unwrap();
    let data = &bytes[20 + word(12) + 8..];
    let number = |value: &serde_json::Value| value.as_u64().unwrap() as usize;
    let view = |index: usize| {
        let view = &json["bufferViews"][index];
        &data[number(&view["byteOffset"])..][..number(&view["byteLength"])]
    };
    assert_eq!(json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["index"], 0);
    let png = view(number(&json["images"][0]["bufferView"]));
    let texture = image::load_from_memory(png).unwrap().to_rgb8();
    assert_eq!(texture.dimensions(), (128, 128));
    let attributes = &json["meshes"][0]["primitives"][0]["attributes"];
    assert!(attributes["COLOR_0"].is_null());
    let accessor = &json["accessors"][number(&attributes["TEXCOORD_0"])];
    let coordinates = view(number(&accessor["bufferView"]));
    assert_eq!(
        (accessor["type"].as_str(), coordinates.len()),
        (Some("VEC2"), 8 * number(&accessor["count"]))
    );
    assert_eq!(accessor["count"], json["accessors"][number(&attributes["POSITION"])]["count"]);

    // The OBJ has the same texture and coordinates; v grows upward.
    assert_eq!(export(&["--texture", "128", "--out", "mesh.obj"]).code, Some(0));
    assert_eq!(image::open(here.join("mesh_texture.png")).unwrap().to_rgb8(), texture);
    let material = fs::read_to_string(here.join("mesh.mtl")).unwrap();
    assert!(material.contains("map_Kd mesh_texture.png\n"), "{material}");
    let text = fs::read_to_string(here.join("mesh.obj")).unwrap();
    assert!(text.contains("\nmtllib mesh.mtl\nusemtl surface\n"));
    let floats =
        coordinates.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect::<Vec<_>>();
    let mut count = 0;
    for (line, pair) in
        text.lines().filter_map(|line| line.strip_prefix("vt ")).zip(floats.as_chunks::<2>().0)
    {
        let (u, v) = line.split_once(' ').unwrap();
        assert_eq!([u.parse::<f32>().unwrap(), v.parse::<f32>().unwrap()], [pair[0], 1.0 - pair[1]]);
        count += 1;
    }
    assert_eq!(8 * count, coordinates.len());

    // So has the USDZ, whose v grows upward too.
    assert_eq!(export(&["--texture", "128", "--out", "mesh.usdz"]).code, Some(0));
    let files = unpack(&here.join("mesh.usdz"));
    assert_eq!(files[1].0, "texture.png");
    assert_eq!(image::load_from_memory(&files[1].1).unwrap().to_rgb8(), texture);
    let layer = String::from_utf8(files[0].1.clone()).unwrap();
    assert!(layer.contains("@texture.png@") && layer.contains("</surface/material>"));
    let found = numbers(&layer, "primvars:st");
    assert_eq!(found.len(), floats.len());
    for (found, pair) in found.as_chunks::<2>().0.iter().zip(floats.as_chunks::<2>().0) {
        assert_eq!(found.map(|x| x as f32), [pair[0], 1.0 - pair[1]]);
    }

    let finer =
        ["--resolution", "100", "--triangles", "0", "--level", "0.3", "--specks", "0", "--seen-by", "0"];
    for (arguments, expected) in [
        (&["--texture", "128", "--out", "other.ply"][..], "PLY has no textures"),
        (&[&finer[..], &["--texture", "64", "--out", "other.glb"]].concat(), "charts do not fit"),
        (&["--texture", "32", "--out", "other.glb"], "32"),
    ] {
        let answer = run(here, &[&["export", "mesh", "run"], arguments].concat());
        assert!(answer.code == Some(2) && answer.err.contains(expected), "{arguments:?}: {}", answer.err);
    }
    assert!(!here.join("other.glb").exists() && !here.join("other.ply").exists());
}
