//! Checks that photographs of different exposures train a model as good as that of equally exposed photographs, and
//! that training finds their gains.

use trimip_core::{
    Config, Frame, Session, ViewSet, Viewer,
    config::{Exposure, OptimizerConfig},
    engine::{exposure, trainer::Trainer},
    measures::{metrics::psnr_of_error, quality::Measures},
    run::evaluate::evaluate,
};
use trimip_cpu::{CpuBackend, simd::Simd};
use trimip_data::settings::DataConfig;
use trimip_tests::fixtures::{GivenFrames, TestRandom, as_code};

/// Largest root mean square error of log-gains, whose spread is 0.25.
const TOLERANCE: f64 = 0.07;

/// Largest deficit in dB of a model of differently exposed photographs, compared with one of equally exposed
/// photographs.
const LOSS: f64 = 0.5;

/// Smallest gain in dB over a model that ignores the exposures.
const GAIN: f64 = 0.5;

/// Returns the gains of each photograph: at most 1, so that no colour is clipped, and at least 0.4, so that few bits
/// are lost.
fn known(photographs: usize) -> Vec<[f64; 3]> {
    let mut random = TestRandom::new(5);
    (0..photographs).map(|_| [0; 3].map(|_| random.between(0.4, 1.0))).collect()
}

/// Returns the photographs with their colours multiplied by `gains`.
fn multiplied(mut views: ViewSet, gains: &[[f64; 3]]) -> ViewSet {
    let photographs = exposure::photographs(&views);
    for (view, photograph) in views.views.iter().zip(photographs) {
        let k = &view.camera.intrinsics;
        for pixel in &mut views.pixels[view.offset..][..(k.width * k.height) as usize] {
            for c in 0..3 {
                pixel[c] = (f64::from(pixel[c]) * gains[photograph as usize][c]).round() as u8;
            }
        }
    }
    views
}

fn configuration() -> Config {
    let mut config = as_code();
    let read = config.change(|data: &mut DataConfig| {
        data.format = "builtin".into();
        (data.builtin_size, data.builtin_train, data.builtin_test) = (32, 24, 3);
        (data.builtin_supersampling, data.scales) = (2, 2);
    });
    read.unwrap();
    config.data.background = [0.0; 3];
    (config.encoder.plane_size, config.encoder.levels) = (32, 5);
    config.field.hidden = 32;
    config.renderer.steps_per_diagonal = 192;
    config.occupancy.resolution = 32;
    config.occupancy.warmup = 64;
    config.train.samples_per_step = 4096;
    config.train.steps = 1000;
    // The run is short, so gains need a high learning rate.
    config.optimizer = OptimizerConfig { exposure_rate: 2e-2, ..Config::default().optimizer };
    config
}

/// Trains on the scene's photographs, modified by `change`. Returns the PSNR over all test views, computed after a gain
/// is fitted to each channel, and the log-gains of the photographs.
fn trained(config: &Config, change: impl Fn(ViewSet) -> ViewSet) -> (f64, Vec<[f64; 3]>) {
    let scene = trimip_data::open(&config.section().unwrap()).unwrap();
    let backend = CpuBackend::new(2, Simd::detect()).unwrap();
    let mut trainer = Trainer::new(backend, config, change(scene.train)).unwrap();
    for step in 0..config.train.steps {
        trainer.step(step as f64 / config.train.steps as f64).unwrap();
    }
    // Per channel: Σ rendered², Σ rendered·true, Σ true².
    let (mut sums, mut count) = ([[0.0; 3]; 3], 0_usize);
    for index in 0..scene.test.len() {
        let frame = scene.test.load(index).unwrap();
        for view in 0..frame.views.len() {
            let rendered: Frame = trainer.render(&frame.views[view].camera).unwrap();
            let truth = frame.composited(view, config.data.background);
            count += truth.len();
            for (rendered, truth) in rendered.rgb().iter().zip(&truth) {
                for c in 0..3 {
                    let (rendered, truth) = (f64::from(rendered[c]), f64::from(truth[c]));
                    let products = [rendered * rendered, rendered * truth, truth * truth];
                    sums[c].iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
                }
            }
        }
    }
    let left = sums.map(|[rr, rt, tt]| tt - rt * rt / rr);
    (psnr_of_error(left.iter().sum::<f64>() / (3 * count) as f64), trainer.log_gains())
}

/// Returns the root mean square difference of log-gains, after the known ones are centred.
fn apart(found: &[[f64; 3]], known: &[[f64; 3]]) -> f64 {
    let count = known.len() as f64;
    let mean = [0, 1, 2].map(|c| known.iter().map(|gain| gain[c].ln()).sum::<f64>() / count);
    let error = |(found, known): (&[f64; 3], &[f64; 3])| {
        (0..3).map(|c| (found[c] - known[c].ln() + mean[c]).powi(2)).sum::<f64>()
    };
    assert_eq!(found.len(), known.len());
    (found.iter().zip(known).map(error).sum::<f64>() / (3.0 * count)).sqrt()
}

#[test]
fn a_test_photograph_of_another_exposure_is_measured_at_it() {
    let config = configuration();
    let scene = trimip_data::open(&config.section().unwrap()).unwrap();
    let backend = CpuBackend::new(2, Simd::detect()).unwrap();
    let mut trainer = Trainer::new(backend, &config, scene.train).unwrap();
    // The photograph is the model's own picture, darkened: it differs only in exposure, up to the rounding to 8 bits.
    let mut photograph = scene.test.load(0).unwrap();
    for view in photograph.views.clone() {
        let rendered = trainer.render(&view.camera).unwrap().rgb();
        for (pixel, rgb) in photograph.pixels[view.offset..].iter_mut().zip(rendered) {
            let [r, g, b] = [rgb[0] * 0.5, rgb[1] * 0.6, rgb[2] * 0.7].map(|c| (255.0 * c).round() as u8);
            *pixel = [r, g, b, 255];
        }
    }
    let frames = GivenFrames(vec![photograph]);
    for view in evaluate(&mut trainer, &frames, 1, &config.data, |_| Ok(true)).unwrap() {
        let Measures { psnr, psnr_exposed, .. } = view.measures;
        assert!(
            psnr_exposed > 45.0 && psnr_exposed > psnr + 15.0,
            "{psnr_exposed:.2} dB, without {psnr:.2} dB"
        );
    }
}

#[test]
fn gains_of_photographs_are_found_and_spoil_no_model() {
    let mut config = configuration();
    let gains = known(config.section::<DataConfig>().unwrap().builtin_train as usize);
    let (ignored, none) = trained(&config, |views| multiplied(views, &gains));
    assert!(none.is_empty());
    config.loss.exposure = Exposure::Gain;
    let (equal, of_equal) = trained(&config, |views| views);
    let (found, of_found) = trained(&config, |views| multiplied(views, &gains));
    // The gains absorb part of the error of an imperfect model: for photographs of one exposure, log-gains of 0.035
    // remain.
    let (error, spurious) = (apart(&of_found, &gains), apart(&of_equal, &vec![[1.0; 3]; gains.len()]));
    let spread = apart(&vec![[0.0; 3]; gains.len()], &gains);
    println!("{ignored:.2} dB ignored, {equal:.2} dB of equal photographs, {found:.2} dB");
    println!("log-gains of {spread:.3} to {error:.3}, of 0 to {spurious:.3}");
    assert!(spread > 0.2 && error < TOLERANCE, "log-gains of {spread:.3} are off by {error:.3}");
    assert!(spurious < TOLERANCE, "photographs of one exposure have log-gains of {spurious:.3}");
    assert!(found > equal - LOSS, "{found:.2} dB, of equal photographs {equal:.2} dB");
    assert!(found > ignored + GAIN, "{found:.2} dB, {ignored:.2} dB if all are taken for equal");
}
