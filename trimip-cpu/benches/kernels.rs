//! Criterion benchmarks of the matrix kernels on a block of rows that stays in L2, for every instruction set and both
//! precisions, compared with the crate `matrixmultiply`. Throughput counts multiply-adds; FLOP/s is twice `elem/s`.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use trimip_core::config::Precision;
use trimip_cpu::Buffer;
use trimip_cpu::gemm::{
    Epilogue, Finish, Packed, Product, Start, accumulate, multiply, pair_columns, pair_rows,
};
use trimip_cpu::simd::{Kernel, Lanes, Simd};

const ROWS: usize = 504;

fn values(count: usize) -> Buffer<f32> {
    let mut buffer = Buffer::zeros(count);
    for (i, value) in buffer.iter_mut().enumerate() {
        *value = (i as f32 * 0.37).sin();
    }
    buffer
}

/// Multiply-adds on registers only: the processor's peak.
struct Peak<const PAIRS: bool>;

/// Number of multiply-add instructions in one run of [`Peak`].
const PEAK: usize = 24 * 1000;

impl<const PAIRS: bool> Kernel for Peak<PAIRS> {
    type Output = f32;
    #[inline(always)]
    fn run<L: Lanes>(self) -> f32 {
        let factor = L::splat(black_box(1.0));
        // Enough independent sums to hide the latency, few enough to stay in registers.
        let mut sums = [L::splat(0.0); 12];
        for _ in 0..PEAK / 12 {
            for i in 0..12 {
                sums[i] =
                    if PAIRS { factor.dot_add(factor, sums[i]) } else { factor.mul_add(factor, sums[i]) };
            }
        }
        sums.into_iter().map(L::sum).sum()
    }
}

fn peak(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("peak");
    for simd in Simd::available().into_iter().filter(|simd| *simd != Simd::Portable) {
        group.throughput(Throughput::Elements(16 * PEAK as u64));
        group.bench_function(format!("f32/{simd:?}"), |b| b.iter(|| simd.run(Peak::<false>)));
    }
    let simd = Simd::detect();
    group.throughput(Throughput::Elements(32 * PEAK as u64));
    group.bench_function(format!("bf16/{simd:?}"), |b| b.iter(|| simd.run(Peak::<true>)));
    group.finish();
}

fn kernels(criterion: &mut Criterion) {
    for (k, n) in [(48, 128), (128, 16), (32, 128), (128, 128)] {
        let (a, d, weights) = (values(ROWS * k), values(ROWS * n), values(k * n));
        let pack = |precision| {
            let mut packed = Packed::zeros(k, n, precision);
            packed.fill(|row, column| weights[row * n + column]);
            packed
        };
        let (packed, halves) = (pack(Precision::F32), pack(Precision::Bf16));
        let (mut c, mut g) = (values(ROWS * n), values(k * n));
        let mut group = criterion.benchmark_group(format!("{k} to {n}"));
        group.throughput(Throughput::Elements((ROWS * k * n) as u64));
        let epilogue = Epilogue { start: Start::Zero, finish: Finish::Relu };
        for simd in Simd::available() {
            let product = Product { simd, precision: Precision::F32, rows: ROWS, k, n };
            let half = Product { precision: Precision::Bf16, rows: ROWS / 2, ..product };
            group.bench_function(BenchmarkId::new("multiply", format!("{simd:?}")), |b| {
                b.iter(|| multiply(simd, ROWS, black_box(&a), &packed, &mut c, epilogue));
            });
            group.bench_function(BenchmarkId::new("accumulate", format!("{simd:?}")), |b| {
                b.iter(|| accumulate(product, black_box(&a), &d, &mut g));
            });
            // Rounding to bf16 is timed as part of the product.
            let mut columns = values(ROWS * k / 2);
            group.bench_function(BenchmarkId::new("multiply bf16", format!("{simd:?}")), |b| {
                b.iter(|| {
                    pair_columns(simd, black_box(&a), &mut columns);
                    multiply(simd, ROWS, &columns, &halves, &mut c, epilogue);
                });
            });
            let mut rows = [values(0), values(0)];
            group.bench_function(BenchmarkId::new("accumulate bf16", format!("{simd:?}")), |b| {
                b.iter(|| {
                    pair_rows(simd, ROWS, k, black_box(&a), &mut rows[0]);
                    pair_rows(simd, ROWS, n, &d, &mut rows[1]);
                    accumulate(half, &rows[0], &rows[1], &mut g);
                });
            });
        }
        group.bench_function("multiply/matrixmultiply", |b| {
            b.iter(|| {
                let (a, w, c) = (black_box(&a).as_ptr(), weights.as_ptr(), c.as_mut_ptr());
                // SAFETY: the matrices are [ROWS, k], [k, n] and [ROWS, n], row-major.
                unsafe {
                    matrixmultiply::sgemm(
                        ROWS, k, n, 1.0, a, k as isize, 1, w, n as isize, 1, 0.0, c, n as isize, 1,
                    );
                }
            });
        });
        group.finish();
    }
}

criterion_group!(benches, peak, kernels);
criterion_main!(benches);
