//! Runs the examples. The README shows the function of the first one.

#[allow(dead_code)]
#[path = "../examples/first.rs"]
mod first;
#[allow(dead_code)]
#[path = "../examples/mesh.rs"]
mod mesh;
#[allow(dead_code)]
#[path = "../examples/own_loss.rs"]
mod own_loss;
#[allow(dead_code)]
#[path = "../examples/query.rs"]
mod query;
#[allow(dead_code)]
#[path = "../examples/render.rs"]
mod render;
#[allow(dead_code)]
#[path = "../examples/train.rs"]
mod train;
#[allow(dead_code)]
#[path = "../examples/training_loop.rs"]
mod training_loop;

use std::path::Path;

/// Settings of a run that takes a tenth of a second.
const TINY: [&str; 9] = [
    "data.builtin_size=16",
    "data.builtin_train=4",
    "data.builtin_test=1",
    "encoder.plane_size=16",
    "encoder.levels=3",
    "field.hidden=16",
    "train.samples_per_step=512",
    "train.steps=40",
    "eval.min_gain=0",
];

/// Asserts that the picture has this size and is not blank.
fn expect_picture(path: &Path, size: (u32, u32)) {
    let picture = image::open(path).unwrap().into_rgb8();
    assert_eq!(picture.dimensions(), size);
    let first = picture.get_pixel(0, 0);
    assert!(picture.pixels().any(|pixel| pixel != first), "{} has one colour", path.display());
}

/// Writes the built-in scene as photographs.
fn write_photographs(folder: &Path) {
    let config = trimip::settings::defaults().with("data.builtin_size", 16).unwrap();
    let config = config.with("data.builtin_train", 4).unwrap().with("data.builtin_test", 1).unwrap();
    let config = trimip::Config::from_settings(&config).unwrap();
    trimip::data::write_builtin(&config.section().unwrap(), folder, &trimip::data::unwatched).unwrap();
}

#[test]
fn the_readme_shows_a_function_that_runs() {
    let read =
        |file: &str| std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap();
    let readme = read("../README.md");
    let shown = readme.split("```rust\n").nth(1).and_then(|rest| rest.split("```").next());
    let shown = shown.expect("the README has a block of Rust");
    assert!(
        read("examples/first.rs").ends_with(shown),
        "the README's function is not that of the example:\n{shown}"
    );

    let temporary = tempfile::tempdir().unwrap();
    let photographs = temporary.path().join("photographs");
    write_photographs(&photographs);
    first::first(photographs.to_str().unwrap(), 3.0, temporary.path()).unwrap();
    expect_picture(&temporary.path().join("view.png"), (16, 16));
}

#[test]
fn one_example_trains_and_the_other_renders() {
    let temporary = tempfile::tempdir().unwrap();
    let arguments: Vec<String> = TINY.map(String::from).into();
    let folder = temporary.path().join("run");
    train::run(&arguments, &folder).unwrap();
    expect_picture(&folder.join("view.png"), (16, 16));

    let picture = temporary.path().join("other.png");
    render::run(&[&folder, &picture].map(|path| path.display().to_string())).unwrap();
    expect_picture(&picture, (64, 48));
    assert_eq!(render::run(&[]).unwrap_err().kind(), trimip_core::ErrorKind::Input);

    // A folder of photographs is the first argument.
    let photographs = temporary.path().join("photographs");
    write_photographs(&photographs);
    let again = temporary.path().join("again");
    train::run(&[vec![photographs.display().to_string()], arguments].concat(), &again).unwrap();
    expect_picture(&again.join("view.png"), (16, 16));
}

#[test]
fn a_training_loop_of_ones_own_learns() {
    let mut config = trimip::Config::default();
    config.encoder.plane_size = 64;
    config.encoder.levels = 4;
    config.field.hidden = 16;
    config.train.samples_per_step = 4096;
    let small = |data: &mut trimip::data::DataConfig| {
        data.format = "builtin".into();
        (data.builtin_size, data.builtin_train, data.builtin_test) = (16, 8, 1);
    };
    config.change(small).unwrap();
    let [first, last] = [1, 150].map(|steps| training_loop::train(&config, steps).unwrap());
    assert!(last < 0.5 * first, "{first} after one step, {last} after 150");
}

#[test]
fn a_model_has_a_mesh_and_densities() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path().join("run");
    let arguments =
        ["data.builtin_size=32", "data.builtin_train=12", "encoder.plane_size=64", "train.steps=300"];
    let arguments: Vec<String> = TINY.iter().chain(&arguments).map(|&argument| argument.into()).collect();
    train::run(&arguments, &folder).unwrap();
    let mesh = mesh::extract(&folder, 32).unwrap();
    assert!(mesh.triangles.len() > 100, "{} triangles", mesh.triangles.len());
    // The model is denser behind the surface than in front of it.
    let beside = |distance: f32| {
        let vertices = mesh.positions.iter().zip(&mesh.normals);
        let point = |(position, normal): (&[f32; 3], &[f32; 3])| {
            std::array::from_fn(|axis| f64::from(position[axis] + distance * normal[axis]))
        };
        let found = query::query(&folder, &vertices.map(point).collect::<Vec<_>>(), 0.02).unwrap();
        found.iter().map(|radiance| radiance.density).sum::<f32>() / found.len() as f32
    };
    let [behind, before] = [-0.05, 0.05].map(beside);
    assert!(behind > 1.5 * before, "mean densities {behind} behind the surface, {before} in front of it");
}

#[test]
fn a_loss_of_ones_own_acts_by_its_weight_and_belongs_to_the_run() {
    use own_loss::Entropy;
    let temporary = tempfile::tempdir().unwrap();
    let defaults = trimip::Config::default().loss;
    trimip::losses::verify::pixel_term(&Entropy { weight: 1.0 }, &defaults).unwrap();
    let train = |weight: &str, folder: &str| {
        let weight = format!("entropy.weight={weight}");
        let assignments = [&TINY[..], &["train.steps=200", &weight]].concat();
        own_loss::train(&assignments, &temporary.path().join(folder))
    };
    let [off, strong] =
        [("0", "off"), ("1", "strong")].map(|(weight, folder)| train(weight, folder).unwrap());
    assert!(strong < 0.5 * off, "mean entropy {off} without the term, {strong} with it");

    // The setting is in the run folder, and a resumed run cannot change it.
    let config = std::fs::read_to_string(temporary.path().join("strong/config.toml")).unwrap();
    assert!(config.ends_with("[entropy]\nweight = 1.0\n"), "{config}");
    let error = train("0.5", "strong").unwrap_err();
    assert!(error.message().contains("entropy.weight is 0.5, was 1"), "{error}");

    // A term with the weight 0 changes no bit.
    let plain = temporary.path().join("plain");
    let arguments: Vec<String> =
        TINY.iter().chain(&["train.steps=200"]).map(|&argument| argument.into()).collect();
    train::run(&arguments, &plain).unwrap();
    let [with, without] =
        [temporary.path().join("off"), plain].map(|folder| trimip::read_model(&folder).unwrap().file);
    assert_eq!(with.tensors, without.tensors);
}
