//! Checks that training corrects wrong cameras of photographs, and that this improves the model.

use glam::{DMat3, DQuat, DVec3};
use trimip_core::{
    Camera, Config, Session, ViewSet, Viewer,
    config::{CameraPoses, OptimizerConfig},
    engine::trainer::Trainer,
    measures::metrics::psnr_of_error,
};
use trimip_cpu::{CpuBackend, simd::Simd};
use trimip_data::settings::DataConfig;
use trimip_tests::fixtures::{TestRandom, as_code};

/// Angle by which each camera is rotated, in degrees.
const TURNED: f64 = 0.5;

/// Distance by which each camera is moved, as a fraction of its distance to the middle of the scene.
const SHIFTED: f64 = 0.01;

/// Smallest gain in dB from refined poses.
const GAIN: f64 = 0.4;

/// Largest fraction of the cameras' error that may remain, measured in pixels of the pictures.
const LEFT: f64 = 0.6;

/// Ratio of the given focal length to the true one.
const ZOOMED: f64 = 1.04;

/// Largest fraction of the focal length's error that may remain. The size of the scene changes along with the focal length, and
/// only small differences in perspective distinguish the two.
const ZOOM_LEFT: f64 = 0.9;

/// Shift of the given principal point in pixels.
const OFF_CENTRE: f64 = 1.5;

fn configuration() -> Config {
    let mut config = as_code();
    let read = config.change(|data: &mut DataConfig| {
        data.format = "builtin".into();
        (data.builtin_size, data.builtin_train, data.builtin_test) = (64, 24, 3);
        (data.builtin_supersampling, data.scales) = (2, 1);
    });
    read.unwrap();
    (config.encoder.plane_size, config.encoder.levels) = (64, 5);
    config.field.hidden = 32;
    config.renderer.steps_per_diagonal = 192;
    config.occupancy.resolution = 32;
    config.occupancy.warmup = 64;
    config.train.samples_per_step = 8192;
    config.train.steps = 1000;
    // The run is short, so poses move faster and earlier than by default.
    config.optimizer =
        OptimizerConfig { camera_rate: 1e-4, camera_delay: 0.1, ..Config::default().optimizer };
    config
}

fn vector(random: &mut TestRandom) -> DVec3 {
    DVec3::from_array([0; 3].map(|_| random.between(-1.0, 1.0))).normalize()
}

/// Returns the photographs with perturbed cameras. The mean of the perturbations is nearly zero.
fn perturbed(mut views: ViewSet) -> ViewSet {
    let mut random = TestRandom::new(11);
    let off: Vec<[DVec3; 2]> = views.views.iter().map(|_| [0; 2].map(|_| vector(&mut random))).collect();
    let mean = |part: usize| off.iter().map(|off| off[part]).sum::<DVec3>() / off.len() as f64;
    let mean = [mean(0), mean(1)];
    for (view, off) in views.views.iter_mut().zip(off) {
        let distance = view.camera.origin.length();
        let turn = DQuat::from_scaled_axis(TURNED.to_radians() * (off[0] - mean[0]).normalize());
        view.camera.rotation = DMat3::from_quat(turn) * view.camera.rotation;
        view.camera.origin += SHIFTED * distance * (off[1] - mean[1]).normalize();
    }
    views
}

/// Returns the root mean square differences of cameras over the photographs: rotation in degrees, distance, and displacement of
/// the scene's corners in pixels of the picture.
fn apart(found: &[Camera], known: &[Camera]) -> [f64; 3] {
    let count = known.len() as f64;
    let mut squares = [0.0; 3];
    for (found, known) in found.iter().zip(known) {
        let turn = DQuat::from_mat3(&(found.rotation * known.rotation.transpose()));
        squares[0] += turn.to_scaled_axis().length().to_degrees().powi(2) / count;
        squares[1] += (found.origin - known.origin).length_squared() / count;
        for corner in 0..8 {
            let point =
                DVec3::from_array([0, 1, 2].map(|axis| if corner >> axis & 1 == 1 { 0.7 } else { -0.7 }));
            let place = |camera: &Camera| {
                let local = camera.rotation.transpose() * (point - camera.origin);
                camera.intrinsics.fx / -local.z * local.truncate()
            };
            squares[2] += (place(found) - place(known)).length_squared() / (8.0 * count);
        }
    }
    squares.map(f64::sqrt)
}

fn cameras(session: &dyn Session) -> Vec<Camera> {
    session
        .refined()
        .map(|refined| refined.cameras.into_iter().map(|(_, camera)| camera).collect())
        .unwrap_or_default()
}

struct Trained {
    psnr: f64,
    cameras: Vec<Camera>,
}

fn trained(config: &Config, views: ViewSet) -> Trained {
    let scene = trimip_data::open(&config.section().unwrap()).unwrap();
    let backend = CpuBackend::new(2, Simd::detect()).unwrap();
    let given: Vec<Camera> = views.views.iter().map(|view| view.camera).collect();
    let mut trainer = Trainer::new(backend, config, views).unwrap();
    for step in 0..config.train.steps {
        trainer.step(step as f64 / config.train.steps as f64).unwrap();
    }
    let (mut squares, mut count) = (0.0, 0_usize);
    for index in 0..scene.test.len() {
        let frame = scene.test.load(index).unwrap();
        let rendered = trainer.render(&frame.views[0].camera).unwrap().rgb();
        for (rendered, truth) in rendered.iter().zip(frame.composited(0, config.data.background)) {
            squares += (0..3).map(|c| f64::from(rendered[c] - truth[c]).powi(2)).sum::<f64>();
            count += 3;
        }
    }
    let refined = cameras(&trainer);
    let cameras = if refined.is_empty() { given } else { refined };
    Trained { psnr: psnr_of_error(squares / count as f64), cameras }
}

#[test]
fn poses_that_are_off_come_back() {
    let mut config = configuration();
    let scene = trimip_data::open(&config.section().unwrap()).unwrap();
    let truth: Vec<Camera> = scene.train.views.iter().map(|view| view.camera).collect();
    let wrong = perturbed(scene.train);
    let fixed = trained(&config, wrong.clone());
    config.train.cameras = CameraPoses::Refine;
    let refined = trained(&config, wrong);
    let [before, after] = [&fixed, &refined].map(|trained| apart(&trained.cameras, &truth));
    println!("{:.2} dB, {before:?} as given", fixed.psnr);
    println!("{:.2} dB, {after:?} refined", refined.psnr);
    let gain = refined.psnr - fixed.psnr;
    assert!(gain > GAIN, "{gain:.2} dB gained");
    assert!(after[2] < LEFT * before[2], "{:.2} of {:.2} pixels remain", after[2], before[2]);
}

/// All photographs were taken by one camera. Training corrects its focal length and principal point, which are wrong; the poses
/// are right.
#[test]
fn intrinsics_that_are_off_come_back() {
    let mut config = configuration();
    config.train.cameras = CameraPoses::Refine;
    let scene = trimip_data::open(&config.section().unwrap()).unwrap();
    let truth = scene.train.views[0].camera.intrinsics;
    let mut wrong = scene.train;
    for view in &mut wrong.views {
        let k = &mut view.camera.intrinsics;
        (k.fx, k.fy, k.cx) = (ZOOMED * k.fx, ZOOMED * k.fy, k.cx + OFF_CENTRE);
    }
    let found: Vec<_> = trained(&config, wrong).cameras.iter().map(|camera| camera.intrinsics).collect();
    println!("{:?}", found[0]);
    assert!(
        found.iter().all(|k| (k.fx, k.cx, k.cy) == (found[0].fx, found[0].cx, found[0].cy)),
        "one camera"
    );
    let [zoom, shift] = [(found[0].fx / truth.fx).ln() / ZOOMED.ln(), (found[0].cx - truth.cx) / OFF_CENTRE];
    assert!(
        zoom.abs() < ZOOM_LEFT && shift.abs() < LEFT,
        "{zoom:.2} of the focal length and {shift:.2} of the shift remain"
    );
}
