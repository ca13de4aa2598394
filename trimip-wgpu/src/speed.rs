//! The training speed that is expected of an adapter, for the scene plan.

use crate::gpu::choose_one_of;
use trimip_core::{Result, scene_plan::Compute};

/// Kept samples per second that are expected of a GPU in training. This is the paper's figure for an A100, not a
/// measurement of this program.
const EXPECTED: f64 = 2.2e7;

/// Kept samples per second of training on a software adapter: llvmpipe of Mesa 22.3 on two cores of an AMD EPYC
/// (AVX2), with the quickstart's model.
pub const SOFTWARE_SAMPLES_PER_SECOND: f64 = 1_000.0;

/// Number of occupancy-grid cells whose density is evaluated per second on that software adapter.
pub const SOFTWARE_CELLS_PER_SECOND: f64 = 12_000.0;

/// Returns the training speed of the adapter with this name. `index`, modulo their number, selects one of several
/// equally good adapters.
///
/// # Errors
/// When there is no such adapter.
pub fn compute(name: &str, index: usize) -> Result<Compute> {
    let info = choose_one_of(name, index)?.get_info();
    let software = info.device_type == wgpu::DeviceType::Cpu;
    Ok(Compute {
        name: info.name,
        samples_per_second: if software { SOFTWARE_SAMPLES_PER_SECOND } else { EXPECTED },
        bf16_from: None,
        wide: !software,
    })
}
