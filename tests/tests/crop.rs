//! Checks of the crop of a scene: the plan chooses it, the model stores it, and meshes, films and pages apply it.

use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_tests::binary::{refuses, run, tiny_and};
use trimip_tests::watching::{Shown, view};

/// Trains the smallest model of contracted space into `run`, on cameras that look at the origin.
fn train(here: &Path, more: &[&str]) {
    let place = ["--out", "run", "--set", "scene.contraction=ball", "--set", "plan.hull=off"];
    let answer = run(here, &tiny_and(&[&place[..], more].concat()));
    assert_eq!(answer.code, Some(0), "{}", answer.err);
}

/// Writes the mesh of the run, with additional arguments; returns its vertices and the program's output.
fn mesh(here: &Path, more: &[&str]) -> (Vec<[f64; 3]>, String) {
    // After twenty training steps, space is a fog of low density.
    let export = ["export", "mesh", "run", "--out", "mesh.obj", "--resolution", "32", "--level", "0.01"];
    let answer = run(here, &[&export[..], &["--triangles", "0", "--no-colors"], more].concat());
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    let text = fs::read_to_string(here.join("mesh.obj")).unwrap();
    let vertices = text.lines().filter_map(|line| line.strip_prefix("v ")).map(|line| {
        let numbers: Vec<f64> = line.split(' ').take(3).map(|number| number.parse().unwrap()).collect();
        numbers.try_into().unwrap()
    });
    (vertices.collect(), answer.out)
}

/// Returns the centre and the radius of the ball that the plan chose.
fn planned(here: &Path) -> Vec<f64> {
    let config = fs::read_to_string(here.join("run/config.toml")).unwrap();
    let line = config.lines().find_map(|line| line.strip_prefix("crop = \"ball ")).expect("a ball");
    line.trim_end_matches('"').split(',').map(|number| number.parse().unwrap()).collect()
}

fn distance(point: &[f64; 3], ball: &[f64]) -> f64 {
    (0..3).map(|axis| (point[axis] - ball[axis]).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn the_mesh_of_a_place_is_its_crop() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here, &[]);
    let ball = planned(here);
    let cameras = fs::read_to_string(here.join("run/cameras.json")).unwrap();
    assert_eq!(cameras.matches("transform_matrix").count(), 4, "those of the training photographs");
    let (cropped, told) = mesh(here, &["--seen-by", "0"]);
    assert!(told.contains("crop: ball ") && !cropped.is_empty(), "{told}");
    let reach = |vertices: &[[f64; 3]]| vertices.iter().map(|p| distance(p, &ball)).fold(0.0, f64::max);
    let spacing = ball[3] / 16.0;
    assert!(reach(&cropped) <= ball[3] + 2.0 * spacing, "{} beyond {}", reach(&cropped), ball[3]);
    let (whole, told) = mesh(here, &["--seen-by", "0", "--crop", "none"]);
    assert!(told.contains("closed and manifold") && reach(&whole) > 1.5 * ball[3], "{told}");
    let (part, told) = mesh(here, &["--seen-by", "0", "--crop", "box -0.2,-0.2,-0.2,0.2,0.3,0.4"]);
    assert!(told.contains("crop: box -0.2,-0.2,-0.2,0.2,0.3,0.4"), "{told}");
    let inside = |p: &[f64; 3]| (0..3).all(|i| p[i] >= -0.23 && p[i] <= [0.23, 0.33, 0.43][i]);
    assert!(part.iter().all(inside), "{part:?}");
    // The crop is a setting of the model, so a copy of the file elsewhere has it too.
    fs::create_dir(here.join("alone")).unwrap();
    fs::copy(here.join("run/model.safetensors"), here.join("alone/my.safetensors")).unwrap();
    let alone =
        ["export", "mesh", "alone/my.safetensors", "--resolution", "16", "--level", "0.01", "--seen-by", "0"];
    let answer = run(here, &alone);
    assert!(answer.code == Some(0) && answer.out.contains("crop: ball "), "{answer:?}");
}

#[test]
fn the_mesh_of_a_place_comes_from_the_depths_of_its_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here, &[]);
    let opaque =
        ["--set", "plan.hull=off", "--set", "field.density_scale=200", "--set", "data.builtin_size=48"];
    let object = tiny_and(&[&["--out", "object"], &opaque[..]].concat());
    assert_eq!(run(here, &object).code, Some(0));
    let export = |model: &str, more: &[&str]| {
        let plain = ["export", "mesh", model, "--out", "mesh.obj", "--resolution", "64", "--triangles", "0"];
        run(here, &[&plain[..], more].concat())
    };
    // After twenty training steps, a place is a fog through which every picture sees.
    let answer = export("run", &[]);
    assert_eq!(answer.code, Some(1), "{answer:?}");
    assert!(answer.err.contains("the depths of 4 pictures agree on no surface"), "{}", answer.err);
    let answer = export("run", &["--level", "0.01", "--seen-by", "1"]);
    assert!(answer.code == Some(0) && answer.out.contains("surface: density 0.0100 per unit"), "{answer:?}");
    // With this density, the fog of an object is an opaque solid in its box.
    let answer = export("object", &["--surface", "depths", "--seen-by", "1"]);
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    assert!(answer.out.contains("surface: depths of 4 pictures on cells "), "{}", answer.out);
    assert!(answer.out.contains("manifold, open along "), "{}", answer.out);
    let answer = export("object", &[]);
    assert!(answer.code == Some(0) && answer.out.contains("surface: density "), "{answer:?}");
    refuses(
        here,
        &["export", "mesh", "run", "--surface", "depths", "--level", "5"],
        &["--level", "no level"],
    );
    // A model without its cameras.
    fs::create_dir(here.join("alone")).unwrap();
    fs::copy(here.join("run/model.safetensors"), here.join("alone/my.safetensors")).unwrap();
    let moved = ["export", "mesh", "alone/my.safetensors", "--resolution", "16"];
    let moved = [&moved[..], &["--set", "data.format=blender", "--set", "data.root=elsewhere"]].concat();
    for option in [["--surface", "depths"], ["--seen-by", "2"]] {
        refuses(
            here,
            &[&moved[..], &option].concat(),
            &[option[0], "neither the data set nor the run folder"],
        );
    }
    let answer = run(here, &[&moved[..], &["--level", "0.01"]].concat());
    assert!(answer.code == Some(0) && answer.out.contains("surface: density 0.0100"), "{answer:?}");
}

#[test]
fn what_no_camera_sees_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here, &[]);
    let (all, _) = mesh(here, &["--seen-by", "0", "--specks", "0"]);
    let (seen, told) = mesh(here, &["--seen-by", "1", "--specks", "0"]);
    assert!(seen.len() < all.len() && told.contains("that few cameras see"), "{told}");
    assert!(!seen.is_empty());
}

#[test]
fn pictures_show_the_crop_alone_and_by_default_the_whole_place() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here, &[]);
    let opacity = |out: &str, more: &[&str]| {
        let film = ["render", "run", "--flythrough", "2", "--width", "16", "--what", "opacity", "--out", out];
        let answer = run(here, &[&film[..], more].concat());
        assert_eq!(answer.code, Some(0), "{}", answer.err);
        let picture = image::open(here.join(out).join("0000_opacity.png")).unwrap().into_luma16();
        picture.pixels().map(|pixel| f64::from(pixel.0[0])).sum::<f64>()
    };
    let (whole, part) = (opacity("whole", &[]), opacity("part", &["--crop", "auto"]));
    assert!(part > 0.0 && part < whole, "{part} of {whole}");
    assert_eq!(opacity("nothing", &["--crop", "ball 900,900,900,1"]), 0.0);
    // With another crop, `render` begins a new job in the same folder.
    assert_eq!(opacity("whole", &["--crop", "auto"]), part);
}

/// Returns the description of the scene that `view` sends to its page.
fn about(shown: &Shown) -> Value {
    let (status, text) = shown.get(&format!("/{}/scene.json", shown.token), &[]);
    assert_eq!(status, 200);
    serde_json::from_slice(&text).unwrap()
}

#[test]
fn pages_open_with_the_crop_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let answer = run(here, &tiny_and(&["--out", "run", "--set", "scene.crop=ball 0,0,0,0.5"]));
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    // A given crop replaces the model's crop. Without one, the page's switch applies the model's crop.
    let (own, given) = ("ball 0,0,0,0.5", "box -0.2,-0.2,-0.2,0.2,0.3,0.4");
    let nothing = "ball 900,900,900,1";
    for (options, crop, cropped) in [
        (&[][..], own, false),
        (&["--crop", "none"], own, false),
        (&["--crop", "auto"], own, true),
        (&["--crop", given], given, true),
        (&["--crop", nothing], nothing, true),
    ] {
        let shown = Shown::start_with(here, "run", options);
        let told = about(&shown);
        assert_eq!((&told["crop"], &told["cropped"]), (&json!(crop), &json!(cropped)), "{options:?}");
        let mut page = shown.join(&shown.token, None).expect("the page may enter");
        let mut light = |id: u64, cropped: bool| {
            let mut request = view(id, [3.0, 1.0, 2.0], 24, 24);
            (request["show"], request["cropped"]) = (json!("opacity"), json!(cropped));
            let picture = image::load_from_memory(&page.finest(&request).unwrap().jpeg).unwrap().to_luma8();
            picture.pixels().map(|pixel| u64::from(pixel.0[0])).sum::<u64>()
        };
        let (whole, part) = (light(1, false), light(2, true));
        assert!(part < whole && (part == 0) == (crop == nothing), "{options:?}: {part} of {whole}");
        assert_eq!(light(3, false), whole);
    }
}

#[test]
fn an_object_has_no_crop_and_a_given_one_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let answer = run(here, &tiny_and(&["--out", "object"]));
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    let config = fs::read_to_string(here.join("object/config.toml")).unwrap();
    assert!(config.contains("crop = \"none\""));
    train(here, &["--set", "scene.crop=ball 0,0,0,0.25"]);
    assert_eq!(planned(here), [0.0, 0.0, 0.0, 0.25]);
    for (crop, part) in [
        ("ball 1,2", "a ball has four numbers"),
        ("box 0,0,0,1,1,0", "above the first"),
        ("cube", "a crop begins with none, box, ball or half"),
        ("half 0,0,0,1", "a half-space has six numbers"),
    ] {
        refuses(here, &["export", "mesh", "run", "--crop", crop], &[part, "or auto"]);
        refuses(here, &["render", "run", "--crop", crop], &[part, "or auto"]);
        refuses(here, &["view", "run", "--crop", crop], &[part, "or auto"]);
        refuses(here, &["export", "web", "run", "--crop", crop], &[part, "or auto"]);
        let setting = format!("scene.crop={crop}");
        refuses(here, &tiny_and(&["--out", "other", "--set", &setting]), &[part, "--set"]);
    }
    refuses(
        here,
        &["export", "mesh", "object", "--crop", "ball 99,0,0,1"],
        &["lies outside the scene's box"],
    );
    let told = about(&Shown::start_with(here, "object", &["--crop", "auto"]));
    assert_eq!((&told["crop"], &told["cropped"]), (&json!("none"), &json!(false)));
}
