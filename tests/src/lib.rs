//! Shared parts of the tests across crates: the whole model in f64 ([`mod@reference`]), small test problems
//! ([`fixtures`]), the program under test ([`binary`]), the tests that every backend must pass ([`suite`]), and what any bytes
//! get from every reader ([`formats`]).

#![deny(unsafe_code)]

pub mod binary;
pub mod files;
pub mod fixtures;
pub mod formats;
#[cfg(feature = "wgpu")]
pub mod gpu;
pub mod ranks;
pub mod reference;
pub mod suite;
pub mod watching;
pub mod whole;
