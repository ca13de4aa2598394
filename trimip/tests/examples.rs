//! Runs the examples: two train and write a picture, the third renders a model. The README shows the function of the first one.

#[allow(dead_code)]
#[path = "../examples/first.rs"]
mod first;
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
