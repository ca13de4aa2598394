//! A loss term of one's own, defined outside of the crates that train: the entropy of a pixel's opacity, which makes rays either
//! opaque or empty (`lambda_entropy` of torch-ngp). Its weight is a setting, which the run folder keeps.
//!
//! `cargo run --release -p trimip --example own_loss`

use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;
use trimip::losses::{Definition, LossSection, PixelTerm, Target, Term};
use trimip::{Addition, ForeignSection, Fragment, Pixel, Section, config::LossConfig, losses};
use trimip::{Training, backends, data, events::Event, settings};

/// Opacities are kept this far from 0 and 1, where the derivative of the entropy is infinite.
const LEAST: f32 = 1e-5;

/// The section `[entropy]` of the settings.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct Entropy {
    /// Weight relative to that of colour.
    pub weight: f32,
}

impl Section for Entropy {
    const NAME: &'static str = "entropy";
    const FRAGMENTS: &'static [Fragment] = &[Fragment {
        after: "",
        table: r#"
[entropy]
section = { meaning = "entropy of the opacity of pixels" }
weight = { default = 1e-3, range = [0, 1], meaning = "weight relative to that of colour; 0 = off" }
"#,
    }];
    const ADDITION: Option<Addition> = Some(losses::addition::<Self>());
}

impl LossSection for Entropy {
    fn terms(&self) -> Vec<Term> {
        vec![Term::Pixel(Arc::new(*self))]
    }
}

impl Definition for Entropy {
    fn name(&self) -> &'static str {
        "entropy"
    }

    fn weight(&self, _: &LossConfig) -> f32 {
        self.weight
    }
}

impl PixelTerm for Entropy {
    fn evaluate(
        &self,
        _: &LossConfig,
        pixel: &Pixel,
        _: &Target,
        factor: f32,
        gradient: &mut [f32; 4],
    ) -> f32 {
        let o = pixel.opacity.clamp(LEAST, 1.0 - LEAST);
        if o == pixel.opacity {
            gradient[3] += factor * ((1.0 - o) / o).ln();
        }
        -o * o.ln() - (1.0 - o) * (1.0 - o).ln()
    }

    fn reference(&self, _: &LossConfig, pixel: [f64; 4], _: &Target) -> f64 {
        let least = f64::from(LEAST);
        let o = pixel[3].clamp(least, 1.0 - least);
        -o * o.ln() - (1.0 - o) * (1.0 - o).ln()
    }
}

fn main() -> trimip::Result<()> {
    let entropy = train(&["train.seconds=60"], Path::new("runs/own-loss"))?;
    println!("mean entropy of the opacity in the first test view: {entropy:.4}");
    Ok(())
}

/// Trains on the built-in scene with `assignments` such as `entropy.weight=0.01`, and returns the mean entropy of the opacity in
/// the first test view.
pub fn train(assignments: &[&str], folder: &Path) -> trimip::Result<f64> {
    let mut settings = settings::with_sections(&[ForeignSection::of::<Entropy>()]);
    settings.set("data.format", "builtin")?;
    for assignment in assignments {
        settings.apply_assignment(assignment)?;
    }
    let trained = Training::new(settings, folder).run(&mut |event: &Event| println!("{event:?}"))?;
    let term = trained.config.section::<Entropy>()?;
    let camera = data::open(&trained.config.section()?)?.test.load(0)?.views[0].camera;
    let frame = backends::load(&trained.model()?)?.render(&camera)?;
    let entropies = frame.pixels.iter().map(|pixel| {
        let [r, g, b] = pixel.rgb.map(f64::from);
        term.reference(&trained.config.loss, [r, g, b, pixel.opacity.into()], &Target::default())
    });
    Ok(entropies.sum::<f64>() / frame.pixels.len() as f64)
}
