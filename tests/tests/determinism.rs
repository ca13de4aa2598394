//! The same seed gives the same bits for any number of threads; another seed gives other bits. Marching with
//! empty-space skipping gives bitwise the same samples as querying every step.

use trimip_core::{
    Aabb, Layout, Session, Viewer,
    config::{CameraPoses, Exposure, Precision},
    engine::{backend::Occupancy, batch::Ray, checkpoint::Checkpoint, trainer::Trainer},
    math::rng::{Random, Sequence},
};
use trimip_cpu::{CpuBackend, simd::Simd};
use trimip_tests::{fixtures, suite, suite::Bench};

/// Returns the state after some training steps with `threads` threads, and a picture rendered from it. The encoder, the
/// cones, the edge exponents and the losses are those of `encoder`.
fn trained(
    encoder: &trimip_core::Config,
    simd: Simd,
    precision: Precision,
    threads: u32,
    seed: u64,
) -> (Checkpoint, trimip_core::Frame) {
    let mut config = fixtures::encoded(suite::training::configuration(), encoder);
    (config.seed, config.field.precision) = (seed, precision);
    (config.renderer.cones, config.renderer.cone_width) =
        (encoder.renderer.cones, encoder.renderer.cone_width);
    config.data.edge_exponents.clone_from(&encoder.data.edge_exponents);
    config.loss.clone_from(&encoder.loss);
    config.train.backward_fraction.clone_from(&encoder.train.backward_fraction);
    config.train.error_map.clone_from(&encoder.train.error_map);
    config.renderer.color_weight.clone_from(&encoder.renderer.color_weight);
    // A step of this size has 16 sets of partial gradients, more than there are threads, so workers compete for the
    // sets.
    config.train.samples_per_step = 4096;
    let views = fixtures::noise(4, 16, 3, 30);
    let camera = views.views[0].camera;
    let mut trainer = Trainer::new(CpuBackend::new(threads, simd).unwrap(), &config, views).unwrap();
    suite::training::steps(&mut trainer, &config, 20).unwrap();
    let frame = trainer.render(&camera).unwrap();
    (trainer.checkpoint().unwrap(), frame)
}

#[test]
fn threads_change_no_bit() {
    let sets = Simd::available().into_iter();
    let sets: Vec<_> =
        sets.flat_map(|simd| [Precision::F32, Precision::Bf16].map(|precision| (simd, precision))).collect();
    let mut configurations = fixtures::every_encoder();
    configurations.extend([fixtures::growing_tensor(), fixtures::growing_hash_grid()]);
    // Pixels have one, one and nine cones at the three scales. The second of these configurations adds the distortion
    // loss, exposure gains and refined poses.
    let mut several_cones = fixtures::small();
    (several_cones.renderer.cones, several_cones.renderer.cone_width) = (3, 0.45);
    several_cones.data.edge_exponents = vec![0.0, 0.25, 0.5];
    configurations.push(several_cones.clone());
    several_cones.loss.distortion = 0.3;
    several_cones.loss.exposure = Exposure::Gain;
    several_cones.train.cameras = CameraPoses::Refine;
    (several_cones.optimizer.camera_rate, several_cones.optimizer.camera_delay) = (1e-3, 0.0);
    configurations.push(several_cones);
    configurations.push(suite::training::drawn());
    configurations.extend(suite::losses::examples(&fixtures::small()).into_iter().map(|(_, config)| config));
    // The code that assigns tiles and partial gradients is the same for every instruction set, so only one set runs all
    // configurations.
    let best = Simd::detect();
    let every = |(i, encoder)| {
        let met = sets.iter().filter(move |(simd, _)| i == 0 || *simd == best);
        met.map(move |&set| (encoder, set))
    };
    for (encoder, (simd, precision)) in configurations.iter().enumerate().flat_map(every) {
        let (expected, picture) = trained(encoder, simd, precision, 1, 42);
        assert!(expected.state.totals.samples > 20_000, "the steps are not empty");
        for threads in [2, 3, 5] {
            let (found, same) = trained(encoder, simd, precision, threads, 42);
            let (kind, cones) = (encoder.encoder.kind, encoder.renderer.cones);
            let loss = &encoder.loss;
            let name =
                format!("{kind:?}, {cones} cones, {loss:?}, {simd:?}, {precision:?}, {threads} threads");
            assert_eq!(found.state, expected.state, "{name}");
            for (tensor, value) in &expected.file.tensors {
                assert!(found.file.tensors.get(tensor) == Some(value), "{name}: `{tensor}` differs");
            }
            assert!(same == picture, "{name}: the picture differs");
        }
    }
}

#[test]
fn another_seed_gives_another_run() {
    let run = |seed| trained(&fixtures::small(), Simd::detect(), Precision::F32, 2, seed).0;
    let (first, second) = (run(1), run(2));
    for (name, tensor) in first.file.tensors.iter().filter(|(name, _)| !name.starts_with("occupancy")) {
        assert!(second.file.tensors.get(name) != Some(tensor), "`{name}` is the same");
    }
}

/// Returns the distances of the samples that result from querying every step, in the marcher's own precision.
fn every_step(config: &trimip_core::Config, ray: &Ray, offset: f32, bits: &[u8]) -> Vec<f32> {
    let aabb = Aabb::<f32>::new(&config.scene);
    let (enter, leave) = aabb.intersect(ray.origin, ray.direction);
    let length = aabb.longest() * 3.0_f32.sqrt() / config.renderer.steps_per_diagonal as f32;
    let first = enter + offset * length;
    let resolution = config.occupancy.resolution;
    let mut distances = Vec::new();
    for i in 0.. {
        let t = first + (i as f32 + 0.5) * length;
        if !(enter < leave && t < leave) {
            return distances;
        }
        let [x, y, z] = [0, 1, 2].map(|axis| {
            let inverse = (aabb.max[axis] - aabb.min[axis]).recip();
            let position = (ray.origin[axis] + t * ray.direction[axis] - aabb.min[axis]) * inverse;
            ((position * resolution as f32) as u32).min(resolution - 1)
        });
        let cell = x + resolution * (y + resolution * z);
        if bits[cell as usize / 8] >> (cell % 8) & 1 == 1 {
            distances.push(t);
        }
    }
    distances
}

#[test]
fn skipping_empty_space_changes_no_sample() {
    let mut samples = 0;
    for (resolution, fraction, seed) in
        [(32, 0.02, 1), (64, 0.1, 2), (32, 0.5, 3), (20, 0.9, 4), (8, 0.1, 5), (4, 0.5, 6)]
    {
        let config = suite::marching::configuration(resolution);
        let parameters = fixtures::lively(&Layout::new(&config), 1);
        let backend = CpuBackend::new(1, Simd::detect()).unwrap();
        let mut bench = Bench::new(backend, &config, None, &parameters).unwrap();
        let bits = suite::marching::bits(resolution, fraction, seed);
        bench.stages.occupancy.restore(&bits, None);
        let rays = suite::marching::rays(seed);
        for jitter in [None, Some(3)] {
            for (i, found) in suite::marching::marched(&mut bench, &rays, jitter).iter().enumerate() {
                let random = Random::new(config.seed);
                let offset = jitter.map_or(0.0, |step| random.uniform(Sequence::Jitter, step, i as u32)[0]);
                let expected = every_step(&config, &rays[i], offset, &bits);
                assert_eq!(found, &expected, "grid of {resolution}, {:?}", rays[i]);
                samples += expected.len();
            }
        }
    }
    assert!(samples > 20_000, "the rays meet {samples} samples");
}
