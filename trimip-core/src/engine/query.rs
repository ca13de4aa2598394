//! Density and colour of a model at points of the world, without rendering a picture: for meshes and volumes.

use crate::{
    Backend, Field, Query, Result, Space,
    engine::{
        batch::{Interval, Radiance, Ray, Samples, Sphere, Tile, Tiling, Workspace},
        loaded::LoadedModel,
    },
    field::encoders,
};
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// Number of queries per tile.
const PLACES_PER_TILE: u32 = 512;

/// Number of queries whose results are on the device at once.
const PLACES_AT_ONCE: usize = 1 << 18;

/// The rays, intervals and spheres of samples.
type Parts = (Vec<Ray>, Vec<Interval>, Vec<Sphere>);

/// Converts queries to samples, each on a ray of its own that starts at the distance `reach` in front of the sample.
fn parts(queries: &[Query], space: &Space<f32>, centre: [f64; 3]) -> Parts {
    let reach = space.aabb().longest();
    let mut parts = (Vec::new(), Vec::new(), Vec::new());
    for Query { point, radius, direction } in queries {
        let point: [f32; 3] = std::array::from_fn(|axis| (point[axis] - centre[axis]) as f32);
        let origin = std::array::from_fn(|axis| point[axis] - reach * direction[axis]);
        parts.0.push(Ray {
            origin,
            slope: radius / reach,
            direction: *direction,
            cosine: 1.0,
            ..Ray::default()
        });
        parts.1.push(Interval { t: reach, length: 2.0 * radius });
        parts.2.push(Sphere { position: space.to_cube(point), radius: radius * space.scale(point) });
    }
    parts
}

impl<B: Backend> LoadedModel<B> {
    /// Implements [`Viewer::query`](crate::Viewer::query); without `colors`, computes only densities.
    pub(crate) fn evaluate(&mut self, queries: &[Query], colors: bool) -> Result<Vec<Radiance>> {
        let (centred, centre) = self.config.centred();
        let space = Space::<f32>::new(&centred.scene);
        let (backend, stages, parameters) = (&*self.backend, &self.stages, &self.parameters);
        let mut out = backend.zeros::<Radiance>(0);
        let mut all = Vec::with_capacity(queries.len());
        for queries in queries.chunks(PLACES_AT_ONCE) {
            let (rays, intervals, spheres) = parts(queries, &space, centre.to_array());
            backend.install(|| {
                backend.map_tiles(
                    &stages.field,
                    Tiling { count: queries.len() as u32, per_tile: PLACES_PER_TILE },
                    &mut out,
                    &|work, tile| {
                        let own = tile.start as usize..tile.end as usize;
                        // Recorded work is submitted first, because a device executes buffer writes before any work
                        // that is not submitted yet.
                        backend.submit();
                        work.rays.place(backend, &rays[own.clone()]);
                        work.samples.place(backend, &intervals[own.clone()], &spheres[own]);
                        stages.density(parameters, work);
                        if colors {
                            let Workspace { stream, rays, samples, field_context, radiance, .. } = work;
                            let tile = &mut Tile { stream, parameters, rays, samples };
                            stages.field.color(tile, 0.0, field_context, radiance);
                        }
                    },
                    &|work| &work.radiance,
                );
            });
            let found = backend.read(&out);
            all.extend(found.into_iter().zip(queries).map(|(own, Query { point, .. })| {
                let point = std::array::from_fn(|axis| (point[axis] - centre[axis]) as f32);
                Radiance { density: own.density * space.density_scale(point), ..own }
            }));
            backend.health()?;
        }
        Ok(all)
    }
}

impl<B: Backend> LoadedModel<B> {
    /// Implements [`Viewer::features`](crate::Viewer::features).
    pub(crate) fn encode(&mut self, queries: &[Query]) -> Result<Vec<f32>> {
        let (centred, centre) = self.config.centred();
        let (width, stride) = (encoders::of(&centred).width(&centred), encoders::stride(&centred));
        let space = Space::<f32>::new(&centred.scene);
        let (backend, stages, parameters) = (&*self.backend, &self.stages, &self.parameters);
        let mut out = backend.zeros::<Radiance>(0);
        let all = Mutex::new(vec![0.0; queries.len() * width]);
        for (i, queries) in queries.chunks(PLACES_AT_ONCE).enumerate() {
            let (rays, intervals, spheres) = parts(queries, &space, centre.to_array());
            let work = |work: &mut Workspace<B>, tile: Range<u32>| {
                let own = tile.start as usize..tile.end as usize;
                backend.submit();
                work.rays.place(backend, &rays[own.clone()]);
                work.samples.place(backend, &intervals[own.clone()], &spheres[own.clone()]);
                // `map_tiles` returns the densities, which are not used.
                stages.density(parameters, work);
                let rows = backend.read(&work.features);
                let mut all = all.lock().unwrap_or_else(PoisonError::into_inner);
                let first = (i * PLACES_AT_ONCE + own.start) * width;
                let into = all[first..].chunks_exact_mut(width);
                into.zip(rows.chunks_exact(stride)).take(own.len()).for_each(|(to, from)| {
                    to.copy_from_slice(&from[..width]);
                });
            };
            let tiling = Tiling { count: queries.len() as u32, per_tile: PLACES_PER_TILE };
            backend.install(|| {
                backend.map_tiles(&stages.field, tiling, &mut out, &work, &|work| &work.radiance);
            });
            backend.health()?;
        }
        Ok(all.into_inner().unwrap_or_else(PoisonError::into_inner))
    }
}

impl<B: Backend> Samples<B> {
    /// Replaces all samples with one sample per ray.
    pub fn place(&mut self, backend: &B, intervals: &[Interval], spheres: &[Sphere]) {
        let count = spheres.len() as u32;
        let segment = |start| crate::engine::batch::Segment { start, count: 1 };
        backend.write(&mut self.segments, &(0..count).map(segment).collect::<Vec<_>>());
        backend.write(&mut self.rays, &(0..count).collect::<Vec<_>>());
        backend.write(&mut self.intervals, intervals);
        backend.write(&mut self.spheres, spheres);
        backend.write(&mut self.counts, &[[count; 2]]);
    }
}
