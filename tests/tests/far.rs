//! Checks that scenes far from the origin, for example with poses in map or earth-centred coordinates, plan, train, render and export like
//! the same scene near the origin. Everything that the program writes has the coordinates of the photographs.

use glam::DVec3;
use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_core::{
    Camera, Config, Session, Settings, ViewSet,
    engine::trainer::Trainer,
    scene::origin::LocalOrigin,
    scene_plan::{self, Compute, Facts},
};
use trimip_cpu::{CpuBackend, simd::Simd};
use trimip_tests::binary::{Answer, refuses, run, tiny_and};
use trimip_tests::watching::{self, Shown};

/// Offsets in metres: Universal Transverse Mercator, earth-centred, and along one axis.
const FAR: [DVec3; 3] = [
    DVec3::new(448_262.0, 5_411_932.0, 310.0),
    DVec3::new(4_075_539.5, 931_735.27, 4_801_629.35),
    DVec3::new(0.0, 0.0, -6e6),
];

/// Writes the built-in scene, moved by `by`. Without `alpha`, its photographs show a sky with a colour for each direction.
fn scene(root: &Path, alpha: bool, by: DVec3) {
    let sets = ["data.builtin_size=32", "data.builtin_train=16", "data.builtin_test=2"];
    let mut arguments =
        vec!["data", "builtin", root.to_str().unwrap(), "--set", "data.builtin_supersampling=2"];
    sets.iter().for_each(|set| arguments.extend(["--set", set]));
    done(&run(root.parent().unwrap(), &arguments));
    for split in ["train", "test"] {
        let path = root.join(format!("transforms_{split}.json"));
        let mut file: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        let angle = file["camera_angle_x"].as_f64().unwrap();
        for frame in file["frames"].as_array_mut().unwrap() {
            let name = format!("{}.png", frame["file_path"].as_str().unwrap());
            let matrix = &mut frame["transform_matrix"];
            if !alpha {
                let rows = [0, 1, 2].map(|i| [0, 1, 2].map(|j| matrix[i][j].as_f64().unwrap()));
                above_a_sky(&root.join(name), angle, rows);
            }
            for axis in 0..3 {
                matrix[axis][3] = json!(matrix[axis][3].as_f64().unwrap() + by[axis]);
            }
        }
        fs::write(path, file.to_string()).unwrap();
    }
}

fn above_a_sky(path: &Path, angle: f64, rotation: [[f64; 3]; 3]) {
    let mut picture = image::open(path).unwrap().to_rgba8();
    let (width, height) = picture.dimensions();
    let focal = 0.5 * f64::from(width) / (0.5 * angle).tan();
    for (x, y, pixel) in picture.enumerate_pixels_mut() {
        let middle = |at: u32, side: u32| f64::from(at) + 0.5 - 0.5 * f64::from(side);
        let ray = DVec3::new(middle(x, width), -middle(y, height), -focal).normalize();
        let opacity = f64::from(pixel[3]) / 255.0;
        for channel in 0..3 {
            let sky = 127.5 + 90.0 * (5.0 * DVec3::from(rotation[channel]).dot(ray)).sin();
            pixel[channel] = (opacity * f64::from(pixel[channel]) + (1.0 - opacity) * sky).round() as u8;
        }
        pixel[3] = 255;
    }
    image::DynamicImage::from(picture).to_rgb8().save(path).unwrap();
}

fn done(answer: &Answer) {
    assert_eq!(answer.code, Some(0), "{answer:?}");
}

/// Returns the settings of a run on the scene in a folder.
fn settings(root: &Path) -> Settings {
    let mut settings = trimip::settings::defaults();
    settings.set("data.root", root.to_str().unwrap()).unwrap();
    for assignment in ["data.scales=2", "train.steps=120", "train.samples_per_step=2048", "threads=2"] {
        settings.apply_assignment(assignment).unwrap();
    }
    settings
}

/// Returns the training views, their local origin and the planned settings.
fn planned(root: &Path) -> (ViewSet, LocalOrigin, Config) {
    let mut settings = settings(root);
    let scene = trimip_data::open(&Config::from_settings(&settings).unwrap().section().unwrap()).unwrap();
    let (test, compute) = (scene.test.cameras(), Compute::one_thread());
    let (stated, origin) = (scene.stated.as_ref(), scene.origin);
    let facts = Facts { train: &scene.train, test: &test, stated, origin, compute: &compute };
    let findings = scene_plan::make(&mut settings, &facts).unwrap();
    let told = findings.iter().any(|finding| finding.to_string().starts_with("data.origin: set: "));
    assert_eq!(told, !origin.is_zero(), "{findings:?}");
    (scene.train, origin, Config::from_settings(&settings).unwrap())
}

/// Returns the mean PSNR of the last third of the batches, in dB.
fn trained(config: &Config, views: ViewSet) -> f64 {
    let mut trainer = Trainer::new(CpuBackend::new(2, Simd::detect()).unwrap(), config, views).unwrap();
    let steps = config.train.steps;
    let psnr: Vec<f64> =
        (0..steps).map(|step| trainer.step(step as f64 / steps as f64).unwrap().batch_psnr).collect();
    let last = &psnr[psnr.len() * 2 / 3..];
    last.iter().sum::<f64>() / last.len() as f64
}

/// A scene at 6e6 units has the same rays, the same plan and the same training as that scene near the origin. Adding and subtracting these
/// coordinates rounds positions by up to 1e-9.
#[test]
fn a_scene_far_away_is_seen_planned_and_learned_as_a_near_one() {
    let folder = tempfile::tempdir().unwrap();
    for (index, (alpha, by)) in
        [(true, FAR[0]), (true, FAR[1]), (false, FAR[1]), (false, FAR[2])].into_iter().enumerate()
    {
        let far = folder.path().join(format!("far-{index}"));
        scene(&far, alpha, by);
        let (far_views, origin, far_config) = planned(&far);
        assert!(origin.numbers().iter().all(|x| x.fract() == 0.0), "{origin}");
        // The near scene has the coordinates that the far scene has relative to its local origin.
        let near = folder.path().join(format!("near-{index}"));
        scene(&near, alpha, by - DVec3::from(origin.numbers()));
        let (near_views, none, near_config) = planned(&near);
        assert!(none.is_zero());
        assert!(near_views.pixels[..] == far_views.pixels[..]);
        for (near, far) in near_views.views.iter().zip(&far_views.views) {
            let k = near.camera.intrinsics;
            for (x, y) in [(0, 0), (k.width / 2, k.height / 3), (k.width - 1, k.height - 1)] {
                let [near, far] = [near, far].map(|view| view.camera.cone::<f64>(x, y));
                let apart = |a: [f64; 3], b: [f64; 3]| (DVec3::from(a) - DVec3::from(b)).length();
                assert!(
                    apart(near.origin, far.origin) < 2e-9 && apart(near.direction, far.direction) < 1e-12
                );
            }
        }
        let placed = |config: &Config| {
            let mut config = config.clone();
            (config.data.root, config.data.origin) = (String::new(), Vec::new());
            config.to_toml()
        };
        assert_eq!(placed(&far_config), placed(&near_config), "{alpha} {by}");
        assert_eq!(far_config.data.origin, origin.numbers());
        let [near, far] =
            [(near_config, near_views), (far_config, far_views)].map(|(c, views)| trained(&c, views));
        assert!(near > 10.0 && (near - far).abs() < 0.3, "alpha {alpha}, {by}: {far:.2} dB, not {near:.2}");
    }
}

/// Returns the camera positions in a file.
fn places(path: &Path) -> Vec<DVec3> {
    let file: Value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    let at = |frame: &Value, axis: usize| frame["transform_matrix"][axis][3].as_f64().unwrap();
    file["frames"]
        .as_array()
        .unwrap()
        .iter()
        .map(|f| DVec3::from([0, 1, 2].map(|axis| at(f, axis))))
        .collect()
}

/// Returns the first vertex of a mesh file, in the coordinates that the file states, and the beginning of the file.
fn vertex(path: &Path) -> (DVec3, String) {
    let bytes = fs::read(path).unwrap();
    let head = String::from_utf8_lossy(&bytes[..2000.min(bytes.len())]).into_owned();
    let numbers: Vec<f64> = match path.extension().unwrap().to_str().unwrap() {
        "obj" => {
            let line = head.lines().find_map(|line| line.strip_prefix("v ")).unwrap();
            line.split(' ').take(3).map(|number| number.parse().unwrap()).collect()
        }
        "ply" => {
            let end = b"end_header\n";
            let start = bytes.windows(end.len()).position(|window| window == end).unwrap() + end.len();
            match head.contains("property double x") {
                true => {
                    bytes[start..start + 24].as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect()
                }
                false => {
                    let floats = bytes[start..start + 12].as_chunks().0;
                    floats.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect()
                }
            }
        }
        _ => {
            let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
            let json: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
            let node = |axis: usize| json["nodes"][0]["translation"][axis].as_f64().unwrap_or(0.0);
            let floats = bytes[28 + length..40 + length].as_chunks().0;
            floats.iter().enumerate().map(|(i, b)| node(i) + f64::from(f32::from_le_bytes(*b))).collect()
        }
    };
    (DVec3::new(numbers[0], numbers[1], numbers[2]), head)
}

#[test]
fn what_leaves_the_program_has_the_coordinates_of_the_photographs() {
    let temporary = tempfile::tempdir().unwrap();
    let here = temporary.path();
    let by = FAR[1];
    scene(&here.join("far"), true, by);
    scene(&here.join("near"), true, DVec3::ZERO);
    let train = |name: &str| {
        let out = format!("{name}-run");
        run(here, &[&["train", name], &tiny_and(&["--set", "data.format=auto", "--out", &out])[..]].concat())
    };
    let told = train("far");
    done(&told);
    assert!(told.out.contains("data.origin: set"), "{told:?}");
    let plan: Value = serde_json::from_slice(&fs::read(here.join("far-run/plan.json")).unwrap()).unwrap();
    let all = plan.as_array().unwrap().iter();
    let mut changes = all.flat_map(|finding| finding["changes"].as_array().unwrap());
    let chosen = changes.find(|change| change["path"] == "data.origin").unwrap()["to"].as_str().unwrap();
    let origin: [f64; 3] = serde_json::from_str(chosen).unwrap();
    assert!((DVec3::from(origin) - by).length() < 4.0 && origin.iter().all(|x| x.fract() == 0.0), "{chosen}");
    done(&train("near"));
    assert!(train("far").out.contains("finished"), "the same command finds its run");
    let again = ["--out", "far-run", "--continue-for", "1s"];
    done(&run(here, &again));
    for report in ["report.html", "report.json"] {
        let text = fs::read_to_string(here.join("far-run").join(report)).unwrap();
        assert!(text.contains(&origin[0].to_string()), "{report} does not tell the origin");
    }

    // The stored cameras have the photographs' coordinates.
    let [stated, kept] =
        ["far/transforms_train.json", "far-run/cameras.json"].map(|name| places(&here.join(name)));
    assert_eq!(stated.len(), kept.len());
    assert!(stated.iter().zip(&kept).all(|(a, b)| (*a - *b).length() < 2e-9), "{kept:?}");

    // A pose in the photographs' coordinates renders the same picture as the photograph's own camera.
    let render = |more: &[&str]| done(&run(here, &[&["render", "far-run"], more].concat()));
    render(&["--views", "1", "--out", "views"]);
    let size = ["--width", "32", "--height", "32"];
    render(&[&["--path", "far/transforms_test.json", "--out", "path"], &size[..]].concat());
    let file: Value =
        serde_json::from_slice(&fs::read(here.join("far/transforms_test.json")).unwrap()).unwrap();
    let matrix = file["frames"][1]["transform_matrix"].to_string();
    let fov = file["camera_angle_x"].as_f64().unwrap().to_degrees().to_string();
    render(&[&["--pose", &matrix, "--fov", &fov, "--out", "pose"], &size[..]].concat());
    let picture = |name: &str| image::open(here.join(name)).unwrap().to_rgb8().into_raw();
    let (view, path, pose) =
        (picture("views/0001_r_1_color.png"), picture("path/0001_color.png"), picture("pose/pose_color.png"));
    let apart = |other: &[u8]| view.iter().zip(other).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
    assert!(apart(&path) <= 1 && apart(&pose) <= 1, "{} {}", apart(&path), apart(&pose));
    let written = places(&here.join("path/cameras.json"));
    assert!((written[1] - places(&here.join("far/transforms_test.json"))[1]).length() < 2e-9, "{written:?}");
    let [x, y, z] = by.to_array();
    let eye = format!("{},{y},{z}/{x},{y},{z}", x + 4.0);
    render(&[&["--look-at", &eye, "--out", "looking"], &size[..]].concat());
    assert!((places(&here.join("looking/cameras.json"))[0] - DVec3::new(x + 4.0, y, z)).length() < 2e-9);
    assert!(picture("looking/look_at_color.png").iter().any(|&byte| byte < 250), "it looks at nothing");

    // Meshes have these coordinates too, in every format. `--local` writes coordinates that fit in 32 bits, and their offset.
    let mesh = |out: &str, more: &[&str]| {
        let arguments = ["export", "mesh", "far-run", "--out", out, "--resolution", "24", "--level", "0.01"];
        run(here, &[&arguments, more].concat())
    };
    for end in ["ply", "obj", "glb"] {
        let (whole, local) = (format!("whole.{end}"), format!("local.{end}"));
        done(&mesh(&whole, &[]));
        done(&mesh(&local, &["--local"]));
        let [(there, _), (here, head)] = [&whole, &local].map(|name| vertex(&here.join(name)));
        assert!((there - by).length() < 4.0 && here.length() < 6.0, "{end}: {there} {here}");
        assert!(head.contains("offset") && origin.iter().all(|x| head.contains(&x.to_string())), "{head}");
        // The digits of an OBJ file distinguish any two f32 values.
        assert!((there - here - DVec3::from(origin)).length() < 1e-6, "{end}: {there} {here}");
    }
    let crop = format!("ball {x},{y},{z},1.2");
    let cropped = mesh("cropped.ply", &["--crop", &crop]);
    done(&cropped);
    assert!(cropped.out.contains(&format!("crop: {crop}")), "{}", cropped.out);
    assert!((vertex(&here.join("cropped.ply")).0 - by).length() < 1.3);

    // The crops of pages have the photographs' coordinates; the views of pages are relative to the local origin.
    let shown = Shown::start_with(here, "far-run", &["--crop", &crop]);
    let told = shown.get(&format!("/{}/scene.json", shown.token), &[]).1;
    assert_eq!(serde_json::from_slice::<Value>(&told).unwrap()["crop"], crop);
    let mut page = shown.join(&shown.token, None).unwrap();
    let mut request = watching::view(1, [3.0, 1.0, 2.0], 24, 24);
    (request["show"], request["cropped"]) = (json!("opacity"), json!(true));
    let seen = image::load_from_memory(&page.finest(&request).unwrap().jpeg).unwrap().to_luma8();
    assert!(seen.pixels().any(|pixel| pixel.0[0] > 16), "the crop is where the scene is");

    // `data inspect` reports a folder in the folder's own coordinates.
    let inspected = run(here, &["data", "inspect", "far", "--html", "far.html"]);
    done(&inspected);
    assert!(fs::read_to_string(here.join("far.html")).unwrap().contains("relative to [40755"));
    assert!(inspected.out.contains("z 48016") && inspected.out.contains("data.origin"), "{}", inspected.out);
    let near = run(here, &["data", "inspect", "near"]);
    assert!(!near.out.contains("data.origin"), "{}", near.out);
    for file in ["far-run/plan.json", "near-run/plan.json"] {
        let text = fs::read_to_string(here.join(file)).unwrap();
        assert_eq!(text.contains("data.origin"), file.starts_with("far"), "{file}");
    }
}

#[test]
fn an_origin_is_a_place_and_belongs_to_the_model() {
    let temporary = tempfile::tempdir().unwrap();
    let here = temporary.path();
    scene(&here.join("far"), true, FAR[0]);
    for (set, part) in [
        ("data.origin=[1.0, 2.0]", "[x, y, z]"),
        ("data.origin=[1.0, 2.0, 2e9]", "-1e9 to 1e9"),
        ("data.origin=[1.0, 2.0, \"z\"]", "data.origin"),
    ] {
        refuses(here, &["plan", "far", "--set", set], &["data.origin", part]);
    }
    let built_in = ["plan", "--set", "data.format=builtin", "--set", "data.origin=[1, 2, 3]"];
    refuses(here, &built_in, &["data.origin", "built-in"]);
    // A given origin is kept, and boxes are relative to it.
    let given = ["plan", "far", "--set", "data.origin=[448000, 5411000, 0]", "--json", "plan.json"];
    done(&run(here, &given));
    let plan: Value = serde_json::from_slice(&fs::read(here.join("plan.json")).unwrap()).unwrap();
    let config = Config::from_toml("plan", plan["config"].as_str().unwrap()).unwrap();
    assert_eq!(config.data.origin, [448_000.0, 5_411_000.0, 0.0]);
    let middle = |axis: usize| 0.5 * (config.scene.aabb_min[axis] + config.scene.aabb_max[axis]);
    assert!((middle(0) - 262.0).abs() < 1.0 && (middle(1) - 932.0).abs() < 1.0, "{:?}", config.scene);
    done(&run(
        here,
        &[&["train", "far", "--out", "run"], &tiny_and(&["--set", "data.format=auto"])[..]].concat(),
    ));
    refuses(
        here,
        &["eval", "run", "--set", "data.origin=[1, 2, 3]"],
        &["data.origin", "belongs to the trained model"],
    );
    // Without its photographs, a model uses the cameras that its run stored.
    let cameras = trimip::run::cameras::training_cameras(
        &here.join("run"),
        LocalOrigin::at(&[448_262.0, 5_411_932.0, 310.0]),
    );
    let cameras: Vec<Camera> = cameras.unwrap().unwrap();
    assert!(cameras.len() == 16 && cameras.iter().all(|camera| camera.origin.length() < 8.0));
}
