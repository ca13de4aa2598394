//! Loss terms of a crate outside of the workspace: the square of a pixel's opacity, and the sum of the opacities 1 − exp(−x) of a
//! ray's samples with optical depths x.

use serde::{Deserialize, Serialize};
use std::sync::Arc;
use trimip_core::config::LossConfig;
use trimip_core::field::losses::{
    ConeSamples, Definition, LossSection, PixelTerm, RayTerm, Target, Term, addition,
};
use trimip_core::{Addition, Config, Fragment, Pixel, Section};

/// The section `[outside]`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Outside {
    opacity: f32,
    depth: f32,
}

impl Section for Outside {
    const NAME: &'static str = "outside";
    const FRAGMENTS: &'static [Fragment] = &[Fragment {
        after: "",
        table: r#"
[outside]
section = { meaning = "loss terms of another crate" }
opacity = { default = 0.0, range = [0, 1], meaning = "weight of the squared opacity of a pixel" }
depth = { default = 0.0, range = [0, 1], meaning = "weight of the opacities of the samples of a ray" }
"#,
    }];
    const ADDITION: Option<Addition> = Some(addition::<Self>());
}

impl LossSection for Outside {
    fn terms(&self) -> Vec<Term> {
        vec![
            Term::Pixel(Arc::new(SquaredOpacity(self.opacity))),
            Term::Ray(Arc::new(SampleOpacities(self.depth))),
        ]
    }
}

/// Square of the opacity of a pixel. Holds its weight.
pub struct SquaredOpacity(pub f32);

impl Definition for SquaredOpacity {
    fn name(&self) -> &'static str {
        "squared_opacity"
    }

    fn weight(&self, _: &LossConfig) -> f32 {
        self.0
    }
}

impl PixelTerm for SquaredOpacity {
    fn evaluate(
        &self,
        _: &LossConfig,
        pixel: &Pixel,
        _: &Target,
        factor: f32,
        gradient: &mut [f32; 4],
    ) -> f32 {
        gradient[3] += factor * 2.0 * pixel.opacity;
        pixel.opacity * pixel.opacity
    }

    fn reference(&self, _: &LossConfig, pixel: [f64; 4], _: &Target) -> f64 {
        pixel[3].powi(2)
    }
}

/// Sum of the opacities of a ray's samples. Holds its weight.
pub struct SampleOpacities(pub f32);

impl Definition for SampleOpacities {
    fn name(&self) -> &'static str {
        "sample_opacities"
    }

    fn weight(&self, _: &LossConfig) -> f32 {
        self.0
    }
}

impl RayTerm for SampleOpacities {
    fn evaluate(&self, _: &LossConfig, cone: &ConeSamples<'_, f32>, by_depth: &mut [f32]) -> f32 {
        for (by_depth, sample) in by_depth.iter_mut().zip(cone.samples) {
            *by_depth += (-sample.depth).exp();
        }
        cone.samples.iter().map(|sample| -(-sample.depth).exp_m1()).sum()
    }

    fn reference(&self, _: &LossConfig, cone: &ConeSamples<'_, f64>) -> f64 {
        cone.samples.iter().map(|sample| -(-sample.depth).exp_m1()).sum()
    }
}

/// Returns `base` with each of the two terms alone.
///
/// # Panics
/// If the configuration refuses the section.
pub fn examples(base: &Config) -> [(&'static str, Config); 2] {
    [("squared_opacity", [0.3, 0.0]), ("sample_opacities", [0.0, 0.2])].map(|(name, [opacity, depth])| {
        let mut config = base.clone();
        config.change::<Outside>(|own| *own = Outside { opacity, depth }).expect("weights in their ranges");
        (name, config)
    })
}
