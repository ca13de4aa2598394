//! Limits the time of evaluations to a fraction of the training time. The time per pixel is predicted from the current
//! time per training ray and from the last evaluation. The number of views is decided while they are rendered.

use std::cmp::Reverse;

/// Fraction of the time for evaluations that evaluations during training may use; the final evaluation gets the rest.
const ON_THE_WAY: f64 = 0.6;

/// Extra seconds for the final evaluation, so that short runs are measured too.
const AT_THE_END: f64 = 20.0;

/// Time of a rendered pixel relative to that of a training ray, assumed before the first measurement: rendering is one
/// of the three passes of training.
const FORWARD: f64 = 0.5;

/// Limits the time that a run spends on evaluations.
#[derive(Clone, Debug)]
pub struct Timekeeper {
    fraction: f64,
    points: f64,
    passed: f64,
    spent: f64,
    ray: f64,
    /// Seconds per pixel in the last evaluation, and seconds per training ray at that time.
    measured: Option<[f64; 2]>,
    /// Strides of the evaluations during training.
    covered: Vec<usize>,
}

impl Timekeeper {
    /// Limits `points` evaluations during training and a final one to `fraction` of the training time; 0 means no limit.
    pub fn new(fraction: f64, points: u32) -> Self {
        Self {
            fraction,
            points: points.max(1).into(),
            passed: 0.0,
            spent: 0.0,
            ray: 0.0,
            measured: None,
            covered: Vec::new(),
        }
    }

    /// Records `seconds` of training with `rays` rays.
    pub fn trained(&mut self, seconds: f64, rays: u64) {
        if rays > 0 {
            self.ray = seconds / rays as f64;
        }
    }

    /// Records `seconds` of evaluation during training.
    pub fn spend(&mut self, seconds: f64) {
        self.spent += seconds;
    }

    /// Records `seconds` in which an evaluation rendered `pixels`.
    pub fn rendered(&mut self, seconds: f64, pixels: f64) {
        if pixels > 0.0 {
            self.measured = Some([seconds / pixels, self.ray]);
        }
    }

    /// Records that an evaluation during training measured every `stride`-th view.
    pub fn covered(&mut self, stride: usize) {
        self.covered.push(stride);
    }

    /// Returns the stride of most evaluations during training (of two equally frequent strides, the finer one), or
    /// `wanted` if there was no evaluation.
    pub fn usual_stride(&self, wanted: usize) -> usize {
        let times = |stride: usize| self.covered.iter().filter(|other| **other == stride).count();
        let usual = self.covered.iter().copied().max_by_key(|&stride| (times(stride), Reverse(stride)));
        usual.unwrap_or(wanted)
    }

    /// Returns the predicted seconds per pixel.
    pub fn pixel(&self) -> f64 {
        match self.measured {
            Some([pixel, ray]) if ray > 0.0 => pixel * self.ray / ray,
            Some([pixel, _]) => pixel,
            None => FORWARD * self.ray,
        }
    }

    /// Returns the factor, from 1 to `coarsest`, by which a view of `pixels` pixels must be reduced to be rendered
    /// within `allowed` seconds.
    pub fn finest(&self, pixels: f64, allowed: f64, coarsest: u32) -> u32 {
        let (mut finest, mut seconds) = (1, self.pixel() * pixels);
        while seconds > allowed && finest < coarsest {
            (finest, seconds) = (2 * finest, 0.25 * seconds);
        }
        finest
    }

    /// Returns the seconds for the next evaluation during a run of `total` seconds of training: an equal part of the
    /// time for evaluations during training, plus the time that earlier evaluations left unused.
    pub fn on_the_way(&mut self, total: f64) -> f64 {
        self.passed += 1.0;
        self.bounded(ON_THE_WAY * self.fraction * total * self.passed / self.points - self.spent)
    }

    /// Returns the seconds for the final evaluation.
    pub fn at_the_end(&self, total: f64) -> f64 {
        self.bounded((1.0 - ON_THE_WAY) * self.fraction * total + AT_THE_END)
    }

    /// Returns the predicted seconds of the remaining evaluations in a run of `total` seconds. `pixels` is the number
    /// of pixels of all test views together, and an evaluation during training covers the fraction `part` of them.
    pub fn left(&self, total: f64, pixels: f64, part: f64) -> f64 {
        let whole = self.pixel() * pixels;
        let each = (part * whole).min(self.bounded(ON_THE_WAY * self.fraction * total / self.points));
        // The last point is part of the final evaluation.
        each * (self.points - 1.0 - self.passed).max(0.0) + whole.min(self.at_the_end(total))
    }

    fn bounded(&self, seconds: f64) -> f64 {
        if self.fraction > 0.0 { seconds } else { f64::INFINITY }
    }
}

/// Returns strides over `frames` views, from a stride with few views down to `wanted`. Each stride is a multiple of the
/// next, so an evaluation that has to end early has measured evenly spread views. If `curve` is a multiple of `wanted`,
/// `curve` is one of the strides.
pub fn strides(frames: usize, curve: usize, wanted: usize) -> Vec<usize> {
    let mut chain = vec![wanted.max(1)];
    let mut last = wanted.max(1);
    if curve.is_multiple_of(last) {
        // Largest factors first, because the chain is reversed below: after the views of the curve, the final
        // evaluation then starts by adding only a few views.
        let mut rest = curve / last;
        for factor in (2..=rest).rev() {
            while rest.is_multiple_of(factor) && is_prime(factor) {
                rest /= factor;
                last *= factor;
                chain.push(last);
            }
        }
    }
    while last < frames {
        last *= 2;
        chain.push(last);
    }
    chain.reverse();
    chain
}

fn is_prime(number: usize) -> bool {
    number > 1 && (2..).take_while(|divisor| divisor * divisor <= number).all(|d| !number.is_multiple_of(d))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_stride_is_a_multiple_of_the_next() {
        assert_eq!(strides(200, 50, 1), [200, 100, 50, 25, 5, 1]);
        assert_eq!(strides(7, 1, 1), [8, 4, 2, 1]);
        assert_eq!(strides(12, 3, 2), [16, 8, 4, 2], "the curve's own views are not among them");
        assert_eq!(strides(1, 25, 25), [25]);
        for (frames, curve, wanted) in [(1, 1, 1), (30, 7, 3), (1000, 125, 1), (0, 1, 1), (3000, 720, 2)] {
            let chain = strides(frames, curve, wanted);
            assert!(chain.windows(2).all(|pair| pair[0].is_multiple_of(pair[1]) && pair[0] > pair[1]));
            assert!(chain[0] >= frames && chain.last() == Some(&wanted));
        }
    }

    #[test]
    fn evaluations_stay_within_their_share() {
        let mut keeper = Timekeeper::new(0.25, 6);
        let (total, mut sum) = (300.0, 0.0);
        for _ in 0..6 {
            let allowed = keeper.on_the_way(total);
            keeper.spend(allowed);
            sum += allowed;
        }
        assert!((sum - 0.6 * 0.25 * total).abs() < 1e-9);
        assert!(sum + keeper.at_the_end(total) <= 0.25 * total + AT_THE_END + 1e-9);
        // The next evaluation may use the time that this one left.
        let mut keeper = Timekeeper::new(0.25, 6);
        keeper.on_the_way(total);
        assert!((keeper.on_the_way(total) - 15.0).abs() < 1e-9);
        assert!(Timekeeper::new(0.0, 6).at_the_end(total).is_infinite());
    }

    #[test]
    fn a_view_that_was_too_slow_is_reduced() {
        let mut keeper = Timekeeper::new(0.25, 6);
        keeper.rendered(10.0, 1e6);
        assert_eq!([10.0, 9.9, 2.5, 2.4, 0.0].map(|allowed| keeper.finest(1e6, allowed, 8)), [1, 2, 2, 4, 8]);
        // A view that ran out of time at one factor is tried again at a larger one.
        for factor in [1_u32, 2, 4] {
            keeper.rendered(10.0, 1e6 / f64::from(factor * factor));
            assert_eq!(keeper.finest(1e6, 9.0, 8), 2 * factor);
        }
    }

    #[test]
    fn the_usual_stride_is_that_of_most_evaluations() {
        let mut keeper = Timekeeper::new(0.25, 6);
        assert_eq!(keeper.usual_stride(5), 5);
        [12, 6, 6, 3, 3].into_iter().for_each(|stride| keeper.covered(stride));
        assert_eq!(keeper.usual_stride(5), 3);
        keeper.covered(6);
        assert_eq!(keeper.usual_stride(5), 6);
    }

    #[test]
    fn a_pixel_follows_the_training_rays() {
        let mut keeper = Timekeeper::new(0.25, 6);
        keeper.trained(2.0, 1000);
        assert_eq!(keeper.pixel(), FORWARD * 2e-3);
        keeper.rendered(3.0, 1000.0);
        assert_eq!(keeper.pixel(), 3e-3);
        // When fog clears, training rays and rendered pixels both become cheaper.
        keeper.trained(1.0, 1000);
        assert!((keeper.pixel() - 1.5e-3).abs() < 1e-12);
    }
}
