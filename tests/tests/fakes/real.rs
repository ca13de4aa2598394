//! Checks of the verb `capture` with the real programs, if `TRIMIP_REQUIRE_COLMAP=1` is set. The programs take minutes, and because of
//! COLMAP's threads its cameras differ in every run.

use glam::DVec3;
use serde_json::Value;
use std::{
    fs,
    io::Write,
    path::Path,
    process::{Command, Stdio},
    time::Instant,
};
use trimip_core::Intrinsics;
use trimip_data::{
    builtin::{orbit, render},
    colmap::Model,
    settings::Finish,
};
use trimip_tests::binary::run;

/// Asserts that the programs are on the path of the test.
fn expect_programs(names: &[&str]) {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let is_there = |name: &&&str| std::env::split_paths(&path).any(|folder| folder.join(name).is_file());
    let missing: Vec<_> = names.iter().filter(|name| !is_there(name)).collect();
    assert!(missing.is_empty(), "{missing:?} are required");
}

/// Number of frames in the film of the built-in scene, and number of frames taken from it.
const FILMED: u32 = 60;
const TAKEN: usize = 20;

/// Films an arc around the built-in scene with the real ffmpeg; returns the positions of the cameras.
fn film_of_the_builtin_scene(film: &Path) -> Vec<DVec3> {
    let intrinsics = Intrinsics::from_angle(480, 360, 0.8);
    let picture = |index: u32| {
        let camera =
            orbit(intrinsics, 3.0, 0.45 + 0.1 * (0.2 * f64::from(index)).sin(), 0.03 * f64::from(index));
        let pixels = render(&camera, 2, Finish::Mixed, &|| ());
        let over = |p: &[u8; 4], c: usize| {
            (u32::from(p[c]) * u32::from(p[3]) / 255 + 60 * (255 - u32::from(p[3])) / 255) as u8
        };
        (camera.origin, pixels.iter().flat_map(|p| [over(p, 0), over(p, 1), over(p, 2)]).collect::<Vec<u8>>())
    };
    let mut ffmpeg = Command::new("ffmpeg")
        .args([
            "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "480x360", "-r", "15", "-i",
            "pipe:0",
        ])
        .args(["-pix_fmt", "yuv420p", "-q:v", "2", "-c:v", "mpeg4"])
        .arg(film)
        .stdin(Stdio::piped())
        .spawn()
        .unwrap();
    let mut pipe = ffmpeg.stdin.take().unwrap();
    let places = (0..FILMED).map(|index| {
        let (place, bytes) = picture(index);
        pipe.write_all(&bytes).unwrap();
        place
    });
    let places = places.collect();
    drop(pipe);
    assert!(ffmpeg.wait().unwrap().success());
    places
}

/// Asserts that the distances between the cameras of a capture match those of the film up to scale. Distances do not depend on the
/// position and rotation of the capture. Returns the number of cameras.
fn expect_places(capture: &Path, truth: &[DVec3]) -> usize {
    let pictures: Value =
        serde_json::from_slice(&fs::read(capture.join("state/pictures.json")).unwrap()).unwrap();
    let frame = |name: &str| {
        let all = pictures["result"]["pictures"].as_array().unwrap();
        let source = all.iter().find(|picture| picture["name"] == name).unwrap()["source"].as_str().unwrap();
        source.split(' ').nth(1).unwrap().parse::<usize>().unwrap()
    };
    let model = Model::read(&capture.join("sparse/0")).unwrap();
    let cameras = model.cameras_of_images("the model").unwrap();
    let found: Vec<(DVec3, DVec3)> = model
        .images
        .iter()
        .zip(&cameras)
        .map(|(image, camera)| (truth[frame(&image.name)], camera.origin))
        .collect();
    let pairs = || {
        found
            .iter()
            .enumerate()
            .flat_map(|(i, a)| found[..i].iter().map(move |b| (a.0.distance(b.0), a.1.distance(b.1))))
    };
    let (real, own) = pairs().fold((0.0, 0.0), |sum, pair| (sum.0 + pair.0, sum.1 + pair.1));
    let mut off: Vec<f64> = pairs().map(|(a, b)| (a - b * real / own).abs()).collect();
    off.sort_by(f64::total_cmp);
    // Cameras are 3 units from the scene, and neighbouring cameras 0.27 units from each other. From so small a film, COLMAP finds the lens
    // to within a few percent.
    let (median, worst) = (off[off.len() / 2], off[off.len() - 1]);
    println!("distances are off by {median:.3} in the median, {worst:.3} at most");
    assert!(median < 0.1 && worst < 0.5, "distances are off by {median} in the median, {worst} at most");
    found.len()
}

#[test]
fn the_real_programs_find_the_cameras_of_a_film() {
    if std::env::var_os("TRIMIP_REQUIRE_COLMAP").is_none_or(|value| value != "1") {
        println!("skipped: TRIMIP_REQUIRE_COLMAP=1 runs it");
        return;
    }
    expect_programs(&["ffmpeg", "ffprobe", "colmap"]);
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let truth = film_of_the_builtin_scene(&here.join("a round.mp4"));
    let has_pycolmap = || {
        let mut python = Command::new("python3");
        python
            .args(["-c", "import pycolmap"])
            .stderr(Stdio::null())
            .status()
            .is_ok_and(|status| status.success())
    };
    for (poses, is_there) in [("colmap", true), ("pycolmap", has_pycolmap())] {
        if !is_there {
            println!("skipped: {poses} is not installed");
            continue;
        }
        let started = Instant::now();
        let taken = TAKEN.to_string();
        let answer =
            run(here, &["capture", "a round.mp4", "--frames", &taken, "--poses", poses, "--out", poses]);
        assert_eq!((answer.code, answer.err.as_str()), (Some(0), ""), "{poses}: {answer:?}");
        let placed = expect_places(&here.join(poses), &truth);
        println!("{poses}: {placed} of {TAKEN} cameras in {:.0} s", started.elapsed().as_secs_f64());
        assert!(placed >= TAKEN * 3 / 4, "{poses}: {placed} of {TAKEN}: {}", answer.out);
    }
}
