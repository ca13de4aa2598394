//! Tests of COLMAP models with detached parts: a room that a model contains twice.

use crate::common::{colmap::Sparse, settings};
use glam::{DMat3, DQuat, DVec3};
use image::{GrayImage, Luma};
use std::path::Path;
use trimip_core::Camera;
use trimip_data::{Scene, open, settings::DataConfig};

const SIZE: [u32; 2] = [240, 180];
const FOCAL: f64 = 200.0;
const FRAMES: usize = 32;
/// Number of frames of the detached part, which come first.
const PART: usize = 10;

/// Half the side lengths of a room around the origin.
const ROOM: DVec3 = DVec3::new(2.0, 1.8, 1.4);

/// Returns smooth noise with cells of this size, in [0, 1].
fn noise(at: DVec3, cell: f64) -> f64 {
    let at = at / cell;
    let (low, part) = (at.floor(), at - at.floor());
    let corner = |[x, y, z]: [u32; 3]| {
        let [x, y, z] = (low + DVec3::new(x.into(), y.into(), z.into())).to_array().map(|place| place as i64);
        let mut bits =
            (x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663) ^ z.wrapping_mul(83_492_791)) as u64;
        bits = (bits ^ (bits >> 33)).wrapping_mul(0xff51_afd7_ed55_8ccd);
        ((bits >> 40) as f64) / f64::from(1 << 24)
    };
    let mut sum = 0.0;
    for i in 0..8 {
        let upper = [i & 1, i >> 1 & 1, i >> 2];
        let weight: f64 = (0..3).map(|a| if upper[a] == 1 { part[a] } else { 1.0 - part[a] }).product();
        sum += weight * corner(upper);
    }
    sum
}

/// Returns the brightness of the walls: no two places look alike.
fn shade(at: DVec3) -> f64 {
    0.5 * noise(at, 0.11)
        + 0.3 * noise(at + DVec3::splat(7.3), 0.23)
        + 0.2 * noise(at - DVec3::splat(3.1), 0.6)
}

/// Returns the point at which a ray from within the room meets a wall.
fn wall(origin: DVec3, direction: DVec3) -> DVec3 {
    let t = (0..3).map(|axis| (ROOM[axis] * direction[axis].signum() - origin[axis]) / direction[axis]);
    origin + t.fold(f64::INFINITY, f64::min) * direction
}

/// Returns the world-to-camera rotation (x right, y down, z ahead) and the centre of a frame, on a walk along a circle
/// with the camera turned outwards.
fn pose(frame: usize) -> (DMat3, DVec3) {
    let angle = frame as f64 / FRAMES as f64 * std::f64::consts::TAU;
    let ahead = DVec3::new(angle.cos(), angle.sin(), -0.1 + 0.1 * (3.0 * angle).sin()).normalize();
    let right = ahead.cross(DVec3::Z).normalize();
    let centre = 0.5 * DVec3::new(-angle.sin(), angle.cos(), 0.2 * (2.0 * angle).cos());
    (DMat3::from_cols(right, ahead.cross(right), ahead).transpose(), centre)
}

/// Returns the pixel at which a frame sees a place.
fn seen([rotation, centre]: [DMat3; 2], at: DVec3) -> Option<[f64; 2]> {
    let local = rotation * (at - centre.x_axis);
    let [x, y] = [0, 1].map(|i| FOCAL * local[i] / local.z + 0.5 * f64::from(SIZE[i]));
    let inside = |x: f64, side: u32| (1.0..f64::from(side) - 1.0).contains(&x);
    (local.z > 0.1 && inside(x, SIZE[0]) && inside(y, SIZE[1])).then_some([x, y])
}

fn photograph(frame: usize) -> GrayImage {
    let (rotation, centre) = pose(frame);
    GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| {
        let [x, y] = [x, y].map(|i| f64::from(i) + 0.5);
        let local = DVec3::new((x - 120.0) / FOCAL, (y - 90.0) / FOCAL, 1.0);
        Luma([(255.0 * shade(wall(centre, rotation.transpose() * local))) as u8])
    })
}

/// Returns scale, rotation and shift of the room around the frames of the detached part.
fn apart(is_torn: bool) -> (f64, DMat3, DVec3) {
    match is_torn {
        true => (
            1.05,
            DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(0.02, 0.03, -0.04))),
            DVec3::new(3.0, 1.0, 0.2),
        ),
        false => (1.0, DMat3::IDENTITY, DVec3::ZERO),
    }
}

/// Returns the model of the room. If it is torn, frames of the detached part share no point with the others.
fn model(is_torn: bool) -> Sparse {
    let (scale, turn, shift) = apart(is_torn);
    let mut sparse = Sparse::default();
    sparse.cameras.push((1, 1, "PINHOLE", SIZE.map(u64::from), vec![FOCAL, FOCAL, 120.0, 90.0]));
    for frame in 0..FRAMES {
        let (mut rotation, mut centre) = pose(frame);
        if frame < PART {
            (rotation, centre) = (rotation * turn.transpose(), scale * (turn * centre) + shift);
        }
        let q = DQuat::from_mat3(&rotation);
        let t = -(rotation * centre);
        sparse.images.push((
            frame as u32 + 1,
            [q.w, q.x, q.y, q.z],
            t.to_array(),
            1,
            format!("walk{frame}.png"),
            Vec::new(),
        ));
    }
    let mut add = |at: DVec3, is_part: Option<bool>| {
        let number = sparse.points.len() as u64 + 1;
        let mut track = Vec::new();
        for frame in 0..FRAMES {
            let (rotation, centre) = pose(frame);
            let place = seen([rotation, DMat3::from_cols(centre, centre, centre)], at);
            if let Some(place) = place.filter(|_| is_part.is_none_or(|is_part| is_part == (frame < PART))) {
                let features = &mut sparse.images[frame].5;
                track.push([frame as u32 + 1, features.len() as u32]);
                features.push((place, number as i64));
            }
        }
        let at = if is_part == Some(true) { scale * (turn * at) + shift } else { at };
        if track.len() > 1 {
            sparse.points.push((number, at.to_array(), [9, 9, 9], 0.2, track));
        } else {
            // If too few frames see a point, its features belong to no point.
            let lone = sparse.images.iter_mut().flat_map(|image| image.5.iter_mut());
            lone.filter(|(_, point)| *point == number as i64).for_each(|(_, point)| *point = -1);
        }
    };
    for i in 0..4000_u32 {
        // Evenly spread directions from the middle of the room.
        let z = 1.6 * (f64::from(i) + 0.5) / 4000.0 - 0.8;
        let angle = 2.399_963 * f64::from(i);
        let at = wall(
            DVec3::ZERO,
            DVec3::new((1.0 - z * z).sqrt() * angle.cos(), (1.0 - z * z).sqrt() * angle.sin(), z),
        );
        match is_torn {
            true => [true, false].into_iter().for_each(|is_part| add(at, Some(is_part))),
            false => add(at, None),
        }
    }
    sparse
}

fn write(root: &Path, sparse: &Sparse, photograph: impl Fn(usize) -> GrayImage) {
    sparse.write_binary(&root.join("sparse/0"));
    std::fs::create_dir_all(root.join("images")).unwrap();
    for (frame, image) in sparse.images.iter().enumerate() {
        photograph(frame).save(root.join("images").join(&image.4)).unwrap();
    }
}

fn read(root: &Path, change: impl Fn(&mut DataConfig)) -> Scene {
    let mut config = settings(root, 1);
    config.holdout = 0;
    change(&mut config);
    open(&config).unwrap()
}

fn cameras(scene: &Scene) -> Vec<Camera> {
    scene.train.views.iter().map(|view| view.camera).collect()
}

/// Returns the largest error of the distances (in units of the truth) and angles (radians) between pairs of cameras.
fn misplaced(cameras: &[Camera], frames: &[usize]) -> f64 {
    let truth = |i: usize| pose(frames[i]);
    let half = cameras.len() / 2;
    let unit = (cameras[half].origin - cameras[cameras.len() - 1].origin).length()
        / (truth(half).1 - truth(cameras.len() - 1).1).length();
    let mut worst = 0.0_f64;
    for a in 0..cameras.len() {
        for b in 0..a {
            let found = (cameras[a].origin - cameras[b].origin).length() / unit;
            let expected = (truth(a).1 - truth(b).1).length();
            let turned = cameras[a].rotation.z_axis.angle_between(cameras[b].rotation.z_axis);
            let expected_turn = truth(a).0.row(2).angle_between(truth(b).0.row(2));
            worst = worst.max((found - expected).abs()).max((turned - expected_turn).abs());
        }
    }
    worst
}

/// Returns the training frames: all except every eighth in the order of their names.
fn trained() -> Vec<usize> {
    let mut frames: Vec<usize> = (0..FRAMES).collect();
    frames.sort_by_key(|frame| format!("walk{frame}"));
    frames.into_iter().enumerate().filter(|(i, _)| i % 8 != 0).map(|(_, frame)| frame).collect()
}

fn warning(scene: &Scene) -> Option<&str> {
    scene.warnings.iter().map(String::as_str).find(|warning| warning.contains("were detached"))
}

#[test]
fn a_part_that_stands_apart_is_aligned() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &model(true), photograph);
    let as_it_is = read(folder.path(), |config| config.realign = false);
    assert!(misplaced(&cameras(&as_it_is), &trained()) > 1.0);
    assert_eq!(warning(&as_it_is), None);
    let aligned = read(folder.path(), |_| {});
    let found = warning(&aligned).expect("a warning");
    for part in ["10 of 32 photographs", "walk9", "walk10", "data.realign = false"] {
        assert!(found.contains(part), "{found}");
    }
    let worst = misplaced(&cameras(&aligned), &trained());
    assert!(worst < 0.01, "{worst} of a room 4 wide");
    // Points of both parts are joined: the points of a wall lie at the wall, not at its copy.
    let far =
        aligned.points.iter().filter(|point| DVec3::from(point.position).abs().max_element() > 2.3).count();
    assert!(20 * far < aligned.points.len(), "{far} of {}", aligned.points.len());
    assert_eq!(cameras(&read(folder.path(), |_| {})), cameras(&aligned), "the same bits each time");
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(
        one.install(|| cameras(&read(folder.path(), |_| {}))),
        cameras(&aligned),
        "and for any threads"
    );
}

#[test]
fn a_model_in_one_piece_stays() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &model(false), photograph);
    let [on, off] = [true, false].map(|realign| read(folder.path(), |config| config.realign = realign));
    assert_eq!(warning(&on), None);
    assert_eq!(cameras(&on), cameras(&off));
    assert!(misplaced(&cameras(&on), &trained()) < 1e-6);
}

/// Checks that nothing is moved without evidence in the photographs, which are black.
#[test]
fn a_part_whose_photographs_show_nothing_in_common_stays() {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), &model(true), |_| GrayImage::new(SIZE[0], SIZE[1]));
    let scene = read(folder.path(), |_| {});
    assert_eq!(warning(&scene), None);
    assert_eq!(cameras(&scene), cameras(&read(folder.path(), |config| config.realign = false)));
}
