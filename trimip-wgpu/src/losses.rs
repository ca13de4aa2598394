//! The loss terms on the GPU: the list of their WGSL files in `shaders/losses`, from which the kernels of the loss are
//! composed. A file defines a function with the term's name: `fn NAME(difference, numbers) -> vec2` for a photometric term,
//! `fn NAME(pixel, at, numbers, factor, gradient) -> f32` for a pixel term, `fn NAME(cone, at, fraction) -> f32` for a ray
//! term.

use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Text};
use crate::gpu::{GRID, Gpu, Kernel, Pipeline};
use crate::shaders::{COMPOSITING, FIXED, PIXEL, SUM, SUM_OF_FOUR, TARGET, words};
use crate::space::{GpuSpace, SPACE};
use trimip_core::config::Photometric;
use trimip_core::field::losses::RAY_TERMS;
use trimip_core::scene::edge_exponents::LEAST_OPACITY;

shared! {
    /// Parameters of the pixel terms.
    pub struct Params as Params {
        /// Number of pixels.
        pub count: u32,
        /// Number of workgroups.
        pub blocks: u32,
        /// 1 if the loss averages only over pixels with samples.
        pub live: u32,
        /// Number of photographs that have gains.
        pub photographs: u32,
        /// Weight of the photometric term, then its numbers.
        pub photometric: [f32; 4],
        /// Weight of each pixel term, then its numbers.
        pub terms: PixelTerms,
    }

    /// Parameters of a ray term.
    pub struct RayParams as Params {
        pub space: GpuSpace,
        /// Weight of the term relative to the photometric term, then its numbers.
        pub term: [f32; 4],
        /// Number of pixels.
        pub count: u32,
        /// Number of workgroups.
        pub blocks: u32,
    }
}

/// Number of words of a photograph's three gains.
pub const GAIN_WORDS: usize = words(size_of::<[f32; 3]>()) as usize;
/// Number of words of a photograph's three sums in fixed point, which follow the gains of all photographs.
pub const SUM_WORDS: usize = words(size_of::<[u64; 3]>()) as usize;

const PARAMS: [Source; 2] = [Source::of::<PixelTerms>(), Source::of::<Params>()];
const NOT_EXPOSED: [Source; 1] = [Text(include_str!("shaders/losses/exposure_none.wgsl"))];
const EXPOSED: [Source; 4] = [
    FIXED,
    Source::whole("GAIN_WORDS", GAIN_WORDS as u32),
    Source::whole("SUM_WORDS", SUM_WORDS as u32),
    Text(include_str!("shaders/losses/exposure_gain.wgsl")),
];

/// Shader source: tests whether numbers are finite.
pub const FINITE: Source = Text(include_str!("shaders/finite.wgsl"));

/// The kernels of a configuration's loss.
pub struct Kernels {
    /// Evaluates the pixel terms, without exposure gains.
    pub evaluate: Pipeline,
    /// Evaluates the pixel terms, with exposure gains.
    pub evaluate_exposed: Pipeline,
    /// Adds up the sums of the pixels' workgroups.
    pub add_up: Pipeline,
    /// The kernels of each ray term, in the order of core's list.
    pub rays: [RayKernels; RAY_TERMS.len()],
}

/// The kernels of a ray term.
pub struct RayKernels {
    /// Evaluates the term for every cone.
    pub cones: Pipeline,
    /// True if the cones' kernel reads the rays in addition to the samples along them.
    pub reads_rays: bool,
    /// Adds up the sums of the cones' workgroups.
    pub sums: Pipeline,
}

impl Kernels {
    /// Looks up the pipelines on a device.
    pub fn new(gpu: &Gpu, kind: Photometric) -> Self {
        let [evaluate, evaluate_exposed] = [false, true].map(|exposed| gpu.pipeline(evaluate(kind, exposed)));
        let rays = RAY_SOURCES.map(|term| {
            let [cones, sums] = ray_kernels(term).map(|kernel| gpu.pipeline(kernel));
            RayKernels { cones, reads_rays: reads_rays(term), sums }
        });
        Self { evaluate, evaluate_exposed, add_up: gpu.pipeline(add_up()), rays }
    }
}

/// Returns the kernel that evaluates pixels with the photometric term `kind`, with or without exposure gains.
fn evaluate(kind: Photometric, exposed: bool) -> Kernel {
    let kernel = Kernel::new(
        "evaluate",
        &[
            GRID,
            FINITE,
            SUM_OF_FOUR,
            PIXEL,
            TARGET,
            PARAMS[0],
            PARAMS[1],
            Source::real("LEAST_OPACITY", LEAST_OPACITY as f32),
            Text(PENALTIES),
            Text(TERMS),
            Text(penalty(kind)),
            Text(include_str!("shaders/loss.wgsl")),
        ],
        &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Write), (7, Read), (8, Read)],
    );
    if exposed { kernel.and(&EXPOSED, &[(9, Read), (10, Write)]) } else { kernel.and(&NOT_EXPOSED, &[]) }
}

fn add_up() -> Kernel {
    Kernel::new(
        "add_up",
        &[SUM_OF_FOUR, PARAMS[0], PARAMS[1], Text(include_str!("shaders/loss_sums.wgsl"))],
        &[(2, Parameters), (4, Write), (5, Write), (6, Read)],
    )
}

/// Returns true if a ray term reads the rays in addition to the samples along them.
fn reads_rays(term: &str) -> bool {
    term.contains("rays[")
}

/// Returns the kernels of a ray term: one evaluates the cones, the other adds up their sums.
fn ray_kernels(term: &'static str) -> [Kernel; 2] {
    let sources = [
        GRID,
        SPACE,
        COMPOSITING,
        SUM,
        TARGET,
        Source::of::<RayParams>(),
        Text(term),
        Text(include_str!("shaders/ray_term.wgsl")),
    ];
    let mut bindings = vec![(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Read)];
    if reads_rays(term) {
        bindings.push((5, Read));
    }
    bindings.extend([(6, Read), (7, Read), (8, Write)]);
    [
        Kernel::new("evaluate_rays", &sources, &bindings),
        Kernel::new("add_rays", &sources, &[(2, Parameters), (8, Write), (9, Write)]),
    ]
}

/// Composes the WGSL of all terms from a list.
macro_rules! losses {
    (
        photometric { $($kind:ident => $photometric:ident),* $(,)? }
        pixel { $($pixel:ident),* $(,)? }
        ray { $($ray:ident),* $(,)? }
    ) => {
        shared! {
            /// Weight and numbers of each pixel term.
            pub struct PixelTerms as PixelTerms {
                $(pub $pixel: [f32; 4]),*
            }
        }

        impl PixelTerms {
            /// Creates the parameters from the terms in the order of core's list.
            pub fn of([$($pixel),*]: [[f32; 4]; trimip_core::field::losses::PIXEL_TERMS.len()]) -> Self {
                Self { $($pixel),* }
            }
        }

        /// The functions of the photometric terms.
        pub const PENALTIES: &str =
            concat!($(include_str!(concat!("shaders/losses/", stringify!($photometric), ".wgsl"))),*);

        /// The functions of the pixel terms, and the function that computes their weighted sum.
        const TERMS: &str = concat!(
            $(include_str!(concat!("shaders/losses/", stringify!($pixel), ".wgsl")),)*
            "fn pixel_terms(loss: f32, pixel: vec4<f32>, at: u32, weight: f32, gradient: ptr<function, vec4<f32>>) -> f32 {\n",
            "    var sum = loss;\n",
            $(
                "    sum += params.terms.", stringify!($pixel), ".x * ", stringify!($pixel),
                "(pixel, at, params.terms.", stringify!($pixel), ".yzw, weight * params.terms.", stringify!($pixel),
                ".x, gradient);\n",
            )*
            "    return sum;\n}\n",
        );

        /// Returns the WGSL function that calls the photometric term.
        fn penalty(kind: Photometric) -> &'static str {
            match kind {
                $(Photometric::$kind => concat!(
                    "fn penalty(difference: f32) -> vec2<f32> {\n    return ",
                    stringify!($photometric), "(difference, params.photometric.yzw);\n}\n",
                )),*
            }
        }

        /// For each ray term: its function, and the function that calls it.
        const RAY_SOURCES: [&str; RAY_TERMS.len()] = [$(concat!(
            include_str!(concat!("shaders/losses/", stringify!($ray), ".wgsl")),
            "fn ray_term(cone: u32, at: u32, fraction: f32) -> f32 {\n    return ", stringify!($ray),
            "(cone, at, fraction);\n}\n",
        )),*];

        /// Names of the pixel terms and of the ray terms.
        #[cfg(test)]
        const PIXEL_NAMES: &[&str] = &[$(stringify!($pixel)),*];
        #[cfg(test)]
        const RAY_NAMES: &[&str] = &[$(stringify!($ray)),*];
    };
}

losses! {
    photometric {
        SmoothL1 => smooth_l1,
        Charbonnier => charbonnier,
    }
    pixel { opacity }
    ray { distortion, depth }
}

/// Returns every kernel, for validation.
#[cfg(test)]
pub fn all() -> Vec<Kernel> {
    let photometric =
        Photometric::ALL.iter().flat_map(|kind| [false, true].map(|exposed| evaluate(*kind, exposed)));
    photometric.chain(RAY_SOURCES.into_iter().flat_map(ray_kernels)).chain([add_up()]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip_core::field::losses::PIXEL_TERMS;

    #[test]
    fn every_registered_term_is_listed_in_the_same_order() {
        assert!(PIXEL_TERMS.iter().map(|term| term.name()).eq(PIXEL_NAMES.iter().copied()));
        assert!(RAY_TERMS.iter().map(|term| term.name()).eq(RAY_NAMES.iter().copied()));
        for kind in Photometric::ALL {
            let called = format!("return {}(difference", kind.term().name());
            assert!(evaluate(*kind, false).source().contains(&called), "{kind:?}");
        }
    }
}
