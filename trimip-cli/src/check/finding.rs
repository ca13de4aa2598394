//! The result of a case, the error measures of the cases, and the types of their arguments.

use trimip::Result;

/// Result of a case.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// Part of the catalogue.
    pub part: &'static str,
    /// Name of the case.
    pub case: String,
    /// The law that must hold.
    pub law: &'static str,
    /// The largest error found.
    pub worst: f64,
    /// The tolerance.
    pub bound: f64,
}

impl Finding {
    /// Returns true if the law holds; NaN violates every law.
    pub fn holds(&self) -> bool {
        self.worst <= self.bound
    }
}

/// Returns the largest of the errors; NaN if one of them is NaN.
pub fn worst(errors: impl IntoIterator<Item = f64>) -> f64 {
    errors.into_iter().fold(0.0, |most, error| if error.is_nan() || error > most { error } else { most })
}

/// Returns |found − expected|.
pub fn apart(found: impl Into<f64>, expected: f64) -> f64 {
    (found.into() - expected).abs()
}

/// Returns |found − expected| / |expected|.
pub fn relative(found: impl Into<f64>, expected: f64) -> f64 {
    let found = found.into();
    if found == expected { 0.0 } else { (found - expected).abs() / expected.abs() }
}

/// Returns the number of values that are not finite.
pub fn not_finite<'a>(values: impl IntoIterator<Item = &'a f32>) -> f64 {
    values.into_iter().filter(|value| !value.is_finite()).count() as f64
}

/// Function that creates a fresh backend for a case.
pub type Make<'a, B> = &'a dyn Fn() -> Result<B>;

/// Function that receives every finding as soon as it is made.
pub type Tell<'a> = &'a mut dyn FnMut(Finding);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_law_is_broken_by_too_much_and_by_what_is_no_number() {
        let finding = |worst| Finding { part: "", case: String::new(), law: "", worst, bound: 1.0 };
        assert!(finding(0.0).holds() && finding(1.0).holds());
        assert!(!finding(1.1).holds() && !finding(f64::NAN).holds() && !finding(f64::INFINITY).holds());
        assert!(worst([0.1, f64::NAN, 0.3]).is_nan() && worst([0.1, 0.3, 0.2]) == 0.3);
        assert!(relative(f32::NAN, 1.0).is_nan() && relative(0.0_f32, 0.0) == 0.0);
    }
}
