//! An encoder of coordinates: the features of a sample are the coordinates of its centre in the unit cube, mapped to a range. The encoder
//! has no parameters.

use super::definition::{Definition, Reference, SamplePosition};
use crate::math::scalar::Real;
use crate::{Config, Slot};

/// The coordinate encoder.
pub struct Dummy;

/// Number of features.
pub const WIDTH: usize = 3;

/// The linear map from a coordinate to a feature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range<R> {
    /// The feature of coordinate 0.
    pub lower: R,
    /// The feature of coordinate 1.
    pub upper: R,
}

impl<R: Real> Range<R> {
    /// Returns the range of a configuration.
    pub fn new(config: &Config) -> Self {
        let [lower, upper] = [config.dummy.lower, config.dummy.upper].map(|end| R::from_f64(end.into()));
        Self { lower, upper }
    }

    /// Returns the features of a position in the unit cube.
    #[inline(always)]
    pub fn map(&self, position: [R; 3]) -> [R; WIDTH] {
        position.map(|x| self.lower + (self.upper - self.lower) * x)
    }
}

impl Definition for Dummy {
    fn describe(&self, config: &Config) -> String {
        let Range { lower, upper } = Range::<f64>::new(config);
        format!("coordinates from {lower} to {upper}, without parameters")
    }

    fn width(&self, _: &Config) -> usize {
        WIDTH
    }

    fn slots(&self, _: &Config) -> Vec<Slot> {
        Vec::new()
    }

    fn reference(&self, config: &Config, _: Vec<Vec<f64>>) -> Box<dyn Reference> {
        Box::new(Range::<f64>::new(config))
    }
}

impl Reference for Range<f64> {
    fn features(&self, at: &SamplePosition) -> Vec<f64> {
        self.map(at.position).to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_of_the_cube_are_the_ends_of_the_range() {
        let range = Range { lower: -0.5, upper: 2.0 };
        assert_eq!(range.map([0.0, 0.5, 1.0]), [-0.5, 0.75, 2.0]);
    }
}
