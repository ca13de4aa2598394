//! The terms of the loss on the GPU: the list of their WGSL in `shaders/losses`, composed into the kernels of the loss. A file
//! defines a function of the term's name: `fn NAME(difference, numbers) -> vec2` of a photometric term, `fn NAME(pixel, at,
//! numbers, factor, gradient) -> f32` of a term of pixels, `fn NAME(cone, share) -> f32` of a term of rays.

use crate::kernel::Access::{self, Parameters, Read, Write};
use crate::kernel::{COMPOSITING, FIXED, GRID, Kernel, RAY, SPACE};
use trimip_core::config::Photometric;
use trimip_core::losses::RAY_TERMS;

const TOTAL: &str = include_str!("shaders/total.wgsl");
const FINITE: &str = include_str!("shaders/finite.wgsl");
const LOSS: &str = include_str!("shaders/loss.wgsl");
const RAY_TERM: &str = include_str!("shaders/ray_term.wgsl");
const NOT_EXPOSED: &str = include_str!("shaders/losses/exposure_none.wgsl");
const EXPOSED: &str = include_str!("shaders/losses/exposure_gain.wgsl");

/// Bindings of `evaluate` without gains, and with them.
const BINDINGS: &[(u32, Access)] =
    &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Write), (7, Read), (8, Read)];
const EXPOSED_BINDINGS: &[(u32, Access)] = &[
    (0, Read),
    (1, Write),
    (2, Parameters),
    (3, Read),
    (4, Write),
    (7, Read),
    (8, Read),
    (9, Read),
    (10, Write),
];
const RAY_BINDINGS: &[(u32, Access)] = &[
    (0, Read),
    (1, Write),
    (2, Parameters),
    (3, Read),
    (4, Read),
    (5, Read),
    (6, Read),
    (7, Read),
    (8, Write),
];

/// Adds up the sums of the pixels' workgroups.
pub static ADD_UP: Kernel = Kernel::new(
    "add_up",
    &[TOTAL, include_str!("shaders/loss_sums.wgsl")],
    &[(2, Parameters), (4, Write), (5, Write), (6, Read)],
);

/// Composes the kernels of all terms from a list.
macro_rules! losses {
    (
        photometric { $($kind:ident => $photometric:literal),* $(,)? }
        pixel { $($pixel:literal),* $(,)? }
        ray { $($ray:literal),* $(,)? }
    ) => {
        /// The functions of the photometric terms.
        pub const PENALTIES: &str =
            concat!($(include_str!(concat!("shaders/losses/", $photometric, ".wgsl"))),*);

        /// The functions of the terms of pixels, and their weighted sum.
        const TERMS: &str = concat!(
            $(include_str!(concat!("shaders/losses/", $pixel, ".wgsl")),)*
            "struct PixelTerms {\n", $("    ", $pixel, ": vec4<f32>,\n",)* "}\n",
            "fn pixel_terms(loss: f32, pixel: vec4<f32>, at: u32, weight: f32, gradient: ptr<function, vec4<f32>>) -> f32 {\n",
            "    var sum = loss;\n",
            $(
                "    sum += params.terms.", $pixel, ".x * ", $pixel,
                "(pixel, at, params.terms.", $pixel, ".yzw, weight * params.terms.", $pixel, ".x, gradient);\n",
            )*
            "    return sum;\n}\n",
        );

        /// Names of the terms of pixels and of rays.
        #[cfg(test)]
        const PIXEL_NAMES: &[&str] = &[$($pixel),*];
        #[cfg(test)]
        const RAY_NAMES: &[&str] = &[$($ray),*];

        /// Evaluates the pixels with the photometric term `kind`, with or without gains of photographs.
        pub fn evaluate(kind: Photometric, exposed: bool) -> &'static Kernel {
            match kind {
                $(Photometric::$kind => {
                    const PENALTY: &str = concat!(
                        "fn penalty(difference: f32) -> vec2<f32> {\n    return ",
                        $photometric, "(difference, params.photometric.yzw);\n}\n",
                    );
                    static WITHOUT: Kernel = Kernel::new(
                        "evaluate",
                        &[GRID, FINITE, TOTAL, NOT_EXPOSED, PENALTIES, TERMS, PENALTY, LOSS],
                        BINDINGS,
                    );
                    static WITH: Kernel = Kernel::new(
                        "evaluate",
                        &[GRID, FINITE, TOTAL, FIXED, EXPOSED, PENALTIES, TERMS, PENALTY, LOSS],
                        EXPOSED_BINDINGS,
                    );
                    if exposed { &WITH } else { &WITHOUT }
                })*
            }
        }

        /// The kernels of each term of rays, as core lists them: that of the cones, and that of their sums.
        pub static RAY_KERNELS: [[Kernel; 2]; RAY_TERMS.len()] = [$({
            const TERM: &str = concat!(
                include_str!(concat!("shaders/losses/", $ray, ".wgsl")),
                "fn ray_term(cone: u32, share: f32) -> f32 {\n    return ", $ray, "(cone, share);\n}\n",
            );
            const FILES: &[&str] = &[GRID, RAY, SPACE, COMPOSITING, TERM, RAY_TERM];
            [
                Kernel::new("evaluate_rays", FILES, RAY_BINDINGS),
                Kernel::new("add_rays", FILES, &[(2, Parameters), (8, Write), (9, Write)]),
            ]
        }),*];
    };
}

losses! {
    photometric {
        SmoothL1 => "smooth_l1",
        Charbonnier => "charbonnier",
    }
    pixel { "opacity" }
    ray { "distortion" }
}

/// Every kernel, for validation.
#[cfg(test)]
pub fn kernels() -> Vec<Kernel> {
    let photometric = Photometric::ALL
        .iter()
        .flat_map(|kind| [false, true].map(|exposed| evaluate(*kind, exposed).clone()));
    photometric.chain(RAY_KERNELS.iter().flatten().cloned()).chain([ADD_UP.clone()]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip_core::losses::PIXEL_TERMS;

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
