//! A folder with photographs, and programs that imitate ffmpeg, COLMAP, pycolmap and glomap.

use super::sparse::Sparse;
use glam::{DMat3, DQuat, DVec3};
use serde_json::Value;
use std::{
    fs,
    os::unix::fs::PermissionsExt,
    path::PathBuf,
    process::{Command, Stdio},
};
use trimip_tests::binary::{Answer, command, run};

/// Number of photographs of the built-in scene, and their side in pixels.
pub const VIEWS: usize = 12;
pub const SIDE: u32 = 48;

/// A folder with photographs in `walk/`, and programs in `fake/bin/`; no other programs are on the path.
pub struct Place {
    pub folder: tempfile::TempDir,
    /// Camera-to-world matrix of each photograph, with OpenGL axes.
    poses: Vec<[[f64; 4]; 4]>,
    focal: f64,
}

impl Place {
    /// Creates photographs `walk/00.jpg` to `walk/11.jpg` and no program.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        fs::create_dir_all(here.join("fake/bin")).unwrap();
        fs::create_dir(here.join("walk")).unwrap();
        let sets = [
            format!("data.builtin_size={SIDE}"),
            format!("data.builtin_train={VIEWS}"),
            "data.builtin_test=1".into(),
            "data.builtin_supersampling=2".into(),
        ];
        let mut arguments = vec!["data", "builtin", "set"];
        sets.iter().for_each(|set| arguments.extend(["--set", set]));
        assert_eq!(run(here, &arguments).code, Some(0));
        let json: Value =
            serde_json::from_slice(&fs::read(here.join("set/transforms_train.json")).unwrap()).unwrap();
        let focal = 0.5 * f64::from(SIDE) / (0.5 * json["camera_angle_x"].as_f64().unwrap()).tan();
        let mut poses = Vec::new();
        for (index, frame) in json["frames"].as_array().unwrap().iter().enumerate() {
            poses.push(serde_json::from_value(frame["transform_matrix"].clone()).unwrap());
            let name = format!("set/{}.png", frame["file_path"].as_str().unwrap().trim_start_matches("./"));
            let picture = image::open(here.join(name)).unwrap().to_rgb8();
            picture.save(here.join(format!("walk/{index:02}.jpg"))).unwrap();
        }
        fs::remove_dir_all(here.join("set")).unwrap();
        Self { folder, poses, focal }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn has(&self, name: &str) -> bool {
        self.path(name).exists()
    }

    pub fn program(&self, name: &str, text: &str) {
        let path = self.path("fake/bin").join(name);
        fs::write(&path, text).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }

    pub fn colmap(&self, version: &str) {
        let (help, extraction, matching) = match version {
            "3.8" => (include_str!("colmap-3.8.help"), "SiftExtraction", "SiftMatching"),
            _ => (include_str!("colmap-4.help"), "FeatureExtraction", "FeatureMatching"),
        };
        self.program("colmap", include_str!("colmap.sh"));
        fs::write(self.path("fake/help"), help).unwrap();
        let matcher = [&format!("{matching}.use_gpu"), &format!("{matching}.num_threads"), "database_path"];
        let with = |more: &[&'static str]| {
            matcher
                .iter()
                .map(|name| name.to_string())
                .chain(more.iter().map(|name| name.to_string()))
                .collect()
        };
        let mapper = vec![
            "database_path".into(),
            "image_path".into(),
            "output_path".into(),
            "Mapper.num_threads".into(),
            "Mapper.ba_refine_extra_params".into(),
        ];
        let extractor = [
            "database_path".to_string(),
            "image_path".into(),
            "ImageReader.camera_model".into(),
            "ImageReader.single_camera".into(),
            "ImageReader.single_camera_per_folder".into(),
            format!("{extraction}.max_image_size"),
            format!("{extraction}.use_gpu"),
            format!("{extraction}.num_threads"),
        ];
        let commands: [(&str, Vec<String>); 6] = [
            ("feature_extractor", extractor.into()),
            ("exhaustive_matcher", with(&[])),
            (
                "sequential_matcher",
                with(&["SequentialMatching.overlap", "SequentialMatching.loop_detection"]),
            ),
            ("matches_importer", with(&["match_list_path", "match_type"])),
            ("mapper", mapper.clone()),
            ("global_mapper", mapper[..3].to_vec()),
        ];
        for (command, options) in commands {
            let lines: Vec<String> =
                options.iter().map(|option| format!("  --{option} arg (=1)\n")).collect();
            fs::write(self.path(&format!("fake/help-{command}")), lines.concat()).unwrap();
        }
    }

    pub fn pycolmap(&self) {
        self.program("python3", include_str!("python3.sh"));
        fs::write(self.path("fake/pycolmap"), "pycolmap 4.2.1 False True\n").unwrap();
    }

    /// Adds ffmpeg, ffprobe, and a film `film` of 40 moving frames, every fourth of which is sharp.
    pub fn film(&self, film: &str) {
        for (name, text) in [("ffmpeg", include_str!("ffmpeg.sh")), ("ffprobe", include_str!("ffprobe.sh"))] {
            self.program(name, text);
        }
        fs::write(self.path("fake/ffmpeg-help"), "-fps_mode  x\n-vsync  x\n").unwrap();
        let probe = format!(
            "{{\"streams\":[{{\"codec_name\":\"hevc\",\"width\":{0},\"height\":{0},\"avg_frame_rate\":\"10/1\",\"nb_frames\":\"40\",\
             \"color_transfer\":\"arib-std-b67\",\"pix_fmt\":\"yuv420p10le\"}}]}}",
            64
        );
        fs::write(self.path("fake/probe"), probe).unwrap();
        let (mut raw, mut times) = (Vec::new(), String::new());
        for frame in 0..40_usize {
            for pixel in 0..64 * 64_usize {
                let (x, y) = ((pixel % 64 + 2 * frame) as f64, (pixel / 64) as f64);
                let wave = (0.21 * x).sin() + (0.17 * x + 0.33 * y).sin() + (0.37 * y - 0.11 * x).sin();
                // The sharp frames have fine detail, which a blurred frame lacks.
                let fine = if frame % 4 == 1 && (pixel + pixel / 64) % 2 == 0 { 12 } else { 0 };
                raw.push((120.0 + 35.0 * wave) as u8 + fine);
            }
            times += &format!(
                "[Parsed_showinfo_2 @ 0x1] n:{frame:4} pts:{frame} pts_time:{:.2} x\n",
                0.1 * frame as f64
            );
        }
        fs::write(self.path("fake/raw"), raw).unwrap();
        fs::write(self.path("fake/showinfo"), times).unwrap();
        fs::create_dir_all(self.path("fake/frames")).unwrap();
        for number in 1..=VIEWS {
            fs::copy(
                self.path(&format!("walk/{:02}.jpg", number - 1)),
                self.path(&format!("fake/frames/{number}.jpg")),
            )
            .unwrap();
        }
        fs::write(self.path(film), "a film").unwrap();
    }

    /// Adds a COLMAP model of the photographs `views` as the mapper's model `number`; `name` returns the name of a photograph.
    pub fn model(&self, number: u32, views: &[usize], name: impl Fn(usize) -> String) {
        self.model_in(&format!("fake/models/{number}"), views, &[], name);
    }

    /// Adds two COLMAP models of all photographs under their own names. In the model of the mapper, the cameras `lost` are far away; in
    /// the model of the mapper without distortion, the cameras `undistorted` are far away.
    pub fn lost_models(&self, lost: &[usize], undistorted: &[usize]) {
        let whole: Vec<usize> = (0..VIEWS).collect();
        for (folder, lost) in [("fake/models/0", lost), ("fake/undistorted/models/0", undistorted)] {
            self.model_in(folder, &whole, lost, |view| format!("{view:02}.jpg"));
        }
    }

    fn model_in(&self, folder: &str, views: &[usize], lost: &[usize], name: impl Fn(usize) -> String) {
        let mut sparse = Sparse::default();
        let half = 0.5 * f64::from(SIDE);
        let side = u64::from(SIDE);
        sparse.cameras.push((1, 1, "PINHOLE", [side, side], vec![self.focal, self.focal, half, half]));
        let points: Vec<DVec3> = (0..27)
            .map(|i| {
                0.4 * DVec3::new(f64::from(i % 3) - 1.0, f64::from(i / 3 % 3) - 1.0, f64::from(i / 9) - 1.0)
            })
            .collect();
        let mut tracks = vec![Vec::new(); points.len()];
        for (id, &view) in (1..).zip(views) {
            let rows = self.poses[view];
            let row = |row: usize| DVec3::new(rows[row][0], -rows[row][1], -rows[row][2]);
            // Rotation from the axes of a camera that looks along +z to those of the world.
            let to_world = DMat3::from_cols(row(0), row(1), row(2)).transpose();
            let far = if lost.contains(&view) { 1e9 } else { 1.0 };
            let origin = far * DVec3::new(rows[0][3], rows[1][3], rows[2][3]);
            let from_world = to_world.transpose();
            let shift = -(from_world * origin);
            let q = DQuat::from_mat3(&from_world);
            let places = points.iter().enumerate().map(|(index, point)| {
                let local = from_world * *point + shift;
                let place = [half + self.focal * local.x / local.z, half + self.focal * local.y / local.z];
                tracks[index].push([id, index as u32]);
                (place, index as i64)
            });
            sparse.images.push((id, [q.w, q.x, q.y, q.z], shift.to_array(), 1, name(view), places.collect()));
        }
        for (index, (point, track)) in points.iter().zip(tracks).enumerate() {
            sparse.points.push((index as u64, point.to_array(), [90, 80, 70], 0.5, track));
        }
        sparse.write_binary(&self.path(folder));
    }

    /// Adds a COLMAP model of all photographs under their own names.
    pub fn whole_model(&self) {
        self.model(0, &(0..VIEWS).collect::<Vec<_>>(), |view| format!("{view:02}.jpg"));
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = command(self.folder.path(), arguments);
        command.env("PATH", self.path("fake/bin")).stdin(Stdio::null());
        command
    }

    pub fn run(&self, arguments: &[&str]) -> Answer {
        let output = self.command(arguments).output().unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Answer { code: output.status.code(), out: text(&output.stdout), err: text(&output.stderr) }
    }

    /// Runs `capture` to success; returns the program's output.
    #[track_caller]
    pub fn captures(&self, arguments: &[&str]) -> String {
        let answer = self.run(&[&["capture"], arguments].concat());
        assert_eq!((answer.code, answer.err.as_str()), (Some(0), ""), "{answer:?}");
        for line in answer.out.lines() {
            let event: Value = serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"));
            assert!(event["kind"].is_string(), "{line}");
        }
        answer.out
    }

    /// Returns the programs' calls so far, and clears them.
    pub fn calls(&self) -> Vec<String> {
        let calls = fs::read_to_string(self.path("fake/calls")).unwrap_or_default();
        let _ = fs::remove_file(self.path("fake/calls"));
        calls.lines().map(String::from).collect()
    }

    /// Returns the second word of each call.
    pub fn commands(&self) -> Vec<String> {
        self.calls().iter().filter_map(|call| call.split(' ').nth(1)).map(String::from).collect()
    }

    pub fn sign(&self, name: &str, text: &str) {
        fs::write(self.path("fake").join(name), text).unwrap();
    }

    pub fn unsign(&self, name: &str) {
        let _ = fs::remove_file(self.path("fake").join(name));
    }
}
