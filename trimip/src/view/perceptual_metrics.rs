//! Computes the perceptual measures: MS-SSIM, LDR-FLIP and, with weights from a file, LPIPS.

use super::{flip::flip_of_pictures, pictures};
use trimip_core::{
    Result,
    config::EvalConfig,
    measures::{
        metrics::ms_ssim,
        perception::{Pair, Perception, PerceptualScores},
    },
};

/// The perceptual measures that this build and the settings provide. FLIP and MS-SSIM run in parallel; LPIPS uses all cores.
pub struct PerceptualMetrics {
    #[cfg(feature = "lpips")]
    lpips: Option<super::lpips::Lpips>,
}

impl PerceptualMetrics {
    /// Reads the weights of LPIPS, if `eval.lpips` names a file.
    ///
    /// # Errors
    /// Of kind `Input`, when the file is no LPIPS network, or this build has no LPIPS.
    pub fn open(eval: &EvalConfig) -> Result<Self> {
        #[cfg(feature = "lpips")]
        {
            let path = std::path::Path::new(&eval.lpips);
            let wanted = !eval.lpips.is_empty();
            Ok(Self { lpips: wanted.then(|| super::lpips::Lpips::open(path)).transpose()? })
        }
        #[cfg(not(feature = "lpips"))]
        {
            if !eval.lpips.is_empty() {
                return Err(trimip_core::Error::input(
                    format!("eval.lpips = \"{}\"", eval.lpips),
                    "this build has no LPIPS",
                    "build with the feature `lpips`, or set eval.lpips = \"\" to do without it",
                ));
            }
            Ok(Self {})
        }
    }
}

impl Perception for PerceptualMetrics {
    fn measure_perception(&mut self, pair: &Pair<'_>) -> Result<PerceptualScores> {
        let (rendered, target) = (pair.rendered, pair.target);
        let (ms_ssim, (flip, flip_map)) = std::thread::scope(|scope| {
            let similar = scope.spawn(|| ms_ssim(rendered, target, pair.width, pair.height));
            let flip = flip(pair);
            (similar.join().unwrap_or(f64::NAN), flip)
        });
        #[cfg(feature = "lpips")]
        let lpips = match &mut self.lpips {
            Some(lpips) => lpips.measure(rendered, target, pair.width)?,
            None => f64::NAN,
        };
        #[cfg(not(feature = "lpips"))]
        let lpips = f64::NAN;
        Ok(PerceptualScores { ms_ssim, flip, lpips, flip_map })
    }
}

/// Returns the mean FLIP error over the compared pixels, and the error of each pixel, which is 0 for the others. Colours are rounded to 8
/// bits. The mean is NaN if a rendered value is not finite.
fn flip(pair: &Pair<'_>) -> (f64, Option<Vec<f32>>) {
    let picture = |rgb| pictures::rgb_image(pair.width as u32, pair.height as u32, rgb);
    let Some(mut errors) = flip_of_pictures(&picture(pair.rendered), &picture(pair.target)) else {
        return (f64::NAN, None);
    };
    let excluded = |i: usize| pair.excluded.get(i).copied().unwrap_or(false);
    let compared = (0..errors.len()).filter(|&i| !excluded(i)).count();
    errors.iter_mut().enumerate().filter(|(i, _)| excluded(*i)).for_each(|(_, error)| *error = 0.0);
    let finite = pair.rendered.iter().flatten().all(|value| value.is_finite());
    let sum: f64 = errors.iter().copied().map(f64::from).sum();
    (if finite { sum / compared as f64 } else { f64::NAN }, Some(errors))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair<'a>(
        rendered: &'a [[f32; 3]],
        target: &'a [[f32; 3]],
        width: usize,
        excluded: &'a [bool],
    ) -> Pair<'a> {
        Pair { rendered, target, width, height: rendered.len() / width, excluded }
    }

    fn perceptual(pair: &Pair<'_>) -> PerceptualScores {
        PerceptualMetrics::open(&trimip_core::Config::default().eval)
            .unwrap()
            .measure_perception(pair)
            .unwrap()
    }

    #[test]
    fn a_file_that_is_not_there_is_refused_with_what_to_do() {
        let eval = EvalConfig { lpips: "nowhere.onnx".into(), ..trimip_core::Config::default().eval };
        let error = PerceptualMetrics::open(&eval).err().expect("there is no such file");
        assert_eq!(error.kind(), trimip_core::ErrorKind::Input);
        assert!(
            error.message().contains("nowhere.onnx") && error.message().contains("eval.lpips = \"\""),
            "{error}"
        );
    }

    #[test]
    fn every_measure_that_can_be_taken_is() {
        let (grey, side) = (vec![[0.5; 3]; 176 * 176], 176);
        let same = perceptual(&pair(&grey, &grey, side, &[]));
        assert!((same.ms_ssim - 1.0).abs() < 1e-9 && same.lpips.is_nan());
        assert!(if cfg!(feature = "flip") { same.flip == 0.0 } else { same.flip.is_nan() });
        let small = perceptual(&pair(&grey[..64], &grey[..64], 8, &[]));
        assert!(small.ms_ssim.is_nan() && small.flip.is_nan() == same.flip.is_nan());
    }

    #[cfg(feature = "flip")]
    mod flip {
        use super::*;
        use crate::view::flip_colors;

        /// Returns the FLIP error of two pictures of one colour each by the equations of the paper, in f64. The filters do not change such
        /// pictures and they have no edge, so only the difference of the colours remains.
        fn of_colors(a: [u8; 3], b: [u8; 3]) -> f64 {
            let linear = |byte: u8| {
                let value = f64::from(byte) / 255.0;
                if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
            };
            // Lightness, and the two opponent channels after Hunt's adjustment.
            let seen = |rgb: [f64; 3]| {
                let sum =
                    |row: [f64; 3]| (0..3).map(|i| row[i] * rgb[i]).sum::<f64>() / row.iter().sum::<f64>();
                let f = |t: f64| {
                    if t > (6.0_f64 / 29.0).powi(3) {
                        t.cbrt()
                    } else {
                        t * (29.0_f64 / 6.0).powi(2) / 3.0 + 4.0 / 29.0
                    }
                };
                let x = f(sum([10_135_552.0, 8_788_810.0, 4_435_075.0]));
                let y = f(sum([2_613_072.0, 8_788_810.0, 887_015.0]));
                let z = f(sum([1_425_312.0, 8_788_810.0, 70_074_185.0]));
                let lightness = 116.0 * y - 16.0;
                [lightness, 0.01 * lightness * 500.0 * (x - y), 0.01 * lightness * 200.0 * (y - z)]
            };
            let distance =
                |a: [f64; 3], b: [f64; 3]| ((a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])).powf(0.7);
            let most = distance(seen([0.0, 1.0, 0.0]), seen([0.0, 0.0, 1.0]));
            let found = distance(seen(a.map(linear)), seen(b.map(linear)));
            if found < 0.4 * most {
                found * 0.95 / (0.4 * most)
            } else {
                0.95 + 0.05 * (found - 0.4 * most) / (0.6 * most)
            }
        }

        #[test]
        fn colours_differ_by_the_equations_of_the_paper() {
            for (a, b) in [
                ([0, 0, 0], [255, 255, 255]),
                ([100, 100, 100], [110, 110, 110]),
                ([200, 30, 60], [180, 90, 20]),
                ([0, 255, 0], [0, 0, 255]),
            ] {
                let color = |rgb: [u8; 3]| vec![rgb.map(|byte| f32::from(byte) / 255.0); 30 * 25];
                let found = perceptual(&pair(&color(a), &color(b), 30, &[])).flip;
                let expected = of_colors(a, b);
                assert!((found - expected).abs() < 2e-4, "{a:?} {b:?}: {found}, not {expected}");
            }
        }

        /// Returns a smooth pattern with some noise, in integers so that other programs can reproduce it.
        fn pattern(width: u32, height: u32, seed: u32) -> Vec<[f32; 3]> {
            let byte = |x: u32, y: u32, c: u32| {
                let noise = (x * 7919 + y * 104_729 + c * 31 + seed * 613).wrapping_mul(2_654_435_761) >> 27;
                ((x * (2 + c) + y * 3 + x * y / 64) % 200 + noise * seed).min(255)
            };
            (0..width * height)
                .map(|i| [0, 1, 2].map(|c| byte(i % width, i / width, c) as f32 / 255.0))
                .collect()
        }

        #[test]
        fn edges_and_noise_differ_as_in_the_authors_newer_program() {
            // Reference value from flip-evaluator 1.7 in Python at 67 pixels per degree: 0.471213.
            let (a, b) = (pattern(192, 176, 1), pattern(192, 176, 3));
            let one = perceptual(&pair(&a, &b, 192, &[]));
            assert!((one.flip - 0.471_213).abs() < 1e-4, "{}", one.flip);
            let map = one.flip_map.as_ref().unwrap();
            assert!(map.len() == a.len() && map.iter().all(|error| (0.0..=1.0).contains(error)));
            let mean = map.iter().copied().map(f64::from).sum::<f64>() / map.len() as f64;
            assert_eq!(one.flip, mean);
            assert_eq!(
                perceptual(&pair(&b, &a, 192, &[])).flip_map,
                one.flip_map,
                "neither picture comes first"
            );
        }

        #[test]
        fn pixels_that_are_not_compared_do_not_count_and_no_number_is_none() {
            // The left half differs. It is excluded, with a margin as wide as the filters' reach.
            let (width, height) = (60, 20);
            let left = |i: usize| i % width < 30;
            let target = vec![[0.5; 3]; width * height];
            let mut rendered: Vec<[f32; 3]> =
                (0..target.len()).map(|i| [if left(i) { 0.9 } else { 0.5 }; 3]).collect();
            let excluded: Vec<bool> = (0..target.len()).map(|i| i % width < 45).collect();
            let of_rest = perceptual(&pair(&rendered, &target, width, &excluded));
            assert_eq!(of_rest.flip, 0.0);
            assert!(of_rest.flip_map.unwrap().iter().all(|&error| error == 0.0));
            assert!(perceptual(&pair(&rendered, &target, width, &[])).flip > 0.1);
            rendered[0][1] = f32::NAN;
            assert!(perceptual(&pair(&rendered, &target, width, &[])).flip.is_nan());
        }

        #[test]
        fn errors_become_magma() {
            let picture = flip_colors(3, 1, &[0.0, 0.5, 1.0]).unwrap();
            // The ends and the middle of matplotlib's magma.
            let expected = [[0, 0, 4], [183, 55, 121], [252, 253, 191]];
            for (pixel, expected) in picture.pixels().zip(expected) {
                let near = pixel.0.iter().zip(expected).all(|(&a, b): (&u8, u8)| a.abs_diff(b) <= 2);
                assert!(near, "{pixel:?}, not {expected:?}");
            }
        }
    }
}
