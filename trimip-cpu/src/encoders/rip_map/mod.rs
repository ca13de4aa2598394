//! Ripmaps on the CPU: a texel's 16 channels fill one vector register, and a query sums at most 16 texels on each
//! plane. A ripmap holds a copy of its base, so that every level is read from one array.

mod passes;
mod scatter;

use self::passes::{base_len, map_len};
use self::scatter::{Gradient, Sort, spread};
use super::bands::{BANDS, Extent};
use super::{Encoding, GradientMemory, Piece, Places};
use crate::buffer::{Buffer, take, take_mut};
use crate::simd::{Kernel, Lanes, Simd, fetch};
use crate::wire::{Reader, put_counted};
use trimip_core::engine::batch::Sphere;
use trimip_core::field::encoders::rip_map::{CHANNELS, CONTEXT, Gaussian, Plane, planes};
use trimip_core::{Aabb, Config, Result};

/// The planes and their ripmaps.
pub(crate) struct RipMaps {
    simd: Simd,
    planes: Vec<Plane<f32>>,
    /// Size of the unit cube, in world units.
    extent: [f32; 3],
    /// The ripmaps of all planes, and their gradients.
    maps: Buffer<f32>,
    map_gradients: Buffer<f32>,
    /// The texels whose gradient may be non-zero: for each row of each ripmap, an interval of columns in units of level
    /// 0, aligned so that it halves evenly on every level.
    touched: Vec<Vec<Extent>>,
}

impl Encoding for RipMaps {
    type Gradient = Gradient;

    fn new(simd: Simd, config: &Config, training: bool) -> Self {
        let aabb = Aabb::<f64>::new(&config.scene);
        let planes: Vec<Plane<f32>> = planes(&config.rip_map, &aabb).iter().map(Plane::cast).collect();
        let maps: usize = planes.iter().map(map_len).sum();
        let whole = |plane: &Plane<f32>| vec![Extent::whole(plane.sides[0]); plane.height()];
        Self {
            simd,
            extent: aabb.extent().map(|side| side as f32),
            maps: Buffer::zeros(maps),
            map_gradients: Buffer::zeros(if training { maps } else { 0 }),
            touched: planes.iter().map(whole).collect(),
            planes,
        }
    }

    fn gradient(&self) -> Gradient {
        let bands = vec![Vec::new(); self.planes.len() * BANDS];
        Gradient { gaussians: Buffer::zeros(0), rows: Buffer::zeros(0), bands }
    }

    fn refresh(&mut self, parameters: &[f32], all: bool) {
        let Self { simd, planes, maps, touched, .. } = self;
        let (mut base, mut maps) = (parameters, &mut maps[..]);
        for (plane, touched) in planes.iter().zip(touched) {
            let whole = vec![Extent::whole(plane.sides[0]); plane.sides[1]];
            let changed = if all { &whole } else { &touched[..plane.sides[1]] };
            let base = take(&mut base, base_len(plane));
            passes::average(*simd, plane, base, take_mut(&mut maps, map_len(plane)), changed);
        }
    }

    fn forward(&self, at: Places<'_>, context: &mut [f32], features: &mut [f32], stride: usize) {
        let (context, _) = context.as_chunks_mut::<CONTEXT>();
        let samples = at.owners.iter().zip(at.intervals).zip(at.spheres);
        for (((owner, interval), sphere), row) in samples.zip(&mut *context) {
            let ray = &at.rays[*owner as usize];
            let (Sphere { position, radius }, t) = (*sphere, ray.apex_distance(interval.t));
            *row = Gaussian::new(position, self.extent, radius, ray.direction, t, interval.length).row();
        }
        self.simd.run(Gather { planes: &self.planes, maps: &self.maps, context, features, stride });
    }

    fn backward(&self, _: Places<'_>, context: &[f32], rows: &[f32], _: usize, gradient: &mut Gradient) {
        let (first, start) = (gradient.gaussians.len(), gradient.rows.len());
        let gaussians = context.as_chunks::<CONTEXT>().0;
        gradient.gaussians.resize(first + gaussians.len());
        gradient.gaussians[first..].copy_from_slice(gaussians);
        gradient.rows.resize(start + rows.len());
        gradient.rows[start..].copy_from_slice(rows);
        let bands = &mut gradient.bands;
        self.simd.run(Sort { planes: &self.planes, gaussians, first: first as u32, bands });
    }

    fn reduce(&mut self, gradients: &mut [&mut Gradient], parameter_gradient: &mut [f32]) {
        let Self { simd, planes, map_gradients, touched, .. } = self;
        spread(*simd, planes, gradients, map_gradients, touched, parameter_gradient);
        let (mut base, mut maps) = (parameter_gradient, &mut map_gradients[..]);
        for (plane, touched) in planes.iter().zip(touched) {
            let base = take_mut(&mut base, base_len(plane));
            passes::pull(*simd, plane, take_mut(&mut maps, map_len(plane)), base, touched);
        }
        for gradient in gradients {
            gradient.gaussians.clear();
            gradient.rows.clear();
            gradient.bands.iter_mut().for_each(Vec::clear);
        }
    }

    fn put(&self, gradient: &Gradient, out: &mut Vec<u8>) {
        put_counted(out, &gradient.gaussians);
        put_counted(out, &gradient.rows);
        gradient.bands.iter().for_each(|band| put_counted(out, band));
    }

    fn take(&self, from: &mut Reader<'_>, gradient: &mut Gradient) -> Result<()> {
        from.buffer(&mut gradient.gaussians)?;
        from.buffer(&mut gradient.rows)?;
        let samples = gradient.gaussians.len();
        from.expect("gradients", gradient.rows.len(), samples * self.planes.len() * CHANNELS)?;
        gradient.bands.iter_mut().try_for_each(|band| from.indices(band, samples))
    }

    fn gradient_memory(config: &Config) -> GradientMemory {
        let planes = config.rip_map.planes as usize;
        // A sample stores its gradient, its Gaussian, and its index in the lists of the bands that it touches.
        let row = planes * (size_of::<[f32; CHANNELS]>() + 2 * size_of::<u32>());
        GradientMemory {
            by_sample: row + size_of::<[f32; CONTEXT]>(),
            by_partial: planes * BANDS * size_of::<Vec<u32>>(),
        }
    }

    fn touched(&self) -> Option<Vec<Piece<'_>>> {
        let piece = |(plane, rows): (&Plane<f32>, &'_ Vec<Extent>)| {
            let extents: Vec<Extent> = rows[..plane.sides[1]].to_vec();
            let within = Box::new(move |row: usize| {
                let columns = extents[row].texels();
                columns.start * CHANNELS..columns.end * CHANNELS
            });
            Piece { length: base_len(plane), row: plane.sides[0] * CHANNELS, within }
        };
        Some(self.planes.iter().zip(&self.touched).map(piece).collect())
    }
}

/// Number of samples whose texels are prefetched before the first of them is summed.
const AHEAD: usize = 8;

struct Gather<'a> {
    planes: &'a [Plane<f32>],
    maps: &'a [f32],
    context: &'a [[f32; CONTEXT]],
    features: &'a mut [f32],
    stride: usize,
}

/// The texels that a sample reads on a plane, and their weights.
#[derive(Clone, Copy)]
struct Texels {
    texels: [*const f32; 16],
    weights: [f32; 16],
    count: usize,
}

impl Gather<'_> {
    /// Lists the texels of a sample and prefetches them.
    #[inline(always)]
    fn find(plane: &Plane<f32>, map: &[f32], gaussian: &Gaussian<f32>, to: &mut Texels) {
        to.count = 0;
        for read in plane.reads(gaussian) {
            if read.level_weight == 0.0 {
                continue;
            }
            for i in 0..2 {
                let row = plane.texel(read.levels, read.taps.rows[i], 0);
                for j in 0..2 {
                    // SAFETY: `taps` clamps rows and columns to the level, and the map holds every level.
                    let texel = unsafe { map.as_ptr().add((row + read.taps.columns[j]) * CHANNELS) };
                    fetch(texel);
                    to.texels[to.count] = texel;
                    to.weights[to.count] = read.level_weight * read.taps.weights[i][j];
                    to.count += 1;
                }
            }
        }
    }
}

impl Kernel for Gather<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { planes, maps, context, features, stride } = self;
        let mut ahead = [Texels { texels: [std::ptr::null(); 16], weights: [0.0; 16], count: 0 }; AHEAD];
        for (context, out) in context.chunks(AHEAD).zip(features.chunks_mut(AHEAD * stride)) {
            for (p, plane) in planes.iter().enumerate() {
                let map = &maps[plane.start * CHANNELS..][..map_len(plane)];
                for (row, texels) in context.iter().zip(&mut ahead) {
                    Self::find(plane, map, &Gaussian::of(row), texels);
                }
                for (texels, out) in ahead[..context.len()].iter().zip(out.chunks_exact_mut(stride)) {
                    let mut sum = L::splat(0.0);
                    for (texel, weight) in texels.texels.iter().zip(texels.weights).take(texels.count) {
                        // SAFETY: `find` computed the pointer from the map that this kernel borrows.
                        sum = L::splat(weight).mul_add(unsafe { L::load(*texel) }, sum);
                    }
                    sum.put(&mut out.as_chunks_mut().0[p]);
                }
            }
        }
    }
}
