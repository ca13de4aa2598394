//! Tests of masked pixels: training learns nothing from ignored pixels, whatever colours they store, and weights each pixel by
//! the fraction of it that is kept.

use super::training::{configuration, steps};
use crate::fixtures::{GivenFrames, TestRandom, noise};
use trimip_core::{
    Alpha, Backend, Config, Result, Session, StepReport, ViewSet, Viewer,
    config::TrainBackground,
    engine::{batch::StepSums, trainer::Trainer},
    measures::quality::{Measures, ViewQuality},
    run::evaluate::evaluate,
};

/// Returns photographs of noise at two scales. Their left half is ignored and has random colours from the seed `garbage`; some of
/// the coarse pixels in the right half are partly kept.
pub fn half(garbage: u64) -> ViewSet {
    let (mut set, mut random) =
        (ViewSet { alpha: Alpha::Kept, ..noise(3, 16, 2, 2) }, TestRandom::new(garbage));
    let ViewSet { views, pixels, scales, .. } = &mut set;
    for scale in scales {
        for view in &views[scale.views.clone()] {
            let k = view.camera.intrinsics;
            let pixels = &mut pixels[view.offset..][..(k.width * k.height) as usize];
            for (i, pixel) in pixels.iter_mut().enumerate() {
                let x = i as u32 % k.width;
                if 2 * x < k.width {
                    let [r, g, b, ..] = random.bits().to_le_bytes();
                    *pixel = [r, g, b, 0];
                } else {
                    pixel[3] = if scale.factor > 1 && x.is_multiple_of(2) { 64 } else { 255 };
                }
            }
        }
    }
    set
}

/// Returns photographs of noise in which `fraction` / 255 of every pixel is kept.
fn uniform(fraction: u8) -> ViewSet {
    let mut views = ViewSet { alpha: Alpha::Kept, ..noise(3, 16, 2, 2) };
    views.pixels.iter_mut().for_each(|pixel| pixel[3] = fraction);
    views
}

/// Returns a configuration whose loss uses every part of a target, including the opacity, the random background and the weight of
/// the distortion.
pub fn everything() -> Config {
    let mut config = configuration();
    (config.loss.opacity, config.loss.distortion) = (0.1, 0.05);
    config.train.background = TrainBackground::Random;
    config
}

/// Parameters and reports of a run have the same bits for any colours in ignored pixels.
///
/// # Errors
/// When a step fails.
pub fn garbage<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = everything();
    let run = |views: ViewSet| -> Result<(Vec<u32>, StepReport)> {
        let mut trainer = Trainer::new(make(), &config, views)?;
        steps(&mut trainer, &config, 20)?;
        let report = trainer.step(0.5)?;
        Ok((trainer.parameters().iter().map(|p| p.to_bits()).collect(), report))
    };
    let (one, of_one) = run(half(1))?;
    let (other, of_other) = run(half(2))?;
    assert!(one == other, "ignored pixels are learned from");
    assert_eq!((of_one.loss, of_one.batch_psnr), (of_other.loss, of_other.batch_psnr));
    let (taken, _) = run(ViewSet { alpha: Alpha::Straight, ..half(1) })?;
    assert!(taken != one, "as opacity the same pixels teach something");
    Ok(())
}

/// Photographs that are wholly ignored change no parameter. Keeping the same fraction of every pixel changes only the weight of
/// the pixels.
///
/// # Errors
/// When a step fails.
pub fn fractions<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = everything();
    let mut trainer = Trainer::new(make(), &config, uniform(0))?;
    let before = trainer.parameters();
    steps(&mut trainer, &config, 6)?;
    assert!(trainer.parameters() == before, "there is nothing to learn");
    let gradient = |views: ViewSet| -> Result<(StepSums, Vec<f32>)> {
        Trainer::new(make(), &config, views)?.loss_and_gradient(0, 150)
    };
    let ((whole, by_whole), (fifth, by_fifth)) = (gradient(uniform(255))?, gradient(uniform(51))?);
    assert!((fifth.weight / whole.weight - 0.2).abs() < 1e-6 && (fifth.loss / whole.loss - 0.2).abs() < 1e-5);
    let square = |values: &mut dyn Iterator<Item = f32>| values.map(|x| f64::from(x * x)).sum::<f64>();
    let apart = square(&mut by_whole.iter().zip(&by_fifth).map(|(a, b)| a - b));
    let size = square(&mut by_whole.iter().copied());
    // A device may add gradients in fixed point, whose error does not shrink with the weight.
    assert!(size > 0.0 && apart < 1e-8 * size, "{apart} of {size}");
    // Photographs that are wholly kept give the gradient of opaque ones without a mask.
    let opaque = ViewSet { alpha: Alpha::Straight, ..uniform(255) };
    assert!(gradient(opaque)?.1 == by_whole);
    Ok(())
}

/// Measures cover the pixels of which at least half is kept. A view without such pixels has no measures.
///
/// # Errors
/// When a picture fails.
pub fn measures<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = configuration();
    let mut trainer = Trainer::new(make(), &config, half(1))?;
    // Two frames with one view at each of two scales; the second frame is masked as a whole.
    let frame = |garbage: u64, fraction: Option<u8>| {
        let mut set = half(garbage);
        for scale in &mut set.scales {
            scale.views = scale.views.start..scale.views.start + 1;
        }
        if let Some(fraction) = fraction {
            set.pixels.iter_mut().for_each(|pixel| pixel[3] = fraction);
        }
        set
    };
    let mut measured = |garbage: u64| -> Result<Vec<ViewQuality>> {
        let frames = GivenFrames(vec![frame(garbage, None), frame(garbage, Some(0))]);
        evaluate(&mut trainer, &frames, 1, &config.data, |_| Ok(true))
    };
    let (one, other) = (measured(1)?, measured(2)?);
    assert_eq!(one.iter().map(|view| (view.index, view.scale)).collect::<Vec<_>>(), [(0, 1), (0, 2)]);
    for (one, other) in one.iter().zip(&other) {
        // SSIM is not compared: its windows extend beyond the edge of a mask, where both pictures have the photograph's colours,
        // which differ between the two runs.
        let other = Measures { ssim: one.measures.ssim, ..other.measures };
        // Measures that were not taken are NaN, which equals nothing, so the test compares their text.
        assert_eq!(format!("{other:?}"), format!("{:?}", one.measures));
    }
    // The expected PSNR, over the right half.
    let set = frame(1, None);
    let rendered = trainer.render(&set.views[0].camera)?.rgb();
    let squares: Vec<f64> = set
        .pixels_of(0)
        .iter()
        .zip(&rendered)
        .filter(|(pixel, _)| pixel[3] == 255)
        .flat_map(|(pixel, rgb)| [0, 1, 2].map(|c| (f64::from(pixel[c]) / 255.0 - f64::from(rgb[c])).powi(2)))
        .collect();
    assert_eq!(squares.len(), 3 * 16 * 8);
    let by_hand = -10.0 * (squares.iter().sum::<f64>() / squares.len() as f64).log10();
    assert!((one[0].measures.psnr - by_hand).abs() < 1e-4, "{} is not {by_hand}", one[0].measures.psnr);
    Ok(())
}
