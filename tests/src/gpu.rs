//! Adapters for the tests. On a machine without one, tests are skipped with a message. If `TRIMIP_REQUIRE_GPU` is set,
//! they fail instead.

use trimip_core::Result;
use trimip_wgpu::{Addition, WgpuBackend};

/// All methods of adding texel gradients.
pub const ADDITIONS: [Addition; 3] = [Addition::Fixed, Addition::Atomic, Addition::Exchange];

/// Runs `part` on the best adapter with each of the `additions` that it supports.
///
/// # Panics
/// If `part` fails, or if an adapter is required and there is none.
pub fn with(additions: &[Addition], part: impl Fn(&(dyn Fn() -> WgpuBackend + Sync)) -> Result<()>) {
    if trimip_wgpu::adapters().is_empty() {
        assert!(
            std::env::var_os("TRIMIP_REQUIRE_GPU").is_none(),
            "a GPU is required and there is no adapter"
        );
        println!("skipped: this machine has no adapter for wgpu");
        return;
    }
    for &addition in additions {
        let open = || WgpuBackend::adding("", addition).expect("the adapter opens");
        match open() {
            None => println!("skipped: this adapter has no {addition:?} additions"),
            Some(backend) => {
                println!("{}, {addition:?} additions", backend.adapter());
                part(&|| open().expect("it did before")).expect("a small configuration is accepted");
            }
        }
    }
}

/// Runs a test that needs bitwise reproducible results.
pub fn reproducibly(part: impl Fn(&(dyn Fn() -> WgpuBackend + Sync)) -> Result<()>) {
    with(&[Addition::Fixed], part);
}
