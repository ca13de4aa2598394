//! Every reader with its memory limit: a multiple of the file's size, plus a constant. The multiple is the memory per byte of the shortest
//! possible entries, which need the most.

use super::{Format, seeds};
use image::ImageReader;
use std::{fmt::Display, io::Cursor, sync::LazyLock};
use trimip::{
    run::{curve, folder::events_of, history::History, store::ViewRecord},
    view::cameras,
};
use trimip_core::{
    Camera, Config, Error, Intrinsics, Result,
    engine::{checkpoint::Checkpoint, proxy::Proxy},
    field::model::{Model, assets},
    scene_plan::Finding,
};
use trimip_data::{
    colmap::{Encoding, File, Model as Sparse},
    in_memory::{self, CameraFile},
};

/// Constant part of a limit, for default settings, messages, and the first entries of growing lists.
const FIXED: usize = 1 << 20;

/// Names of the files of a COLMAP model, as text and as binary.
const TEXT: [&str; 3] = ["cameras.txt", "images.txt", "points3D.txt"];
const BINARY: [&str; 3] = ["cameras.bin", "images.bin", "points3D.bin"];

/// All formats: the camera files that scene readers register, and all others.
pub static FORMATS: LazyLock<Vec<Format>> =
    LazyLock::new(|| in_memory::camera_files().map(of_cameras).chain(others()).collect());

/// Returns the format of a file that holds the cameras of a scene.
fn of_cameras(file: &'static CameraFile) -> Format {
    let read = |bytes: &[u8]| {
        let cameras = (file.cameras)(file.file, bytes)?;
        cameras.iter().for_each(|(_, camera)| expect_finite(camera));
        Ok(())
    };
    Format {
        name: file.kind,
        files: std::slice::from_ref(&file.file),
        read: Box::new(read),
        seeds: Box::new(|| [vec![(file.example)()], seeds::of_cameras(file.kind)].concat()),
        limit: Box::new(|bytes| file.memory * bytes.len() + FIXED),
    }
}

type Read = fn(&[u8]) -> Result<()>;
type Seeds = fn() -> Vec<Vec<u8>>;
type Limit = fn(&[u8]) -> usize;

fn others() -> [Format; 15] {
    let of = |name, files, read: Read, seeds: Seeds, limit: Limit| -> Format {
        Format { name, files, read: Box::new(read), seeds: Box::new(seeds), limit: Box::new(limit) }
    };
    [
        of(
            "colmap-text",
            &TEXT,
            |bytes| colmap(Encoding::Text, TEXT, bytes),
            || seeds::colmap(false),
            |b| 8 * b.len() + FIXED,
        ),
        of(
            "colmap-binary",
            &BINARY,
            |bytes| colmap(Encoding::Binary, BINARY, bytes),
            || seeds::colmap(true),
            |b| 4 * b.len() + FIXED,
        ),
        of("ply", &["points.ply"], ply, seeds::ply, |b| 24 * b.len() + FIXED),
        of(
            "photograph",
            &["photograph"],
            |bytes| in_memory::photograph("photograph", bytes).map(drop),
            seeds::pictures,
            picture,
        ),
        of("mask", &["mask"], |bytes| in_memory::mask("mask", bytes).map(drop), seeds::pictures, picture),
        of(
            "archive",
            &["archive.zip"],
            |bytes| in_memory::archive("archive.zip", bytes).map(drop),
            seeds::archives,
            |b| 8 * b.len() + FIXED,
        ),
        of("configuration", &["run.toml"], configuration, seeds::configurations, |b| 400 * b.len() + FIXED),
        of("assignment", &["set", "command line"], assignment, seeds::assignments, |b| 400 * b.len() + FIXED),
        of("path", &["path.json"], path, seeds::paths, |b| 160 * b.len() + FIXED),
        // Proxies and packed models are compressed: DEFLATE expands one byte to at most 1032 bytes, each of which may become a float.
        of("model", &["model.safetensors", "the model's proxy"], model, seeds::models, |b| {
            5400 * b.len() + FIXED
        }),
        of("checkpoint", &["checkpoint.safetensors"], checkpoint, seeds::checkpoints, |b| {
            400 * b.len() + FIXED
        }),
        of("curve", &["curve.csv"], csv, seeds::curves, |b| 64 * b.len() + FIXED),
        of("events", &[], events, seeds::events, |b| 64 * b.len() + FIXED),
        of("views", &["views.json"], views, seeds::views, |b| 64 * b.len() + FIXED),
        of("plan", &["plan.json"], plan, seeds::plans, |b| 64 * b.len() + FIXED),
    ]
}

/// Asserts that the numbers of a camera are finite, and that its focal lengths and size are positive.
fn expect_finite(camera: &Camera) {
    let k = &camera.intrinsics;
    assert!(camera.rotation.is_finite() && camera.origin.is_finite(), "{camera:?}");
    assert!([k.fx, k.fy, k.cx, k.cy].iter().all(|value| value.is_finite()), "{camera:?}");
    assert!(k.fx > 0.0 && k.fy > 0.0 && k.width > 0 && k.height > 0, "{camera:?}");
}

/// Parses a COLMAP model. The first byte selects one of its three files, which consists of the other bytes; the other two files are valid.
fn colmap(encoding: Encoding, names: [&str; 3], bytes: &[u8]) -> Result<()> {
    let (&which, bytes) = bytes.split_first().unwrap_or((&0, &[]));
    let mut files = seeds::sparse_files(encoding == Encoding::Binary).each_ref().map(Vec::as_slice);
    files[usize::from(which % 3)] = bytes;
    let file = |i: usize| File { name: names[i], bytes: files[i] };
    let model = Sparse::parse(encoding, file(0), file(1), Some(file(2)))?;
    model.cameras_of_images(names[1])?.iter().for_each(expect_finite);
    assert!(model.points.iter().flat_map(|point| point.position).all(f64::is_finite));
    Ok(())
}

fn ply(bytes: &[u8]) -> Result<()> {
    let points = in_memory::ply("points.ply", bytes)?;
    assert!(points.iter().flat_map(|point| point.position).all(f64::is_finite));
    Ok(())
}

/// Returns the memory limit of a picture: 8 bytes per pixel during decoding and 4 afterwards, the coefficients of a progressive JPEG, and
/// the decoder's own buffers. Decoders allocate a whole chunk of a WebP file, whose length has 24 bits, or a whole tile of a TIFF file
/// before they read it.
fn picture(bytes: &[u8]) -> usize {
    let size = ImageReader::new(Cursor::new(bytes)).with_guessed_format().ok();
    let size = size.and_then(|reader| reader.into_dimensions().ok()).unwrap_or((0, 0));
    let pixels = u64::from(size.0) * u64::from(size.1);
    let in_parts = [&b"RIFF"[..], b"II", b"MM"].iter().any(|start| bytes.starts_with(start));
    let beside = if in_parts { 20 << 20 } else { FIXED };
    if pixels > 1 << 28 {
        16 * bytes.len() + beside
    } else {
        24 * pixels as usize + 16 * bytes.len() + beside
    }
}

/// Returns the bytes as text, or `None` if they are not UTF-8: the program refuses such a file when it reads it.
fn text(bytes: &[u8]) -> Option<&str> {
    std::str::from_utf8(bytes).ok()
}

fn configuration(bytes: &[u8]) -> Result<()> {
    let Some(text) = text(bytes) else { return Ok(()) };
    let config = Config::from_toml("run.toml", text)?;
    assert_eq!(Config::from_toml("again", &config.to_toml())?, config);
    Ok(())
}

fn assignment(bytes: &[u8]) -> Result<()> {
    let Some(text) = text(bytes) else { return Ok(()) };
    let mut settings = trimip::settings::defaults();
    settings.apply_assignment(text)?;
    Config::from_settings(&settings).map(drop)
}

fn path(bytes: &[u8]) -> Result<()> {
    let Some(text) = text(bytes) else { return Ok(()) };
    let cameras = cameras::path_of("path.json", text, Intrinsics::from_angle(80, 60, 0.7))?;
    cameras.iter().for_each(|(_, camera)| expect_finite(camera));
    Ok(())
}

fn model(bytes: &[u8]) -> Result<()> {
    let model = Model::from_bytes("model.safetensors", bytes)?;
    Proxy::from_assets(&assets(&model.file)).map(drop)
}

fn checkpoint(bytes: &[u8]) -> Result<()> {
    let checkpoint = Checkpoint::from_bytes("checkpoint.safetensors", bytes)?;
    checkpoint.not_finite();
    checkpoint.into_model();
    Ok(())
}

fn csv(bytes: &[u8]) -> Result<()> {
    let Some(text) = text(bytes) else { return Ok(()) };
    let (points, _) = curve::parse("curve.csv", text)?;
    assert!(points.is_sorted_by(|a, b| a.seconds <= b.seconds));
    Ok(())
}

/// Reads events. Lines that are no events are skipped, because a killed run may end in the middle of a line.
fn events(bytes: &[u8]) -> Result<()> {
    let history = History::of(&events_of(bytes));
    history.best_known();
    history.curve();
    history.devices();
    history.evaluation_seconds();
    Ok(())
}

fn views(bytes: &[u8]) -> Result<()> {
    serde_json::from_slice::<Vec<ViewRecord>>(bytes).map(drop).map_err(|error| refused("views.json", &error))
}

fn plan(bytes: &[u8]) -> Result<()> {
    serde_json::from_slice::<Vec<Finding>>(bytes).map(drop).map_err(|error| refused("plan.json", &error))
}

fn refused(name: &str, error: &dyn Display) -> Error {
    Error::input(name, error, "write it again")
}
