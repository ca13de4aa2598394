//! Small valid files of every format, most of them written by the program itself.

#[allow(missing_docs, dead_code)]
#[path = "../../../trimip-data/tests/common/colmap.rs"]
mod colmap;

pub use colmap::Sparse;

use crate::{suite::hybrid::add_proxy, zip};
use image::{DynamicImage, ImageFormat, Luma, LumaA, Rgb, Rgba};
use serde_json::{Value, json};
use std::{io::Cursor, sync::OnceLock};
use trimip::run::store::ViewRecord;
use trimip_core::{
    Config, Layout,
    engine::{
        checkpoint::{Checkpoint, OCCUPANCY_DENSITY, TrainState},
        events::{Event, Provenance, Totals},
    },
    field::{
        model::{Model, OCCUPANCY},
        tensors::{Tensor, TensorFile},
    },
    measures::quality::{Measures, ScaleQuality},
};
use trimip_data::settings::DataConfig;

const POSE: [[f64; 4]; 4] =
    [[1.0, 0.0, 0.0, 0.1], [0.0, 0.0, -1.0, -4.0], [0.0, 1.0, 0.0, 0.3], [0.0, 0.0, 0.0, 1.0]];

/// Returns two archives: one with a folder, stored and compressed files, and an entry that the reader skips; and a
/// smaller one.
pub(super) fn archives() -> Vec<Vec<u8>> {
    let camera = br#"{"camera_angle_x": 0.7, "frames": []}"#;
    let scene = [
        zip::Entry::stored("scene/", b""),
        zip::Entry::deflated("scene/transforms_train.json", camera),
        zip::Entry::stored("scene/train/r_0.png", b"\x89PNG"),
        zip::Entry::deflated("scene/points.ply", &[b'0'; 300]),
        zip::Entry::stored("__MACOSX/scene/._r_0.png", b"x"),
    ];
    vec![zip::archive(&scene), zip::archive(&scene[3..])]
}

/// Returns additional camera files of a kind; the reader itself provides one example.
pub(super) fn of_cameras(kind: &str) -> Vec<Vec<u8>> {
    match kind {
        "transforms" => transforms(),
        "metadata" => metadata(),
        _ => Vec::new(),
    }
}

fn transforms() -> Vec<Vec<u8>> {
    let frame = |path: &str| json!({ "file_path": path, "transform_matrix": POSE });
    let with = |path: &str, more: Value| {
        let mut frame = frame(path);
        more.as_object().into_iter().flatten().for_each(|(key, value)| frame[key] = value.clone());
        frame
    };
    let plain = json!({ "camera_angle_x": 0.7, "frames": [frame("./train/r_0"), frame("./train/r_1")] });
    let nerfstudio = json!({
        "fl_x": 9.0, "fl_y": 8.5, "cx": 4.1, "cy": 3.0, "w": 8, "h": 6, "k1": 0.01, "k2": -0.002, "p1": 1e-4,
        "camera_model": "OPENCV", "applied_transform": POSE[..3], "applied_scale": 0.5, "ply_file_path": "points.ply",
        "train_filenames": ["images/0.png", "images/1.png"], "test_filenames": ["images/2.png"],
        "frames": [
            frame("images/0.png"),
            with("images/1.png", json!({ "mask_path": "masks/1.png", "w": 16, "h": 12, "fl_x": 18.0 })),
            with("images/2.png", json!({ "camera_model": "OPENCV_FISHEYE", "k3": 0.003, "p1": 0, "k4": 1e-5 })),
        ],
    });
    let ngp = json!({
        "camera_angle_x": 0.9, "camera_angle_y": 0.7, "aabb_scale": 4, "scale": 0.33, "offset": [0.5, 0.5, 0.5],
        "is_fisheye": false, "frames": [with("images/a.jpg", json!({ "sharpness": 30.5 })), frame("images/b.jpg")],
    });
    [plain, nerfstudio, ngp].iter().map(|document| document.to_string().into_bytes()).collect()
}

fn metadata() -> Vec<Vec<u8>> {
    static FILE: OnceLock<Vec<u8>> = OnceLock::new();
    let written = FILE.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a folder");
        let mut data = DataConfig { format: "builtin".into(), ..DataConfig::default() };
        (data.scales, data.builtin_size, data.builtin_train, data.builtin_test) = (2, 8, 2, 1);
        trimip_data::write_multiscale(&data, folder.path(), &trimip_data::unwatched)
            .expect("the set is written");
        std::fs::read(folder.path().join("metadata.json")).expect("it has a file")
    });
    let full = json!({ "train": {
        "file_path": ["a_d0.png", "a_d1.png"], "cam2world": [POSE, POSE], "width": [8, 4], "height": [6, 3],
        "focal": [9.0, 4.5], "lossmult": [1, 4], "fl_y": [9.5, 4.75], "cx": [4.0, 2.0], "cy": [3.0, 1.5],
        "k1": [0.01, 0.01], "camera_model": ["OPENCV", "OPENCV"],
        "pix2cam": [[[1.0 / 9.0, 0.0, -4.0 / 9.0], [0.0, -1.0 / 9.0, 3.0 / 9.0], [0.0, 0.0, -1.0]],
                    [[1.0 / 4.5, 0.0, -2.0 / 4.5], [0.0, -1.0 / 4.5, 1.5 / 4.5], [0.0, 0.0, -1.0]]],
    } });
    vec![written.clone(), full.to_string().into_bytes()]
}

/// Returns a COLMAP model with one image per camera model, five features per image, and five points.
pub fn sparse() -> Sparse {
    let mut sparse = colmap::capture();
    sparse.images.iter_mut().for_each(|image| image.5.truncate(5));
    sparse.points.truncate(5);
    sparse
}

pub(super) fn sparse_files(binary: bool) -> &'static [Vec<u8>; 3] {
    static FILES: OnceLock<[[Vec<u8>; 3]; 2]> = OnceLock::new();
    let both = FILES.get_or_init(|| [sparse().text().map(String::into_bytes), sparse().binary()]);
    &both[usize::from(binary)]
}

/// Returns the three files of a COLMAP model, each preceded by a byte with its number.
pub(super) fn colmap(binary: bool) -> Vec<Vec<u8>> {
    (0..).zip(sparse_files(binary)).map(|(which, file)| [&[which][..], file].concat()).collect()
}

pub(super) fn ply() -> Vec<Vec<u8>> {
    let head = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\ncomment points\nelement camera 1\nproperty list uchar int parts\nelement vertex 9\n\
             property float x\nproperty float y\nproperty double z\nproperty uchar red\nproperty uchar green\n\
             property uchar blue\nend_header\n"
        )
    };
    let rows: String = (0..9).map(|i| format!("{i} {}.5 0.5e-1 {i} 7 255\n", i % 7)).collect();
    let mut files = vec![format!("{}2 4 5\n{rows}", head("ascii")).into_bytes()];
    for big in [false, true] {
        let mut bytes = head(if big { "binary_big_endian" } else { "binary_little_endian" }).into_bytes();
        let mut put = |value: &[u8]| {
            let turned = value.iter().rev().copied();
            if big { bytes.extend(turned) } else { bytes.extend(value) }
        };
        put(&[1]);
        put(&7_i32.to_le_bytes());
        for i in 0..9_u8 {
            put(&f32::from(i).to_le_bytes());
            put(&f32::from(i % 7).to_le_bytes());
            put(&0.05_f64.to_le_bytes());
            [i, 7, 255].iter().for_each(|channel| put(&[*channel]));
        }
        files.push(bytes);
    }
    files
}

pub(super) fn pictures() -> Vec<Vec<u8>> {
    let of = |image: DynamicImage, format| {
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, format).expect("memory takes it");
        bytes.into_inner()
    };
    let (png, jpeg) = (ImageFormat::Png, ImageFormat::Jpeg);
    let (w, h) = (19, 11);
    let byte = |x: u32, y: u32| (x * 13 + y * 7) as u8;
    let grey = image::ImageBuffer::from_fn(w, h, |x, y| Luma([byte(x, y)]));
    let deep =
        image::ImageBuffer::from_fn(w, h, |x, y| Rgba([(x * 3000) as u16, (y * 5000) as u16, 9, 60_000]));
    let soft = image::ImageBuffer::from_fn(w, h, |x, y| LumaA([255, byte(x, y)]));
    let color = image::ImageBuffer::from_fn(w, h, |x, y| Rgb([byte(x, y), byte(y, x), 9]));
    vec![
        of(DynamicImage::ImageLuma8(grey.clone()), png),
        of(DynamicImage::ImageRgba16(deep.clone()), png),
        of(DynamicImage::ImageRgba16(deep), ImageFormat::Tiff),
        of(DynamicImage::ImageRgb8(color.clone()), ImageFormat::Tiff),
        of(DynamicImage::ImageRgb8(color.clone()), ImageFormat::Bmp),
        of(DynamicImage::ImageRgb8(color.clone()), ImageFormat::WebP),
        of(DynamicImage::ImageLumaA8(soft.clone()), ImageFormat::WebP),
        of(DynamicImage::ImageLumaA8(soft), png),
        of(DynamicImage::ImageRgb8(color.clone()), png),
        of(DynamicImage::ImageRgb8(color), jpeg),
        of(DynamicImage::ImageLuma8(grey), jpeg),
    ]
}

pub(super) fn configurations() -> Vec<Vec<u8>> {
    let mut hash_grid = Config::default();
    hash_grid.encoder.kind = trimip_core::config::EncoderKind::HashGrid;
    let short = "seed = 7 # a comment\n[train]\nseconds = 60\n[data]\nroot = \"a\\\\b\"\ntrain = [\"train\", 'val']\n\
                 background = [0, 0.5, 1.0]\n[encoder]\nhalvings = [[0.0, 2], [0.25, 1], [0.5, 0]]\n";
    [short.to_string(), tiny().to_toml(), hash_grid.to_toml()].map(String::into_bytes).into()
}

pub(super) fn assignments() -> Vec<Vec<u8>> {
    let all = [
        "train.steps=100",
        "data.root=some/folder",
        "data.background=[0, 0, 0.5]",
        "encoder.halvings=[[0.0, 2], [0.5, 0]]",
        "encoder.kind=hash-grid",
        "eval.final=false",
        "scene.aabb_min=[-1.0, -1.0, -1.0]",
        "field.hidden = 64",
        "data.edge_exponents=[0.0, 0.2, 0.3]",
    ];
    all.map(|text| text.as_bytes().to_vec()).into()
}

pub(super) fn paths() -> Vec<Vec<u8>> {
    let flat: Vec<f64> = POSE.concat();
    let path = json!({
        "w": 100, "h": 50, "fl_x": 120, "fl_y": 110, "cx": 50.5,
        "frames": [
            { "transform_matrix": POSE }, { "transform_matrix": flat, "fl_x": 60 },
            { "transform_matrix": POSE, "camera_angle_x": 0.9, "camera_model": "OPENCV_FISHEYE", "k1": 0.01 },
        ],
    });
    let mut files = transforms();
    files.push(path.to_string().into_bytes());
    files
}

/// Returns the smallest configuration.
fn tiny() -> Config {
    let mut settings = trimip::settings::defaults();
    for assignment in [
        "encoder.plane_size=4",
        "encoder.levels=2",
        "encoder.halvings=[[0.0, 1], [0.5, 0]]",
        "field.hidden=16",
        "field.density_layers=1",
        "field.color_layers=1",
        "field.geometry=4",
        "field.harmonics=1",
        "occupancy.resolution=16",
        "hybrid.resolution=16",
        "threads=1",
    ] {
        settings.apply_assignment(assignment).expect("the setting exists");
    }
    Config::from_settings(&settings).expect("the configuration is valid")
}

/// Returns the initial parameters of a model of `config` as tensors, once per suffix of their names. If there are
/// several suffixes, the densities of the occupancy grid follow.
fn tensors(config: &Config, suffixes: &[&str]) -> TensorFile {
    let layout = Layout::new(config);
    let values = layout.initial(config);
    let mut file = TensorFile::default();
    suffixes.iter().for_each(|suffix| layout.to_tensors(&values, suffix, &mut file));
    let cells = (config.occupancy.resolution as usize).pow(3);
    file.tensors.insert(OCCUPANCY.into(), Tensor::u8(&[cells / 8], vec![0xff; cells / 8]));
    if suffixes.len() > 1 {
        file.tensors.insert(OCCUPANCY_DENSITY.into(), Tensor::f32(&[cells], vec![1.0; cells]));
    }
    file
}

/// Returns the bytes that `write` writes to a file.
fn written(write: impl FnOnce(&std::path::Path) -> trimip_core::Result<u64>) -> Vec<u8> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("file");
    write(&path).expect("the file is written");
    std::fs::read(path).expect("it is there")
}

pub(super) fn models() -> Vec<Vec<u8>> {
    static FILES: OnceLock<Vec<Vec<u8>>> = OnceLock::new();
    let files = FILES.get_or_init(|| {
        let mut config = tiny();
        let plain = Model::new(config.clone(), tensors(&config, &[""]));
        config.file.planes = trimip_core::config::FilePrecision::F16;
        let mut baked = Model::new(config.clone(), tensors(&config, &[""]));
        let mut viewer = trimip::backends::load(&baked).expect("the processor renders it");
        add_proxy(&mut *viewer, &mut baked).expect("the proxy is computed");
        let packed = written(|path| plain.write_packed(path));
        let whole = [plain, baked];
        whole.iter().map(|model| written(|path| model.write(path))).chain([packed]).collect()
    });
    files.clone()
}

pub(super) fn checkpoints() -> Vec<Vec<u8>> {
    static FILE: OnceLock<Vec<u8>> = OnceLock::new();
    let file = FILE.get_or_init(|| {
        let config = tiny();
        let state = TrainState {
            stage: 1,
            spacing: 0.5,
            rays_per_step: 64,
            marched_per_ray: 9.5,
            ..TrainState::default()
        };
        let file = tensors(&config, &["", ".m", ".v"]);
        written(|path| Checkpoint { config, state, file }.write(path))
    });
    vec![file.clone()]
}

pub(super) fn curves() -> Vec<Vec<u8>> {
    let own = "seconds,step,samples,rays,stride,views,last,psnr_mean,ssim_mean\n0.500,1,9,9,25,8,false,10.5,0.5\n\
               60.250,99,9,9,25,8,false,30.125,0.9\n60.250,99,9,9,1,200,true,29.5,0.91\n";
    [own, "seconds , psnr_mean\r\n\n15,17.77\r\n30,19.76\r\n"].map(|text| text.as_bytes().to_vec()).into()
}

pub(super) fn events() -> Vec<Vec<u8>> {
    let totals =
        Totals { step: 40, seconds: 4.5, samples: 40_000, marched: 60_000, rays: 400, ..Totals::default() };
    let evaluation = |last| Event::Evaluation {
        totals,
        stride: 2,
        frames: 8,
        bounded: false,
        last,
        scales: vec![ScaleQuality {
            scale: 1,
            images: 4,
            perceptual_images: 0,
            measures: Measures { psnr: 30.5, ssim: 0.9, ..Measures::UNKNOWN },
        }],
        psnr: 30.5,
        ssim: 0.9,
        seconds: 2.0,
    };
    let provenance = Provenance { command: Some("trimip-cli".into()), ..Provenance::default() };
    let all = [
        Event::Plan { lines: vec!["scene".into()], summary: vec!["data".into()], memory_bytes: 9 },
        Event::Resumed { totals },
        Event::Warning { message: "dark".into() },
        evaluation(false),
        evaluation(true),
        Event::finished(totals),
        Event::SessionEnded {
            device: "cpu".into(),
            backend: "cpu".into(),
            wall_seconds: 9.5,
            peak_memory_bytes: Some(1 << 30),
            provenance,
        },
    ];
    let lines = all.iter().map(|event| serde_json::to_string(event).expect("events are JSON") + "\n");
    vec![lines.collect::<String>().into_bytes()]
}

pub(super) fn views() -> Vec<Vec<u8>> {
    let record = ViewRecord {
        index: 3,
        name: "r_3".into(),
        scale: 2,
        psnr: Some(30.5),
        ssim: None,
        ms_ssim: None,
        flip: Some(0.125),
        lpips: None,
        nearest_distance: Some(0.75),
        nearest_spacings: Some(1.5),
        comparison: Some("0003_r_3_scale2_compare.png".into()),
        flip_map: Some("0003_r_3_scale2_flip.png".into()),
    };
    vec![serde_json::to_vec(&[record.clone(), record]).expect("records are JSON")]
}

pub(super) fn plans() -> Vec<Vec<u8>> {
    let change = json!({ "path": "encoder.shape", "from": "\"square\"", "to": "\"box\"" });
    let finding = json!({
        "decision": "plan.levels", "choice": "auto", "left_out": true, "reason": "no camera reaches them", "changes": [change],
    });
    vec![json!([finding]).to_string().into_bytes()]
}
