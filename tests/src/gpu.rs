//! GPU adapters for the tests. On a machine without an adapter, tests print a message and are skipped. If `TRIMIP_REQUIRE_GPU` is
//! set, they fail instead.

use std::sync::Mutex;
use trimip_core::Result;
use trimip_wgpu::{Addition, WgpuBackend};

/// All methods of adding texel gradients.
pub const ADDITIONS: [Addition; 3] = [Addition::Fixed, Addition::Atomic, Addition::Exchange];

/// Number of backends that share a device.
const SHARE: usize = 16;

/// Runs `part` on the best adapter with each of the `additions` that it supports.
///
/// Several backends share a device and its compiled kernels, because Mesa's software driver never frees the code of a kernel: a
/// process that compiles tens of thousands of kernels runs out of memory mappings. The driver also keeps some memory of every
/// dispatch until the device is dropped, so a limited number of backends share each device.
///
/// # Panics
/// If `part` fails, or if an adapter is required and the machine has none.
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
                let shared = Mutex::new((backend, 0));
                let make = || {
                    let mut shared = shared.lock().expect("no maker failed");
                    let (backend, served) = &mut *shared;
                    if *served == SHARE {
                        *backend = open().expect("it opened before");
                        *served = 0;
                    }
                    *served += 1;
                    backend.on_the_same_device()
                };
                part(&make).expect("a small configuration is accepted");
            }
        }
    }
}

/// Runs `part`, which needs bitwise reproducible results, with fixed-point additions.
pub fn reproducibly(part: impl Fn(&(dyn Fn() -> WgpuBackend + Sync)) -> Result<()>) {
    with(&[Addition::Fixed], part);
}
