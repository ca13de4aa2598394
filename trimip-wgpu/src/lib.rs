//! The stages of Tri-MipRF on any GPU through wgpu: the place where they will live, behind the traits of
//! [`trimip_core::backend`]. This build has none yet, and says so to whoever asks.

use trimip_core::Error;

/// Why there is no wgpu backend, in one line: what is missing and what to do.
pub fn missing() -> Error {
    Error::input("backend = \"wgpu\"", "this build has no wgpu backend yet", "use backend = \"cpu\"")
}
