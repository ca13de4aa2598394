//! Tests every instruction set against literal roundings and sums.

use super::*;

/// Pairs of 32 values, and dot products of these pairs.
struct Pairs([f32; 32]);

impl Kernel for Pairs {
    type Output = [[f32; 16]; 3];
    #[inline(always)]
    fn run<L: Lanes>(self) -> Self::Output {
        let halves = self.0.as_chunks().0;
        let (x, y) = (L::of(&halves[0]), L::of(&halves[1]));
        let pairs = x.pair(y);
        [pairs.array(), x.pair_neighbours(y).array(), pairs.dot_add(pairs, L::splat(0.5)).array()]
    }
}

#[test]
fn pairs_are_the_nearest_bf16_and_their_dot_products() {
    let nearest = |x: f32| f32::from_bits(u32::from(bf16(x)) << 16);
    // Literal roundings: an exact value, ties that round down and up to even, rounding up; then values beyond the range
    // of bf16.
    assert_eq!(
        [1.0, 1.0 + 1.0 / 256.0, 1.0 + 3.0 / 256.0, 1.005].map(nearest),
        [1.0, 1.0, 1.0 + 4.0 / 256.0, 1.0 + 1.0 / 128.0]
    );
    assert_eq!([f32::MAX, -f32::INFINITY, 1e-40].map(nearest), [f32::INFINITY, -f32::INFINITY, 0.0]);
    assert!(nearest(f32::NAN).is_nan() && nearest(f32::from_bits(0x7f80_0001)).is_nan());

    let mut values: [f32; 32] = std::array::from_fn(|i| (i as f32 * 0.7).sin() * 10f32.powi(i as i32 - 16));
    (values[3], values[20]) = (-1e-41, 0.0);
    for set in Simd::available() {
        let [apart, neighbours, dots] = set.run(Pairs(values));
        for i in 0..16 {
            let (a, b) = (values[i], values[16 + i]);
            assert_eq!(apart[i].to_bits(), pair(a, b).to_bits(), "{set:?} {i}");
            assert_eq!(
                neighbours[i].to_bits(),
                pair(values[2 * i], values[2 * i + 1]).to_bits(),
                "{set:?} {i}"
            );
            let [a, b] = [a, b].map(|x| f64::from(nearest(x)));
            let expected = a * a + b * b + 0.5;
            assert!(
                (f64::from(dots[i]) - expected).abs() <= 2e-7 * expected,
                "{set:?} {i}: {} {expected}",
                dots[i]
            );
        }
    }
}

struct Check;

impl Kernel for Check {
    type Output = [[f32; 16]; 5];
    #[inline(always)]
    fn run<L: Lanes>(self) -> Self::Output {
        let x: [f32; 16] = std::array::from_fn(|i| i as f32 - 7.5);
        let mask: [f32; 16] = std::array::from_fn(|i| if i % 3 == 0 { 1.0 } else { -0.0 });
        let mut out = [[0.0; 16]; 5];
        let (x, mask) = (L::of(&x), L::of(&mask));
        x.mul_add(L::splat(2.0), L::splat(0.25)).put(&mut out[0]);
        x.relu().put(&mut out[1]);
        x.where_positive(mask).put(&mut out[2]);
        x.add(x).put(&mut out[3]);
        out[4] = [x.sum(); 16];
        out
    }
}

#[test]
fn every_set_computes_the_same() {
    for set in [Simd::Amx, Simd::Avx512Bf16, Simd::Avx512, Simd::Avx2, Simd::Neon] {
        if !Simd::available().contains(&set) {
            println!("skipped: this processor does not have {set:?}");
        }
    }
    for set in Simd::available() {
        let out = set.run(Check);
        for i in 0..16 {
            let x = i as f32 - 7.5;
            let expected = [2.0 * x + 0.25, x.max(0.0), if i % 3 == 0 { x } else { 0.0 }, 2.0 * x, 0.0];
            assert_eq!(out.map(|row| row[i]), expected, "{set:?}");
        }
    }
}
