//! Tests of the checks of captures: each is silent about the built-in scene as it is, and reports a scene that has the
//! mistake it looks for.

use glam::DVec3;
use trimip_core::{Aabb, Alpha, Camera, Scale, ViewSet};
use trimip_data::checks::{self, Check, Subject, Verdict};
use trimip_data::settings::DataConfig;
use trimip_data::{Observation, Point, Scene};

/// The box of the built-in scene.
const WHOLE: Aabb<f64> = Aabb { min: [-1.25; 3], max: [1.25; 3] };

/// Opens the built-in scene with 32 training views of 96 pixels at two scales, and 4 test views.
fn scene() -> Scene {
    let mut data = DataConfig { format: "builtin".into(), ..DataConfig::default() };
    (data.builtin_size, data.builtin_train, data.builtin_test) = (96, 32, 4);
    (data.builtin_supersampling, data.scales) = (2, 2);
    trimip_data::open(&data).unwrap()
}

/// Replaces the poses of the frames at all scales.
fn posed(train: &mut ViewSet, pose: impl Fn(usize, &[Camera]) -> Camera) {
    for scale in train.scales.clone() {
        let own: Vec<Camera> = scale.views.clone().map(|view| train.views[view].camera).collect();
        for (frame, view) in scale.views.enumerate() {
            train.views[view].camera = Camera { intrinsics: own[frame].intrinsics, ..pose(frame, &own) };
        }
    }
}

/// Returns the pixels of a frame at a scale.
fn pixels<'a>(train: &'a mut ViewSet, scale: &Scale, frame: usize) -> &'a mut [[u8; 4]] {
    let view = &train.views[scale.views.start + frame];
    let k = &view.camera.intrinsics;
    let (start, length) = (view.offset, k.width as usize * k.height as usize);
    &mut train.pixels[start..start + length]
}

fn doubted(check: &Check) -> bool {
    matches!(check.verdict, Verdict::Suspicious(_))
}

/// Returns the views that a check doubts.
fn views(check: &Check) -> Vec<usize> {
    check.suspects.iter().map(|suspect| suspect.view).collect()
}

/// Returns points on a grid, each with observations that are `shift` pixels away from its projections.
fn points(cameras: &[Camera], shift: f64) -> Vec<Point> {
    let place =
        |i: i32| DVec3::new(f64::from(i % 3 - 1), f64::from(i / 3 % 3 - 1), f64::from(i / 9 - 1)) * 0.6;
    let seen = |camera: &Camera, at: DVec3, view: usize| {
        let [x, y] = camera.intrinsics.image_of(camera.rotation.transpose() * (at - camera.origin))?;
        Some(Observation { view: view as u32, at: [x + shift, y] })
    };
    (0..27)
        .map(|i| Point {
            position: place(i).to_array(),
            color: [i as u8, 100, 200],
            error: Some(0.5),
            seen: Some(cameras.len()),
            track: (0..cameras.len()).filter_map(|v| seen(&cameras[v], place(i), v)).collect(),
        })
        .collect()
}

fn finest(train: &ViewSet) -> Vec<Camera> {
    train.scales[0].views.clone().map(|view| train.views[view].camera).collect()
}

#[test]
fn a_scene_as_it_should_be_is_not_doubted() {
    let scene = scene();
    let train = &scene.train;
    let points = points(&finest(train), 0.3);
    let test = [("other".to_string(), scene.test.cameras()[0])];
    let all = checks::all(&Subject { train, test: &test, points: &points, aabb: Some(&WHOLE) });
    for check in &all {
        assert_eq!(check.verdict, Verdict::Fine, "{check:?}");
        assert_eq!((check.warning(train), check.suspects.len()), (None, 0));
    }
    let silhouettes = all.iter().find(|check| check.name == "silhouettes and poses").unwrap();
    let overlap = &silhouettes.values[0];
    assert_eq!(overlap.of.len(), 32);
    assert!(overlap.of.iter().all(|value| value.is_some_and(|value| value > 0.8)), "{overlap:?}");
}

#[test]
fn silhouettes_tell_poses_of_other_photographs() {
    let mut scene = scene();
    // Two frames swap their poses.
    let swapped = [5, 20];
    posed(&mut scene.train, |frame, own| match frame {
        5 => own[20],
        20 => own[5],
        _ => own[frame],
    });
    let two = checks::silhouettes(&scene.train);
    let mut found = views(&two);
    found.sort_unstable();
    assert!(doubted(&two) && swapped.iter().all(|view| found.contains(view)), "{two:?}");
    let warning = two.warning(&scene.train).unwrap();
    assert!(warning.contains("r_5 (") && warning.contains("wrong pose"), "{warning}");
    // All poses are shuffled. If their order were only shifted, the spiral of the cameras would turn and little else would change.
    posed(&mut scene.train, |frame, own| own[(11 * frame + 3) % own.len()]);
    let all = checks::silhouettes(&scene.train);
    assert!(doubted(&all) && all.warning(&scene.train).unwrap().contains("do not belong"), "{all:?}");
    // Masks of ignored pixels show no silhouettes.
    scene.train.alpha = Alpha::Kept;
    assert_eq!(checks::silhouettes(&scene.train).verdict, Verdict::Unknown);
}

/// Checks poses with OpenCV's axes, y down and z forward, in a file whose layout has OpenGL's axes.
#[test]
fn turned_axes_look_away_from_everything() {
    let mut scene = scene();
    let points = points(&finest(&scene.train), 0.3);
    let turned = |camera: Camera| Camera {
        rotation: camera.rotation * glam::DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)),
        ..camera
    };
    let mut single = scene.train.clone();
    posed(&mut single, |frame, own| if frame == 7 { turned(own[frame]) } else { own[frame] });
    assert_eq!(views(&checks::focus(&single, &[])), [7]);
    assert_eq!(views(&checks::ahead(&single, &points)), [7]);
    posed(&mut scene.train, |frame, own| turned(own[frame]));
    let focus = checks::focus(&scene.train, &[]);
    assert!(doubted(&focus) && focus.figure.contains("0 of 32"), "{focus:?}");
    assert!(doubted(&checks::ahead(&scene.train, &points)));
    let reprojection = checks::reprojection(&scene.train, &points);
    assert!(doubted(&reprojection) && reprojection.suspects.len() == 32, "{reprojection:?}");
    assert!(doubted(&checks::silhouettes(&scene.train)));
}

#[test]
fn points_beside_their_places_tell_of_poses() {
    let scene = scene();
    let mut points = points(&finest(&scene.train), 0.3);
    assert!(!doubted(&checks::reprojection(&scene.train, &points)));
    let of = |view: u32| move |seen: &&mut Observation| seen.view == view;
    points.iter_mut().flat_map(|p| p.track.iter_mut()).filter(of(9)).for_each(|seen| seen.at[1] += 1.5);
    let nine = checks::reprojection(&scene.train, &points);
    assert_eq!(views(&nine), [9], "1.5 pixels are five times the others' 0.3: {nine:?}");
    points.iter_mut().flat_map(|p| p.track.iter_mut()).for_each(|seen| seen.at[0] += 5.0);
    assert_eq!(checks::reprojection(&scene.train, &points).suspects.len(), 32);
    assert_eq!(checks::reprojection(&scene.train, &[]).verdict, Verdict::Unknown);
    // Observations in views that do not exist are ignored.
    points.iter_mut().flat_map(|p| p.track.iter_mut()).for_each(|seen| seen.view = 99);
    assert_eq!(checks::ahead(&scene.train, &points).verdict, Verdict::Unknown);
}

#[test]
fn one_bright_photograph_differs_from_its_neighbours() {
    let mut scene = scene();
    assert!(!doubted(&checks::brightness(&scene.train)));
    for scale in scene.train.scales.clone() {
        for pixel in pixels(&mut scene.train, &scale, 3) {
            // An eighth of the stored values is less than a twentieth of the light.
            *pixel = [pixel[0] / 8, pixel[1] / 8, pixel[2] / 8, pixel[3]];
        }
    }
    let check = checks::brightness(&scene.train);
    assert_eq!(views(&check), [3], "{check:?}");
    let grey = [[188, 188, 188, 255], [0, 0, 0, 0]];
    let stops = checks::stops(&grey, Alpha::Straight).unwrap();
    assert!((stops + 1.0).abs() < 0.01, "sRGB 188 is half the light: {stops}");
    assert_eq!(checks::stops(&grey[1..], Alpha::Straight), None);
}

#[test]
fn doubles_are_named() {
    let mut scene = scene();
    let test = |camera: Camera| [("t".to_string(), camera), ("u".to_string(), scene.test.cameras()[0])];
    let leaked = checks::poses(&scene.train, &test(finest(&scene.train)[4]));
    assert!(doubted(&leaked) && leaked.figure.contains("the first t"), "{leaked:?}");
    let mut fixed = scene.train.clone();
    posed(&mut fixed, |frame, own| if frame == 6 { own[2] } else { own[frame] });
    let twins = checks::poses(&fixed, &[]);
    assert_eq!(views(&twins), [6]);
    assert_eq!(twins.suspects[0].figure, "same as r_2");
    for scale in scene.train.scales.clone() {
        let first = pixels(&mut scene.train, &scale, 1).to_vec();
        pixels(&mut scene.train, &scale, 30).copy_from_slice(&first);
    }
    let copies = checks::photographs(&scene.train);
    assert_eq!((views(&copies), copies.suspects[0].figure.as_str()), (vec![30], "same as r_1"));
}

#[test]
fn a_small_box_cuts_the_object() {
    let scene = scene();
    let small = Aabb { min: [-0.4; 3], max: [0.4; 3] };
    let check = checks::coverage(&scene.train, Some(&small));
    assert!(doubted(&check) && check.suspects.len() == 32, "{check:?}");
    assert_eq!(checks::coverage(&scene.train, None).verdict, Verdict::Unknown);
}

#[test]
fn a_zoom_and_another_size_stand_apart() {
    let mut scene = scene();
    scene.train.views[2].camera.intrinsics.fx *= 2.0;
    scene.train.views[2].camera.intrinsics.fy *= 2.0;
    let check = checks::sizes(&scene.train);
    assert_eq!(views(&check), [2]);
    assert!(check.suspects[0].figure.contains("focal length"), "{check:?}");
}

#[test]
fn cameras_that_no_rig_has_are_named() {
    let scene = scene();
    let train = &scene.train;
    let mut far = train.clone();
    posed(&mut far, |frame, own| match frame {
        7 => Camera { origin: 2000.0 * own[7].origin, ..own[7] },
        _ => own[frame],
    });
    let found = checks::stray(&far);
    assert!(doubted(&found) && views(&found) == [7], "{found:?}");
    let lens = |change: &dyn Fn(&mut Camera)| {
        let mut other = train.clone();
        for scale in other.scales.clone() {
            change(&mut other.views[scale.views.start + 3].camera);
        }
        checks::optics(&other)
    };
    // The focal length of a very wide angle of view, and the principal point of a larger photograph.
    let wide = lens(&|camera| camera.intrinsics.fx = 0.5);
    let shifted = lens(&|camera| camera.intrinsics.cx *= 2.0);
    for (found, figure) in [(wide, "field of view of 17"), (shifted, "principal point 50 % from the middle")]
    {
        assert!(doubted(&found) && views(&found) == [3], "{found:?}");
        assert!(found.suspects[0].figure.contains(figure), "{found:?}");
    }
    let mut few = train.clone();
    few.scales[0].views.end = few.scales[0].views.start + 3;
    let found = checks::number(&few);
    assert!(doubted(&found) && found.figure == "3 photographs to learn from", "{found:?}");
}

/// Checks that no check fails or panics without data.
#[test]
fn nothing_at_all_is_not_known() {
    let none = ViewSet {
        views: Vec::new(),
        pixels: Vec::new().into(),
        alpha: Alpha::Straight,
        scales: Vec::new(),
        depths: Vec::new(),
    };
    let all = checks::all(&Subject { train: &none, test: &[], points: &[], aabb: Some(&WHOLE) });
    assert!(all.iter().all(|check| !doubted(check)), "{all:?}");
    let mut flat = scene().train;
    posed(&mut flat, |_, own| own[0]);
    let point = Aabb { min: [0.0; 3], max: [0.0; 3] };
    checks::all(&Subject { train: &flat, test: &[], points: &[], aabb: Some(&point) });
}
