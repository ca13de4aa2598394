//! The samples kept of each ray, their features and their densities match the reference.

use super::{Bench, marching, wide};
use crate::{
    fixtures::{TestRandom, lively},
    reference::{Reference, Sample, visible},
};
use trimip_core::{
    Backend, Layout, Renderer, Result,
    engine::{
        backend::{Occupancy, evaluate_visible_samples},
        batch::{Interval, Sphere},
    },
    field::encoders,
};

/// Limits of transmittance and weight that keep all, most and few samples.
const LIMITS: [(f32, f32); 4] = [(0.0, 0.0), (1e-4, 0.0), (0.3, 0.0), (1e-3, 0.01)];

/// Distance of a decision from its limit, in logarithms, below which f32 may decide otherwise. It comes from an error of 4e-5 in
/// the features, amplified by the density network, over several hundred samples of optical depth 0.1.
const MARGIN: f64 = 2e-3;

/// Largest fraction of rays with such a decision; large, because a ray whose samples merge passes the weight limit several times.
const DOUBTFUL_FRACTION: f64 = 0.2;

/// Tolerance of features and densities: the errors of both stages in [`super::stages`], compounded.
const TOLERANCE: f64 = 5e-4;

/// Returns a backend with varied rays, a half-empty occupancy grid and the given pruning limits.
fn bench<B: Backend>(backend: B, limits: (f32, f32)) -> Result<(Bench<B>, trimip_core::Config)> {
    let mut config = marching::configuration(32);
    (config.renderer.min_transmittance, config.renderer.min_weight) = limits;
    let layout = Layout::new(&config);
    let mut parameters = lively(&layout, 4);
    // Densities from nearly zero to opaque within a few steps.
    let last = layout.network("density").last().map_or(0..0, |slot| slot.range.clone());
    parameters[last].iter_mut().for_each(|weight| *weight *= 4.0);
    let mut bench = Bench::new(backend, &config, None, &parameters)?;
    // If the densities of cells allow it, a backend may march over several samples at once. Cells are empty, thin, opaque after
    // some steps, or opaque at once.
    let mut random = TestRandom::new(9);
    let density = |_| match random.below(40) {
        0 => 1e3,
        1..8 => 0.7,
        8..16 => 0.02,
        _ => 0.0,
    };
    let densities: Vec<f32> = (0..32_u32.pow(3)).map(density).collect();
    bench.stages.occupancy.restore(&marching::bits(32, 0.5, 7), Some(&densities));
    bench.workspace.rays.place(&bench.backend, &marching::rays(11));
    Ok((bench, config))
}

/// Returns the intervals and spheres of every ray.
fn samples<B: Backend>(bench: &Bench<B>) -> Vec<Vec<(Interval, Sphere)>> {
    let (backend, samples) = (&bench.backend, &bench.workspace.samples);
    let (intervals, spheres) = (backend.read(&samples.intervals), backend.read(&samples.spheres));
    let pairs: Vec<_> = intervals.into_iter().zip(spheres).collect();
    let segments = backend.read(&samples.segments);
    segments.iter().map(|s| pairs[s.start as usize..(s.start + s.count) as usize].to_vec()).collect()
}

/// The visibility pass keeps those marched samples that the reference rule keeps at the reference densities. It stores the
/// lengths that the kept samples represent, and their features and densities.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn kept<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for limits in LIMITS {
        let (mut bench, config) = bench(make(), limits)?;
        let layout = Layout::new(&config);
        let reference = Reference::new(&config, &layout, &wide(&bench.backend.read(&bench.parameters)));
        let (width, stride) = (encoders::of(&config).width(&config), encoders::stride(&config));
        let jitter = Some(3);
        let Bench { stages, workspace, .. } = &mut bench;
        stages.renderer.march(
            &mut workspace.stream,
            &workspace.rays,
            &stages.occupancy,
            jitter,
            &mut workspace.samples,
        );
        let (marched, rays) = (samples(&bench), bench.backend.read(&bench.workspace.rays.rays));
        let Bench { stages, workspace, parameters, .. } = &mut bench;
        stages.renderer.visibility_pass(stages, parameters, workspace, jitter);
        let seen = samples(&bench);
        let features = bench.backend.read(&bench.workspace.features);
        let radiance = bench.backend.read(&bench.workspace.radiance);
        let (mut row, mut doubtful, mut dropped, mut merged) = (0, 0, 0, 0);
        for (i, (marched, seen)) in marched.iter().zip(&seen).enumerate() {
            let literal = |(interval, sphere): &(Interval, Sphere)| Sample::new(&rays[i], interval, sphere);
            let all: Vec<_> = marched.iter().map(literal).collect();
            let (kept, margin) = visible(&config, &all, &reference.densities(&all));
            if margin < MARGIN {
                doubtful += 1;
            } else {
                assert_eq!(seen.len(), kept.len(), "limits {limits:?}, ray {i}, of {}", all.len());
                for ((interval, sphere), (place, factor)) in seen.iter().zip(&kept) {
                    let (own, expected) = marched[*place];
                    assert_eq!((interval.t, *sphere), (own.t, expected), "limits {limits:?}, ray {i}");
                    let found = f64::from(interval.length / own.length);
                    assert!((found / factor - 1.0).abs() < 2.0 * TOLERANCE, "ray {i}: {found}, not {factor}");
                    merged += usize::from(found > 1.0);
                }
                dropped += all.len() - kept.len();
            }
            for sample in seen.iter().map(literal) {
                let expected = reference.features(&sample);
                let density = reference.density(&reference.geometry(&expected));
                let found = &features[row * stride..][..width];
                for (found, expected) in found.iter().zip(&expected) {
                    assert!((f64::from(*found) - expected).abs() < TOLERANCE, "ray {i}: feature {found}");
                }
                let found = f64::from(radiance[row].density);
                assert!((found / density - 1.0).abs() < TOLERANCE, "ray {i}: density {found}, not {density}");
                row += 1;
            }
        }
        assert!(row > 300, "the rays see something");
        assert_eq!(merged > 30, limits.1 > 0.0, "limits {limits:?} merge {merged} samples");
        assert_eq!(dropped > 100, limits.0 > 0.0, "limits {limits:?} drop {dropped} samples");
        let fraction = f64::from(doubtful) / marched.len() as f64;
        assert!(
            fraction <= DOUBTFUL_FRACTION,
            "{limits:?}: {doubtful} of {} rays are near a limit",
            marched.len()
        );
    }
    Ok(())
}

/// Returns the complete output of the visibility pass, which colour and compositing read, as bytes to compare bit by bit.
fn seen<B: Backend>(bench: &mut Bench<B>, stride: usize, jitter: Option<u64>, all: bool) -> Vec<Vec<u8>> {
    let Bench { backend, stages, workspace, parameters } = bench;
    if all {
        evaluate_visible_samples(stages, parameters, workspace, jitter);
    } else {
        stages.renderer.visibility_pass(stages, parameters, workspace, jitter);
    }
    let count = backend.read(&workspace.samples.spheres).len();
    let bytes = |slice: &[f32]| slice.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let segments = backend.read(&workspace.samples.segments);
    let owners = backend.read(&workspace.samples.rays);
    let sphere = |s: &Sphere| bytes(&[s.position[0], s.position[1], s.position[2], s.radius]);
    vec![
        segments.iter().flat_map(|s| [s.start, s.count]).flat_map(u32::to_le_bytes).collect(),
        owners.iter().flat_map(|ray| ray.to_le_bytes()).collect(),
        backend.read(&workspace.samples.intervals).iter().flat_map(|i| bytes(&[i.t, i.length])).collect(),
        backend.read(&workspace.samples.spheres).iter().flat_map(sphere).collect(),
        bytes(&backend.read(&workspace.features)[..count * stride]),
        backend.read(&workspace.radiance)[..count].iter().flat_map(|r| bytes(&[r.density])).collect(),
    ]
}

/// A backend's own visibility pass gives the same bits as evaluating every sample. For a backend without its own pass the test is
/// trivial.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn pieces<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for limits in LIMITS {
        let (mut bench, config) = bench(make(), limits)?;
        let stride = encoders::stride(&config);
        for jitter in [None, Some(3)] {
            let (all, pieces) =
                (seen(&mut bench, stride, jitter, true), seen(&mut bench, stride, jitter, false));
            assert!(all[4].len() > stride * 4 * 100, "the rays see something");
            assert_eq!(all, pieces, "limits {limits:?}, jitter {jitter:?}");
        }
    }
    Ok(())
}
