//! Checks of the verb `capture`, with programs that imitate ffmpeg, COLMAP of several versions, pycolmap and glomap: the
//! arguments of its calls, its choice among the programs, the files that remain when a program fails or is killed, and its
//! messages to the user. `TRIMIP_REQUIRE_COLMAP=1` also runs the test of `fakes/real.rs`, which calls the real programs.

#![cfg(unix)]

#[path = "../../trimip-data/tests/common/colmap.rs"]
#[allow(dead_code)]
mod sparse;

mod fakes;
#[path = "fakes/real.rs"]
mod real;

use fakes::{Place, SIDE, VIEWS};
use std::{
    fs,
    path::PathBuf,
    process::{Command, Stdio},
    time::{Duration, Instant},
};
use trimip_tests::{
    binary::{refuses, run},
    files::files,
    zip::{Entry, archive},
};

#[test]
fn photographs_become_a_scene_by_colmap_3_8() {
    let place = Place::new();
    place.colmap("3.8");
    place.whole_model();
    let before = files(&place.path("walk"));
    let told = place.captures(&["walk"]);
    assert_eq!(
        place.calls(),
        [
            "colmap feature_extractor --database_path features.part.db --image_path images --ImageReader.camera_model RADIAL \
             --ImageReader.single_camera 1 --ImageReader.single_camera_per_folder 0 --SiftExtraction.max_image_size 1600 \
             --SiftExtraction.use_gpu 0 --SiftExtraction.num_threads -1",
            "colmap exhaustive_matcher --database_path database.part.db --SiftMatching.use_gpu 0 --SiftMatching.num_threads -1",
            "colmap mapper --database_path database.db --image_path images --output_path models.part --Mapper.num_threads -1",
        ]
    );
    for part in [
        "RADIAL (ordinary lenses",
        "one for all pictures",
        "on the CPU: this COLMAP is built without CUDA",
        "each picture with every other, 66 pairs",
        "one after the other (12 pictures",
        "12 of 12 pictures placed by colmap 3.8, 27 points",
        "next: trimip-cli captures/walk",
    ] {
        assert!(told.contains(part), "{part}: {told}");
    }
    assert_eq!(files(&place.path("walk")), before, "photographs stay as they are");
    for name in [
        "images/11.jpg",
        "sparse/0/images.bin",
        "models/0/images.bin",
        "database.db",
        "inspect.html",
        "log/model.log",
    ] {
        assert!(place.has(&format!("captures/walk/{name}")), "{name}");
    }
    let page = fs::read_to_string(place.path("captures/walk/inspect.html")).unwrap();
    assert!(page.contains("COLMAP") && !page.contains("Without a camera"));
    let log = fs::read_to_string(place.path("captures/walk/log/features.log")).unwrap();
    assert!(log.contains("feature_extractor") && log.contains("Processed file [12/12]"), "{log}");
    assert!(told.contains("\"done\":1,\"total\":12"), "{told}");

    // A second run of the command does nothing, even without any program. The result is a scene that other verbs read.
    let whole = files(&place.path("captures/walk"));
    fs::remove_dir_all(place.path("fake/bin")).unwrap();
    let again = place.captures(&["walk"]);
    assert_eq!(again.matches("\"earlier\":true").count(), 3, "{again}");
    assert!(place.calls().is_empty() && files(&place.path("captures/walk")) == whole);
    let inspected = place.run(&["data", "inspect", "captures/walk"]);
    assert!(inspected.code == Some(0) && inspected.out.contains("12 images"), "{inspected:?}");
}

#[test]
fn options_have_the_names_of_the_version() {
    let place = Place::new();
    place.colmap("4");
    place.whole_model();
    place.captures(&["walk", "--mapper", "global", "--threads", "2", "--size", "640", "--camera", "opencv"]);
    let calls = place.calls();
    for part in [
        "OPENCV",
        "FeatureExtraction.max_image_size 640",
        "FeatureExtraction.use_gpu 0",
        "FeatureExtraction.num_threads 2",
    ] {
        assert!(calls[0].contains(part), "{part}: {calls:?}");
    }
    assert!(calls[1].ends_with("--FeatureMatching.use_gpu 0 --FeatureMatching.num_threads 2"), "{calls:?}");
    assert_eq!(
        calls[2],
        "colmap global_mapper --database_path database.db --image_path images --output_path models.part"
    );
}

#[test]
fn programs_are_chosen_in_order_or_as_asked_for() {
    let place = Place::new();
    place.whole_model();
    place.pycolmap();
    let told = place.captures(&["walk", "--out", "a"]);
    assert!(told.contains("placed by pycolmap 4.2.1"), "{told}");
    let calls = place.calls();
    assert!(
        calls[0].starts_with("pycolmap features {") && calls[0].contains("\"camera_mode\":\"SINGLE\""),
        "{calls:?}"
    );
    assert!(
        calls[1].starts_with("pycolmap exhaustive {") && calls[2].starts_with("pycolmap incremental {"),
        "{calls:?}"
    );
    assert!(calls[2].contains("\"models\":\"models.part\"") && place.has("a/log/poses.py"), "{calls:?}");

    // COLMAP before version 4 ranks below this pycolmap, and above an older pycolmap.
    place.colmap("3.8");
    assert!(place.captures(&["walk", "--out", "n"]).contains("placed by pycolmap 4.2.1"));
    place.sign("pycolmap", "pycolmap 3.10.0 False False\n");
    place.calls();
    let told = place.captures(&["walk", "--out", "b"]);
    assert!(told.contains("placed by colmap 3.8") && told.contains("pip install pycolmap"), "{told}");
    assert_eq!(place.commands(), ["feature_extractor", "exhaustive_matcher", "mapper"]);
    place.colmap("4");
    place.sign("pycolmap", "pycolmap 4.2.1 False True\n");
    assert!(place.captures(&["walk", "--out", "o"]).contains("placed by colmap 4"));
    place.calls();
    assert!(
        place.captures(&["walk", "--out", "c", "--poses", "pycolmap"]).contains("placed by pycolmap 4.2.1")
    );
    place.calls();
    // A program that is installed later does not change finished stages.
    assert!(
        place.captures(&["walk", "--out", "a"]).contains("placed by pycolmap 4.2.1")
            && place.calls().is_empty()
    );

    place.colmap("3.8");
    place.sign("pycolmap", "pycolmap 3.10.0 False False\n");
    place.program("glomap", include_str!("fakes/glomap.sh"));
    assert!(place.captures(&["walk", "--out", "d", "--poses", "glomap"]).contains("placed by glomap"));
    let calls = place.calls();
    assert_eq!(
        calls[2],
        "glomap mapper --database_path database.db --image_path images --output_path models.part"
    );
    assert!(place.captures(&["walk", "--out", "e", "--mapper", "global"]).contains("placed by glomap"));
}

#[test]
fn a_film_of_any_name_gives_its_sharpest_frames() {
    let place = Place::new();
    let film = "-a fílm 1.mp4";
    place.film(film);
    place.colmap("3.8");
    place.model(0, &(0..10).collect::<Vec<_>>(), |view| format!("{:05}.jpg", view + 1));
    let told = place.captures(&["--frames", "10", "--", film]);
    let calls = place.calls();
    let path = format!("-i {}", place.path(film).canonicalize().unwrap().display());
    assert!(
        calls[0].contains(&path) && calls[0].contains("scale=64:64:flags=area,format=gray,showinfo"),
        "{calls:?}"
    );
    assert!(calls[1].contains("-fps_mode passthrough") && calls[1].contains("tonemap=hable"), "{calls:?}");
    assert!(calls[1].contains(",scale=out_color_matrix=bt601 "), "{calls:?}");
    let selected: Vec<usize> = calls[1]
        .split("eq(n,")
        .skip(1)
        .map(|rest| rest.split(')').next().unwrap().parse().unwrap())
        .collect();
    assert!(selected.len() == 10 && selected.iter().all(|frame| frame % 4 == 1), "{selected:?}");
    assert!(
        calls[3].starts_with("colmap sequential_matcher") && calls[3].contains("overlap 10"),
        "{calls:?}"
    );
    for part in ["HDR (HLG)", "frames: 10 of 40", "10 of 10 pictures placed", "a film"] {
        assert!(told.contains(part), "{part}: {told}");
    }
    assert!(told.contains("next: trimip-cli 'captures/-a fílm 1'"), "{told}");
    assert!(
        place.has("captures/-a fílm 1/images/00010.jpg")
            && place.has("captures/-a fílm 1/sparse/0/images.bin")
    );

    // The option has another name in older versions of ffmpeg.
    place.sign("ffmpeg-help", "-vsync x\n");
    place.captures(&["--frames", "10", "--out", "old", "--", film]);
    assert!(place.calls()[0].contains("-vsync passthrough"));
}

#[test]
fn a_stage_that_failed_is_done_again_and_those_before_it_are_kept() {
    let place = Place::new();
    place.colmap("3.8");
    place.whole_model();
    let stages = ["feature_extractor", "exhaustive_matcher", "mapper"];
    for (index, stage) in stages.into_iter().enumerate() {
        place.sign(&format!("fail-{stage}"), "E1 something\nE2 is wrong\nE3 for sure\n");
        let answer = place.run(&["capture", "walk"]);
        answer.expect_error(
            1,
            &[
                &format!("colmap {stage} ended with exit code 1: E1 something | E2 is wrong | E3 for sure"),
                "captures/walk/log/",
            ],
        );
        assert_eq!(place.commands(), stages[index..=index].to_vec(), "{stage}");
        place.unsign(&format!("fail-{stage}"));
        if index + 1 < stages.len() {
            // Only the next stage fails, so this one is finished.
            place.sign(&format!("fail-{}", stages[index + 1]), "E\n");
            assert_eq!(place.run(&["capture", "walk"]).code, Some(1));
            assert_eq!(place.commands(), stages[index..index + 2].to_vec());
        }
    }
    place.captures(&["walk"]);
    assert_eq!(place.commands(), ["mapper"]);
}

#[test]
fn what_is_changed_is_done_again_from_there() {
    let place = Place::new();
    place.colmap("3.8");
    place.whole_model();
    place.captures(&["walk"]);
    place.calls();
    for (more, expected) in [
        (&["--matcher", "sequential"][..], &["sequential_matcher", "mapper"][..]),
        (&[], &["exhaustive_matcher", "mapper"]),
        (&["--threads", "3"], &[]),
        (&["--camera", "radial"], &[]),
        (&["--size", "500"], &["feature_extractor", "exhaustive_matcher", "mapper"]),
        (&["--size", "500", "--fresh"], &["feature_extractor", "exhaustive_matcher", "mapper"]),
    ] {
        place.captures(&[&["walk"], more].concat());
        assert_eq!(place.commands(), expected, "{more:?}");
    }
    // Removing a photograph, or a picture of the capture, changes the input.
    for change in ["walk/11.jpg", "captures/walk/images/03.jpg"] {
        place.captures(&["walk"]);
        place.calls();
        fs::remove_file(place.path(change)).unwrap();
        fs::remove_dir_all(place.path("fake/models")).unwrap();
        place.model(0, &(0..VIEWS - 1).collect::<Vec<_>>(), |view| format!("{view:02}.jpg"));
        place.captures(&["walk"]);
        assert_eq!(place.commands(), ["feature_extractor", "exhaustive_matcher", "mapper"], "{change}");
    }
}

/// Returns true if a process exists and is no zombie.
fn lives(id: &str) -> bool {
    fs::read_to_string(format!("/proc/{id}/stat")).is_ok_and(|stat| !stat.contains(") Z "))
}

#[test]
fn a_capture_that_is_killed_leaves_no_process_and_nothing_half_done() {
    let place = Place::new();
    place.film("walk.mp4");
    place.colmap("3.8");
    place.model(0, &(0..10).collect::<Vec<_>>(), |view| format!("{:05}.jpg", view + 1));
    let arguments = ["capture", "walk.mp4", "--frames", "10"];
    let stages = ["ffmpeg", "feature_extractor", "sequential_matcher", "mapper"];
    for (index, stage) in stages.into_iter().enumerate() {
        for signal in ["-KILL", "-TERM", "-INT"] {
            place.unsign("hanging");
            place.sign(&format!("hang-{stage}"), "");
            let mut child =
                place.command(&arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
            let started = Instant::now();
            let id = loop {
                let id = fs::read_to_string(place.path("fake/hanging")).unwrap_or_default();
                if id.ends_with('\n') {
                    break id.trim().to_string();
                }
                assert!(started.elapsed() < Duration::from_secs(60), "{stage} begins");
                std::thread::sleep(Duration::from_millis(5));
            };
            assert!(!cfg!(target_os = "linux") || lives(&id));
            assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
            let code = child.wait().unwrap().code();
            assert_eq!(code, if signal == "-KILL" { None } else { Some(130) }, "{stage} {signal}");
            while lives(&id) {
                assert!(started.elapsed() < Duration::from_secs(60), "{stage} {signal}: the program goes on");
                std::thread::sleep(Duration::from_millis(5));
            }
            let state = |name: &str| place.has(&format!("captures/walk/state/{name}.json"));
            let done = ["pictures", "features", "matches", "model"].map(state);
            let expected = [0, 1, 2, 3].map(|stage| stage < index);
            assert_eq!(done, expected, "{stage} {signal}");
        }
        place.unsign(&format!("hang-{stage}"));
        place.calls();
    }
    place.captures(&["walk.mp4", "--frames", "10"]);
    assert_eq!(place.commands(), ["mapper"]);
    let left: Vec<PathBuf> = files(&place.path("captures/walk"))
        .into_keys()
        .filter(|path| path.to_string_lossy().contains("part"))
        .collect();
    assert!(left.is_empty(), "{left:?}");
    assert!(!fs::read(place.path("captures/walk/database.db")).unwrap().is_empty());
}

#[test]
fn missing_programs_are_told_with_the_line_that_installs_them() {
    let place = Place::new();
    fs::write(place.path("walk.mp4"), "a film").unwrap();
    // No program is on the path.
    let refused = |arguments: &[&str], parts: &[&str]| {
        let answer = place.run(&[&["capture"], arguments].concat());
        answer.expect_error(2, parts);
        assert!(!place.has("captures") && answer.out.is_empty(), "{answer:?}");
    };
    refused(&["walk.mp4"], &["walk.mp4: no ffmpeg with ffprobe", "install it: "]);
    refused(&["walk"], &["walk: neither colmap nor a python3 with pycolmap", "install it: ", "pycolmap"]);
    refused(&["walk", "--poses", "colmap"], &["--poses colmap: no program colmap"]);
    refused(&["walk", "--poses", "pycolmap"], &["pip install pycolmap"]);
    refused(&["walk", "--poses", "glomap"], &["no program glomap"]);
    // A Python without pycolmap does not count.
    place.program("python3", include_str!("fakes/python3.sh"));
    refused(&["walk"], &["neither colmap nor"]);
}

#[test]
fn wrong_input_is_refused_with_what_to_do() {
    let place = Place::new();
    place.colmap("3.8");
    let here = place.folder.path();
    fs::create_dir(here.join("few")).unwrap();
    fs::copy(here.join("walk/00.jpg"), here.join("few/0.jpg")).unwrap();
    fs::create_dir(here.join("scene")).unwrap();
    fs::write(here.join("scene/transforms.json"), "{}").unwrap();
    fs::create_dir(here.join("theirs")).unwrap();
    fs::write(here.join("theirs/letter.txt"), "x").unwrap();
    let refused = |arguments: &[&str], parts: &[&str]| {
        let before = files(here);
        place.run(&[&["capture"], arguments].concat()).expect_error(2, parts);
        assert_eq!(files(here), before, "{arguments:?}");
    };
    refused(&["few"], &["few: holds only 1 photograph", "take more"]);
    refused(&["scene"], &["scene: holds a scene with cameras already", "trimip-cli scene"]);
    refused(&["gone.mp4"], &["gone.mp4: does not exist"]);
    refused(&["few/0.jpg"], &["is no film", "the folder of all photographs"]);
    refused(&["walk", "--out", "theirs"], &["theirs: holds files that no capture wrote", "--out"]);
    refused(&["walk", "--minutes", "5"], &["--train"]);
    refused(&["walk", "--frames", "1"], &["--frames"]);
    refused(&["walk", "--frames", "9"], &["--frames: is for films"]);
    refused(&["walk", "--mapper", "global"], &["colmap 3.8 has no global mapper"]);
    refused(&["walk", "--vocab-tree", "gone.bin"], &["gone.bin: is no vocabulary tree"]);
    refused(&["walk", "--train", "--set", "train.stepz=1"], &["train.stepz"]);
    refused(&["."], &["lies in the folder that is captured", "--out"]);
    place.whole_model();
    place.captures(&["walk", "--out", "mine"]);
    fs::create_dir(here.join("other")).unwrap();
    for name in ["00.jpg", "01.jpg", "02.jpg"] {
        fs::copy(here.join("walk").join(name), here.join("other").join(name)).unwrap();
    }
    refused(&["other", "--out", "mine"], &["mine: holds the capture of ", "/walk"]);
    // The error for a broken film contains ffmpeg's message.
    place.film("walk.mp4");
    place.sign("fail-ffmpeg", "");
    place
        .run(&["capture", "walk.mp4"])
        .expect_error(1, &["ffmpeg ended with exit code 1: moov atom not found"]);
    place.sign("probe", "{\"streams\":[]}");
    place.run(&["capture", "walk.mp4"]).expect_error(2, &["walk.mp4: has no video stream"]);
}

#[test]
fn pictures_that_no_camera_is_found_of_are_refused() {
    let place = Place::new();
    place.colmap("3.8");
    place
        .run(&["capture", "walk"])
        .expect_error(2, &["colmap 3.8 placed none of these pictures", "more overlap", "log/model.log"]);
    assert!(!place.has("captures/walk/sparse"));
    place.whole_model();
    place.calls();
    place.captures(&["walk"]);
    assert_eq!(place.commands(), ["mapper"]);
}

#[test]
fn a_model_with_lost_cameras_is_tried_again_without_distortion() {
    let place = Place::new();
    place.colmap("3.8");
    place.lost_models(&[3, 7], &[7]);
    let told = place.captures(&["walk"]);
    let calls = place.calls();
    assert!(
        calls.len() == 4 && calls[2].ends_with("--output_path models.part --Mapper.num_threads -1"),
        "{calls:?}"
    );
    let again = "--output_path again.part --Mapper.num_threads -1 --Mapper.ba_refine_extra_params 0";
    assert!(calls[3].ends_with(again), "{calls:?}");
    for part in [
        "2 of 12 are more than 1000 times as far from the centre as the median camera",
        "once more, without lens distortion",
        "11 of 12 pictures placed",
        "not placed: 07.jpg (07.jpg): its camera is more than 1000 times as far",
    ] {
        assert!(told.contains(part), "{part}: {told}");
    }
    assert!(!told.contains("not placed: 03.jpg"), "{told}");
    let page = fs::read_to_string(place.path("captures/walk/inspect.html")).unwrap();
    assert!(page.contains("Without a camera") && page.contains("07.jpg"));
    let left: Vec<PathBuf> = files(&place.path("captures/walk")).into_keys().collect();
    assert!(left.iter().all(|path| !path.to_string_lossy().contains("again")), "{left:?}");
    // Readers of the scene leave the photograph out.
    let inspected = place.run(&["data", "inspect", "captures/walk"]);
    assert!(inspected.out.contains("1 of 12 photographs, the first 07,"), "{inspected:?}");

    // The first model is kept if the second one is no better; for a lens model without distortion there is no second one.
    place.lost_models(&[7], &[3, 7]);
    assert!(place.captures(&["walk", "--out", "b"]).contains("11 of 12 pictures placed"));
    assert_eq!(place.calls().len(), 4);
    assert!(place.captures(&["walk", "--out", "c", "--camera", "pinhole"]).contains("11 of 12"));
    assert_eq!(place.calls().len(), 3);
}

#[test]
fn heic_is_converted_and_left_as_it_is() {
    let place = Place::new();
    place.colmap("3.8");
    fs::create_dir(place.path("phone")).unwrap();
    for view in 0..VIEWS {
        let jpeg = fs::read(place.path(&format!("walk/{view:02}.jpg"))).unwrap();
        let heic = [b"\0\0\0\x18ftypheic\0\0\0\0\n", &jpeg[..]].concat();
        // Some phones name HEIC files `.jpg`.
        let name = if view % 2 == 0 { format!("IMG {view:02}.HEIC") } else { format!("IMG {view:02}.jpg") };
        fs::write(place.path("phone").join(name), heic).unwrap();
    }
    let before = files(&place.path("phone"));
    let missing = place.run(&["capture", "phone"]);
    missing.expect_error(2, &["no program that reads HEIC", "install it: "]);
    place.program("heif-convert", include_str!("fakes/heif-convert.sh"));
    place.model(0, &(0..VIEWS).collect::<Vec<_>>(), |view| format!("IMG_{view:02}.jpg"));
    place.calls();
    let told = place.captures(&["phone"]);
    assert!(told.contains("12 pictures") && told.contains("converted by heif-convert"), "{told}");
    let calls = place.calls();
    assert!(
        calls.iter().filter(|call| call.starts_with("heif-convert -q 100 ")).count() == VIEWS,
        "{calls:?}"
    );
    assert_eq!(files(&place.path("phone")), before);
    assert_eq!(
        image::image_dimensions(place.path("captures/phone/images/IMG_03.jpg")).unwrap(),
        (SIDE, SIDE)
    );
}

#[test]
fn of_several_models_the_largest_is_taken_and_the_rest_is_told() {
    let place = Place::new();
    place.colmap("3.8");
    let name = |view: usize| format!("{view:02}.jpg");
    place.model(0, &[9, 10], name);
    place.model(1, &[0, 1, 2, 3, 4, 5, 6, 7], name);
    // Photograph 11 is blurred.
    let blurred = image::open(place.path("walk/11.jpg")).unwrap().blur(6.0);
    blurred.save(place.path("walk/11.jpg")).unwrap();
    let told = place.captures(&["walk"]);
    for part in [
        "8 of 12 pictures placed",
        "models: 2 with 8 (1), 2 (0) pictures",
        "not placed: 09.jpg (09.jpg): in another model of 2 pictures",
        "not placed: 11.jpg (11.jpg): too blurred",
        "not placed: 08.jpg (08.jpg): too few matches",
    ] {
        assert!(told.contains(part), "{part}: {told}");
    }
    let page = fs::read_to_string(place.path("captures/walk/inspect.html")).unwrap();
    let section = &page[page.find("Without a camera").expect("the section")..];
    let section = &section[..section.find("</section>").unwrap()];
    assert!(
        section.matches("<figure><img").count() == 4 && section.contains("too blurred"),
        "{}",
        section.len()
    );
    let stated = |path: &str| fs::read(place.path(path)).unwrap()[..8].to_vec();
    assert_eq!(stated("captures/walk/sparse/0/images.bin"), 8_u64.to_le_bytes());
}

#[test]
fn photographs_of_several_sizes_and_folders_are_kept_apart() {
    let place = Place::new();
    place.colmap("3.8");
    fs::create_dir_all(place.path("walk/b")).unwrap();
    for view in 0..3 {
        let picture = image::open(place.path(&format!("walk/{view:02}.jpg"))).unwrap();
        picture.crop_imm(0, 0, SIDE, SIDE - 8).save(place.path(&format!("walk/b/{view:02}.jpg"))).unwrap();
        fs::remove_file(place.path(&format!("walk/{view:02}.jpg"))).unwrap();
    }
    place.model(0, &(3..VIEWS).collect::<Vec<_>>(), |view| format!("48x48/{view:02}.jpg"));
    let told = place.captures(&["walk"]);
    assert!(told.contains("one for each of 2 sizes") && told.contains("9 of 12 pictures placed"), "{told}");
    assert!(place.calls()[0].contains("single_camera 0 --ImageReader.single_camera_per_folder 1"));
    assert!(place.has("captures/walk/images/48x40/00.jpg") && place.has("captures/walk/images/48x48/11.jpg"));
}

#[test]
fn archives_are_unpacked_and_what_is_refused_today_names_this_verb() {
    let place = Place::new();
    place.colmap("3.8");
    place.whole_model();
    let here = place.folder.path();
    let entries: Vec<Entry> = (0..VIEWS)
        .map(|view| {
            Entry::stored(
                &format!("photos/{view:02}.jpg"),
                &fs::read(here.join(format!("walk/{view:02}.jpg"))).unwrap(),
            )
        })
        .collect();
    fs::write(here.join("trip.zip"), archive(&entries)).unwrap();
    fs::write(here.join("a film.mp4"), "x").unwrap();
    refuses(here, &["walk"], &["its 12 pictures need cameras", "trimip-cli capture walk"]);
    refuses(here, &["trip.zip"], &["its 12 pictures need cameras", "trimip-cli capture trip.zip"]);
    refuses(here, &["a film.mp4"], &["trimip-cli capture 'a film.mp4'"]);
    assert!(run(here, &[]).err.contains("trimip-cli capture FILM"));
    let told = place.captures(&["trip.zip"]);
    assert!(
        told.contains("trip.zip is unpacked in trip") && told.contains("12 of 12 pictures placed"),
        "{told}"
    );
    assert!(place.has("captures/trip/sparse/0/images.bin"));
}

#[test]
fn a_capture_is_trained_on_and_filmed() {
    let place = Place::new();
    place.colmap("3.8");
    place.whole_model();
    let settings = [
        "data.scales=1",
        "encoder.plane_size=16",
        "encoder.levels=3",
        "field.hidden=16",
        "occupancy.resolution=16",
        "train.samples_per_step=512",
        "train.steps=10",
        "eval.points=0",
        "eval.min_gain=0",
        "backend=cpu",
        "threads=2",
    ];
    let mut arguments = vec!["capture", "walk", "--train"];
    settings.iter().for_each(|set| arguments.extend(["--set", set]));
    let answer = place.run(&arguments);
    assert_eq!(answer.code, Some(0), "{answer:?}");
    assert!(answer.out.contains("\"kind\":\"finished\"") && !answer.out.contains("next: "), "{answer:?}");
    assert!(answer.err.contains("trimip-cli train captures/walk --set data.scales=1"), "{}", answer.err);
    assert!(
        answer.err.contains("no film: there is no ffmpeg") && answer.err.contains("tools/web.sh"),
        "{}",
        answer.err
    );
    assert!(place.has("runs/walk/model.safetensors") && place.has("runs/walk/report.html"));
}
