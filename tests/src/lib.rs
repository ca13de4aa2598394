//! What the tests across crates share: the whole model written literally in f64 ([`reference`]), small problems with a
//! purpose ([`fixtures`]), and the truths that every backend must satisfy ([`suite`]).

pub mod fixtures;
pub mod reference;
pub mod suite;
