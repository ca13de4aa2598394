//! Loss terms of other crates: a section of settings adds terms that are made from its values.

use super::{Definition, PIXEL_TERMS, PixelTerm, RAY_TERMS, RayTerm};
use crate::{Addition, Config, Result, Section};
use std::ops::Deref;
use std::sync::Arc;

/// A loss term of another crate.
#[derive(Clone)]
#[non_exhaustive]
pub enum Term {
    /// A term of a pixel.
    Pixel(Arc<dyn PixelTerm>),
    /// A term of the samples of a ray.
    Ray(Arc<dyn RayTerm>),
}

impl Term {
    /// Returns the declaration of the term.
    pub fn definition(&self) -> &dyn Definition {
        match self {
            Self::Pixel(term) => term.as_ref(),
            Self::Ray(term) => term.as_ref(),
        }
    }
}

/// A section of settings whose crate adds terms to the loss: it implements this trait, and its
/// [`Section::ADDITION`] is `Some(losses::addition::<Self>())`. The CPU backend computes the terms; the wgpu backend refuses
/// terms whose weight is not 0, because they have no WGSL.
pub trait LossSection: Section {
    /// Returns the terms for these settings, in the order in which they are added up. A term takes its weight and its
    /// numbers from the section; it may ignore the [`LossConfig`](crate::config::LossConfig) that it receives.
    fn terms(&self) -> Vec<Term>;
}

/// Function that makes the terms of a section.
type TermsOf = fn(&Config) -> Result<Vec<Term>>;

/// Returns the addition of a section that adds loss terms.
pub const fn addition<S: LossSection>() -> Addition {
    Addition(&const { terms_of::<S> as TermsOf })
}

fn terms_of<S: LossSection>(config: &Config) -> Result<Vec<Term>> {
    Ok(config.section::<S>()?.terms())
}

/// Returns the terms that sections of other crates add to the loss, in the order of the sections.
///
/// # Errors
/// Fails for the reasons of [`Config::section`].
pub fn others(config: &Config) -> Result<Vec<Term>> {
    let mut terms = Vec::new();
    for section in config.registered_sections() {
        if let Some(of) = section.addition.and_then(|addition| addition.0.downcast_ref::<TermsOf>()) {
            terms.extend(of(config)?);
        }
    }
    Ok(terms)
}

/// A term of this crate's lists, or of another crate.
pub enum Held<T: ?Sized + 'static> {
    /// A member of a list of this crate.
    Listed(&'static T),
    /// A term of another crate.
    Other(Arc<T>),
}

impl<T: ?Sized> Clone for Held<T> {
    fn clone(&self) -> Self {
        match self {
            Self::Listed(term) => Self::Listed(term),
            Self::Other(term) => Self::Other(Arc::clone(term)),
        }
    }
}

impl<T: ?Sized> Deref for Held<T> {
    type Target = T;

    fn deref(&self) -> &T {
        match self {
            Self::Listed(term) => term,
            Self::Other(term) => term,
        }
    }
}

/// All terms that the loss of a configuration may have in addition to the photometric term, enabled or not.
pub struct Terms {
    /// The terms of pixels: those of [`PIXEL_TERMS`], then those of other crates.
    pub pixel: Vec<Held<dyn PixelTerm>>,
    /// The terms of rays: those of [`RAY_TERMS`], then those of other crates.
    pub ray: Vec<Held<dyn RayTerm>>,
}

impl Terms {
    /// Returns the terms for `config`.
    ///
    /// # Errors
    /// Fails for the reasons of [`others`].
    pub fn of(config: &Config) -> Result<Self> {
        let mut terms = Self {
            pixel: PIXEL_TERMS.iter().map(|&term| Held::Listed(term)).collect(),
            ray: RAY_TERMS.iter().map(|&term| Held::Listed(term)).collect(),
        };
        for other in others(config)? {
            match other {
                Term::Pixel(term) => terms.pixel.push(Held::Other(term)),
                Term::Ray(term) => terms.ray.push(Held::Other(term)),
            }
        }
        Ok(terms)
    }
}
