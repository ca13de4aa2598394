//! A scene of Apple's ARKitScenes: photographs in `lowres_wide/`, named by video and time in seconds, the intrinsics of each in
//! `lowres_wide_intrinsics/` (width, height, focal lengths, principal point), and `lowres_wide.traj` with one pose per line: time, rotation
//! axis times angle, and translation, world-to-camera with x right, y down and z forward (ARKitScenes, DATA.md and its loader).

use super::reader::{CameraFile, NamedCameras, Reader};
use crate::{
    depth_image::DepthFile,
    listing::{Calibration, Frame, Listing, vision_pose},
    names, numbers, pose,
    source::map_in_order,
    split::Split,
};
use glam::{DMat3, DVec3};
use std::path::{Path, PathBuf};
use trimip_core::{Camera, Error, Intrinsics, Lens, Place, Result, plural::count};

/// Trajectory, photographs and their intrinsics.
const POSES: &str = "lowres_wide.traj";
const IMAGES: &str = "lowres_wide";
const INTRINSICS: &str = "lowres_wide_intrinsics";

/// Folders of depth images (16-bit millimetres) and confidence images (0 to 2), named like the photographs (DATA.md).
const DEPTHS: [&str; 2] = ["lowres_depth", "confidence"];

/// Largest difference between the times of a pose and of its photograph, seconds.
const MOST_APART: f64 = 5e-3;

/// Possible differences between the time in the name of a photograph and that in the name of its intrinsics, seconds: both are rounded.
const STEPS: [f64; 3] = [0.0, -1e-3, 1e-3];

const ADVICE: &str = "download the scene again";

pub(super) static READER: Reader = Reader {
    format: "arkitscenes",
    name: "scene of ARKitScenes",
    files: Some("lowres_wide.traj"),
    recognises: |root| root.join(POSES).is_file(),
    open: |root, config| {
        let path = root.join(POSES);
        let poses = poses(&path, numbers::lines(&path, ADVICE)?)?;
        let mut photographs: Vec<PathBuf> =
            root.join(IMAGES).read_dir().into_iter().flatten().flatten().map(|entry| entry.path()).collect();
        photographs.retain(|path| names::is_picture(path));
        photographs.sort();
        let found = map_in_order(&photographs, |_, path| frame(root, path, &poses))?;
        let frames: Vec<Frame> = found.into_iter().flatten().collect();
        let warnings = (frames.len() < photographs.len())
            .then(|| {
                let all = count(photographs.len(), "photograph");
                format!("{} has poses of {} of {all}: the others are left out", path.display(), frames.len())
            })
            .into_iter()
            .collect();
        let facts = Split { warnings, ..Split::default() };
        let listing = Listing::new(root, config, &path, frames, facts)?;
        Ok(Box::new(listing.with_depths(|photograph| DepthFile::of_arkit(root, DEPTHS, photograph))))
    },
    images: Some("scenes of ARKitScenes"),
    divisible: true,
    camera_files: &[
        CameraFile {
            kind: "arkitscenes-trajectory",
            file: POSES,
            cameras: cameras_of_trajectory,
            example: || TRAJECTORY.into(),
            memory: 64,
        },
        CameraFile {
            kind: "arkitscenes-intrinsics",
            file: "lowres_wide_intrinsics/7_10.250.pincam",
            cameras: camera_of_intrinsics,
            example: || PINCAM.into(),
            memory: 64,
        },
    ],
};

/// Examples of a trajectory and of the intrinsics of a photograph, as in the files.
const TRAJECTORY: &str = "10.25 0.1 0.2 0.3 0.25 0.5 4\n10.5 0.1 -0.2 0.3 0.5 0.5 4\n";
const PINCAM: &str = "8 6 9 9.5 4.1 3.2\n";

/// Returns a camera for each pose, named by its number.
fn cameras_of_trajectory(name: &str, bytes: &[u8]) -> Result<NamedCameras> {
    let path = Path::new(INTRINSICS);
    let intrinsics = intrinsics(path, &numbers::parse(path, PINCAM.as_bytes(), ADVICE)?)?;
    let path = Path::new(name);
    let camera = |(index, line): (usize, &Line)| {
        let (rotation, origin) = placed(line).ok_or_else(|| not_finite(&path.into()))?;
        Ok((index.to_string(), Camera { intrinsics, rotation, origin }))
    };
    poses(path, numbers::parse(path, bytes, ADVICE)?)?.iter().enumerate().map(camera).collect()
}

fn camera_of_intrinsics(name: &str, bytes: &[u8]) -> Result<NamedCameras> {
    let path = Path::new(name);
    let intrinsics = intrinsics(path, &numbers::parse(path, bytes, ADVICE)?)?;
    Ok(vec![(names::stem(name), Camera { intrinsics, rotation: DMat3::IDENTITY, origin: DVec3::ZERO })])
}

/// A line of the trajectory: time, rotation around an axis, translation.
type Line = [f64; 7];

/// Parses poses from the lines of a file, and sorts them by time.
fn poses(path: &Path, lines: Vec<Vec<f64>>) -> Result<Vec<Line>> {
    let pose = |(index, line): (usize, Vec<f64>)| {
        let found = count(line.len(), "number");
        line.try_into().map_err(|_| {
            Error::input(
                format!("{}: pose {index}", path.display()),
                format!("has {found} instead of 7"),
                ADVICE,
            )
        })
    };
    let mut poses: Vec<Line> = lines.into_iter().enumerate().map(pose).collect::<Result<_>>()?;
    poses.sort_by(|a, b| a[0].total_cmp(&b[0]));
    Ok(poses)
}

/// Returns the pose nearest in time, if it is near enough.
fn near(poses: &[Line], time: f64) -> Option<&Line> {
    let after = poses.partition_point(|pose| pose[0] < time);
    let apart = |pose: &&Line| (pose[0] - time).abs();
    let around = poses[after.saturating_sub(1)..].iter().take(2);
    around.min_by(|a, b| apart(a).total_cmp(&apart(b))).filter(|pose| apart(pose) < MOST_APART)
}

/// Returns the rotation and the centre of the camera of a pose, if they are finite.
fn placed(&[_, x, y, z, tx, ty, tz]: &Line) -> Option<(DMat3, DVec3)> {
    let (rotation, origin) = vision_pose(pose::around(DVec3::new(x, y, z)), DVec3::new(tx, ty, tz));
    (rotation.is_finite() && origin.is_finite()).then_some((rotation, origin))
}

fn not_finite(place: &Place) -> Error {
    Error::input(place, "has a pose that is not finite", ADVICE)
}

/// Returns the frame of a photograph, or `None` if there is no pose.
fn frame(root: &Path, photograph: &Path, poses: &[Line]) -> Result<Option<Frame>> {
    let place = Place::from(photograph);
    let name = names::stem(&photograph.file_name().unwrap_or_default().to_string_lossy());
    let parts = name.rsplit_once('_').and_then(|(video, time)| Some((video, numbers::number(time).ok()?)));
    let Some((video, time)) = parts else {
        let what = "is not named by video and time, as in 41069021_305.377.png";
        return Err(Error::input(place, what, "restore its original name"));
    };
    let Some(line) = near(poses, time) else { return Ok(None) };
    let (rotation, origin) = placed(line).ok_or_else(|| not_finite(&place))?;
    let candidates =
        STEPS.map(|step| root.join(INTRINSICS).join(format!("{video}_{:.3}.pincam", time + step)));
    let path = candidates.iter().find(|path| path.is_file()).unwrap_or(&candidates[0]);
    let named = format!("{IMAGES}/{}", photograph.file_name().unwrap_or_default().to_string_lossy());
    Ok(Some(Frame {
        // The file of the intrinsics states the size, so errors about the size name this file.
        place: Place::part(path, format_args!("frame {named}")),
        named,
        rotation,
        origin,
        calibration: Calibration::Sized(intrinsics(path, &numbers::lines(path, ADVICE)?)?),
        split: None,
    }))
}

/// Reads intrinsics from the lines of a file.
fn intrinsics(path: &Path, lines: &[Vec<f64>]) -> Result<Intrinsics> {
    let wrong = |what: String| Error::input(path.display(), what, ADVICE);
    let all = lines.concat();
    let [width, height, fx, fy, cx, cy] = all[..] else {
        return Err(wrong(format!("holds {} instead of 6", count(all.len(), "number"))));
    };
    let is_side = |side: f64| side >= 1.0 && side <= f64::from(u32::MAX) && side.fract() == 0.0;
    if !(is_side(width) && is_side(height) && fx > 0.0 && fy > 0.0) {
        return Err(wrong(format!("states {width}x{height} pixels and the focal lengths {fx} and {fy}")));
    }
    Ok(Intrinsics { width: width as u32, height: height as u32, fx, fy, cx, cy, lens: Lens::default() })
}
