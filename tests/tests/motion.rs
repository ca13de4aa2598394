//! Checks of rendering many views of a model: rendering continues where it was interrupted, and the pictures become a
//! video.

use image::codecs::{gif::GifDecoder, webp::WebPDecoder};
use image::{AnimationDecoder, RgbaImage};
use std::io::Cursor;
use std::{fs, path::Path, process::Stdio, time::SystemTime};
use trimip_data::settings::DataConfig;
use trimip_tests::binary::{Answer, command, run, tiny_and};

/// Trains the smallest model into `run`.
fn train(here: &Path) {
    let answer = run(here, &tiny_and(&["--out", "run"]));
    assert_eq!(answer.code, Some(0), "{}", answer.err);
}

/// Renders a turntable of small pictures.
fn turntable(here: &Path, count: &str, more: &[&str]) -> Answer {
    let size = ["--turntable", count, "--width", "24", "--height", "17"];
    let answer = run(here, &[&["render", "run"], &size[..], more].concat());
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    answer
}

fn picture(folder: &Path, i: usize) -> Vec<u8> {
    fs::read(folder.join(format!("{i:04}_color.png"))).unwrap()
}

fn written(folder: &Path, i: usize) -> SystemTime {
    fs::metadata(folder.join(format!("{i:04}_color.png"))).unwrap().modified().unwrap()
}

#[test]
fn a_killed_turntable_goes_on_with_the_same_pictures() {
    const COUNT: usize = 400;
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here);
    let count = COUNT.to_string();
    let arguments =
        ["render", "run", "--turntable", &count, "--width", "24", "--height", "17", "--out", "parts"];
    let parts = here.join("parts");
    let mut child = command(here, &arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    while !parts.join("0020_color.png").exists() {
        assert!(child.try_wait().unwrap().is_none(), "it ended before it could be killed");
        std::thread::yield_now();
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!parts.join(format!("{:04}_color.png", COUNT - 1)).exists(), "it was killed too late");
    let before: Vec<_> = (0..20).map(|i| written(&parts, i)).collect();
    let answer = turntable(here, &count, &["--out", "parts"]);
    let rendered = answer.out.lines().count();
    assert!((1..=COUNT - 20).contains(&rendered), "{rendered} pictures");
    assert!(answer.err.contains(&format!("{} views rendered earlier", COUNT - rendered)), "{}", answer.err);
    assert_eq!(before, (0..20).map(|i| written(&parts, i)).collect::<Vec<_>>(), "finished pictures stay");
    turntable(here, &count, &["--out", "whole"]);
    for i in 0..COUNT {
        assert!(picture(&parts, i) == picture(&here.join("whole"), i), "picture {i}");
    }
}

#[test]
fn only_what_is_missing_or_of_another_job_is_rendered() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here);
    let rendered = |more: &[&str]| turntable(here, "4", more).out.lines().count();
    assert_eq!([rendered(&[]), rendered(&[])], [4, 0]);
    fs::remove_file(here.join("run/renders/0002_color.png")).unwrap();
    assert_eq!([rendered(&[]), rendered(&["--fresh"])], [1, 4]);
    // Another model, field of view or quantity begins a new job, which renders all pictures.
    assert_eq!(rendered(&["--set", "renderer.min_transmittance=0.5"]), 4);
    assert_eq!([rendered(&["--fov", "50"]), rendered(&["--fov", "50"])], [4, 0]);
    assert_eq!(rendered(&["--fov", "50", "--what", "color,depth"]), 8);
    fs::write(here.join("run/renders/views.txt"), "mine").unwrap();
    let answer = run(here, &["render", "run", "--turntable", "4"]);
    assert_eq!(answer.code, Some(2), "{}", answer.err);
    assert!(answer.err.contains("not a list of rendered views"), "{}", answer.err);
    assert_eq!(fs::read(here.join("run/renders/views.txt")).unwrap(), b"mine");
}

#[test]
fn a_flythrough_goes_along_the_training_cameras_and_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here);
    let film = |more: &[&str]| {
        let size = ["--flythrough", "5", "--width", "24", "--height", "17"];
        let answer = run(here, &[&["render", "run"], &size[..], more].concat());
        assert_eq!(answer.code, Some(0), "{}", answer.err);
        answer.out.lines().count()
    };
    assert_eq!([film(&[]), film(&[])], [5, 0]);
    let size = |folder: &str, picture: &str| {
        image::image_dimensions(here.join("run").join(folder).join(picture)).unwrap()
    };
    assert_eq!(size("renders", "0004_color.png"), (24, 17));
    // Without a size, a film has the size of the photographs; with one side, their aspect ratio.
    for (given, side) in [(&[][..], 16), (&["--height", "20"][..], 20)] {
        let answer = run(
            here,
            &[&["render", "run", "--flythrough", "2", "--out", "run/own", "--fresh"], given].concat(),
        );
        assert_eq!(answer.code, Some(0), "{}", answer.err);
        assert_eq!(size("own", "0001_color.png"), (side, side));
    }
    let text = fs::read(here.join("run/renders/cameras.json")).unwrap();
    let cameras: serde_json::Value = serde_json::from_slice(&text).unwrap();
    let origins: Vec<[f64; 3]> = (0..5)
        .map(|i| [0, 1, 2].map(|axis| cameras["frames"][i]["transform_matrix"][axis][3].as_f64().unwrap()))
        .collect();
    assert_ne!(origins[0], origins[4]);
    // A mean of cameras is not farther away than the farthest of them.
    let builtin = DataConfig { format: "builtin".into(), ..DataConfig::default() };
    let photographed = trimip_data::open_test(&builtin).unwrap().train;
    let farthest = photographed.iter().map(|camera| camera.origin.length()).fold(0.0, f64::max);
    let away = |o: &[f64; 3]| o.iter().map(|x| x * x).sum::<f64>().sqrt();
    assert!(origins.iter().all(|o| away(o) < farthest + 1e-6), "{origins:?}");
    let answer = run(here, &["render", "run", "--flythrough", "1"]);
    assert_eq!(answer.code, Some(2), "{}", answer.err);
    for views in [&["--views", "0", "--width", "24"][..], &["--fov", "30"]] {
        let answer = run(here, &[&["render", "run"], views].concat());
        assert_eq!(answer.code, Some(2), "{}", answer.err);
        assert!(answer.err.contains("--scale"), "{}", answer.err);
    }
}

#[test]
fn motion_blur_mixes_the_pictures_around_a_frame() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here);
    turntable(here, "8", &["--out", "sharp"]);
    turntable(here, "8", &["--out", "still", "--motion-blur", "3", "--shutter", "0"]);
    let blurred = ["--out", "blurred", "--motion-blur", "4"];
    let answer = turntable(here, "8", &blurred);
    assert_eq!(answer.out.lines().count(), 8);
    let open = |folder: &str, i: usize| {
        image::open(here.join(folder).join(format!("{i:04}_color.png"))).unwrap().to_rgba8()
    };
    for i in 0..8 {
        let (sharp, still, blurred) = (open("sharp", i), open("still", i), open("blurred", i));
        let steps = sharp.as_raw().iter().zip(still.as_raw()).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(steps <= Some(1), "a shutter that is open for no time sees no motion");
        let blurs = psnr(&sharp, &blurred);
        assert!((10.0..45.0).contains(&blurs), "{blurs} dB");
    }
    // Pictures of the same motion blur are kept, those of another are rendered again.
    assert_eq!(turntable(here, "8", &blurred).out.lines().count(), 0);
    assert_eq!(turntable(here, "8", &[&blurred[..], &["--shutter", "0.25"]].concat()).out.lines().count(), 8);
    for (arguments, part) in [
        (&["--motion-blur", "4"][..], "add --turntable N"),
        (&["--turntable", "3", "--shutter", "0.5"], "--motion-blur"),
        (&["--turntable", "3", "--motion-blur", "1"], "2..=256"),
        (&["--turntable", "3", "--motion-blur", "2", "--shutter", "1.5"], "from 0 to 1"),
        (&["--turntable", "3", "--motion-blur", "2", "--shutter", "nan"], "from 0 to 1"),
    ] {
        let answer = run(here, &[&["render", "run"], arguments].concat());
        assert!(answer.code == Some(2) && answer.err.contains(part), "{arguments:?}: {answer:?}");
    }
    assert!(!here.join("run/renders").exists());
}

#[test]
fn a_video_that_cannot_be_made_is_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here);
    for (arguments, part) in [
        (&["--turntable", "3", "--video", "a.avi"][..], "end it in .mp4, .gif, .webp, .mov, .mkv, .webm"),
        (&["--turntable", "3", "--video", "a"], "end it in"),
        (&["--video", "a.mp4"], "add --turntable N, --flythrough N or --path FILE"),
        (&["--turntable", "3", "--video", "a.mp4", "--rate", "nan"], "--rate above 0"),
        (&["--turntable", "3", "--video", "a.mp4", "--what", "depth"], "name color in --what"),
        (&["--turntable", "3", "--rate", "24"], "--video"),
        (&["--turntable", "3", "--video", "a.webm"], "no program `ffmpeg`"),
        (&["--turntable", "3", "--video", "a.mp4", "--width", "4000", "--height", "90"], "at most 3840"),
        (&["--turntable", "3", "--video", "a.mp4", "--width", "15", "--height", "90"], "at least 16"),
    ] {
        let output = command(here, &[&["render", "run"], arguments].concat())
            .env("PATH", here.join("nowhere"))
            .output()
            .unwrap();
        let err = String::from_utf8_lossy(&output.stderr);
        assert_eq!(
            (output.status.code(), output.stdout.as_slice()),
            (Some(2), &b""[..]),
            "{arguments:?}: {err}"
        );
        assert!(err.contains(part), "{arguments:?}: {err}");
    }
    assert!(!here.join("run/renders").exists());
}

/// Returns the pictures of a film and their durations in milliseconds.
fn animation<'a>(decoder: impl AnimationDecoder<'a>) -> (Vec<RgbaImage>, Vec<u32>) {
    let frames = decoder.into_frames().collect_frames().unwrap();
    let time = |frame: &image::Frame| {
        let (numerator, denominator) = frame.delay().numer_denom_ms();
        numerator / denominator
    };
    let times = frames.iter().map(time).collect();
    (frames.into_iter().map(image::Frame::into_buffer).collect(), times)
}

/// Returns the PSNR of the colours of two pictures, in dB.
fn psnr(a: &RgbaImage, b: &RgbaImage) -> f64 {
    assert_eq!(a.dimensions(), b.dimensions());
    let squares = a
        .pixels()
        .zip(b.pixels())
        .flat_map(|(a, b)| (0..3).map(|c| (f64::from(a.0[c]) - f64::from(b.0[c])).powi(2)));
    let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), square| (sum + square, count + 1.0));
    10.0 * (255.0_f64.powi(2) * count / sum.max(1e-9)).log10()
}

#[test]
fn films_are_written_without_other_programs() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here);
    let film = |name: &str| {
        let arguments =
            ["render", "run", "--turntable", "7", "--width", "65", "--height", "49", "--rate", "8"];
        let output = command(here, &[&arguments[..], &["--video", name]].concat())
            .env("PATH", here.join("nowhere"))
            .output()
            .unwrap();
        let err = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{name}: {err}");
        assert!(String::from_utf8_lossy(&output.stdout).trim().ends_with(name), "{name}");
        fs::read(here.join(name)).unwrap()
    };
    let webp = film("v.webp");
    let pictures: Vec<RgbaImage> = (0..7)
        .map(|i| image::load_from_memory(&picture(&here.join("run/renders"), i)).unwrap().into_rgba8())
        .collect();
    let (found, times) = animation(WebPDecoder::new(Cursor::new(&webp)).unwrap());
    assert!(found == pictures, "WebP is exact");
    assert_eq!(times, [125; 7]);

    let gif = film("v.gif");
    let (found, times) = animation(GifDecoder::new(Cursor::new(&gif)).unwrap());
    // Hundredths of a second whose sum stays within one of 7/8 s.
    assert!(
        times.iter().all(|time| [120, 130].contains(time)) && times.iter().sum::<u32>() == 880,
        "{times:?}"
    );
    assert_eq!(found.len(), 7);
    for (found, picture) in found.iter().zip(&pictures) {
        assert!(psnr(found, picture) > 28.0, "256 colours: {}", psnr(found, picture));
    }

    let mp4 = film("v.mp4");
    for name in [&b"ftyp"[..], b"moov", b"avc1", b"avcC", b"stsz", b"mdat"] {
        assert!(mp4.windows(4).any(|window| window == name), "{}", String::from_utf8_lossy(name));
    }
    assert!(mp4 == film("again.mp4"), "the same pictures give the same film");
    // Another program reads it, where there is one.
    let decode = ["-v", "error", "-i", "v.mp4", "-f", "rawvideo", "-pix_fmt", "rgba", "-"];
    let Ok(output) = std::process::Command::new("ffmpeg").args(decode).current_dir(here).output() else {
        eprintln!("no ffmpeg: the MP4 is not decoded");
        return;
    };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // Sides are even in H.264: 66 by 50.
    let frames: Vec<&[u8]> = output.stdout.chunks(66 * 50 * 4).collect();
    assert_eq!((frames.len(), output.stdout.len() % (66 * 50 * 4)), (7, 0));
    for (frame, picture) in frames.into_iter().zip(&pictures) {
        let frame = RgbaImage::from_raw(66, 50, frame.to_vec()).unwrap();
        let frame = image::imageops::crop_imm(&frame, 0, 0, 65, 49).to_image();
        assert!(psnr(&frame, picture) > 30.0, "{}", psnr(&frame, picture));
    }
}

/// In place of ffmpeg, the test uses a program that records its input.
#[cfg(unix)]
#[test]
fn the_encoder_gets_the_pictures_in_order_and_its_failure_leaves_nothing() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    train(here);
    let encoder = |script: &str| {
        fs::create_dir_all(here.join("bin")).unwrap();
        let text = format!("#!/bin/sh\n[ \"$1\" = -version ] && exit 0\nfor last; do :; done\n{script}\n");
        fs::write(here.join("bin/ffmpeg"), text).unwrap();
        fs::set_permissions(here.join("bin/ffmpeg"), fs::Permissions::from_mode(0o755)).unwrap();
    };
    let path = format!("{}:{}", here.join("bin").display(), std::env::var("PATH").unwrap());
    let render = || {
        let arguments = ["render", "run", "--turntable", "5", "--width", "24", "--height", "17"];
        let video = ["--video", "out/v.mkv", "--rate", "12"];
        command(here, &[&arguments[..], &video].concat()).env("PATH", &path).output().unwrap()
    };
    encoder("echo \"$@\" > arguments; cat > \"$last\"");
    let output = render();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).trim().ends_with("out/v.mkv"));
    let all: Vec<u8> = (0..5).flat_map(|i| picture(&here.join("run/renders"), i)).collect();
    assert!(fs::read(here.join("out/v.mkv")).unwrap() == all, "the pictures, one after the other");
    let arguments = fs::read_to_string(here.join("arguments")).unwrap();
    assert!(arguments.contains("-framerate 12") && arguments.contains("yuv420p"), "{arguments}");
    for script in ["cat > \"$last\"; echo no such codec >&2; exit 1", "echo no such codec >&2; exit 1"] {
        encoder(script);
        let output = render();
        let err = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(1), "{err}");
        assert!(err.contains("out/v.mkv") && err.contains("no such codec"), "{err}");
        assert!(fs::read(here.join("out/v.mkv")).unwrap() == all, "the earlier video stays");
        assert_eq!(fs::read_dir(here.join("out")).unwrap().count(), 1, "nothing unfinished is left");
    }
}
