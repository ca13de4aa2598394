//! Measures the peak rates of a device: bytes copied and multiply-adds per second. They relate the speed of a stage
//! to the capability of the device.

use super::bind::Size;
use super::buffer::Buffer;
use super::device::Gpu;
use super::kernel::Access::{Parameters, Write};
use super::kernel::{GROUP, Kernel};
use super::source::Source;
use std::sync::Arc;
use web_time::{Duration, Instant};

/// Measured peak rates of a device.
#[derive(Clone, Copy, Debug)]
pub struct Ceilings {
    /// Bytes per second that copies read and write.
    pub bytes: f64,
    /// f32 operations per second; a multiply-add counts as two.
    pub operations: f64,
}

shared! {
    /// Parameters of the kernel of multiply-adds.
    struct Peak as Params {
        rounds: u32,
    }
}

/// Returns the kernel of multiply-adds without memory accesses.
pub fn peak() -> Kernel {
    let sources = [Source::of::<Peak>(), Source::Text(include_str!("shaders/peak.wgsl"))];
    Kernel::new("peak", &sources, &[(0, Write), (1, Parameters)])
}

/// Number of operations per invocation and round of `peak.wgsl`.
const OPERATIONS: f64 = 8.0 * 4.0 * 2.0;

/// Minimum duration of a measurement.
const LEAST: Duration = Duration::from_millis(100);

impl Ceilings {
    /// Measures a device, in a few tenths of a second.
    pub(crate) fn measure(gpu: &Arc<Gpu>) -> Self {
        let mark: Buffer<u32> = Buffer::zeros(gpu, 1);
        let wait = || drop(mark.read());
        // Doubles the work until it takes long enough. The rate is that of the last run, which is the longest.
        let rate = |work: &dyn Fn(u64) -> f64| {
            let mut times = 1_u64;
            loop {
                wait();
                let start = Instant::now();
                let done = work(times);
                wait();
                let time = start.elapsed();
                if time >= LEAST || times >= 1 << 20 {
                    return done / time.as_secs_f64();
                }
                times *= 2;
            }
        };
        let bytes = (gpu.limits().max_buffer_size / 4).min(256 << 20) / 4 * 4;
        let [from, to] = [0, 1].map(|_| Buffer::<u32>::zeros(gpu, bytes as usize / 4));
        let copies = |times: u64| {
            (0..times).for_each(|_| gpu.copy(from.raw(), 0, to.raw(), 0, bytes));
            2.0 * bytes as f64 * times as f64
        };
        let results = Buffer::<[f32; 4]>::zeros(gpu, 1 << 16);
        let pipeline = gpu.pipeline(peak());
        let (rounds, invocations) = (256_u32, u64::from(GROUP) << 8);
        let sums = |times: u64| {
            let items = invocations * times;
            let size = Size::Items(items.min(u64::from(u32::MAX)));
            gpu.dispatch(&pipeline, &[results.bind()], &Peak { rounds }, size);
            OPERATIONS * f64::from(rounds) * items as f64
        };
        Self { bytes: rate(&copies), operations: rate(&sums) }
    }
}
