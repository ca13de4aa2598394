//! What the tests across crates share: the whole model written literally in f64 ([`mod@reference`]), small problems with a
//! purpose ([`fixtures`]), the program to run ([`binary`]), and the truths that every backend must satisfy ([`suite`]).

pub mod binary;
pub mod fixtures;
pub mod gpu;
pub mod reference;
pub mod suite;
