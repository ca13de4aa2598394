//! Tests of depth images: their distances equal those of the written-out equations, the right pixels are known, and
//! broken files give errors.

use crate::common::{
    ring::{arkitscenes, cameras, pinhole, polycam, save_images, transforms},
    settings, write,
};
use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, Rgb};
use serde_json::{Value, json};
use std::{
    fs,
    path::{Path, PathBuf},
};
use trimip_core::{Intrinsics, Lens, scene::depths::KnownDepth, scene::fingerprint::Fingerprint};
use trimip_data::{Scene, open};

/// A depth image; its numbers are thousandths of a unit.
type Image = ImageBuffer<Luma<u16>, Vec<u16>>;

fn path(index: usize) -> String {
    format!("depths/{index}.png")
}

/// Returns the depth image of a slanted surface.
fn slanted(width: u32, height: u32) -> Image {
    let step = 240.0 / f64::from(width);
    let depth = |x: u32, y: u32| 2000.0 + step * (0.9 * f64::from(x) + 0.4 * f64::from(y));
    ImageBuffer::from_fn(width, height, |x, y| Luma([depth(x, y) as u16]))
}

fn save(root: &Path, index: usize, image: impl Into<DynamicImage>) {
    fs::create_dir_all(root.join("depths")).unwrap();
    image.into().save(root.join(path(index))).unwrap();
}

/// Writes a scene of nine photographs with depth images, and returns its transforms file. The first and the last
/// photograph are test frames.
fn scene(root: &Path, intrinsics: Intrinsics, image: &Image) -> Value {
    save_images(root, [intrinsics.width, intrinsics.height]);
    let mut document = transforms(&cameras(intrinsics), intrinsics);
    for index in 0..9 {
        save(root, index, image.clone());
        document["frames"][index]["depth_file_path"] = json!(path(index));
    }
    write(&root.join("transforms.json"), &document);
    document
}

/// Returns the distance along the ray of the position (u, v) per unit of depth along the optical axis, with OpenCV's
/// lens equations written out.
fn literal(k: &Intrinsics, coefficients: [f64; 4], [u, v]: [f64; 2]) -> f64 {
    let [k1, k2, p1, p2] = coefficients;
    let distorted = [(u - k.cx) / k.fx, (v - k.cy) / k.fy];
    let [mut x, mut y] = distorted;
    for _ in 0..200 {
        let r2 = x * x + y * y;
        let radial = 1.0 + k1 * r2 + k2 * r2 * r2;
        let tangential =
            [2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y];
        [x, y] = [(distorted[0] - tangential[0]) / radial, (distorted[1] - tangential[1]) / radial];
    }
    (1.0 + x * x + y * y).sqrt()
}

/// Asserts that each known depth is that of the image in its pixel. Returns the number of known depths at each scale.
fn assert_distances(scene: &Scene, image: &Image, coefficients: [f64; 4]) -> Vec<usize> {
    let set = &scene.train;
    let finest = set.views[0].camera.intrinsics;
    let count = |scale: &trimip_core::Scale| {
        let within = |known: &&KnownDepth| scale.pixels.contains(&(known.pixel as usize));
        let mut count = 0;
        for known in set.depths.iter().filter(within) {
            let view =
                set.views[scale.views.clone()].iter().rfind(|view| view.offset <= known.pixel as usize);
            let (k, at) = (view.unwrap().camera.intrinsics, known.pixel - view.unwrap().offset as u32);
            let (column, row) = (at % k.width, at / k.width);
            let along = literal(&k, coefficients, [f64::from(column) + 0.5, f64::from(row) + 0.5]);
            let pixel = |x: u32, y: u32| {
                let place = |at: u32, own: u32, side: u32| {
                    let place = (f64::from(at) + 0.5) * f64::from(side) / f64::from(own);
                    (place / f64::from(scale.factor)).floor() as u32
                };
                [place(x, image.width(), finest.width), place(y, image.height(), finest.height)]
            };
            let is = |(x, y, value): (u32, u32, &Luma<u16>)| {
                let distance = 1e-3 * f64::from(value.0[0]) * along;
                pixel(x, y) == [column, row]
                    && (f64::from(known.distance) - distance).abs() <= 1e-6 * distance
            };
            assert!(image.enumerate_pixels().any(is), "{known:?} of {column}, {row} at 1/{}", scale.factor);
            assert!((known.deviation / known.distance - 0.02).abs() < 1e-6, "{known:?}");
            count += 1;
        }
        count
    };
    set.scales.iter().map(count).collect()
}

fn told(scene: &Scene, what: &str) -> bool {
    scene.warnings.iter().chain(&scene.description).any(|line| line.contains(what))
}

#[test]
fn depths_along_the_optical_axis_become_distances_along_rays() {
    let distorted = [0.11, -0.03, 0.004, -0.006];
    for (coefficients, size) in [
        ([0.0; 4], [60, 40]),
        ([0.0; 4], [30, 20]),
        ([0.0; 4], [15, 10]),
        (distorted, [60, 40]),
        (distorted, [24, 16]),
        // The depth image is finer than the photograph.
        (distorted, [120, 80]),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let image = slanted(size[0], size[1]);
        let mut document = scene(folder.path(), pinhole(), &image);
        for (key, value) in ["k1", "k2", "p1", "p2"].into_iter().zip(coefficients) {
            document[key] = json!(value);
        }
        write(&folder.path().join("transforms.json"), &document);
        let scene = open(&settings(folder.path(), 2)).unwrap();
        assert!(scene.warnings.iter().all(|warning| !warning.contains("depth")), "{:?}", scene.warnings);
        let counts = assert_distances(&scene, &image, coefficients);
        // In a finer depth image, every second pixel along each axis gives a known depth.
        let pixels = if size[0] == 120 { 60 * 40 } else { (size[0] * size[1]) as usize };
        let coarse = pixels.min(600);
        assert_eq!(counts[0], 7 * pixels, "{size:?}");
        assert!((coarse * 7 / 2..=coarse * 7).contains(&counts[1]), "{size:?}: {counts:?}");
        let all: usize = counts.iter().sum();
        let line = format!(
            "depth images of 7 of 7 training views, {}x{}: the rays of {all} pixels end at known distances",
            size[0], size[1]
        );
        assert!(told(&scene, &line), "{line}: {:?}", scene.description);
        assert!(scene.train.depths.is_sorted_by_key(|known| known.pixel));
        // Reading again gives the same depths.
        assert_eq!(open(&settings(folder.path(), 2)).unwrap().train.depths, scene.train.depths);
    }
}

#[test]
fn photographs_that_are_halved_have_the_same_depths() {
    let folder = tempfile::tempdir().unwrap();
    let image = slanted(30, 20);
    scene(folder.path(), pinhole(), &image);
    let config = trimip_data::settings::DataConfig { most_pixels: 7000.0, ..settings(folder.path(), 1) };
    let halved = open(&config).unwrap();
    assert_eq!(halved.train.views[0].camera.intrinsics.width, 30);
    assert_eq!(assert_distances(&halved, &image, [0.0; 4]), [7 * 600]);
}

/// Checks that an image with too many pixels gives the depth of one pixel in each cell of a grid.
#[test]
fn of_dense_images_a_grid_of_pixels_is_known() {
    let folder = tempfile::tempdir().unwrap();
    let k = Intrinsics { lens: Lens::default(), ..Intrinsics::from_angle(300, 200, 0.9) };
    scene(folder.path(), k, &slanted(300, 200));
    let scene = open(&settings(folder.path(), 1)).unwrap();
    // The cells have 4 × 4 pixels.
    assert_eq!(scene.train.depths.len(), 7 * 75 * 50);
    let places = scene.train.depths[..75].iter().map(|known| known.pixel);
    assert!(places.eq((0..75).map(|column| 2 * 300 + 4 * column + 2)));
}

#[test]
fn unknown_depths_and_edges_tell_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut image = ImageBuffer::from_fn(60, 40, |x, _| Luma([if x < 30 { 2000 } else { 2500_u16 }]));
    // A pixel between the surfaces, some unknown pixels, and one that is too far to be measured.
    image.put_pixel(45, 20, Luma([2250]));
    (0..10).for_each(|x| image.put_pixel(x, 7, Luma([0])));
    image.put_pixel(12, 30, Luma([u16::MAX]));
    scene(folder.path(), pinhole(), &image);
    let scene = open(&settings(folder.path(), 1)).unwrap();
    let known: Vec<[u32; 2]> = scene
        .train
        .depths
        .iter()
        .take_while(|known| known.pixel < 2400)
        .map(|known| [known.pixel % 60, known.pixel / 60])
        .collect();
    for (x, y) in (0..60).flat_map(|x| (0..40).map(move |y| (x, y))) {
        let edge = x == 29 || x == 30 || (44..=46).contains(&x) && (19..=21).contains(&y);
        let unknown = x < 10 && y == 7 || (x, y) == (12, 30);
        assert_eq!(known.contains(&[x, y]), !(edge || unknown), "{x}, {y}");
    }
    assert_distances(&scene, &image, [0.0; 4]);
}

/// Checks an image with few known pixels, as if a program had drawn its points into it.
#[test]
fn sparse_images_are_read_whole() {
    let folder = tempfile::tempdir().unwrap();
    let mut image = Image::new(300, 200);
    for [x, y] in [[0, 0], [17, 3], [18, 90], [299, 199]] {
        image.put_pixel(x, y, Luma([3000]));
    }
    let k = Intrinsics { lens: Lens::default(), ..Intrinsics::from_angle(300, 200, 0.9) };
    scene(folder.path(), k, &image);
    let scene = open(&settings(folder.path(), 1)).unwrap();
    let known: Vec<u32> = scene.train.depths[..4].iter().map(|known| known.pixel).collect();
    assert_eq!((known, scene.train.depths.len()), (vec![0, 917, 27_018, 59_999], 28));
}

/// Returns the bytes of a table of numbers in NumPy's format.
fn npy(kind: &str, shape: &str, numbers: impl Iterator<Item = Vec<u8>>) -> Vec<u8> {
    let header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let start = [b"\x93NUMPY\x01\0", &(header.len() as u16).to_le_bytes()[..], header.as_bytes()].concat();
    start.into_iter().chain(numbers.flatten()).collect()
}

#[test]
fn tables_of_numpy_are_depth_images() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let image = slanted(30, 20);
    let mut document = scene(root, pinhole(), &image);
    let pictures = open(&settings(root, 2)).unwrap().train.depths;
    document["depth_unit_scale_factor"] = json!(1.0);
    for index in 0..9 {
        document["frames"][index]["depth_file_path"] = json!(format!("depths\\{index}.npy"));
    }
    write(&root.join("transforms.json"), &document);
    let metres = || image.pixels().map(|value| 1e-3 * f64::from(value.0[0]));
    for (shape, bytes) in [
        ("<f4", npy("<f4", "(20, 30)", metres().map(|depth| (depth as f32).to_le_bytes().to_vec()))),
        ("<f8", npy("<f8", "(20, 30)", metres().map(|depth| depth.to_le_bytes().to_vec()))),
        (">f4", npy(">f4", "(20, 30, 1)", metres().map(|depth| (depth as f32).to_be_bytes().to_vec()))),
    ] {
        (0..9).for_each(|index| fs::write(root.join(format!("depths/{index}.npy")), &bytes).unwrap());
        let tables = open(&settings(root, 2)).unwrap().train.depths;
        assert_eq!(tables.len(), pictures.len());
        for (own, other) in tables.iter().zip(&pictures) {
            let apart = (own.distance - other.distance).abs();
            assert!(own.pixel == other.pixel && apart < 1e-6 * other.distance, "{shape}: {own:?} {other:?}");
        }
    }
    // Numbers that are not finite, and depths behind the camera, are unknown.
    let mut depths: Vec<f64> = metres().collect();
    (depths[0], depths[31], depths[62], depths[93]) = (f64::NAN, f64::INFINITY, -2.0, 0.0);
    let bytes = npy("<f8", "(20, 30)", depths.iter().map(|depth| depth.to_le_bytes().to_vec()));
    (0..9).for_each(|index| fs::write(root.join(format!("depths/{index}.npy")), &bytes).unwrap());
    assert_eq!(open(&settings(root, 1)).unwrap().train.depths.len(), 7 * 596);
}

#[test]
fn units_of_depths_are_those_of_the_poses() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let image = slanted(30, 20);
    let mut document = scene(root, pinhole(), &image);
    let of = |document: &Value| {
        write(&root.join("transforms.json"), document);
        open(&settings(root, 1)).unwrap()
    };
    let plain = of(&document);
    let times = |scene: &Scene, factor: f32| {
        scene.train.depths.iter().zip(&plain.train.depths).all(|(own, other)| {
            own.pixel == other.pixel && (own.distance / other.distance / factor - 1.0).abs() < 1e-6
        })
    };
    document["depth_unit_scale_factor"] = json!(0.002);
    assert!(times(&of(&document), 2.0));
    // The poses were scaled when they were written.
    document["applied_scale"] = json!(0.25);
    assert!(times(&of(&document), 0.5));
    for index in 0..9 {
        document["frames"][index]["depth_unit_scale_factor"] = json!(0.004);
    }
    assert!(times(&of(&document), 1.0));
    // The depths are a thousand times too long, then too short.
    for (factor, likely) in [(4.0, "1e-3"), (4e-6, "1e3")] {
        (0..9).for_each(|index| document["frames"][index]["depth_unit_scale_factor"] = json!(factor));
        let scene = of(&document);
        let warning = format!("should depth_unit_scale_factor be {likely} times as large?");
        assert!(told(&scene, &warning), "{warning}: {:?}", scene.warnings);
    }
}

#[test]
fn a_scene_without_its_depth_images_is_the_same_scene() {
    let folder = tempfile::tempdir().unwrap();
    let mut document = scene(folder.path(), pinhole(), &slanted(60, 40));
    let with = open(&settings(folder.path(), 2)).unwrap();
    let config = trimip_data::settings::DataConfig { depths: false, ..settings(folder.path(), 2) };
    let off = open(&config).unwrap();
    for index in 0..9 {
        document["frames"][index].as_object_mut().unwrap().remove("depth_file_path");
    }
    write(&folder.path().join("transforms.json"), &document);
    let without = open(&settings(folder.path(), 2)).unwrap();
    for other in [off, without] {
        assert!(!with.train.depths.is_empty() && other.train.depths.is_empty());
        assert_eq!(Fingerprint::of(&with.train), Fingerprint::of(&other.train));
        assert!(!told(&other, "depth image"), "{:?}", other.description);
    }
}

#[test]
fn what_is_wrong_with_a_depth_image_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let good = scene(root, pinhole(), &slanted(30, 20));
    let file = |index: usize| root.join(path(index));
    type Change = fn(&dyn Fn(usize) -> PathBuf, &mut Value);
    let table: [(Change, &[&str]); 13] = [
        (
            |file, _| (1..6).for_each(|index| fs::remove_file(file(index)).unwrap()),
            &[
                "frame 1 (images/1.png): depth image",
                "depths/1.png does not exist (5 of 7 depth images are missing)",
            ],
        ),
        (
            |file, _| {
                DynamicImage::from(ImageBuffer::from_pixel(30, 20, Luma([90_u8]))).save(file(2)).unwrap();
            },
            &[
                "frame 2",
                "depths/2.png has 8 bits: it visualises depths",
                "16-bit grey",
                "data.depths = false",
            ],
        ),
        (
            |file, _| {
                DynamicImage::from(ImageBuffer::from_pixel(30, 20, Rgb([90_u16; 3]))).save(file(2)).unwrap();
            },
            &["depths/2.png has colours", "data.depths = false"],
        ),
        (
            |file, _| {
                let float = DynamicImage::from(ImageBuffer::from_pixel(30, 20, Rgb([2.0_f32; 3])));
                float.save_with_format(file(2), ImageFormat::Tiff).unwrap();
            },
            &["depths/2.png has pixels of floating-point numbers"],
        ),
        (
            |file, _| DynamicImage::from(Image::new(30, 30)).save(file(3)).unwrap(),
            &["frame 3", "depths/3.png is 30x30 pixels, but image", "60x40", "the photograph's shape"],
        ),
        (
            |file, _| {
                let bytes = fs::read(file(4)).unwrap();
                fs::write(file(4), &bytes[..bytes.len() / 2]).unwrap();
            },
            &["frame 4", "depths/4.png cannot be decoded"],
        ),
        (|file, _| fs::write(file(4), "no picture").unwrap(), &["frame 4", "depths/4.png cannot be decoded"]),
        (
            |_, document| document["depth_unit_scale_factor"] = json!(0.0),
            &["\"depth_unit_scale_factor\" is 0; expected a number above 0"],
        ),
        (
            |_, document| document["depth_unit_scale_factor"] = json!("mm"),
            &["\"depth_unit_scale_factor\" is the text"],
        ),
        (
            |_, document| document["frames"][1]["depth_file_path"] = json!(7),
            &["frame 1", "\"depth_file_path\" is 7"],
        ),
        (
            |file, document| {
                fs::write(file(5).with_extension("npy"), npy("<u2", "(20, 30)", std::iter::empty())).unwrap();
                document["frames"][5]["depth_file_path"] = json!("depths/5.npy");
            },
            &["depths/5.npy: is not a table of NumPy: its numbers are '<u2', but only f8 and f4 are known"],
        ),
        (
            |file, document| {
                fs::write(file(5).with_extension("npy"), npy("<f4", "(20, 30)", std::iter::empty())).unwrap();
                document["frames"][5]["depth_file_path"] = json!("depths/5.npy");
            },
            &["depths/5.npy: states 20 x 30 numbers of 4 bytes, but 0 bytes follow"],
        ),
        (
            |file, document| {
                fs::write(file(5).with_extension("npy"), npy("<f4", "(30, 20)", std::iter::empty())).unwrap();
                document["frames"][5]["depth_file_path"] = json!("depths/5.npy");
            },
            &["frame 5", "depths/5.npy is 20x30 pixels, but image"],
        ),
    ];
    for (change, parts) in table {
        (0..9).for_each(|index| save(root, index, slanted(30, 20)));
        let mut document = good.clone();
        change(&file, &mut document);
        write(&root.join("transforms.json"), &document);
        let error = open(&settings(root, 1)).unwrap_err();
        assert!(error.kind() == trimip_core::ErrorKind::Input && !error.message().contains('\n'), "{error}");
        parts.iter().for_each(|part| assert!(error.message().contains(part), "{part}: {error}"));
        // With `depths: false`, broken depth images do no harm.
        if !parts.iter().any(|part| part.contains('"')) {
            let config = trimip_data::settings::DataConfig { depths: false, ..settings(root, 1) };
            assert!(open(&config).unwrap().train.depths.is_empty());
        }
    }
}

#[test]
fn some_that_are_missing_or_empty_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let mut document = scene(root, pinhole(), &slanted(30, 20));
    (1..3).for_each(|index| fs::remove_file(root.join(path(index))).unwrap());
    save(root, 3, Image::new(30, 20));
    document["frames"][4].as_object_mut().unwrap().remove("depth_file_path");
    write(&root.join("transforms.json"), &document);
    let scene = open(&settings(root, 1)).unwrap();
    for line in [
        "2 of 6 depth images are missing, the first is ",
        "1 of 4 depth images hold no depth, the first that of 3: 0 marks an unknown depth",
        "depth images of 4 of 7 training views, 30x20: the rays of 1800 pixels",
    ] {
        assert!(told(&scene, line), "{line}: {:?} {:?}", scene.warnings, scene.description);
    }
    // All depth images are empty.
    document["frames"][4]["depth_file_path"] = json!(path(4));
    write(&root.join("transforms.json"), &document);
    (0..9).for_each(|index| save(root, index, Image::new(30, 20)));
    let scene = open(&settings(root, 1)).unwrap();
    assert!(scene.train.depths.is_empty() && told(&scene, "7 of 7 depth images hold no depth"));
}

#[test]
fn depth_images_of_fisheyes_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let mut document = scene(folder.path(), pinhole(), &slanted(30, 20));
    document["camera_model"] = json!("OPENCV_FISHEYE");
    write(&folder.path().join("transforms.json"), &document);
    let scene = open(&settings(folder.path(), 1)).unwrap();
    assert!(scene.train.depths.is_empty());
    assert!(told(&scene, "7 depth images of fisheye lenses are not read"), "{:?}", scene.warnings);
}

/// Checks ARKit's depth images, of aspect ratio 3:2, with their confidence. Depths beyond 5 m are guesses and are left out.
#[test]
fn phones_write_millimetres_and_how_sure_they_are() {
    let all = cameras(pinhole());
    let mut image = slanted(30, 20);
    image.put_pixel(11, 5, Luma([5001]));
    let confidence = ImageBuffer::from_fn(30, 20, |x, _| Luma([if x < 3 { 0 } else { 1_u8 }]));
    for phone in ["polycam", "arkitscenes"] {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let [depths, sure] = match phone {
            "polycam" => {
                polycam(root, &all, "corrected_");
                ["keyframes/depth", "keyframes/confidence"]
            }
            _ => {
                arkitscenes(root, &all);
                ["lowres_depth", "confidence"]
            }
        };
        for folder in [depths, sure] {
            fs::create_dir_all(root.join(folder)).unwrap();
        }
        for index in 0..9 {
            let name = match phone {
                "polycam" => format!("{index}.png"),
                _ => format!("41069021_{:.3}.png", 305.3 + 0.1 * f64::from(index)),
            };
            DynamicImage::from(image.clone()).save(root.join(depths).join(&name)).unwrap();
            DynamicImage::from(confidence.clone()).save(root.join(sure).join(&name)).unwrap();
        }
        let scene = open(&settings(root, 1)).unwrap();
        // All pixels are known except the unreliable ones and the one that is too far.
        assert_eq!(scene.train.depths.len(), 7 * (27 * 20 - 1), "{phone}");
        let first = scene.train.depths[0];
        let k = scene.train.views[0].camera.intrinsics;
        let along =
            literal(&k, [0.0; 4], [f64::from(first.pixel % 60) + 0.5, f64::from(first.pixel / 60) + 0.5]);
        let expected = 1e-3 * f64::from(image.get_pixel(3, 0).0[0]) * along;
        assert!((f64::from(first.distance) - expected).abs() < 1e-6 * expected, "{phone}: {first:?}");
    }
}
