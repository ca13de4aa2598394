//! Checks that the program trains a scene of depth images with the depth term, and that the plan and `data inspect` report the depths.

use glam::DVec3;
use serde_json::json;
use std::{fs, path::Path};
use trimip_core::{Camera, Intrinsics};
use trimip_tests::binary::{Answer, refuses, run, tiny_and};

/// Radius of the room, a ball around the origin.
const RADIUS: f64 = 3.0;

/// Returns the distance along a ray to the wall.
fn wall(origin: DVec3, direction: DVec3) -> f64 {
    let along = origin.dot(direction);
    (along * along - origin.length_squared() + RADIUS * RADIUS).sqrt() - along
}

/// Returns cameras near the middle, which look outwards.
fn cameras() -> Vec<Camera> {
    let k = Intrinsics::from_angle(32, 24, 1.2);
    let camera = |i: u32| {
        let turn = 0.5 * f64::from(i);
        let origin = DVec3::new(0.8 * turn.cos(), 0.8 * turn.sin(), 0.2 * f64::from(i % 3));
        let ahead = DVec3::new((2.1 * turn).cos(), (2.1 * turn).sin(), 0.1 * f64::from(i % 5) - 0.2);
        Camera::look_at(k, origin, origin + ahead, DVec3::Z)
    };
    (0..24).map(camera).collect()
}

/// Writes a scene of photographs and depth images in millimetres.
fn scene(root: &Path) {
    for folder in ["images", "depths"] {
        fs::create_dir_all(root.join(folder)).unwrap();
    }
    let frame = |(index, camera): (usize, &Camera)| {
        let seen = |x: u32, y: u32| {
            let cone = camera.cone::<f64>(x, y);
            let distance = wall(DVec3::from(cone.origin), DVec3::from(cone.direction));
            (DVec3::from(cone.origin) + distance * DVec3::from(cone.direction), distance * cone.cosine)
        };
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        image::RgbImage::from_fn(width, height, |x, y| {
            let channel =
                |phase: f64| (127.5 + 90.0 * (2.0 * seen(x, y).0.dot(DVec3::ONE) + phase).sin()) as u8;
            image::Rgb([0.0, 2.0, 4.0].map(channel))
        })
        .save(root.join(format!("images/{index}.png")))
        .unwrap();
        let depth = |x, y| image::Luma([(1e3 * seen(x, y).1).round() as u16]);
        let depths = image::ImageBuffer::from_fn(width, height, depth);
        image::DynamicImage::from(depths).save(root.join(format!("depths/{index}.png"))).unwrap();
        let [x, y, z] = camera.rotation.transpose().to_cols_array_2d();
        let o = camera.origin;
        let row = |axes: [f64; 3], at: f64| [axes[0], axes[1], axes[2], at];
        json!({
            "file_path": format!("images/{index}.png"), "depth_file_path": format!("depths/{index}.png"),
            "transform_matrix": [row(x, o.x), row(y, o.y), row(z, o.z), [0.0, 0.0, 0.0, 1.0]],
        })
    };
    let frames: Vec<_> = cameras().iter().enumerate().map(frame).collect();
    let document = json!({ "camera_angle_x": 1.2, "frames": frames });
    fs::write(root.join("transforms.json"), document.to_string()).unwrap();
}

fn done(answer: &Answer) {
    assert_eq!(answer.code, Some(0), "{answer:?}");
}

#[test]
fn a_scene_with_depth_images_is_trained_with_them_and_says_so() {
    let temporary = tempfile::tempdir().unwrap();
    let here = temporary.path();
    scene(&here.join("room"));
    // Each of the 21 training photographs has 768 pixels, and 192 at half the size. Pixels with much nearer or farther neighbours are
    // excluded.
    let inspected = run(here, &["data", "inspect", "room", "--set", "data.scales=2"]);
    done(&inspected);
    let line = "depth images of 21 of 21 training views, 32x24: the rays of ";
    let known: usize = inspected
        .out
        .split_once(line)
        .and_then(|(_, rest)| rest.split_once(" pixels end at known distances")?.0.parse().ok())
        .unwrap_or_else(|| panic!("{}", inspected.out));
    let all = 21 * (768 + 192);
    assert!(known < all && known > all / 2, "{known} of {all}");
    let train = |out: &str, more: &[&str]| {
        let sets = ["--set", "data.format=auto", "--set", "train.steps=60", "--out", out];
        let answer = run(here, &[&["train", "room"], &tiny_and(&[&sets[..], more].concat())[..]].concat());
        done(&answer);
        (answer, fs::read_to_string(here.join(out).join("config.toml")).unwrap())
    };
    let (told, config) = train("with", &[]);
    let reason =
        format!("points that photographs show, or depth images, give the distances of {known} pixels");
    assert!(told.out.contains(&reason) && told.out.contains(line), "{}", told.out);
    assert!(config.contains("seeded = 0.3") && config.contains("depth = [[0.0, 0.01]"), "{config}");
    for more in [["--set", "plan.depth=off"], ["--set", "data.depths=false"]] {
        let (told, config) = train(more[1], &more);
        assert!(!told.out.contains("give the distances") && config.contains("seeded = 0.0"), "{config}");
    }
    let asked = ["train", "room", "--set", "data.depths=false", "--set", "plan.depth=on"];
    refuses(here, &asked, &["plan.depth", "no points that training photographs show, and no depth images"]);
    fs::remove_dir_all(here.join("room/depths")).unwrap();
    let gone = ["depths/1.png does not exist (21 of 21 depth images are missing)", "data.depths = false"];
    refuses(here, &["train", "room"], &gone);
}
