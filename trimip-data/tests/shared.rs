//! Tests on the shared photographs: the public multi-scale set bit for bit, and scenes from other sources. If the
//! folder (`TRIMIP_SHARED`) does not exist, each test prints that and passes.

use crate::common::{settings, shared};
use glam::DVec3;
use trimip_core::{Alpha, Camera, config::Convention};
use trimip_data::settings::DataConfig;
use trimip_data::{Scene, inspect, open};

#[test]
fn levels_are_the_public_converters_bit_for_bit() {
    let (Some(lego), Some(reference)) = (shared("lego"), shared("lego_multiscale_ref")) else { return };
    let scene = open(&settings(&lego, 4)).unwrap();
    let frames = scene.train.scales[0].views.len();
    let mut compared = 0;
    for (split, indices) in [("train", [0, 1, 50, 99]), ("test", [0, 1, 100, 199])] {
        for index in indices {
            let frame = (split == "test").then(|| scene.test.load(index).unwrap());
            for level in 1..4 {
                let path = reference.join(format!("images_{split}/{index:03}_d{level}.png"));
                let expected = image::open(path).unwrap().into_rgba8().into_raw();
                let found = match &frame {
                    Some(frame) => frame.pixels_of(level),
                    None => scene.train.pixels_of(level * frames + index),
                };
                assert!(found.as_flattened() == expected, "{split} {index} level {level}");
                compared += 1;
            }
        }
    }
    assert_eq!(compared, 24);
}

#[test]
fn metadata_gives_the_cameras_of_the_scene_it_was_made_from() {
    let (Some(lego), Some(reference)) = (shared("lego"), shared("lego_multiscale_ref")) else { return };
    // The finest images of the sample are those of the scene itself.
    let folder = tempfile::tempdir().unwrap();
    for split in ["train", "test"] {
        let images = format!("images_{split}");
        std::fs::create_dir(folder.path().join(&images)).unwrap();
        for entry in reference.join(&images).read_dir().unwrap().flatten() {
            std::fs::copy(entry.path(), folder.path().join(&images).join(entry.file_name())).unwrap();
        }
        for index in if split == "train" { [0, 1, 50, 99] } else { [0, 1, 100, 199] } {
            let finest = lego.join(format!("{split}/r_{index}.png"));
            std::fs::copy(finest, folder.path().join(&images).join(format!("{index:03}_d0.png"))).unwrap();
        }
    }
    std::fs::copy(reference.join("metadata.json"), folder.path().join("metadata.json")).unwrap();
    let (ours, theirs) = (open(&settings(&lego, 4)).unwrap(), open(&settings(folder.path(), 4)).unwrap());
    for level in 0..4 {
        for (nth, index) in [0, 1, 50, 99].into_iter().enumerate() {
            let (a, b) = (level * 100 + index, level * 4 + nth);
            assert!(ours.train.pixels_of(a) == theirs.train.pixels_of(b));
            let (a, b) = (ours.train.views[a].camera, theirs.train.views[b].camera);
            assert_eq!((a.rotation, a.origin), (b.rotation, b.origin));
            assert!((a.intrinsics.fx / b.intrinsics.fx - 1.0).abs() < 1e-12);
            assert_eq!((a.intrinsics.cx, a.intrinsics.width), (b.intrinsics.cx, b.intrinsics.width));
        }
    }
    assert_eq!(theirs.test.len(), 4);
    assert_eq!(theirs.test.load(3).unwrap().views[2].name, "199");
}

#[test]
fn a_set_without_its_finest_images_says_so() {
    let Some(reference) = shared("lego_multiscale_ref") else { return };
    let message = open(&settings(&reference, 4)).unwrap_err().message();
    assert!(message.contains("train: entry 0 (images_train/000_d0.png): image "), "{message}");
    assert!(message.contains("000_d0.png does not exist; copy it there or remove its entry"), "{message}");
}

#[test]
fn photographs_with_their_own_cameras_are_read() {
    let (Some(dtu), Some(fox)) = (shared("dtu24"), shared("fox")) else { return };
    let mut config = settings(&dtu, 2);
    config.convention = Convention::Premultiplied;
    let scene = open(&config).unwrap();
    assert_eq!((scene.train.scales[0].views.len(), scene.test.len()), (42, 7));
    assert_eq!(scene.train.alpha, Alpha::Premultiplied);
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    let k = scene.train.views[0].camera.intrinsics;
    assert!(k.fx != k.fy && k.cx != 200.0);

    let lines = inspect(&settings(&fox, 1), &trimip_data::unwatched).unwrap().join("\n");
    for expected in
        ["train 43", "7 test views", "1080x1920", "no alpha", "lens OPENCV k1 = 0.0578421", "every 8th frame"]
    {
        assert!(lines.contains(expected), "{expected}:\n{lines}");
    }
}

/// Returns the median of some numbers.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Returns for each point of a scene the distances in pixels between its projections and the places where COLMAP saw it.
fn misses(scene: &Scene) -> Vec<Vec<f64>> {
    let missed = |position: [f64; 3], camera: &Camera, at: [f64; 2]| {
        let local = camera.rotation.transpose() * (DVec3::from(position) - camera.origin);
        let found = camera.intrinsics.image_of(local).expect("COLMAP's points are seen");
        (found[0] - at[0]).hypot(found[1] - at[1])
    };
    let views = &scene.train.views;
    let of = |point: &trimip_data::Point| {
        let seen = point.track.iter();
        seen.map(|seen| missed(point.position, &views[seen.view as usize].camera, seen.at))
            .collect::<Vec<_>>()
    };
    scene.points.iter().map(of).collect()
}

#[test]
fn a_model_of_colmap_sees_its_points_where_colmap_did() {
    let Some(fox) = shared("fox") else { return };
    let [binary, text] = ["bin", "txt"].map(|kind| {
        // The scene is named by the folder of its model, and the photographs are found above it.
        let config = DataConfig {
            train: vec!["train".into(), "test".into()],
            format: "colmap".into(),
            most_pixels: 2e5,
            ..settings(&fox.join("colmap").join(kind), 1)
        };
        open(&config).unwrap()
    });
    assert_eq!((binary.train.views.len(), binary.test.len()), (50, 7));
    for (a, b) in binary.train.views.iter().zip(&text.train.views) {
        assert_eq!((&a.name, a.camera), (&b.name, b.camera));
    }
    assert_eq!((binary.points.len(), &binary.points), (12_453, &text.points));
    assert_eq!(binary.stated, text.stated);
    // The photographs are halved until they fit, and places in them are scaled too; errors are in pixels of the original photographs.
    let finest = f64::from(1080 / binary.train.views[0].camera.intrinsics.width);
    let misses: Vec<Vec<f64>> =
        misses(&binary).into_iter().map(|own| own.iter().map(|miss| miss * finest).collect()).collect();
    // COLMAP's error of a point is the mean of the point's distances; the file states places in thousandths of a pixel.
    for (point, misses) in binary.points.iter().zip(&misses) {
        let mean = misses.iter().sum::<f64>() / misses.len() as f64;
        assert!((mean - point.error.unwrap()).abs() < 2e-3, "{mean} {point:?}");
    }
    let all = misses.concat();
    println!("{} places, median miss {:.3} pixels", all.len(), median(all.clone()));
    assert_eq!(all.len(), 81_798);
    assert!(median(all) < 1.0);
    // For the whole scene, the transforms file takes precedence, so the model is chosen by `data.format`.
    let whole = DataConfig { format: "colmap".into(), most_pixels: 2e5, ..settings(&fox, 1) };
    let scene = open(&whole).unwrap();
    assert_eq!((scene.train.views.len(), scene.test.len()), (43, 7));
    assert!(!scene.warnings.iter().any(|warning| warning.contains("placed")), "{:?}", scene.warnings);
}
