//! `check`: a catalogue of stiff and extreme cases for any backend. Each case has a law that it must satisfy.

mod finding;
mod geometry;
mod hybrid;
mod numbers;
mod optics;
mod rig;
mod training;

pub use finding::{Finding, Make, Tell};

use trimip::backends::Visitor;
use trimip::{Backend, Result};

/// Runs all cases on one backend.
pub struct Catalogue<'a> {
    /// True to include the cases that take minutes.
    pub long: bool,
    /// Receives every finding.
    pub tell: Tell<'a>,
}

impl Visitor for Catalogue<'_> {
    type Output = ();

    fn visit<B: Backend>(self, make: Make<'_, B>) -> Result<()> {
        let Self { long, tell } = self;
        optics::cases(make, tell)?;
        geometry::cases(make, tell)?;
        hybrid::cases(make, tell)?;
        training::cases(make, tell)?;
        numbers::cases(make, tell)?;
        if long { training::long(make, tell) } else { Ok(()) }
    }
}
