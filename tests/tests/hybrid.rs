//! Hybrid rendering: pictures by the proxy of a model are those of volume rendering, with fewer samples.

use glam::DVec3;
use std::fs;
use trimip_core::{
    Camera, Config, Frame, Intrinsics, Session, Viewer,
    config::{Format, RendererKind},
    loaded::LoadedModel,
    metrics::psnr,
    model::Model,
    proxy::{Baking, Proxy, bake},
    tensors::Tensor,
    trainer::Trainer,
};
use trimip_cpu::{CpuBackend, simd::Simd};
use trimip_tests::{
    binary::{run, tiny_and},
    fixtures::as_code,
};

/// Number of training steps.
const STEPS: u64 = 200;

/// A model of the built-in scene, its proxy included.
fn model() -> Model {
    let mut config: Config = as_code();
    config.data.format = Format::Builtin;
    (config.data.builtin_size, config.data.builtin_train, config.data.builtin_test) = (48, 12, 1);
    (config.data.builtin_supersampling, config.data.scales) = (2, 2);
    (config.encoder.plane_size, config.encoder.levels) = (64, 5);
    config.field.hidden = 32;
    config.renderer.steps_per_diagonal = 256;
    (config.renderer.cones, config.renderer.cone_width) = (2, 0.04);
    (config.occupancy.resolution, config.occupancy.warmup) = (32, 64);
    (config.train.samples_per_step, config.train.steps) = (4096, STEPS);
    config.hybrid.resolution = 96;
    let scene = trimip_data::open(&config.data).unwrap();
    let mut trainer = Trainer::new(backend(2), &config, scene.train).unwrap();
    for step in 0..STEPS {
        trainer.step(step as f64 / STEPS as f64).unwrap();
    }
    let mut model = trainer.finish().unwrap();
    let proxy = bake(&mut trainer, &model, &Baking::of(&config), &mut |_| true).unwrap().unwrap();
    model.file.tensors.extend(proxy.to_assets().unwrap());
    model
}

fn backend(threads: u32) -> CpuBackend {
    CpuBackend::new(threads, Simd::detect()).unwrap()
}

/// The picture of a model by a kind of renderer.
fn picture(model: &Model, kind: RendererKind, camera: &Camera, threads: u32) -> Frame {
    let mut model = model.clone();
    model.config.renderer.kind = kind;
    LoadedModel::new(backend(threads), &model).unwrap().render(camera).unwrap()
}

/// A camera that looks at the origin.
fn camera(size: u32, eye: DVec3) -> Camera {
    Camera::look_at(Intrinsics::from_angle(size, size, 0.69), eye, DVec3::ZERO, DVec3::Z)
}

/// Rows of pixels as bytes.
fn bits(frame: &Frame) -> Vec<u32> {
    frame.pixels.iter().flat_map(|pixel| pixel.rgb.map(f32::to_bits)).collect()
}

#[test]
fn pictures_by_the_proxy_obey_the_laws_of_pictures() {
    use RendererKind::{Hybrid, Volume};
    let model = model();
    let far = camera(48, DVec3::new(3.0, -2.0, 2.0));
    let hybrid = picture(&model, Hybrid, &far, 1);

    // Near the converged picture of the same model, which training brings no nearer to the photographs than about 25 dB.
    let volume = picture(&model, Volume, &far, 2);
    let near = psnr(&hybrid.rgb(), &volume.rgb());
    assert!(near > 38.0, "{near:.1} dB");
    let apart = hybrid.pixels.iter().zip(&volume.pixels).map(|(a, b)| f64::from(a.opacity - b.opacity).abs());
    let apart = apart.sum::<f64>() / hybrid.pixels.len() as f64;
    assert!(volume.pixels.iter().filter(|pixel| pixel.opacity > 0.9).count() > 100, "something is seen");
    assert!(apart < 0.02, "opacities differ by {apart:.4} on average");

    // The same bits for any number of threads, also where some rays fall back to volume rendering.
    for widest in [model.config.hybrid.widest, 1.1] {
        let mut model = model.clone();
        model.config.hybrid.widest = widest;
        let one = bits(&picture(&model, Hybrid, &far, 1));
        for threads in [2, 3] {
            assert!(bits(&picture(&model, Hybrid, &far, threads)) == one, "{threads} threads, {widest}");
        }
    }

    // Rays that hit nothing show the background.
    let away =
        Camera::look_at(far.intrinsics, DVec3::new(3.0, -2.0, 2.0), DVec3::new(9.0, -6.0, 6.0), DVec3::Z);
    let background = model.config.data.background;
    assert!(picture(&model, Hybrid, &away, 1).pixels.iter().all(|p| p.rgb == background && p.opacity == 0.0));

    // A camera within the proxy.
    let inside = camera(16, DVec3::new(0.2, -0.1, 0.1));
    let (found, expected) = (picture(&model, Hybrid, &inside, 1), picture(&model, Volume, &inside, 1));
    assert!(found.pixels.iter().all(|pixel| pixel.rgb.iter().all(|c| (0.0..=1.0 + 1e-5).contains(c))));
    let near = psnr(&found.rgb(), &expected.rgb());
    assert!(near > 25.0, "within: {near:.1} dB");

    // Cones wider than the proxy knows are volume-rendered, bit by bit.
    let wide = camera(4, DVec3::new(3.0, -2.0, 2.0));
    assert_eq!(bits(&picture(&model, Hybrid, &wide, 1)), bits(&picture(&model, Volume, &wide, 1)));

    // A proxy without any density is no reason to see nothing.
    let mut blind = model.clone();
    let name = |part: &str| format!("asset.proxy.{part}");
    let empty = bake(&mut Nothing, &model, &Baking::of(&model.config), &mut |_| true).unwrap().unwrap();
    blind.file.tensors.extend(empty.to_assets().unwrap());
    assert_eq!(bits(&picture(&blind, Hybrid, &far, 1)), bits(&volume));

    // A missing or broken proxy is told, with what to do.
    let refused = |change: &dyn Fn(&mut Model)| {
        let mut broken = model.clone();
        change(&mut broken);
        broken.config.renderer.kind = Hybrid;
        let error = LoadedModel::new(backend(1), &broken).err().expect("refused");
        assert!(error.exit_code() == 2 && error.message.contains("bake"), "{error}");
    };
    refused(&|model| model.file.tensors.retain(|key, _| !key.starts_with("asset.")));
    refused(&|model| drop(model.file.tensors.remove(&name("codes"))));
    refused(&|model| drop(model.file.tensors.insert(name("codes"), Tensor::u8(&[3], vec![1, 2, 3]))));
    refused(&|model| drop(model.file.tensors.insert(name("shape"), Tensor::f32(&[1], vec![8.0]))));
    for shape in [[7.0, 8.0, 8.0, 0.1, 0.1], [8.0, 8.0, 8.0, f32::NAN, 0.1], [1e9, 8.0, 8.0, 0.1, 0.1]] {
        refused(&|model| drop(model.file.tensors.insert(name("shape"), Tensor::f32(&[5], shape.to_vec()))));
    }

    // The proxy comes back from its assets as it was.
    let proxy = Proxy::from_assets(&trimip_core::model::assets(&model.file)).unwrap().expect("there is one");
    assert_eq!(Proxy::from_assets(&proxy.to_assets().unwrap()).unwrap(), Some(proxy));
}

/// A field without density.
struct Nothing;

impl Viewer for Nothing {
    fn backend(&self) -> &str {
        "nothing"
    }
    fn device_name(&self) -> String {
        "nothing".into()
    }
    fn render(&mut self, _: &Camera) -> trimip_core::Result<Frame> {
        Err(trimip_core::Error::run("renders nothing"))
    }
    fn render_watched(
        &mut self,
        _: &Camera,
        _: &mut dyn FnMut(u32, u32) -> bool,
    ) -> trimip_core::Result<Option<Frame>> {
        Err(trimip_core::Error::run("renders nothing"))
    }
    fn query(
        &mut self,
        queries: &[trimip_core::Query],
    ) -> trimip_core::Result<Vec<trimip_core::batch::Radiance>> {
        Ok(vec![trimip_core::batch::Radiance::default(); queries.len()])
    }
}

#[test]
fn the_proxy_travels_in_the_model_file() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let answer = run(here, &tiny_and(&["--out", "run"]));
    assert_eq!(answer.code, Some(0), "{}", answer.err);

    let answer = run(here, &["render", "run", "--set", "renderer.kind=hybrid"]);
    assert!(answer.code == Some(2) && answer.err.contains("trimip-cli bake"), "{}", answer.err);
    let before = fs::read(here.join("run/model.safetensors")).unwrap();
    let answer =
        run(here, &["bake", "run", "--out", "other/baked.safetensors", "--set", "hybrid.resolution=64"]);
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    assert!(fs::read(here.join("run/model.safetensors")).unwrap() == before, "--out leaves the model alone");
    let answer = run(here, &["bake", "run", "--set", "hybrid.resolution=64"]);
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    let baked = Model::read(&here.join("run/model.safetensors")).unwrap();
    assert_eq!(baked.config.renderer.kind, RendererKind::Hybrid);
    assert!(baked == Model::read(&here.join("other/baked.safetensors")).unwrap());

    let answer = run(here, &["eval", "run"]);
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    let answer = run(here, &["render", "run", "--turntable", "1"]);
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    let answer = run(here, &["bake", "nowhere.safetensors"]);
    assert_eq!(answer.code, Some(2), "{}", answer.err);
}
