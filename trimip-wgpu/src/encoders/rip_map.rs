//! Ripmaps on the GPU. A ripmap holds a copy of its base, so that every level is read from one array. The Gaussians of
//! the samples are the context.

use super::scatter::Scatter;
use super::{Encoding, FeatureGradients, GAUSSIANS, Places, TEXELS, whole};
use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Parts, Text};
use crate::gpu::{Binds, Buffer, GRID, GROUP, Gpu, Kernel, Pipeline, Size};
use crate::workspace::Addition;
use std::sync::Arc;
use trimip_core::field::encoders::rip_map::{self, CHANNELS};
use trimip_core::{Aabb, Config};

shared! {
    /// A plane with a ripmap.
    struct Plane as Plane {
        /// Linear maps from the unit cube to the position along a row, and to the position across the rows: three
        /// factors, then the position of the origin.
        places: [[f32; 4]; 2],
        /// For each of the two axes: its unit vector, then half of log2 of the variance at which level 0 is read.
        axes: [[f32; 4]; 2],
        /// Numbers of columns and rows of level (0, 0).
        sides: [u32; 2],
        /// Index of the first texel of level (0, 0) in the parameters.
        first: u32,
        /// Index of the plane's first texel in the array of all ripmaps.
        start: u32,
    }

    /// Parameters of the kernel that computes Gaussians.
    struct Preparing as Params {
        /// Size of the unit cube, in world units.
        extent: [f32; 3],
        counter: u32,
    }

    /// Parameters of the kernels that read texels and add up gradients.
    struct Params as Params {
        planes: u32,
        levels: u32,
        counter: u32,
    }

    /// Parameters of a pass over all ripmaps.
    struct Pass as Pass {
        planes: u32,
        levels: u32,
        /// Level whose texels are computed, or whose gradient is added to the finer level.
        level: u32,
    }
}

const PLANES: Source = Parts(&[
    GRID,
    Source::of::<Plane>(),
    Source::whole("TEXEL_FOURS", CHANNELS as u32 / 4),
    Text(include_str!("shaders/rip_planes.wgsl")),
]);
const MAP: Source =
    Parts(&[PLANES, GAUSSIANS, TEXELS, Source::of::<Params>(), Text(include_str!("shaders/rip_map.wgsl"))]);
const PASS: Source = Parts(&[PLANES, Source::of::<Pass>(), Text(include_str!("shaders/rip_pass.wgsl"))]);
const AVERAGING: Source = Parts(&[PASS, Text(include_str!("shaders/rip_average.wgsl"))]);
const PULLING: Source = Parts(&[PASS, Text(include_str!("shaders/rip_pull.wgsl"))]);

kernels! {
    /// The kernels of ripmaps, except the one that adds up gradients.
    struct Kernels {
        /// Computes the Gaussians of samples.
        prepare: Kernel::new(
            "rip_prepare",
            &[GRID, GAUSSIANS, Source::of::<Preparing>(), Text(include_str!("shaders/rip_prepare.wgsl"))],
            &[(0, Read), (1, Read), (2, Parameters), (3, Read), (4, Write), (5, Read), (6, Read)],
        ),
        /// Computes the features of samples.
        read: Kernel::new(
            "rip_read",
            &[MAP, Text(include_str!("shaders/rip_read.wgsl"))],
            &[(0, Read), (1, Read), (2, Parameters), (4, Write), (5, Read), (9, Read)],
        ),
        base: Kernel::new("rip_base", &[AVERAGING], &[(0, Write), (1, Read), (2, Parameters), (9, Read)]),
        average_along: Kernel::new(
            "rip_average_along",
            &[AVERAGING],
            &[(0, Write), (2, Parameters), (9, Read)],
        ),
        average_across: Kernel::new(
            "rip_average_across",
            &[AVERAGING],
            &[(0, Write), (2, Parameters), (9, Read)],
        ),
        pull_along: Kernel::new("rip_pull_along", &[PULLING], &[(0, Write), (2, Parameters), (9, Read)]),
        pull_across: Kernel::new("rip_pull_across", &[PULLING], &[(0, Write), (2, Parameters), (9, Read)]),
        take: Kernel::new("rip_take", &[PULLING], &[(0, Write), (1, Write), (2, Parameters), (9, Read)]),
    }
}

/// Returns the kernel that adds feature gradients to the gradients of ripmaps.
fn add(addition: Addition) -> Kernel {
    let channels = Source::whole("CHANNELS", CHANNELS as u32);
    addition.kernel(
        "rip_add",
        &[MAP, channels, Text(include_str!("shaders/rip_add.wgsl"))],
        &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read), (9, Read)],
    )
}

impl Plane {
    fn new(plane: &rip_map::Plane<f64>) -> Self {
        let four = |[x, y, z]: [f64; 3], w: f64| [x, y, z, w].map(|value| value as f32);
        Self {
            places: [0, 1].map(|axis| four(plane.factors[axis], plane.offsets[axis])),
            axes: [0, 1].map(|axis| four(plane.axes[axis], plane.base[axis])),
            sides: plane.sides.map(|side| side as u32),
            first: plane.first as u32,
            start: plane.start as u32,
        }
    }
}

/// The planes and their ripmaps.
pub(crate) struct RipMaps {
    gpu: Arc<Gpu>,
    kernels: Kernels,
    own: Vec<rip_map::Plane<f64>>,
    planes: Buffer<Plane>,
    levels: u32,
    extent: [f32; 3],
    /// Number of floats of the bases of all planes.
    base: usize,
    maps: Buffer<f32>,
    map_gradients: Buffer<f32>,
    /// Sums of gradients for all ripmaps.
    sums: Scatter,
}

impl RipMaps {
    fn params(&self, counter: u32) -> Params {
        Params { planes: self.own.len() as u32, levels: self.levels, counter }
    }

    /// Runs a pass over the texels of `level`: along the rows or, if `across` is true, across them.
    fn pass(
        &self,
        pipeline: &Pipeline,
        across: bool,
        level: u32,
        maps: &Buffer<f32>,
        base: Option<&Buffer<f32>>,
    ) {
        let texels = self.own.iter().map(|plane| match across {
            true => plane.sides[0] * (plane.sides[1] >> level),
            false => (plane.sides[0] >> level) * plane.height(),
        });
        let size = Size::Items((texels.sum::<usize>() * CHANNELS / 4) as u64);
        let binds = Binds::new(maps.bind()).and(base.map(|base| base.part(0, self.base)));
        let pass = Pass { planes: self.own.len() as u32, levels: self.levels, level };
        self.gpu.dispatch(pipeline, &binds.and([self.planes.bind()]), &pass, size);
    }
}

impl Encoding for RipMaps {
    fn new(
        gpu: &Arc<Gpu>,
        config: &Config,
        training: bool,
        addition: Addition,
        skipped: &Buffer<u32>,
    ) -> Self {
        let aabb = Aabb::<f64>::new(&config.scene);
        let own = rip_map::planes(&config.rip_map, &aabb);
        let [base, maps] = rip_map::texels(&config.rip_map, &aabb).map(|texels| texels * CHANNELS);
        let mut planes = Buffer::zeros(gpu, 0);
        planes.write(&own.iter().map(Plane::new).collect::<Vec<_>>());
        let length = if training { maps } else { CHANNELS };
        Self {
            gpu: Arc::clone(gpu),
            kernels: Kernels::new(gpu),
            own,
            planes,
            levels: config.rip_map.levels,
            extent: aabb.extent().map(|side| side as f32),
            base,
            maps: Buffer::zeros(gpu, maps),
            map_gradients: Buffer::zeros(gpu, length),
            sums: Scatter::new(gpu, add(addition), addition, training, length, skipped),
        }
    }

    fn refresh(&mut self, parameters: &Buffer<f32>) {
        self.pass(&self.kernels.base, true, 0, &self.maps, Some(parameters));
        for level in 1..self.levels {
            self.pass(&self.kernels.average_across, true, level, &self.maps, None);
        }
        for level in 1..self.levels {
            self.pass(&self.kernels.average_along, false, level, &self.maps, None);
        }
    }

    fn forward(&self, _: &Buffer<f32>, at: &Places, context: &Buffer<f32>, features: &Buffer<f32>) {
        let rows = &at.rows;
        let binds = [
            whole(&at.rays),
            whole(&at.owners),
            whole(&at.intervals),
            context.bind(),
            rows.bind(),
            whole(&at.spheres),
        ];
        let preparing = Preparing { extent: self.extent, counter: rows.counter };
        self.gpu.dispatch(&self.kernels.prepare, &binds, &preparing, rows.dispatch(1, GROUP));
        let binds = [self.maps.bind(), context.bind(), features.bind(), rows.bind(), self.planes.bind()];
        let size = rows.dispatch(4 * self.own.len() as u32, GROUP);
        self.gpu.dispatch(&self.kernels.read, &binds, &self.params(rows.counter), size);
    }

    fn reduce(
        &mut self,
        partials: impl Iterator<Item = FeatureGradients>,
        _: &Buffer<f32>,
        parameter_gradient: &Buffer<f32>,
    ) {
        let gradients = &self.map_gradients;
        self.sums.clear(gradients);
        for from in partials {
            let rows = &from.at.rows;
            let size = rows.dispatch(4 * self.own.len() as u32, GROUP);
            let work = (&self.params(rows.counter), size);
            self.sums.add(&from, &from.context, gradients, &[self.planes.bind()], work);
        }
        self.sums.to_float(gradients);
        for level in (1..self.levels).rev() {
            self.pass(&self.kernels.pull_along, false, level, gradients, None);
        }
        for level in (1..self.levels).rev() {
            self.pass(&self.kernels.pull_across, true, level, gradients, None);
        }
        self.pass(&self.kernels.take, true, 0, gradients, Some(parameter_gradient));
    }

    #[cfg(test)]
    fn kernels() -> Vec<Kernel> {
        super::scatter::ADDITIONS.map(add).into_iter().chain(Kernels::all()).collect()
    }
}
