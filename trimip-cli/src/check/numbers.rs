//! Numbers at the limits of their range: densities, gradients and hidden units that barely fit into f32 or f16, or overflow.

use super::finding::{Finding, Make, Tell, not_finite, worst};
use super::rig::{camera, hash, photographs, small};
use trimip_core::config::{OptimizerConfig, Precision};
use trimip_core::engine::trainer::Trainer;
use trimip_core::field::adamw::Rule;
use trimip_core::field::tensors::Values;
use trimip_core::{Backend, Config, Frame, Layout, Result, Session, Viewer};

fn found(case: impl Into<String>, law: &'static str, worst: f64, bound: f64) -> Finding {
    Finding { part: "numbers", case: case.into(), law, worst, bound }
}

/// Runs the cases of this part.
pub fn cases<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    logits(make, tell)?;
    gradients().into_iter().for_each(&mut *tell);
    steep(make, tell)?;
    beyond_half(make, tell)?;
    Ok(())
}

/// Checks density logits of ±1e4: empty space and an opaque medium.
fn logits<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    let config = small();
    let layout = Layout::new(&config);
    for (name, logit) in [("density logits of 1e4", 1e4_f32), ("density logits of -1e4", -1e4)] {
        let views = photographs(&[camera(8, 0)], 1, hash);
        let view = views.views[0].camera;
        let mut trainer = Trainer::new(make()?, &config, views)?;
        let mut values = trainer.parameters();
        let last = format!("density.{}.weight", config.field.density_layers);
        for slot in &layout.slots {
            let part = &mut values[slot.range.clone()];
            let inputs = slot.shape[0] as f32;
            if slot.name == "planes" {
                part.fill(1.0);
            } else if slot.name == last {
                // The hidden units are 1, so their weighted sum is the logit.
                part.iter_mut().step_by(slot.shape[1]).for_each(|w| *w = logit / inputs);
            } else if slot.name.starts_with("density") {
                part.fill(1.0 / inputs);
            }
        }
        trainer.set_parameters(&values);
        trainer.occupy_all();
        let frame = trainer.render(&view)?;
        let opacity = if logit > 0.0 { 1.0 } else { 0.0 };
        // The rays at the middle of the picture pass through the box.
        let middle = &frame.pixels[frame.pixels.len() / 2 + 4];
        tell(found(
            name,
            "the box is opaque (1e4) or empty (-1e4)",
            (f64::from(middle.opacity) - opacity).abs(),
            1e-6,
        ));
        let numbers: Vec<f32> =
            frame.pixels.iter().flat_map(|p| [p.rgb[0], p.rgb[1], p.rgb[2], p.opacity, p.depth]).collect();
        tell(found(name, "the picture is finite", not_finite(&numbers), 0.0));
        trainer.step(0.1)?;
        let strange = not_finite(&trainer.parameters());
        tell(found(name, "a step leaves finite parameters", strange, 0.0));
    }
    Ok(())
}

/// Checks the optimiser's update at gradients near the limits of f32, and at gradients whose squares overflow or underflow.
fn gradients() -> Vec<Finding> {
    let config = OptimizerConfig { weight_decay: 0.0, ..Config::default().optimizer };
    [1e-38_f32, 1e-30, 1e-20, 1e-8, 1.0, 1e8, 1e15, 1e19]
        .into_iter()
        .map(|gradient| {
            let rate = config.learning_rate;
            let (mut x, mut m, mut v) = (0.0_f32, 0.0, 0.0);
            let (mut wide, mut wide_m, mut wide_v) = (0.0_f64, 0.0, 0.0);
            for step in 1..=20 {
                Rule::<f32>::new(&config, rate, step).apply(&mut x, &mut m, &mut v, gradient);
                Rule::<f64>::new(&config, rate, step).apply(
                    &mut wide,
                    &mut wide_m,
                    &mut wide_v,
                    gradient.into(),
                );
            }
            // Twenty steps move a parameter by at most twenty learning rates. If squares underflow, epsilon dominates the denominator.
            let strange = not_finite(&[x, m, v]);
            let error = if strange > 0.0 { f64::NAN } else { (f64::from(x) - wide).abs() / (20.0 * rate) };
            found(
                format!("gradients of {gradient:e}"),
                "the steps are those of f64, relative to the largest",
                error,
                if gradient < 1e-15 { 1.0 } else { 1e-5 },
            )
        })
        .collect()
}

/// Multiplies texels of 1e-30 by weights of 1e30: the gradients of the texels are about 1e30, those of the weights
/// about 1e-30. A gradient whose second moment overflows leaves its parameter and its moments unchanged, and is
/// counted.
fn steep<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    let config = small();
    let layout = Layout::new(&config);
    let trainer = || Trainer::new(make()?, &config, photographs(&[camera(16, 0)], 1, hash));
    let (mut trainer, mut resumed) = (trainer()?, trainer()?);
    let mut values = trainer.parameters();
    for slot in &layout.slots {
        let part = &mut values[slot.range.clone()];
        if slot.name == "planes" {
            part.iter_mut().for_each(|texel| *texel = texel.signum() * 1e-30);
        } else if slot.name == "density.0.weight" {
            part.iter_mut().for_each(|weight| *weight *= 1e30);
        }
    }
    trainer.set_parameters(&values);
    trainer.occupy_all();
    for _ in 0..3 {
        trainer.step(0.1)?;
    }
    let checkpoint = trainer.checkpoint()?;
    let case = "gradients of 1e30 and of 1e-30";
    let numbers = checkpoint.file.tensors.values().flat_map(|tensor| match &tensor.values {
        Values::F32(numbers) => numbers.as_slice(),
        _ => &[],
    });
    let before = checkpoint.state.totals.non_finite;
    resumed.restore(&checkpoint)?;
    resumed.step(0.1)?;
    let after = resumed.checkpoint()?.state.totals.non_finite;
    let unless = |holds: bool| if holds { 0.0 } else { 1.0 };
    [
        found(case, "parameters and moments stay finite", not_finite(numbers), 0.0),
        found(case, "are counted if their second moment overflows", unless(before > 0), 0.0),
        found(case, "are still counted after a resume", unless(after > before), 0.0),
    ]
    .into_iter()
    .for_each(tell);
    Ok(())
}

/// Checks activations that overflow f16. In any precision, the picture matches the picture in f32 up to the rounding of
/// the factors. A backend that meets such values in f16 continues in f32.
fn beyond_half<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    let layout = Layout::new(&small());
    let picture = |precision| -> Result<Frame> {
        let mut config = small();
        config.field.precision = precision;
        // The learning rate is negligible: the steps only count overflows.
        config.optimizer.learning_rate = 1e-20;
        let views = photographs(&[camera(16, 0), camera(16, 1)], 1, hash);
        let view = views.views[0].camera;
        let mut trainer = Trainer::new(make()?, &config, views)?;
        let mut values = trainer.parameters();
        for slot in &layout.slots {
            let factor = match slot.name.as_str() {
                "planes" => 100.0,
                "density.0.weight" => 1e7,
                "density.1.weight" => 1e-7,
                _ => 1.0,
            };
            values[slot.range.clone()].iter_mut().for_each(|value| *value *= factor);
        }
        trainer.set_parameters(&values);
        trainer.occupy_all();
        for _ in 0..6 {
            trainer.step(0.1)?;
        }
        trainer.render(&view)
    };
    let exact = picture(Precision::F32)?;
    for (name, precision) in [("bf16", Precision::Bf16), ("f16", Precision::F16)] {
        let found_picture = picture(precision)?;
        let colors = found_picture.pixels.iter().zip(&exact.pixels);
        let errors = colors.flat_map(|(a, b)| (0..3).map(|c| f64::from((a.rgb[c] - b.rgb[c]).abs())));
        tell(found(
            format!("hidden units beyond f16's range, \"{name}\""),
            "the picture is that of f32",
            worst(errors),
            0.02,
        ));
    }
    Ok(())
}
