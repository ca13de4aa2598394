//! Tests of masks: where they are found, their meaning, and the pixels that they do not keep.

use crate::common::{frame, settings, write};
use image::{DynamicImage, ImageBuffer, Luma, Rgb};
use serde_json::{Value, json};
use std::path::Path;
use trimip_core::{Alpha, config::Convention};
use trimip_data::settings::{DataConfig, MaskKeeps, MaskRole};
use trimip_data::{Scene, inspect, open, open_test, unwatched, write_multiscale};

const SIZE: (u32, u32) = (16, 12);

/// Writes a photograph whose pixels where `hidden` is true have the colour `garbage`.
fn photograph(path: &Path, hidden: impl Fn(u32, u32) -> bool, garbage: [u8; 3]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let pixel = |x, y| if hidden(x, y) { Rgb(garbage) } else { Rgb([10 * x as u8, 20 * y as u8, 200]) };
    DynamicImage::from(ImageBuffer::from_fn(SIZE.0, SIZE.1, pixel)).save(path).unwrap();
}

/// Writes a mask that is white where `white` is true.
fn mask(path: &Path, (width, height): (u32, u32), white: impl Fn(u32, u32) -> bool) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let pixel = |x, y| Luma([if white(x, y) { 255_u8 } else { 0 }]);
    DynamicImage::from(ImageBuffer::from_fn(width, height, pixel)).save(path).unwrap();
}

fn left(x: u32, _: u32) -> bool {
    x < 7
}

fn right(x: u32, y: u32) -> bool {
    !left(x, y)
}

fn middle(x: u32, y: u32) -> bool {
    (4..12).contains(&x) && (3..9).contains(&y)
}

/// Writes a scene of four photographs `images/a/0.png` .. whose left parts have the colour `garbage`; `edit` changes its frames.
fn scene(root: &Path, garbage: [u8; 3], edit: impl Fn(usize, &mut Value)) {
    let mut frames = Vec::new();
    for i in 0..4 {
        let name = format!("images/a/{i}.png");
        photograph(&root.join(&name), left, garbage);
        let mut entry = frame(&name);
        edit(i, &mut entry);
        frames.push(entry);
    }
    write(&root.join("transforms.json"), &json!({ "camera_angle_x": 0.7, "frames": frames }));
}

fn with(root: &Path, change: impl Fn(&mut DataConfig)) -> DataConfig {
    let mut config = settings(root, 3);
    change(&mut config);
    config
}

fn pixel(scene: &Scene, x: usize, y: usize) -> [u8; 4] {
    scene.train.pixels_of(0)[y * SIZE.0 as usize + x]
}

#[test]
fn masks_are_found_wherever_tools_put_them_and_mean_what_they_mean_there() {
    type Place = fn(usize) -> String;
    // Path of the mask, whether its left part is white, and the resulting meaning of alpha.
    let cases: [(Place, bool, Alpha); 10] = [
        (|i| format!("masks/a/{i}.png"), false, Alpha::Straight),
        (|i| format!("masks/a/{i}.png.png"), false, Alpha::Straight),
        (|i| format!("masks/{i}.png"), false, Alpha::Straight),
        (|i| format!("masks/images/a/{i}.png"), false, Alpha::Straight),
        (|i| format!("images/a/dynamic_mask_{i}.png"), true, Alpha::Kept),
        (|i| format!("stated/m{i}.png"), false, Alpha::Kept),
        (|i| format!("other/a/{i}.png"), false, Alpha::Straight),
        (|i| format!("masks/a/{i}.webp"), false, Alpha::Straight),
        (|i| format!("masks/a/{i}.png.tif"), false, Alpha::Straight),
        (|i| format!("masks/{i}.bmp"), false, Alpha::Straight),
    ];
    for (number, (place, white_left, alpha)) in cases.into_iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        scene(root, [90, 91, 92], |i, entry| {
            if number == 5 {
                entry["mask_path"] = json!(place(i));
            }
        });
        (0..4).for_each(|i| mask(&root.join(place(i)), SIZE, if white_left { left } else { right }));
        let config = with(root, |config| {
            if number == 6 {
                config.masks = "other".into();
            }
        });
        let found = open(&config).unwrap();
        assert_eq!(found.train.alpha, alpha, "case {number}");
        assert_eq!((pixel(&found, 3, 2), pixel(&found, 8, 2)), ([0; 4], [80, 40, 200, 255]), "case {number}");
        let line = found.description.last().unwrap();
        let rest = if alpha == Alpha::Kept { "neither trained nor evaluated" } else { "empty space" };
        let colour = if white_left { "black is kept" } else { "white is kept" };
        for part in ["masks of 3 of 3 photographs", rest, colour, "56.2 % of the pixels"] {
            assert!(line.contains(part), "case {number}: {part}: {line}");
        }
        assert!(!found.warnings.iter().any(|warning| warning.contains("mask of")), "{:?}", found.warnings);
        // Test frames are masked like training frames.
        let test = open_test(&config).unwrap().frames.load(0).unwrap();
        assert_eq!(
            (test.alpha, test.pixels_of(0)[3], test.pixels_of(0)[8]),
            (alpha, [0; 4], [80, 0, 200, 255])
        );
        // A photograph may be in the training and the test split.
        let both =
            with(root, |c| (c.train, c.masks) = (vec!["train".into(), "test".into()], config.masks.clone()));
        assert_eq!(open(&both).unwrap().train.alpha, alpha);
        // With `data.masks` = "none", no mask is applied.
        let without = open(&with(root, |config| config.masks = "none".into())).unwrap();
        assert_eq!((without.train.alpha, pixel(&without, 3, 2)), (Alpha::Straight, [90, 91, 92, 255]));
    }
}

#[test]
fn colours_of_what_is_not_kept_have_no_part_in_any_pixel() {
    for (role, convention) in [
        (MaskRole::Ignore, Convention::Public),
        (MaskRole::Ignore, Convention::Premultiplied),
        (MaskRole::Object, Convention::Public),
        (MaskRole::Object, Convention::Premultiplied),
    ] {
        let sets = [[0, 0, 0], [255, 255, 255], [3, 141, 59]].map(|garbage| {
            let folder = tempfile::tempdir().unwrap();
            scene(folder.path(), garbage, |_, _| ());
            (0..4).for_each(|i| mask(&folder.path().join(format!("masks/{i}.png")), SIZE, right));
            let config =
                with(folder.path(), |config| (config.mask_role, config.convention) = (role, convention));
            open(&config).unwrap().train
        });
        assert!(sets[0].pixels == sets[1].pixels && sets[0].pixels == sets[2].pixels);
        if role == MaskRole::Ignore {
            // At scale 1/2, column 3 covers the masked column 6 and the kept column 7. Its colour is that of column 7:
            // red 10·7, and green the mean of rows 0 and 1.
            let view = sets[0].scales[1].views.start;
            assert_eq!(sets[0].pixels_of(view)[3], [70, 10, 200, 128]);
        }
    }
}

#[test]
fn settings_override_polarity_and_role() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path(), [1, 2, 3], |_, _| ());
    (0..4).for_each(|i| mask(&folder.path().join(format!("masks/{i}.png")), SIZE, right));
    let black = open(&with(folder.path(), |config| config.mask_keeps = MaskKeeps::Black)).unwrap();
    assert_eq!((pixel(&black, 3, 2), pixel(&black, 8, 2)), ([1, 2, 3, 255], [0; 4]));
    let ignored = with(folder.path(), |config| config.mask_role = MaskRole::Ignore);
    assert_eq!(open(&ignored).unwrap().train.alpha, Alpha::Kept);
    // The multi-scale layout can store empty space, but not unknown pixels.
    let out = tempfile::tempdir().unwrap();
    let error = write_multiscale(&ignored, &out.path().join("a"), &unwatched).unwrap_err();
    assert!(
        error.kind() == trimip_core::ErrorKind::Input && error.message().starts_with("data.mask_role: "),
        "{error}"
    );
    let object = with(folder.path(), |_| ());
    write_multiscale(&object, &out.path().join("b"), &unwatched).unwrap();
    let again = open(&settings(&out.path().join("b"), 3)).unwrap();
    assert!(again.train.pixels == open(&object).unwrap().train.pixels);
}

#[test]
fn masks_that_look_wrong_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scene(root, [1, 2, 3], |_, _| ());
    let warnings = |config: &DataConfig| {
        let scene = open(config).unwrap();
        let lines = inspect(config, &unwatched).unwrap().join("\n");
        assert!(scene.warnings.iter().all(|warning| lines.contains(warning)), "{lines}");
        scene.warnings.join("\n")
    };
    let write = |white: &dyn Fn(usize, u32, u32) -> bool| {
        (0..4).for_each(|i| mask(&root.join(format!("masks/{i}.png")), SIZE, |x, y| white(i, x, y)));
    };
    write(&|_, x, y| !middle(x, y));
    let inverted = warnings(&with(root, |_| ()));
    assert!(inverted.contains("are they inverted? see data.mask_keeps"), "{inverted}");
    assert!(!warnings(&with(root, |config| config.mask_keeps = MaskKeeps::Black)).contains("inverted"));
    assert!(!warnings(&with(root, |config| config.mask_role = MaskRole::Ignore)).contains("inverted"));
    // Frames 1 to 3 are training frames.
    write(&|i, x, y| i == 1 || (i == 3 && middle(x, y)));
    let odd = warnings(&with(root, |_| ()));
    assert!(odd.contains("keep nothing of the photograph: 1, the first that of 2"), "{odd}");
    assert!(odd.contains("keep all of the photograph: 1, the first that of 1"), "{odd}");
    // A photograph without a mask is kept whole.
    std::fs::remove_file(root.join("masks/3.png")).unwrap();
    let missing = warnings(&with(root, |_| ()));
    assert!(
        missing.contains("1 of 4 photographs, the first 3, have no mask and are kept whole"),
        "{missing}"
    );
    // A folder of masks that fits no photograph gives a warning, because its owner expects the masks to be used.
    (0..3).for_each(|i| std::fs::remove_file(root.join(format!("masks/{i}.png"))).unwrap());
    mask(&root.join("masks/mask_0.png"), SIZE, middle);
    assert!(warnings(&with(root, |_| ())).contains("holds no mask of a photograph"));
}

#[test]
fn broken_masks_are_one_line_that_names_file_and_remedy() {
    type Break = fn(&Path, &mut DataConfig);
    let cases: [(Break, &[&str]); 8] = [
        (
            |root, _| mask(&root.join("masks/1.png"), (8, 6), left),
            &[
                "frame 1 (images/a/1.png): mask",
                "masks/1.png is 8x6 pixels, but image",
                "16x12",
                "data.masks = \"none\"",
            ],
        ),
        (
            |root, _| std::fs::write(root.join("masks/1.png"), "no picture").unwrap(),
            &["frame 1 (images/a/1.png)", "masks/1.png cannot be decoded"],
        ),
        (
            |root, _| scene(root, [0; 3], |i, entry| entry["mask_path"] = json!(format!("m{i}.png"))),
            &["frame 1 (images/a/1.png)", "m1.png does not exist", "remove \"mask_path\""],
        ),
        (
            |root, _| scene(root, [0; 3], |_, entry| entry["mask_path"] = json!(7)),
            &["frame 1 (images/a/1.png)", "\"mask_path\" is 7; expected a text"],
        ),
        (|_, config| config.masks = "nowhere".into(), &["data.masks = \"nowhere\"", "is not a folder"]),
        (
            |_, config| config.masks = "images".into(),
            &["data.masks = \"images\"", "holds no mask of 4 photographs: looked for", "1.png.png"],
        ),
        (
            |root, _| {
                std::fs::remove_file(root.join("masks/1.png")).unwrap();
                mask(&root.join("images/a/dynamic_mask_1.png"), SIZE, left);
            },
            &["marks an object", "dynamic_mask_1.png", "set data.mask_role"],
        ),
        (
            |root, _| {
                let frames: Vec<Value> = ["images/a/0.png", "images/b/0.png"].map(frame).to_vec();
                photograph(&root.join("images/b/0.png"), left, [0; 3]);
                write(&root.join("transforms.json"), &json!({ "camera_angle_x": 0.7, "frames": frames }));
            },
            &["masks/0.png would also be the mask of", "images/", "the same subfolders"],
        ),
    ];
    for (number, (breaking, parts)) in cases.into_iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        scene(folder.path(), [0; 3], |_, _| ());
        (0..4).for_each(|i| mask(&folder.path().join(format!("masks/{i}.png")), SIZE, right));
        let mut config = settings(folder.path(), 1);
        breaking(folder.path(), &mut config);
        let error = open(&config).expect_err(&format!("case {number}"));
        assert!(error.kind() == trimip_core::ErrorKind::Input && !error.message().contains('\n'), "{error}");
        for part in parts {
            assert!(error.message().contains(part), "case {number}: {part}: {error}");
        }
    }
}

#[test]
fn alpha_cannot_mean_two_things() {
    let folder = tempfile::tempdir().unwrap();
    scene(folder.path(), [0; 3], |i, entry| entry["mask_path"] = json!(format!("m{i}.png")));
    (0..4).for_each(|i| mask(&folder.path().join(format!("m{i}.png")), SIZE, right));
    crate::common::save_image(&folder.path().join("images/a/2.png"), SIZE.0, SIZE.1);
    let error = open(&settings(folder.path(), 1)).unwrap_err();
    for part in
        ["images/a/2.png has transparent pixels", "alpha cannot mean both", "data.mask_role = \"object\""]
    {
        assert!(
            error.kind() == trimip_core::ErrorKind::Input && error.message().contains(part),
            "{part}: {error}"
        );
    }
    // With the role of an object, a pixel is kept if both mask and alpha keep it.
    let config = with(folder.path(), |config| config.mask_role = MaskRole::Object);
    let object = open(&config).unwrap();
    let (whole, kept) = (open(&with(folder.path(), |c| c.masks = "none".into())).unwrap(), &object.train);
    for (i, (kept, whole)) in kept.pixels_of(1).iter().zip(whole.train.pixels_of(1)).enumerate() {
        assert_eq!(*kept, if i % 16 < 7 { [0; 4] } else { *whole });
    }
}
