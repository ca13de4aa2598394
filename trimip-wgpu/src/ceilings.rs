//! What a device reaches at best, measured: bytes that it copies and multiply-adds that it does in a second. The speed of
//! a stage says something beside these.

use crate::buffer::Buffer;
use crate::device::{GROUP, Gpu, Size};
use crate::kernel::PEAK;
use std::sync::Arc;
use web_time::{Duration, Instant};

/// Measured ceilings of a device.
#[derive(Clone, Copy, Debug)]
pub struct Ceilings {
    /// Bytes read and written in a second by copies.
    pub bytes: f64,
    /// Floating-point operations of f32 in a second, two a multiply-add.
    pub operations: f64,
}

/// Operations of an invocation and a round of `peak.wgsl`.
const OPERATIONS: f64 = 8.0 * 4.0 * 2.0;

/// Least time of a measurement.
const LEAST: Duration = Duration::from_millis(100);

impl Ceilings {
    /// Measures a device: some tenths of a second.
    pub(crate) fn measure(gpu: &Arc<Gpu>) -> Self {
        let mark: Buffer<u32> = Buffer::zeros(gpu, 1);
        let wait = || drop(mark.read());
        // Doubles the work until it lasts long enough; the time of the last, longest one counts.
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
        let (rounds, invocations) = (256_u32, u64::from(GROUP) << 8);
        let sums = |times: u64| {
            let items = invocations * times;
            gpu.dispatch(&PEAK, &[results.bind()], &rounds, Size::Items(items.min(u64::from(u32::MAX))));
            OPERATIONS * f64::from(rounds) * items as f64
        };
        Self { bytes: rate(&copies), operations: rate(&sums) }
    }
}
