//! Checks that the asynchronous interface of a GPU renders a view without a blocking wait, with the same bits as the
//! blocking interface.

use std::future::{Future, poll_fn};
use std::pin::pin;
use trimip_core::{
    Camera, Intrinsics, Layout, Session, Viewer,
    engine::{loaded::LoadedModel, trainer::Trainer},
    field::{
        model::Model,
        tensors::{Tensor, TensorFile},
    },
};
use trimip_cpu::{CpuBackend, simd::Simd};
use trimip_tests::{fixtures, gpu, suite};
use trimip_wgpu::WgpuBackend;

/// Waits for a future; also returns how often it was pending.
fn waited<T>(future: impl Future<Output = T>) -> (T, usize) {
    let mut future = pin!(future);
    let mut pending = 0;
    let value = pollster::block_on(poll_fn(|context| {
        let polled = future.as_mut().poll(context);
        pending += usize::from(polled.is_pending());
        polled
    }));
    (value, pending)
}

/// Returns two models for every encoder: one trained briefly, one with varied parameters and a full occupancy grid.
fn models() -> Vec<Model> {
    let mut models = Vec::new();
    for encoder in fixtures::every_encoder() {
        let mut config = fixtures::encoded(suite::training::configuration(), &encoder);
        let backend = CpuBackend::new(2, Simd::detect()).unwrap();
        let mut trainer = Trainer::new(backend, &config, fixtures::noise(3, 16, 2, 2)).unwrap();
        suite::training::steps(&mut trainer, &config, 20).unwrap();
        models.push(trainer.model().unwrap());
        let layout = Layout::new(&config);
        let mut file = TensorFile::default();
        layout.to_tensors(&fixtures::lively(&layout, 3), "", &mut file);
        let cells = (config.occupancy.resolution as usize).pow(3);
        file.tensors.insert("occupancy".into(), Tensor::u8(&[cells / 8], vec![0xff; cells / 8]));
        config.renderer.steps_per_diagonal = 128;
        models.push(Model::new(config, file));
    }
    models
}

#[test]
fn a_view_rendered_asynchronously_has_the_same_bits() {
    gpu::reproducibly(|make| {
        let target = glam::DVec3::ZERO;
        let eye = glam::DVec3::new(3.0, 2.0, 1.5);
        let camera = Camera::look_at(Intrinsics::from_angle(24, 16, 0.7), eye, target, glam::DVec3::Z);
        for model in models() {
            let blocking = LoadedModel::new(make(), &model)?.render(&camera)?;
            let mut loaded = pollster::block_on(trimip_wgpu::load_async(&model, ""))?;
            let (first, pending) = waited(loaded.render_async(&camera));
            let (again, _) = waited(loaded.render_async(&camera));
            let name = format!("{:?}", model.config.encoder.kind);
            assert!(pending > 0, "{name}: a device that works is waited for by a pending future");
            assert!(first? == blocking && again? == blocking, "{name}: the same bits by both doors");
            assert!(
                blocking.pixels.iter().any(|pixel| *pixel != blocking.pixels[0]),
                "{name} shows something"
            );
            assert!(loaded.render(&camera)? == blocking, "{name}: both doors of one model");
        }
        Ok(())
    });
}

#[test]
fn an_adapter_that_is_not_there_is_refused_by_both_doors() {
    gpu::reproducibly(|_| {
        let blocking = WgpuBackend::new("no such adapter", true).err().expect("it is refused");
        let other = pollster::block_on(WgpuBackend::new_async("no such adapter", true)).err();
        assert_eq!(other.expect("it is refused").message(), blocking.message());
        Ok(())
    });
}

#[test]
fn a_backend_that_works_at_once_is_ready_at_once() {
    let camera = fixtures::noise(1, 16, 1, 2).views[0].camera;
    let model = &models()[0];
    let mut loaded = LoadedModel::new(CpuBackend::new(2, Simd::detect()).unwrap(), model).unwrap();
    let (frame, pending) = waited(loaded.render_async(&camera));
    assert!(pending == 0 && frame.unwrap() == loaded.render(&camera).unwrap());
}
