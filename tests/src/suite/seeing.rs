//! Seeing front to back in pieces keeps the samples, features and densities of asking every sample and pruning.

use super::{Bench, marching, stages::write_rays};
use crate::fixtures::lively;
use trimip_core::{Backend, Layout, Result, backend::Occupancy, backend::see_all};

/// Everything that seeing leaves for colour and compositing, as bytes: equal means equal bits.
fn seen<B: Backend>(bench: &mut Bench<B>, jitter: Option<u64>, all: bool) -> Vec<Vec<u8>> {
    let Bench { backend, stages, space, parameters } = bench;
    if all {
        see_all(stages, parameters, space, jitter);
    } else {
        backend.see(stages, parameters, space, jitter);
    }
    let count = backend.read(&space.samples.spheres).len();
    let bytes = |slice: &[f32]| slice.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let segments = backend.read(&space.samples.segments);
    let owners = backend.read(&space.samples.rays);
    vec![
        segments.iter().flat_map(|s| [s.start, s.count]).flat_map(u32::to_le_bytes).collect(),
        owners.iter().flat_map(|ray| ray.to_le_bytes()).collect(),
        backend.read(&space.samples.intervals).iter().flat_map(|i| bytes(&[i.t, i.length])).collect(),
        backend.read(&space.samples.spheres).iter().flat_map(|s| bytes(&[s.position[0], s.radius])).collect(),
        bytes(&backend.read(&space.features)[..count * 48]),
        backend.read(&space.radiance)[..count].iter().flat_map(|r| bytes(&[r.density])).collect(),
    ]
}

/// Rays of all kinds through a half-empty grid, for limits that keep all, most and few samples.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn pieces<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for (min_transmittance, min_weight) in [(0.0, 0.0), (1e-4, 0.0), (0.3, 0.0), (1e-3, 0.01)] {
        let mut config = marching::configuration(32);
        config.renderer.min_transmittance = min_transmittance;
        config.renderer.min_weight = min_weight;
        let parameters = lively(&Layout::new(&config), 4);
        let mut bench = Bench::new(make(), &config, None, &parameters)?;
        bench.stages.occupancy.restore(&marching::bits(32, 0.5, 7), None);
        write_rays(&bench.backend, &mut bench.space.rays, &marching::rays(11));
        for jitter in [None, Some(3)] {
            let (all, pieces) = (seen(&mut bench, jitter, true), seen(&mut bench, jitter, false));
            assert!(all[4].len() > 48 * 4 * 100, "the rays see something");
            assert_eq!(all, pieces, "limits {min_transmittance} {min_weight}, jitter {jitter:?}");
        }
    }
    Ok(())
}
