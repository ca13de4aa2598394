//! The unit, the position and the rotation of a world change nothing: the built-in scene is planned and trained in worlds transformed by a
//! similarity, in bounded space with silhouettes and in contracted space without.

use glam::{DMat3, DVec3};
use trimip_core::{
    Config, Session, ViewSet,
    config::Contraction,
    engine::trainer::Trainer,
    scene::origin::LocalOrigin,
    scene_plan::{self, Compute, Facts},
};
use trimip_cpu::{CpuBackend, simd::Simd};
use trimip_data::settings::DataConfig;

/// Number of training steps, and number of the last steps over which the batch PSNR is averaged.
const STEPS: u64 = 240;
const LAST: u64 = 60;

/// Largest difference of the PSNR in dB; two seeds differ by that much.
const SPREAD: f64 = 0.5;

/// A similarity: x ↦ scale · turn · x + offset.
struct Similarity {
    scale: f64,
    turn: DMat3,
    offset: DVec3,
}

impl Similarity {
    fn apply(&self, views: &mut ViewSet) {
        for view in &mut views.views {
            view.camera.origin = self.scale * (self.turn * view.camera.origin) + self.offset;
            view.camera.rotation = self.turn * view.camera.rotation;
        }
    }
}

/// Returns the training views of the built-in scene. Without `alpha` they show a sky behind it, with a colour for each direction.
fn views(alpha: bool) -> ViewSet {
    let mut config = trimip::settings::defaults();
    for assignment in
        ["data.format=builtin", "data.builtin_size=48", "data.builtin_train=24", "data.scales=2"]
    {
        config.apply_assignment(assignment).unwrap();
    }
    let data: DataConfig = Config::from_settings(&config).unwrap().section().unwrap();
    let mut views = trimip_data::open(&data).unwrap().train;
    if alpha {
        return views;
    }
    for index in 0..views.views.len() {
        let (camera, offset) = (views.views[index].camera, views.views[index].offset);
        let k = camera.intrinsics;
        for (x, y) in (0..k.height).flat_map(|y| (0..k.width).map(move |x| (x, y))) {
            let direction = camera.cone::<f64>(x, y).direction;
            let sky = direction.map(|d| 127.5 + 90.0 * (5.0 * d).sin());
            let pixel = &mut views.pixels[offset + (y * k.width + x) as usize];
            let opacity = f64::from(pixel[3]) / 255.0;
            let over = |c: usize| (opacity * f64::from(pixel[c]) + (1.0 - opacity) * sky[c]).round() as u8;
            *pixel = [over(0), over(1), over(2), 255];
        }
    }
    views
}

/// Trains on the views; returns the planned configuration, and the mean PSNR of the last batches in dB.
fn trained(views: ViewSet) -> (Config, f64) {
    let mut settings = trimip::settings::defaults();
    for assignment in
        [format!("train.steps={STEPS}"), "train.samples_per_step=4096".into(), "threads=2".into()]
    {
        settings.apply_assignment(&assignment).unwrap();
    }
    let (test, compute) = (Vec::new(), Compute::one_thread());
    let facts =
        Facts { train: &views, test: &test, stated: None, origin: LocalOrigin::default(), compute: &compute };
    scene_plan::make(&mut settings, &facts).unwrap();
    let config = Config::from_settings(&settings).unwrap();
    let mut trainer = Trainer::new(CpuBackend::new(2, Simd::detect()).unwrap(), &config, views).unwrap();
    let mut sum = 0.0;
    for step in 0..STEPS {
        let report = trainer.step(step as f64 / STEPS as f64).unwrap();
        if step >= STEPS - LAST {
            sum += report.batch_psnr;
        }
    }
    (config, sum / LAST as f64)
}

#[test]
fn the_same_scene_in_any_world_is_learned_alike() {
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, -2.0).normalize(), 0.8);
    let same = DMat3::IDENTITY;
    for (alpha, contraction) in [(true, Contraction::None), (false, Contraction::Ball)] {
        let (config, usual) = trained(views(alpha));
        assert_eq!(config.scene.contraction, contraction);
        assert!(usual > 15.0, "{usual}");
        for (scale, turn, offset) in [
            (1e-3, same, DVec3::ZERO),
            (37.0, same, DVec3::new(-20.0, 5.0, 900.0)),
            (1e4, same, DVec3::ZERO),
            (100.0, turn, DVec3::ZERO),
        ] {
            let mut moved = views(alpha);
            Similarity { scale, turn, offset }.apply(&mut moved);
            let (config, found) = trained(moved);
            assert_eq!(config.scene.contraction, contraction);
            let what = format!("alpha {alpha}, scale {scale}, {offset}");
            assert!((found - usual).abs() < SPREAD, "{what}: {found:.2} dB, not {usual:.2}");
        }
    }
}
