//! Stiff optics: rays of one to a hundred thousand samples, from nearly transparent to opaque. x = σδ is the optical depth.

use super::finding::{Finding, Make, Tell, apart, relative, worst};
use super::rig::{Rig, small};
use trimip_core::engine::batch::{Interval, Radiance};
use trimip_core::math::compositing::{composite, composite_gradient};
use trimip_core::{Backend, Result};

/// Length of a sample in these cases: a typical step.
const LENGTH: f32 = 1.0 / 256.0;

/// Tolerance for several f32 roundings.
const ROUNDING: f64 = 1e-6;

/// Tolerance for a driver's exp and a seven-term series, relative to the exact exp_m1.
const EXPONENTIAL: f64 = 5e-6;

type Sample = (Interval, Radiance);

fn sample(i: usize, depth: f64, rgb: [f32; 3]) -> Sample {
    let interval = Interval { t: 2.0 + LENGTH * i as f32, length: LENGTH };
    (interval, Radiance { rgb, density: (depth / f64::from(LENGTH)) as f32 })
}

/// Returns the optical depth of a sample, computed from its f32 values.
fn depth((interval, radiance): &Sample) -> f64 {
    f64::from(interval.length) * f64::from(radiance.density)
}

/// Runs the cases of this part.
pub fn cases<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    let mut rig = Rig::new(make, &small())?;
    let found =
        |case: &str, law, worst, bound| Finding { part: "optics", case: case.into(), law, worst, bound };

    // One sample per ray, with optical depths from 1e-12 to 1e12.
    let thin: Vec<Vec<Sample>> =
        (-48..=48).map(|quarter| vec![sample(0, 10_f64.powf(f64::from(quarter) / 4.0), [1.0; 3])]).collect();
    let (pixels, gradients) = rig.composite(&thin, [1.0, 1.0, 1.0, 0.0]);
    let alpha = |ray: &Vec<Sample>| -(-depth(&ray[0])).exp_m1();
    tell(found(
        "one sample, depth 1e-12 to 1e12",
        "opacity is 1 - exp(-x), relative",
        worst(pixels.iter().zip(&thin).map(|(pixel, ray)| relative(pixel.opacity, alpha(ray)))),
        EXPONENTIAL,
    ));
    tell(found(
        "one sample, depth 1e-12 to 1e12",
        "opacity within 0 and 1",
        worst(pixels.iter().map(|p| (f64::from(p.opacity) - 1.0).max(-f64::from(p.opacity)))),
        0.0,
    ));
    // White in front of white: no density changes the pixel. In front of black, the derivative with respect to density
    // is e^-x times the length.
    let background = small().data.background.map(f64::from);
    let expected = |ray: &Vec<Sample>| {
        let x = depth(&ray[0]);
        let shade: f64 = (0..3).map(|c| 1.0 - background[c]).sum();
        f64::from(LENGTH) * (-x).exp() * shade
    };
    tell(found(
        "one sample, depth 1e-12 to 1e12",
        "gradient by the density, relative to the length",
        worst(
            gradients.iter().zip(&thin).map(|(g, ray)| apart(g.density, expected(ray)) / f64::from(LENGTH)),
        ),
        4.0 * ROUNDING,
    ));

    // Many samples of one medium; the total depth is 1 for any number of samples.
    for count in [1_usize, 10, 1000, rig.backend.longest_ray().min(100_000)] {
        let ray: Vec<Sample> = (0..count).map(|i| sample(i, 1.0 / count as f64, [0.25, 0.5, 1.0])).collect();
        let total: f64 = ray.iter().map(depth).sum();
        let (pixels, _) = rig.composite(&[ray], [1.0, 1.0, 1.0, 0.0]);
        let opacity = -(-total).exp_m1();
        tell(found(
            &format!("a medium of depth 1 in {count} samples"),
            "opacity is that of the undivided medium",
            apart(pixels[0].opacity, opacity),
            // Each addition rounds by at most half a unit in the last place of a sum of at most 1.
            ROUNDING + count as f64 * 6e-8,
        ));
        let weights = f64::from(pixels[0].rgb[2]) - (1.0 - opacity) * background[2];
        tell(found(
            &format!("a medium of depth 1 in {count} samples"),
            "weights sum to the opacity",
            apart(pixels[0].opacity, weights),
            4.0 * ROUNDING + count as f64 * 1.2e-7,
        ));
    }

    let mixed: Vec<Vec<Sample>> = vec![
        // An opaque shell one step thick in a vacuum.
        (0..40)
            .map(|i| {
                sample(i, if i == 17 { 1e6 } else { 0.0 }, if i == 17 { [0.2, 0.4, 0.6] } else { [1.0; 3] })
            })
            .collect(),
        // Vacuum and wall alternate, beginning with vacuum.
        (0..40).map(|i| sample(i, if i % 2 == 1 { 1e9 } else { 0.0 }, [i as f32 / 40.0; 3])).collect(),
        // A haze in front of a wall, and hidden samples behind it.
        (0..400)
            .map(|i| sample(i, if i == 300 { 1e12 } else { 1e-6 }, [0.5, 0.1, i as f32 / 400.0]))
            .collect(),
        // Half-transparent samples of all colours.
        (0..64)
            .map(|i| {
                sample(i, 0.05 + 0.1 * (i % 5) as f64, [(i % 3) as f32 / 2.0, 0.3, (i % 7) as f32 / 6.0])
            })
            .collect(),
    ];
    let by_pixel = [0.7_f32, -0.4, 1.0, -0.6];
    let (pixels, gradients) = rig.composite(&mixed, by_pixel);
    let names = [
        "an opaque shell one step thick",
        "alternating vacuum and wall",
        "a haze in front of a wall",
        "half-thick samples",
    ];
    let mut first = 0;
    for ((name, ray), pixel) in names.iter().zip(&mixed).zip(&pixels) {
        let wide = |i: usize| (depth(&ray[i]), ray[i].1.rgb.map(f64::from));
        let all = (0..ray.len()).map(|i| (wide(i).0, wide(i).1, f64::from(ray[i].0.t)));
        let exact = composite(all, background);
        let values = (0..3).map(|c| apart(pixel.rgb[c], exact.rgb[c]));
        tell(found(
            name,
            "colour, opacity and distance as in f64",
            worst(
                values.chain([apart(pixel.opacity, exact.opacity), apart(pixel.depth, exact.distance) / 4.0]),
            ),
            8.0 * ROUNDING + ray.len() as f64 * 6e-8,
        ));
        let mut errors = Vec::new();
        let gradient = by_pixel.map(f64::from);
        composite_gradient(ray.len(), wide, exact.channels(), gradient, |i, by_depth, by_color| {
            let found = &gradients[first + i];
            errors.push(apart(found.density, by_depth * f64::from(LENGTH)) / f64::from(LENGTH));
            errors.extend((0..3).map(|c| apart(found.rgb[c], by_color[c])));
        });
        tell(found(
            name,
            "gradients as in f64, relative to the length",
            worst(errors),
            16.0 * ROUNDING + ray.len() as f64 * 1.2e-7,
        ));
        first += ray.len();
    }
    rig.backend.health()?;
    Ok(())
}
