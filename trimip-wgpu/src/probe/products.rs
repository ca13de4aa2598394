//! Checks products of matrices, which are exact on whole numbers, and the peak rates of the device.

use super::gpu;
use crate::gpu::{Binds, Buffer, Ceilings, Rows, Size};
use crate::products::{Counter, Finish, GRADIENT_SCALE, accumulate, multiply, multiplying, tile};
use trimip_core::math::rng;

/// The first counter.
const FIRST: Counter = Counter { counter: 0 };

/// Returns small whole numbers. f16 represents them exactly, and f32 represents their products and sums exactly.
fn whole(count: usize, seed: u64) -> Vec<f32> {
    let draws = rng::Random::new(seed).at(rng::Sequence::Pixel, 0);
    (0..count as u32).map(|i| rng::below(draws.bits(i)[0], 17) as f32 - 8.0).collect()
}

/// Packs pairs of values into words of two f16; the values are whole numbers of at most 8.
fn halves(values: &[f32]) -> Vec<u32> {
    let half = |x: f32| {
        let bits = x.to_bits();
        // Keeps the sign, the exponent minus 112, and the upper 10 of 23 mantissa bits; zero stays zero.
        if x == 0.0 {
            0
        } else {
            (bits >> 16 & 0x8000) | ((bits >> 23 & 0xff) - 112) << 10 | (bits >> 13 & 0x3ff)
        }
    };
    values.chunks_exact(2).map(|pair| half(pair[0]) | half(pair[1]) << 16).collect()
}

/// Checks products and weight gradients of matrices, in f32 and, if the device has them, with cooperative matrices.
/// Both must be exact on whole numbers.
#[test]
fn products_of_matrices_are_exact_on_whole_numbers() {
    let Some(gpu) = gpu() else { return };
    let ways = [None, gpu.matrices()];
    for matrices in &ways[..1 + usize::from(gpu.matrices().is_some())] {
        for (k, n, rows) in
            [(48, 128, 100), (128, 16, 64), (16, 32, 1), (32, 48, 333), (160, 16, 70), (16, 96, 469)]
        {
            let (left, weights) = (whole(rows * k, 1), whole(k * n, 2));
            let (right, mask) = (whole(rows * n, 3), whole(rows * n, 4));
            let buffer = |values: &[f32], capacity: usize| {
                let mut buffer = Buffer::zeros(&gpu, capacity);
                buffer.write(values);
                buffer
            };
            let capacity = rows.next_multiple_of(64) * n;
            let mut packed: Buffer<u32> = Buffer::zeros(&gpu, 0);
            match matrices {
                None => packed.write(bytemuck::cast_slice(&weights)),
                Some(_) => packed.write(&halves(&weights)),
            }
            let mut counts: Buffer<u32> = Buffer::zeros(&gpu, 0);
            counts.write(&[rows as u32]);
            let overflows: Buffer<u32> = Buffer::zeros(&gpu, 1);
            let left_buffer = buffer(&left, 0);
            let exact =
                |r: usize, c: usize| (0..k).map(|i| left[r * k + i] * weights[i * n + c]).sum::<f32>();
            let exact_only = [(Finish::Add, 1), (Finish::AddRelu, 1)];
            let finishes = [(Finish::Store, 1), (Finish::Relu, 1), (Finish::Mask, 4)].into_iter();
            let finishes = finishes.chain(exact_only.into_iter().filter(|_| matrices.is_none()));
            let before: Vec<f32> = (0..rows * n).map(|at| (at % 13) as f32 - 6.0).collect();
            for (finish, scale) in finishes {
                let product = buffer(&before, capacity);
                let mask_buffer = buffer(&mask, 0);
                let mask_bind = (finish == Finish::Mask).then(|| mask_buffer.bind());
                let binds =
                    Binds::new(left_buffer.bind()).and([packed.bind(), product.bind()]).and(mask_bind);
                let binds = binds.and([counts.bind()]).and(matrices.map(|_| overflows.bind()));
                let counted = Rows { counts: counts.raw().clone(), counter: 0, capacity: rows };
                let pipeline = gpu.pipeline(multiply(k, n, finish, *matrices, scale));
                gpu.dispatch(&pipeline, &binds, &FIRST, multiplying(&counted, k, n, *matrices));
                let found = gpu.redeem(gpu.send::<f32>(product.raw(), 0, rows * n));
                for (at, found) in found.iter().enumerate() {
                    let exact = exact(at / n, at % n);
                    let expected = match finish {
                        Finish::Store => exact,
                        Finish::Relu => exact.max(0.0),
                        Finish::Add => before[at] + exact,
                        Finish::AddRelu => (before[at] + exact).max(0.0),
                        Finish::Mask => {
                            if mask[at] > 0.0 {
                                exact
                            } else {
                                0.0
                            }
                        }
                    };
                    assert_eq!(*found, expected, "{matrices:?} {finish:?} [{rows}, {k}]·[{k}, {n}] at {at}");
                }
            }
            let chunks = 4;
            let partial = buffer(&[], chunks * k * n);
            let right_buffer = buffer(&right, 0);
            let binds = Binds::new(left_buffer.bind());
            let binds = binds.and([right_buffer.bind(), partial.bind(), counts.bind()]);
            let binds = binds.and(matrices.map(|_| overflows.bind()));
            let (tiles, scale) = match matrices {
                None => ((k / (16 * tile(k) as usize)) * (n / (16 * tile(n) as usize)), 1.0),
                Some(matrices) => (matrices.tiles(k, n) as usize, GRADIENT_SCALE as f32),
            };
            let pipeline = gpu.pipeline(accumulate(k, n, chunks as u32, *matrices));
            gpu.dispatch(&pipeline, &binds, &FIRST, Size::Groups((tiles * chunks) as u64));
            let found = gpu.redeem(gpu.send::<f32>(partial.raw(), 0, chunks * k * n));
            for at in 0..k * n {
                let sum: f32 = (0..chunks).map(|chunk| found[chunk * k * n + at]).sum();
                let expected: f32 = (0..rows).map(|r| left[r * k + at / n] * right[r * n + at % n]).sum();
                assert_eq!(sum, scale * expected, "{matrices:?} [{rows}, {k}]ᵀ·[{rows}, {n}] at {at}");
            }
        }
    }
    let Some(matrices) = gpu.matrices() else { return };
    // A value that f16 cannot represent becomes the largest f16 and is counted: here two numbers and a NaN.
    let mut counts: Buffer<u32> = Buffer::zeros(&gpu, 0);
    counts.write(&[1]);
    let (mut left, mut ones): (Buffer<f32>, Buffer<u32>) = (Buffer::zeros(&gpu, 0), Buffer::zeros(&gpu, 0));
    let mut row = [1.0_f32; 16];
    (row[3], row[4], row[9]) = (1e6, -1e30, f32::NAN);
    left.write(&row);
    ones.write(&halves(&[1.0; 256]));
    let (product, overflows) = (Buffer::<f32>::zeros(&gpu, 64 * 16), Buffer::<u32>::zeros(&gpu, 1));
    let binds = [left.bind(), ones.bind(), product.bind(), counts.bind(), overflows.bind()];
    let pipeline = gpu.pipeline(multiply(16, 16, Finish::Store, Some(matrices), 1));
    gpu.dispatch(&pipeline, &binds, &FIRST, Size::Groups(1));
    assert_eq!(overflows.read(), [3]);
    gpu.check("products").expect("the kernels compile");
}

#[test]
fn ceilings_are_numbers() {
    let Some(gpu) = gpu() else { return };
    let ceilings = Ceilings::measure(&gpu);
    println!("{ceilings:?}");
    // A software driver on one slow core exceeds the lower bounds, and no device reaches the upper ones.
    assert!(
        (1e7..1e15).contains(&ceilings.bytes) && (1e7..1e17).contains(&ceilings.operations),
        "{ceilings:?}"
    );
}
