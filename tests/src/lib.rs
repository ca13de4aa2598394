//! Shared parts of the tests across crates: the whole model in f64 ([`mod@reference`]), small test problems ([`fixtures`]), the program
//! under test ([`binary`]), its pages ([`pages`]), the tests that every backend must pass ([`suite`]), the checks that every file reader
//! must pass for arbitrary bytes ([`formats`]), zip archives of any kind ([`zip`]), and the lists of ARCHITECTURE.md ([`lists`]).

#![deny(unsafe_code)]

pub mod binary;
pub mod files;
pub mod fixtures;
pub mod formats;
#[cfg(feature = "wgpu")]
pub mod gpu;
pub mod lists;
pub mod outside;
pub mod pages;
pub mod ranks;
pub mod reference;
pub mod suite;
pub mod watching;
pub mod whole;
#[allow(missing_docs)]
#[path = "../../trimip-data/tests/common/zip.rs"]
pub mod zip;
