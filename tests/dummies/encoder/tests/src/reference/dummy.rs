//! Reference of the coordinate encoder, written from its equation: lower·(1 − x) + upper·x.

use super::{Literal, Sample};
use trimip_core::Config;

/// The coordinate encoder.
pub struct Dummy(Config);

impl Dummy {
    /// Creates the encoder of a configuration.
    pub fn new(config: &Config) -> Self {
        Self(config.clone())
    }
}

impl Literal for Dummy {
    fn features(&self, sample: &Sample) -> Vec<f64> {
        let [lower, upper] = [self.0.dummy.lower, self.0.dummy.upper].map(f64::from);
        sample.position.iter().map(|x| lower * (1.0 - x) + upper * x).collect()
    }
}
