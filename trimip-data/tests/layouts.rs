//! Tests of layouts: a scene that one layout writes reads back the same, and the views are those that the files state.

use crate::common::{assert_same, blender_scene, frame, save_image, settings, write};
use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_core::{Alpha, Lens, ViewSet, config::Convention};
use trimip_data::settings::{DataConfig, HoldoutBy, PixelStore};
use trimip_data::{
    Watch, builtin, inspect, open, open_test, open_watched, unwatched, write_builtin, write_multiscale,
};

#[test]
fn frames_override_the_file_and_defaults_fill_in() {
    let folder = tempfile::tempdir().unwrap();
    blender_scene(folder.path());
    let path = folder.path().join("transforms_train.json");
    let mut document: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    document["camera_angle_y"] = json!(0.5);
    let second = &mut document["frames"][1];
    (second["fl_x"], second["cy"], second["w"]) = (json!(30.0), json!(5.5), json!(16.0));
    write(&path, &document);
    let scene = open(&settings(folder.path(), 2)).unwrap();
    let [first, second] = [0, 1].map(|view| scene.train.views[view].camera.intrinsics);
    assert_eq!(first.fx, 8.0 / 0.35_f64.tan());
    assert_eq!(first.fy, 6.0 / 0.25_f64.tan());
    assert_eq!((first.cx, first.cy), (8.0, 6.0));
    assert_eq!((second.fx, second.fy, second.cx, second.cy), (30.0, 30.0, 8.0, 5.5));
    assert_eq!(scene.train.views[3].camera.intrinsics, second.reduced(1));
    assert_eq!(scene.train.views[2].camera.origin.to_array(), [0.1, -4.0, 0.3]);
    assert_eq!(scene.train.scales[1].views, 2..4);
    assert_eq!(scene.train.scales[1].pixels, 2 * 16 * 12..2 * (16 * 12 + 8 * 6));
    assert_eq!((scene.test.len(), scene.train.views[1].name.as_str()), (2, "r_1"));
    // Frames loaded one at a time equal those loaded at once.
    let frame = scene.test.load(1).unwrap();
    assert_eq!(frame.pixels_of(1), scene.train.pixels_of(3));
    assert!(scene.test.load(2).is_err());
}

#[test]
fn sizes_may_differ_where_the_angle_is_shared() {
    let folder = tempfile::tempdir().unwrap();
    blender_scene(folder.path());
    save_image(&folder.path().join("train/r_1.png"), 9, 30);
    let scene = open(&settings(folder.path(), 3)).unwrap();
    let sizes: Vec<(u32, u32)> = scene
        .train
        .views
        .iter()
        .map(|view| (view.camera.intrinsics.width, view.camera.intrinsics.height))
        .collect();
    assert_eq!(sizes, [(16, 12), (9, 30), (8, 6), (4, 15), (4, 3), (2, 7)]);
    assert_eq!(scene.train.views[5].offset, scene.train.pixels.len() - 14);
    assert!(scene.description[1].contains("2 sizes from 9x30 to 16x12"), "{:?}", scene.description);
}

#[test]
fn frames_kept_back_are_tested_on_and_not_trained_on() {
    let folder = tempfile::tempdir().unwrap();
    blender_scene(folder.path());
    let mut config = settings(folder.path(), 2);
    let whole = open(&config).unwrap();
    config.holdout = 2;
    let scene = open(&config).unwrap();
    let frames = whole.train.scales[0].views.len();
    assert_eq!((scene.test.len(), scene.train.scales[0].views.len()), (frames.div_ceil(2), frames / 2));
    let held = scene.test.load(0).unwrap();
    assert_eq!(
        (held.views[0].name.as_str(), held.pixels_of(0)),
        (whole.train.views[0].name.as_str(), whole.train.pixels_of(0))
    );
    assert_eq!(scene.train.pixels_of(0), whole.train.pixels_of(1));
    assert!(scene.description[0].contains("(one frame in 2 of"), "{}", scene.description[0]);
    // With `data.holdout`, the test split is not read, so it need not exist.
    config.test = "nowhere".into();
    assert!(open(&config).is_ok());
    config.train = vec!["train".into()];
    config.holdout = 100;
    assert!(open(&config).is_ok());
}

#[test]
fn an_undivided_file_holds_out_every_eighth_frame() {
    let folder = tempfile::tempdir().unwrap();
    let paths: Vec<String> = (0..10).map(|i| format!("images/{i:04}.png")).collect();
    for path in &paths {
        save_image(&folder.path().join(path), 8, 8);
    }
    let frames: Vec<Value> = paths.iter().map(|path| frame(path)).collect();
    write(
        &folder.path().join("transforms.json"),
        &json!({ "fl_x": 10.0, "k1": 0.05, "k2": 0.0, "frames": frames }),
    );
    let scene = open(&settings(folder.path(), 1)).unwrap();
    let names: Vec<&str> = scene.train.views.iter().map(|view| view.name.as_str()).collect();
    assert_eq!(names, ["0001", "0002", "0003", "0004", "0005", "0006", "0007", "0009"]);
    assert_eq!(scene.test.len(), 2);
    assert_eq!(scene.test.load(1).unwrap().views[0].name, "0008");
    assert!(scene.description.iter().any(|line| line.contains("every 8th frame")), "{:?}", scene.description);
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    // Each view has the lens of the file, at every scale.
    let bent = Lens::perspective([0.05, 0.0, 0.0, 0.0], [0.0; 2], [0.0; 3]);
    assert!(scene.train.views.iter().all(|view| view.camera.intrinsics.lens == bent));
}

/// Returns a transforms file without splits, whose 16 cameras lie on a ring, every 22.5° in order. Saves the photographs.
fn ring(root: &Path) -> Value {
    let frames: Vec<Value> = (0..16)
        .map(|i| {
            let path = format!("images/{i:04}.png");
            save_image(&root.join(&path), 8, 8);
            let (y, x) = (f64::from(i) * 22.5).to_radians().sin_cos();
            // The camera looks along -z of its axes, at the origin; z of the world is up.
            let rows =
                [[-y, 0.0, x, 4.0 * x], [x, 0.0, y, 4.0 * y], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]];
            json!({ "file_path": path, "transform_matrix": rows })
        })
        .collect();
    json!({ "fl_x": 10.0, "frames": frames })
}

#[test]
fn a_sector_of_the_cameras_is_held_out_where_the_files_state_no_test_frames() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("transforms.json");
    let mut file = ring(folder.path());
    write(&path, &file);
    let mut config = DataConfig { holdout_by: HoldoutBy::Sector, ..settings(folder.path(), 1) };
    let tested = |config: &DataConfig| -> Vec<String> {
        let scene = open(config).unwrap();
        assert_eq!(scene.train.views.len() + scene.test.len(), 16);
        assert!(
            scene.train.views.iter().all(|view| scene.test_views.iter().all(|(name, _)| *name != view.name))
        );
        scene.test_views.into_iter().map(|(name, _)| name).collect()
    };
    // One frame in eight is held out: the first camera and one of its neighbours.
    let two = tested(&config);
    assert!(two == ["0000", "0001"] || two == ["0000", "0015"], "{two:?}");
    for (holdout, expected) in [
        (16, &["0000"][..]),
        (6, &["0000", "0001", "0015"]),
        (2, &["0000", "0001", "0002", "0003", "0013", "0014", "0015"]),
    ] {
        config.holdout = holdout;
        let found = tested(&config);
        assert_eq!(found.len(), 16_usize.div_ceil(holdout as usize));
        assert!(expected.iter().all(|name| found.iter().any(|other| other == name)), "{holdout}: {found:?}");
    }
    let scene = open(&config).unwrap();
    let told = |part: &str| scene.description.iter().any(|line| line.contains(part));
    assert!(
        told("held out as one sector") && told("within 90° of the first camera"),
        "{:?}",
        scene.description
    );
    assert!(!told("every 8th"), "{:?}", scene.description);
    assert!(open_test(&config).unwrap().frames.len() == scene.test.len());
    // Test frames that the file states are not replaced silently.
    config.holdout = 0;
    let names: Vec<String> = (0..16).map(|i| format!("images/{i:04}.png")).collect();
    (file["train_filenames"], file["test_filenames"]) = (json!(names[..12]), json!(names[12..]));
    write(&path, &file);
    let error = open(&config).unwrap_err();
    assert!(
        error.kind() == trimip_core::ErrorKind::Input
            && error.message().contains("data.holdout_by: is \"sector\""),
        "{error}"
    );
    assert!(
        error.message().contains("its split \"test\"") && error.message().contains("set data.holdout"),
        "{error}"
    );
    config.holdout = 4;
    let scene = open(&config).unwrap();
    assert_eq!((scene.train.views.len(), scene.test.len()), (9, 3), "of the training frames");
    config = DataConfig { holdout: 0, test_list: "test.txt".into(), ..config };
    let message = open(&config).unwrap_err().message();
    assert!(message.contains("data.test_list") && message.contains("data.holdout_by"), "{message}");
    // A folder without test frames is treated like a file without splits.
    fs::remove_file(&path).unwrap();
    write(&folder.path().join("transforms_train.json"), &ring(folder.path()));
    config.test_list = String::new();
    let scene = open(&config).unwrap();
    assert_eq!((scene.train.views.len(), scene.test.len()), (14, 2));
    assert!(
        scene.warnings.iter().any(|line| line.contains("one training frame in 8")),
        "{:?}",
        scene.warnings
    );
    config.holdout = 1000;
    assert_eq!(tested(&config), ["0000"]);
}

#[test]
fn splits_are_concatenated_and_shared_ones_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    blender_scene(folder.path());
    let mut data = settings(folder.path(), 2);
    data.train = vec!["train".into(), "test".into()];
    let scene = open(&data).unwrap();
    assert_eq!(scene.train.views.len(), 8);
    assert!(scene.warnings.iter().any(|w| w.contains("both trained and tested on")), "{:?}", scene.warnings);
}

#[test]
fn a_written_multiscale_set_reads_back_the_same() {
    // Per-frame focal lengths that differ in x and y, and principal points off the centre.
    let folder = tempfile::tempdir().unwrap();
    blender_scene(folder.path());
    let path = folder.path().join("transforms_train.json");
    let mut document: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    for (i, frame) in document["frames"].as_array_mut().unwrap().iter_mut().enumerate() {
        (frame["fl_x"], frame["fl_y"]) = (json!(20.1 + i as f64), json!(19.7));
        (frame["cx"], frame["cy"]) = (json!(8.037), json!(5.951));
        (frame["k1"], frame["p2"]) = (json!(0.01 * i as f64), json!(-0.002));
    }
    write(&path, &document);
    let mut builtin = settings(folder.path(), 4);
    builtin.format = "builtin".into();
    (builtin.builtin_size, builtin.builtin_train, builtin.builtin_test) = (17, 5, 3);
    for config in [settings(folder.path(), 3), builtin] {
        let written = tempfile::tempdir().unwrap();
        let summary = write_multiscale(&config, written.path(), &unwatched).unwrap();
        let (ours, theirs) =
            (open(&config).unwrap(), open(&settings(written.path(), config.scales)).unwrap());
        assert_same(&ours.train, &theirs.train);
        assert_eq!(ours.test.len(), theirs.test.len());
        for index in 0..ours.test.len() {
            assert_same(&ours.test.load(index).unwrap(), &theirs.test.load(index).unwrap());
        }
        assert_eq!(summary.images, ours.train.views.len() + ours.test.len() * config.scales as usize);
        // The written set contains held-out frames like all others.
        let again = tempfile::tempdir().unwrap();
        let held = DataConfig { holdout: 2, ..config.clone() };
        assert_eq!(write_multiscale(&held, again.path(), &unwatched).unwrap().images, summary.images);
        // A set is never overwritten.
        assert!(
            write_multiscale(&config, written.path(), &unwatched)
                .unwrap_err()
                .message()
                .contains("exists already")
        );
        // Fewer scales of the set equal fewer scales of the source.
        let mut fewer = config.clone();
        fewer.scales = 2;
        assert_same(&open(&fewer).unwrap().train, &open(&settings(written.path(), 2)).unwrap().train);
    }
}

#[test]
fn frames_and_their_views_have_the_names_of_photographs() {
    let (folder, set) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    blender_scene(folder.path());
    write_multiscale(&settings(folder.path(), 2), set.path(), &unwatched).unwrap();
    let mut builtin = settings(Path::new(""), 2);
    builtin.format = "builtin".into();
    (builtin.builtin_size, builtin.builtin_train, builtin.builtin_test) = (8, 2, 2);
    let cases = [
        (settings(folder.path(), 2), ["r_0", "r_1"]),
        // The files of all scales of a frame have one name.
        (settings(set.path(), 2), ["000", "001"]),
        (builtin, ["r_0", "r_1"]),
    ];
    for (config, names) in cases {
        let scene = open_test(&config).unwrap();
        for frames in [&scene.frames, &scene.photographs] {
            assert_eq!(frames.names(), names);
            for (index, name) in names.into_iter().enumerate() {
                let views = frames.load(index).unwrap().views;
                assert!(views.len() == 2 && views.iter().all(|view| view.name == name), "{views:?}");
            }
        }
    }
}

#[test]
fn the_public_layout_has_its_columns() {
    let (folder, set) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    blender_scene(folder.path());
    let summary = write_multiscale(&settings(folder.path(), 2), set.path(), &unwatched).unwrap();
    assert_eq!((summary.images, &summary.splits[1]), (8, &("test".to_string(), 2)));
    let document: Value =
        serde_json::from_slice(&fs::read(set.path().join("metadata.json")).unwrap()).unwrap();
    let train = document["train"].as_object().unwrap();
    let mut keys: Vec<&str> = train.keys().map(String::as_str).collect();
    keys.sort_unstable();
    let public =
        ["cam2world", "far", "file_path", "focal", "height", "label", "lossmult", "near", "pix2cam", "width"];
    assert_eq!(keys, public);
    let entry = |key: &str| &train[key][3];
    assert_eq!(entry("file_path"), "images_train/001_d1.png");
    assert_eq!((entry("label"), entry("lossmult")), (&json!(1), &json!(4.0)));
    assert_eq!((entry("near"), entry("far"), entry("height")), (&json!(2.0), &json!(6.0), &json!(6)));
    assert!(set.path().join("images_test/001_d1.png").is_file());
}

#[test]
fn the_built_in_scene_written_as_files_is_the_same_scene() {
    let mut config = settings(Path::new(""), 3);
    config.format = "builtin".into();
    (config.builtin_size, config.builtin_train, config.builtin_test) = (24, 3, 2);
    for convention in [Convention::Public, Convention::Premultiplied] {
        config.convention = convention;
        let folder = tempfile::tempdir().unwrap();
        let summary = write_builtin(&config, folder.path(), &unwatched).unwrap();
        assert_eq!(summary.images, 5);
        let mut files = settings(folder.path(), 3);
        files.convention = convention;
        let (ours, theirs) = (open(&config).unwrap(), open(&files).unwrap());
        assert_eq!((ours.name.as_str(), ours.train.alpha), ("builtin", Alpha::from(convention)));
        assert_same(&ours.train, &theirs.train);
        for index in 0..2 {
            assert_same(&ours.test.load(index).unwrap(), &theirs.test.load(index).unwrap());
        }
        let camera = ours.train.views[0].camera;
        if convention == Convention::Public {
            assert_eq!(
                ours.train.pixels_of(0),
                builtin::render(&camera, config.builtin_supersampling, config.builtin_finish, &|| ())
            );
        }
        assert!(write_builtin(&config, folder.path(), &unwatched).is_err());
    }
}

#[test]
fn progress_begins_at_nothing_rises_and_ends_with_every_row() {
    let (folder, set) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    blender_scene(folder.path());
    let mut rendered = settings(Path::new(""), 2);
    rendered.format = "builtin".into();
    (rendered.builtin_size, rendered.builtin_train, rendered.builtin_test) = (24, 3, 2);
    let photographs = settings(folder.path(), 2);
    let rows = |views: &ViewSet| {
        let finest = views.scales[0].views.clone();
        finest.map(|view| u64::from(views.views[view].camera.intrinsics.height)).sum::<u64>()
    };
    let train = rows(&open(&photographs).unwrap().train);
    let watched = |work: &dyn Fn(Watch<'_>)| {
        let told = std::sync::Mutex::new(Vec::new());
        work(&|done, total| {
            told.lock().unwrap().push((done, total));
            true
        });
        let mut told = told.into_inner().unwrap();
        assert_eq!(told[0].0, 0);
        // Threads report in any order.
        told.sort_unstable();
        told.dedup();
        (told.len(), *told.last().unwrap())
    };
    let read = watched(&|watch| drop(open_watched(&photographs, watch).unwrap()));
    assert_eq!(read, (1 + open(&photographs).unwrap().train.scales[0].views.len(), (train, train)));
    assert_eq!(watched(&|watch| drop(inspect(&photographs, watch).unwrap())), read);
    // Every row that is rendered is reported: three views, then those and two more.
    assert_eq!(watched(&|watch| drop(open_watched(&rendered, watch).unwrap())), (73, (72, 72)));
    let built = set.path().join("built");
    assert_eq!(watched(&|watch| drop(write_builtin(&rendered, &built, watch).unwrap())), (121, (120, 120)));
    let written = watched(&|watch| drop(write_multiscale(&photographs, set.path(), watch).unwrap()));
    assert!(written.1.0 == written.1.1 && written.1.0 > train, "{written:?}");
}

#[test]
fn a_multiscale_set_cannot_be_premultiplied_after_the_fact() {
    let (folder, set) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    blender_scene(folder.path());
    write_multiscale(&settings(folder.path(), 2), set.path(), &unwatched).unwrap();
    let mut config = settings(set.path(), 2);
    config.convention = Convention::Premultiplied;
    assert!(open(&config).unwrap_err().message().starts_with("data.convention: "));
    config.convention = Convention::Public;
    config.scales = 4;
    assert!(
        open(&config).unwrap().warnings[0]
            .contains("has images of 2 of the 4 scales that data.scales asks for")
    );
}

#[test]
fn inspection_names_splits_sizes_cameras_and_warnings() {
    let folder = tempfile::tempdir().unwrap();
    blender_scene(folder.path());
    let lines = inspect(&settings(folder.path(), 2), &unwatched).unwrap().join("\n");
    for expected in [
        "2 training views (train 2), 2 test views (test)",
        "16x12",
        "focal length",
        "4.01 from the origin",
        "clear",
    ] {
        assert!(lines.contains(expected), "{expected}:\n{lines}");
    }
}

#[test]
fn photographs_on_disk_are_the_same_photographs() {
    let mut data = settings(Path::new(""), 4);
    data.format = "builtin".into();
    (data.builtin_size, data.builtin_train, data.builtin_test) = (32, 3, 1);
    let [memory, disk] = [PixelStore::Memory, PixelStore::Disk]
        .map(|pixels| open(&DataConfig { pixels, ..data.clone() }).unwrap());
    assert_eq!(memory.train.pixels, disk.train.pixels);
    assert_eq!((memory.train.pixels.bytes_in_memory(), disk.train.pixels.bytes_in_memory()), (4 * 4080, 0));
    assert!(memory.description.iter().any(|line| line.contains("in memory")));
    assert!(disk.description.iter().any(|line| line.contains("in a file")));
}
