//! Compares every product with its defining sum in f64.

use super::*;
use crate::buffer::Buffer;
use crate::simd::Simd;
use trimip_core::config::Precision;

fn matrix(rows: usize, columns: usize, seed: f32) -> Buffer<f32> {
    let mut values = Buffer::zeros(padded(rows) * columns);
    for (i, value) in values.iter_mut().enumerate() {
        *value = ((i as f32 * 0.37 + seed).sin() * 43.7).fract();
    }
    values
}

fn close(found: f32, expected: f64, terms: usize) {
    // The products have magnitudes up to 1. Each of the `terms` additions rounds a partial sum of about |expected| +
    // √terms, and the rounding errors add up like √terms.
    let tolerance = 6e-8 * (expected.abs() + (terms as f64).sqrt()) * (terms as f64).sqrt() + 1e-7;
    assert!((f64::from(found) - expected).abs() < tolerance, "{found} {expected}");
}

const PRECISIONS: [Precision; 2] = [Precision::F32, Precision::Bf16];

/// Rounds the values to a precision.
fn hold(values: &mut [f32], precision: Precision) {
    if precision == Precision::Bf16 {
        values.iter_mut().for_each(|x| *x = f32::from_bits(u32::from(crate::simd::bf16(*x)) << 16));
    }
}

#[test]
fn products_are_the_written_sums_on_every_set() {
    for (simd, precision) in
        Simd::available().into_iter().flat_map(|set| PRECISIONS.map(|precision| (set, precision)))
    {
        for (rows, k, n) in
            [(1, 16, 16), (12, 48, 128), (37, 128, 16), (25, 32, 48), (13, 128, 128), (5, 4, 64)]
        {
            let (mut a, mut w, mask) = (matrix(rows, k, 0.0), matrix(k, n, 1.0), matrix(rows, n, 2.0));
            let mut packed = Packed::zeros(k, n, precision);
            packed.fill(|row, column| w[row * n + column]);
            let mut left = Buffer::zeros(a.len() / 2);
            match precision {
                Precision::F32 | Precision::F16 => left = matrix(rows, k, 0.0),
                Precision::Bf16 => pair_columns(simd, &a, &mut left),
            }
            hold(&mut a, precision);
            hold(&mut w, precision);
            let mut c = Buffer::zeros(padded(rows) * n);
            let of: Vec<u32> = (0..padded(rows) as u32).map(|row| row % 3).collect();
            let shared = matrix(3, n, 7.0);
            let starts = [Start::Zero, Start::Rows { rows: &shared, of: &of }];
            let finishes = [Finish::Store, Finish::Relu, Finish::Mask(&mask)];
            for (start, finish) in starts.iter().flat_map(|s| finishes.iter().map(move |f| (*s, *f))) {
                multiply(simd, rows, &left, &packed, &mut c, Epilogue { start, finish });
                for (i, &found) in c[..rows * n].iter().enumerate() {
                    let (row, column) = (i / n, i % n);
                    let product: f64 =
                        (0..k).map(|p| f64::from(a[row * k + p]) * f64::from(w[p * n + column])).sum();
                    let sum = match start {
                        Start::Zero => product,
                        Start::Rows { rows, of } => product + f64::from(rows[of[row] as usize * n + column]),
                    };
                    let expected = match finish {
                        Finish::Store => sum,
                        Finish::Relu => sum.max(0.0),
                        Finish::Mask(mask) => sum * f64::from(u8::from(mask[i] > 0.0)),
                    };
                    close(found, expected, k);
                }
            }
        }
    }
}

#[test]
fn few_outputs_are_the_written_dot_products() {
    for simd in Simd::available() {
        for (rows, k, outputs) in [(1, 16, 1), (37, 128, 3), (5, 48, 4)] {
            let (a, w) = (matrix(rows, k, 0.0), matrix(outputs, k, 1.0));
            let w = &w[..outputs * k];
            let mut c = vec![7.0; rows * 4];
            dots(simd, rows, [k, 4], &a, w, &mut c);
            for (i, &found) in c.iter().enumerate() {
                let (row, output) = (i / 4, i % 4);
                let product = |p| f64::from(a[row * k + p]) * f64::from(w[output * k + p]);
                close(found, if output < outputs { (0..k).map(product).sum() } else { 0.0 }, k);
            }
        }
    }
}

#[test]
fn gradients_add_the_written_sums_and_leave_padding_out() {
    for (simd, precision) in
        Simd::available().into_iter().flat_map(|set| PRECISIONS.map(|precision| (set, precision)))
    {
        for (rows, k, n) in
            [(1, 16, 16), (130, 48, 128), (64, 128, 16), (65, 32, 48), (70, 4, 48), (9, 12, 16)]
        {
            if precision == Precision::Bf16 && k % 16 != 0 {
                continue;
            }
            let (mut a, mut d, g) = (matrix(rows, k, 3.0), matrix(rows, n, 4.0), matrix(k, n, 5.0));
            a[rows * k..].fill(f32::NAN);
            let mut out = matrix(k, n, 5.0);
            let product = Product { simd, precision, rows, k, n };
            match precision {
                Precision::F32 | Precision::F16 => accumulate(product, &a, &d, &mut out),
                Precision::Bf16 => {
                    let (mut left, mut right) = (Buffer::default(), Buffer::default());
                    pair_rows(simd, rows, k, &a, &mut left);
                    pair_rows(simd, rows, n, &d, &mut right);
                    accumulate(Product { rows: rows.div_ceil(2), ..product }, &left, &right, &mut out);
                }
            }
            hold(&mut a[..rows * k], precision);
            hold(&mut d, precision);
            for row in 0..k {
                for column in 0..n {
                    let sum: f64 =
                        (0..rows).map(|r| f64::from(a[r * k + row]) * f64::from(d[r * n + column])).sum();
                    close(out[row * n + column], f64::from(g[row * n + column]) + sum, rows);
                }
            }
        }
    }
}
