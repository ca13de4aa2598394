//! Refusal of settings: errors that name the place where a setting was set, and what is expected.

use crate::{Advice, Error, Place, Result};

/// Refuses settings by their dotted path.
pub struct Checker<'a> {
    place: &'a dyn Fn(&str) -> Place,
    given: &'a dyn Fn(&str) -> bool,
}

impl<'a> Checker<'a> {
    /// Creates a checker. `place` returns the place where the value of a dotted path was set; `given` is false for settings
    /// that have their defaults.
    pub fn new(place: &'a dyn Fn(&str) -> Place, given: &'a dyn Fn(&str) -> bool) -> Self {
        Self { place, given }
    }

    /// Returns the place where the value of a dotted path was set.
    pub fn place(&self, path: &str) -> Place {
        (self.place)(path)
    }

    /// Returns false if a setting has its default.
    pub fn given(&self, path: &str) -> bool {
        (self.given)(path)
    }

    /// Refuses the setting `path` unless `ok`.
    ///
    /// # Errors
    /// The error is of kind `Input` and names the place and the expected value.
    pub fn check(&self, ok: bool, path: &str, expected: &str) -> Result<()> {
        match ok {
            true => Ok(()),
            false => Err(Error::input((self.place)(path), "out of range", Advice::Expected(expected.into()))),
        }
    }

    /// Refuses settings that do not fit together, unless `ok`. The error names the first setting of `paths` that was given.
    ///
    /// # Errors
    /// Fails for the reasons of [`check`](Self::check).
    pub fn together(&self, ok: bool, paths: &[&str], expected: &str) -> Result<()> {
        let given = paths.iter().find(|path| (self.given)(path)).or(paths.first());
        self.check(ok, given.unwrap_or(&""), expected)
    }
}
