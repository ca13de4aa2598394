//! Checks of hybrid rendering: pictures rendered with the proxy of a model match those of volume rendering.

use glam::DVec3;
use std::fs;
use std::sync::OnceLock;
use trimip_core::{
    config::{HybridRule, RendererKind},
    engine::{loaded::LoadedModel, proxy::Proxy},
    field::{model::Model, tensors::Tensor},
    measures::metrics::psnr,
};
use trimip_cpu::{CpuBackend, simd::Simd};
use trimip_tests::{
    binary::{run, tiny_and},
    gpu::reproducibly,
    suite::hybrid::{bits, camera, fog, model, picture, pictures},
};

/// Returns a trained model, which the tests share.
fn trained() -> &'static Model {
    static MODEL: OnceLock<Model> = OnceLock::new();
    MODEL.get_or_init(|| model(backend(2)))
}

fn backend(threads: u32) -> CpuBackend {
    CpuBackend::new(threads, Simd::detect()).unwrap()
}

#[test]
fn pictures_by_the_proxy_obey_the_laws_of_pictures() {
    for simd in Simd::available() {
        pictures(|| CpuBackend::new(2, simd).unwrap(), trained()).unwrap();
    }
    reproducibly(|make| pictures(make, trained()));
}

#[test]
fn fog_is_seen_however_thin() {
    fog(|| backend(2)).unwrap();
    reproducibly(|make| fog(make));
}

#[test]
fn threads_change_no_bit() {
    let far = camera(48, DVec3::new(3.0, -2.0, 2.0));
    // With the narrower limit, some rays fall back to volume rendering.
    for widest in [trained().config.hybrid.widest, 1.1] {
        let mut model = trained().clone();
        model.config.hybrid.widest = widest;
        let one = bits(&picture(backend(1), &model, RendererKind::Hybrid, &far).unwrap());
        for threads in [2, 3] {
            let found = bits(&picture(backend(threads), &model, RendererKind::Hybrid, &far).unwrap());
            assert!(found == one, "{threads} threads, {widest}");
        }
    }
}

#[test]
fn backends_show_the_same_picture() {
    reproducibly(|make| {
        let widest = trained().config.hybrid.widest;
        for (widest, rule) in
            [(widest, HybridRule::Weight), (1.1, HybridRule::Weight), (widest, HybridRule::Layers)]
        {
            let mut model = trained().clone();
            (model.config.hybrid.widest, model.config.hybrid.rule) = (widest, rule);
            // After so short a training, surfaces are soft.
            (model.config.hybrid.delta, model.config.hybrid.samples) = (24.0, 48);
            model.config.hybrid.surface = 0.02;
            let far = camera(32, DVec3::new(3.0, -2.0, 2.0));
            let on_cpu = picture(backend(2), &model, RendererKind::Hybrid, &far)?;
            let on_gpu = picture(make(), &model, RendererKind::Hybrid, &far)?;
            // A rounding may move a sample of a few rays to another step or group.
            let near = psnr(&on_cpu.rgb(), &on_gpu.rgb());
            assert!(near > 60.0, "{rule:?}: {near:.1} dB");
            let volume = picture(backend(2), &model, RendererKind::Volume, &far)?;
            let near = psnr(&on_cpu.rgb(), &volume.rgb());
            assert!(near > 30.0, "{rule:?}: {near:.1} dB from volume rendering");
            let apart = on_cpu.pixels.iter().zip(&on_gpu.pixels).filter(|(a, b)| {
                a.rgb.iter().zip(b.rgb).any(|(a, b)| (a - b).abs() > 1e-3)
                    || (a.opacity - b.opacity).abs() > 1e-3
            });
            let fraction = apart.count() as f64 / on_cpu.pixels.len() as f64;
            assert!(fraction < 0.01, "{fraction:.4} of the pixels differ");
        }
        Ok(())
    });
}

#[test]
fn a_missing_or_broken_proxy_is_told_with_what_to_do() {
    let name = |part: &str| format!("asset.proxy.{part}");
    let refused = |change: &dyn Fn(&mut Model)| {
        let mut broken = trained().clone();
        change(&mut broken);
        broken.config.renderer.kind = RendererKind::Hybrid;
        let error = LoadedModel::new(backend(1), &broken).err().expect("refused");
        assert!(error.kind() == trimip_core::ErrorKind::Input && error.message().contains("bake"), "{error}");
    };
    refused(&|model| model.file.tensors.retain(|key, _| !key.starts_with("asset.")));
    refused(&|model| drop(model.file.tensors.remove(&name("codes"))));
    refused(&|model| drop(model.file.tensors.insert(name("codes"), Tensor::u8(&[3], vec![1, 2, 3]))));
    refused(&|model| drop(model.file.tensors.insert(name("shape"), Tensor::f32(&[1], vec![8.0]))));
    for shape in [[7.0, 8.0, 8.0, 0.1, 0.1], [8.0, 8.0, 8.0, f32::NAN, 0.1], [1e9, 8.0, 8.0, 0.1, 0.1]] {
        refused(&|model| drop(model.file.tensors.insert(name("shape"), Tensor::f32(&[5], shape.to_vec()))));
    }
    // A proxy written to assets and read again is unchanged.
    let proxy = Proxy::from_assets(&trimip_core::field::model::assets(&trained().file))
        .unwrap()
        .expect("there is one");
    assert_eq!(Proxy::from_assets(&proxy.to_assets().unwrap()).unwrap(), Some(proxy));
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
