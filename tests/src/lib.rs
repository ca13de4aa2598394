//! Shared parts of the tests across crates: the whole model in f64 ([`mod@reference`]), small test problems
//! ([`fixtures`]), the program under test ([`binary`]), and the tests that every backend must pass ([`suite`]).

pub mod binary;
pub mod files;
pub mod fixtures;
pub mod gpu;
pub mod reference;
pub mod suite;
pub mod whole;
