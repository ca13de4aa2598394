//! Sixteen f32 lanes as AVX-512, AVX2 or plain Rust, chosen at run time. A [`Kernel`] is written once over [`Lanes`];
//! [`Simd::run`] compiles it for each instruction set. The sets differ in rounding alone (fused or not).

/// An instruction set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Simd {
    /// x86-64 with AVX-512F, BW and BF16: one register, and dot products of bf16 pairs at twice the rate.
    Avx512Bf16,
    /// x86-64 with AVX-512F: one register.
    Avx512,
    /// x86-64 with AVX2 and FMA: two registers.
    Avx2,
    /// Any processor.
    Portable,
}

impl Simd {
    /// The widest set of this processor.
    pub fn detect() -> Self {
        Self::available()[0]
    }

    /// True where products of bf16 have instructions of their own, and are faster than those of f32.
    pub fn has_bf16(self) -> bool {
        self == Self::Avx512Bf16
    }

    /// All sets of this processor, widest first.
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut)]
        let mut sets = vec![];
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            let avx512 = avx2 && is_x86_feature_detected!("avx512f");
            if avx512 && is_x86_feature_detected!("avx512bw") && is_x86_feature_detected!("avx512bf16") {
                sets.push(Self::Avx512Bf16);
            }
            if avx512 {
                sets.push(Self::Avx512);
            }
            if avx2 {
                sets.push(Self::Avx2);
            }
        }
        sets.push(Self::Portable);
        sets
    }

    /// Runs a kernel with this set.
    ///
    /// # Panics
    /// When the processor lacks the set.
    #[inline]
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Avx512Bf16 => {
                assert!(is_x86_feature_detected!("avx512bf16"));
                // SAFETY: the processor has the set, or the line above has panicked.
                unsafe { x86::run_avx512_bf16(kernel) }
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                assert!(is_x86_feature_detected!("avx512f"));
                // SAFETY: as above.
                unsafe { x86::run_avx512(kernel) }
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => {
                assert!(is_x86_feature_detected!("avx2"));
                // SAFETY: as above.
                unsafe { x86::run_avx2(kernel) }
            }
            #[allow(unreachable_patterns)]
            _ => kernel.run::<Plain>(),
        }
    }
}

/// Asks for the cache line at `from`, which need not be valid.
#[inline(always)]
pub fn fetch<T>(from: *const T) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch reads nothing; every x86-64 has it.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(from.cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = from;
}

/// A computation written over lanes. `run` and all it calls must be `#[inline(always)]`: only then is it compiled with
/// the instruction set's features.
pub trait Kernel {
    /// What it returns.
    type Output;
    /// Computes.
    fn run<L: Lanes>(self) -> Self::Output;
}

/// Sixteen f32; or sixteen words, each a pair of bf16 (the first in the low half) in the bits of an f32.
pub trait Lanes: Copy {
    /// True when 24 accumulators fit in registers.
    const WIDE: bool;
    /// All lanes alike.
    fn splat(value: f32) -> Self;
    /// Reads 16 values.
    ///
    /// # Safety
    /// `from` is valid for 16 values.
    unsafe fn load(from: *const f32) -> Self;
    /// Writes 16 values.
    ///
    /// # Safety
    /// `to` is valid for 16 values.
    unsafe fn store(self, to: *mut f32);
    /// self · factor + addend.
    fn mul_add(self, factor: Self, addend: Self) -> Self;
    /// Lanes below zero become zero.
    fn relu(self) -> Self;
    /// Lanes where `mask` is above zero; zero elsewhere.
    fn where_positive(self, mask: Self) -> Self;
    /// Sum.
    fn add(self, other: Self) -> Self;
    /// Sum of all lanes.
    fn sum(self) -> f32;
    /// The first of each pair as f32.
    fn first(self) -> Self;
    /// The second of each pair as f32.
    fn second(self) -> Self;
    /// Of words of pairs: self.0 · factor.0 + self.1 · factor.1 + addend, in f32.
    #[inline(always)]
    fn dot_add(self, factor: Self, addend: Self) -> Self {
        self.first().mul_add(factor.first(), self.second().mul_add(factor.second(), addend))
    }
    /// Words of the pairs `(self[i], second[i])`, rounded to bf16.
    #[inline(always)]
    fn pair(self, second: Self) -> Self {
        let (first, second) = (self.array(), second.array());
        let words: [f32; 16] = std::array::from_fn(|i| pair(first[i], second[i]));
        // SAFETY: 16 values.
        unsafe { Self::load(words.as_ptr()) }
    }
    /// Words of the pairs of neighbours in the 32 values of `self` and `next`, rounded to bf16.
    #[inline(always)]
    fn pair_neighbours(self, next: Self) -> Self {
        let values = [self.array(), next.array()];
        let at = |i: usize| values[i / 16][i % 16];
        let words: [f32; 16] = std::array::from_fn(|i| pair(at(2 * i), at(2 * i + 1)));
        // SAFETY: 16 values.
        unsafe { Self::load(words.as_ptr()) }
    }
    /// The 16 values.
    #[inline(always)]
    fn array(self) -> [f32; 16] {
        let mut values = [0.0; 16];
        // SAFETY: 16 values.
        unsafe { self.store(values.as_mut_ptr()) };
        values
    }
}

/// The nearest bf16, ties to even: the upper half of an f32. Values below the smallest normal f32 become zero.
#[inline(always)]
pub fn bf16(value: f32) -> u16 {
    let bits = value.to_bits();
    let rounded = (bits.wrapping_add(0x7fff + (bits >> 16 & 1)) >> 16) as u16;
    if value.is_nan() {
        (bits >> 16) as u16 | 0x40
    } else if value.abs() < f32::MIN_POSITIVE {
        rounded & 0x8000
    } else {
        rounded
    }
}

/// Two values as a word of two bf16.
#[inline(always)]
pub fn pair(first: f32, second: f32) -> f32 {
    f32::from_bits(u32::from(bf16(first)) | u32::from(bf16(second)) << 16)
}

/// Lanes in plain Rust.
#[derive(Clone, Copy)]
pub struct Plain([f32; 16]);

impl Lanes for Plain {
    const WIDE: bool = false;
    #[inline(always)]
    fn splat(value: f32) -> Self {
        Self([value; 16])
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: the caller's promise.
        Self(unsafe { from.cast::<[f32; 16]>().read_unaligned() })
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: the caller's promise.
        unsafe { to.cast::<[f32; 16]>().write_unaligned(self.0) }
    }
    #[inline(always)]
    fn mul_add(mut self, factor: Self, addend: Self) -> Self {
        for i in 0..16 {
            self.0[i] = self.0[i] * factor.0[i] + addend.0[i];
        }
        self
    }
    #[inline(always)]
    fn relu(mut self) -> Self {
        for x in &mut self.0 {
            *x = if *x > 0.0 { *x } else { 0.0 };
        }
        self
    }
    #[inline(always)]
    fn where_positive(mut self, mask: Self) -> Self {
        for i in 0..16 {
            self.0[i] = if mask.0[i] > 0.0 { self.0[i] } else { 0.0 };
        }
        self
    }
    #[inline(always)]
    fn add(mut self, other: Self) -> Self {
        for i in 0..16 {
            self.0[i] += other.0[i];
        }
        self
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        self.0.iter().sum()
    }
    #[inline(always)]
    fn first(self) -> Self {
        Self(self.0.map(|word| f32::from_bits(word.to_bits() << 16)))
    }
    #[inline(always)]
    fn second(self) -> Self {
        Self(self.0.map(|word| f32::from_bits(word.to_bits() & 0xffff_0000)))
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{Kernel, Lanes};
    use std::arch::x86_64::*;

    #[target_feature(enable = "avx512f,avx512bw,avx512bf16,avx2,fma")]
    pub unsafe fn run_avx512_bf16<K: Kernel>(kernel: K) -> K::Output {
        kernel.run::<Zmm<true>>()
    }

    #[target_feature(enable = "avx512f,avx2,fma")]
    pub unsafe fn run_avx512<K: Kernel>(kernel: K) -> K::Output {
        kernel.run::<Zmm<false>>()
    }

    #[target_feature(enable = "avx2,fma")]
    pub unsafe fn run_avx2<K: Kernel>(kernel: K) -> K::Output {
        kernel.run::<Ymm2>()
    }

    /// One AVX-512 register; with the instructions of BF16 or without.
    #[derive(Clone, Copy)]
    pub struct Zmm<const BF16: bool>(__m512);

    // SAFETY of all intrinsics below: reached only through `run_avx512` and `run_avx512_bf16`, whose caller checked the processor.
    #[allow(clippy::undocumented_unsafe_blocks)]
    impl<const BF16: bool> Lanes for Zmm<BF16> {
        const WIDE: bool = true;
        #[inline(always)]
        fn splat(value: f32) -> Self {
            Self(unsafe { _mm512_set1_ps(value) })
        }
        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self {
            Self(unsafe { _mm512_loadu_ps(from) })
        }
        #[inline(always)]
        unsafe fn store(self, to: *mut f32) {
            unsafe { _mm512_storeu_ps(to, self.0) }
        }
        #[inline(always)]
        fn mul_add(self, factor: Self, addend: Self) -> Self {
            Self(unsafe { _mm512_fmadd_ps(self.0, factor.0, addend.0) })
        }
        #[inline(always)]
        fn relu(self) -> Self {
            Self(unsafe { _mm512_max_ps(self.0, _mm512_setzero_ps()) })
        }
        #[inline(always)]
        fn where_positive(self, mask: Self) -> Self {
            unsafe {
                let positive = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(mask.0, _mm512_setzero_ps());
                Self(_mm512_maskz_mov_ps(positive, self.0))
            }
        }
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            Self(unsafe { _mm512_add_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn sum(self) -> f32 {
            unsafe { _mm512_reduce_add_ps(self.0) }
        }
        #[inline(always)]
        fn first(self) -> Self {
            unsafe { Self(_mm512_castsi512_ps(_mm512_slli_epi32::<16>(_mm512_castps_si512(self.0)))) }
        }
        #[inline(always)]
        fn second(self) -> Self {
            unsafe {
                let upper = _mm512_set1_epi32(0xffff_0000_u32 as i32);
                Self(_mm512_castsi512_ps(_mm512_and_si512(_mm512_castps_si512(self.0), upper)))
            }
        }
        #[inline(always)]
        fn dot_add(self, factor: Self, addend: Self) -> Self {
            if BF16 {
                Self(unsafe { _mm512_dpbf16_ps(addend.0, words(self.0), words(factor.0)) })
            } else {
                self.first().mul_add(factor.first(), self.second().mul_add(factor.second(), addend))
            }
        }
        #[inline(always)]
        fn pair(self, second: Self) -> Self {
            if !BF16 {
                return Self(unsafe { round(self.0, second.0) });
            }
            unsafe {
                // The lower half of the words holds `self`, the upper `second`.
                let halves: __m512i = std::mem::transmute(_mm512_cvtne2ps_pbh(second.0, self.0));
                let firsts = _mm512_cvtepu16_epi32(_mm512_castsi512_si256(halves));
                let seconds = _mm512_cvtepu16_epi32(_mm512_extracti64x4_epi64::<1>(halves));
                Self(_mm512_castsi512_ps(_mm512_or_si512(firsts, _mm512_slli_epi32::<16>(seconds))))
            }
        }
        #[inline(always)]
        fn pair_neighbours(self, next: Self) -> Self {
            unsafe {
                if BF16 {
                    return Self(std::mem::transmute::<__m512bh, __m512>(_mm512_cvtne2ps_pbh(
                        next.0, self.0,
                    )));
                }
                let lanes = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
                let even = _mm512_permutex2var_ps(self.0, lanes, next.0);
                let odd = _mm512_add_epi32(lanes, _mm512_set1_epi32(1));
                Self(round(even, _mm512_permutex2var_ps(self.0, odd, next.0)))
            }
        }
    }

    /// The same bits as pairs of bf16.
    #[inline(always)]
    unsafe fn words(bits: __m512) -> __m512bh {
        // SAFETY: both are 512 bits of anything.
        unsafe { std::mem::transmute(bits) }
    }

    /// Words of pairs without the instructions of BF16: what [`super::pair`] does.
    #[inline(always)]
    unsafe fn round(first: __m512, second: __m512) -> __m512 {
        // SAFETY: the caller runs with AVX-512F, as `Zmm` does.
        unsafe {
            let first = _mm512_srli_epi32::<16>(round_up(first));
            let second = _mm512_and_si512(round_up(second), _mm512_set1_epi32(0xffff_0000_u32 as i32));
            _mm512_castsi512_ps(_mm512_or_si512(first, second))
        }
    }

    /// Values whose upper halves are the nearest bf16: what [`super::bf16`] does.
    #[inline(always)]
    unsafe fn round_up(value: __m512) -> __m512i {
        // SAFETY: as above.
        unsafe {
            let bits = _mm512_castps_si512(value);
            let odd = _mm512_and_si512(_mm512_srli_epi32::<16>(bits), _mm512_set1_epi32(1));
            let rounded = _mm512_add_epi32(bits, _mm512_add_epi32(odd, _mm512_set1_epi32(0x7fff)));
            let quiet = _mm512_or_si512(bits, _mm512_set1_epi32(0x40_0000));
            let nan = _mm512_cmp_ps_mask::<_CMP_UNORD_Q>(value, value);
            let sign = _mm512_set1_epi32(i32::MIN);
            let size = _mm512_castsi512_ps(_mm512_andnot_si512(sign, bits));
            let normal = _mm512_cmp_ps_mask::<_CMP_NLT_UQ>(size, _mm512_set1_ps(f32::MIN_POSITIVE));
            let kept = _mm512_mask_mov_epi32(_mm512_and_si512(bits, sign), normal, rounded);
            _mm512_mask_mov_epi32(kept, nan, quiet)
        }
    }

    /// Two AVX2 registers.
    #[derive(Clone, Copy)]
    pub struct Ymm2(__m256, __m256);

    // SAFETY of all intrinsics below: reached only through `run_avx2`, whose caller checked the processor.
    #[allow(clippy::undocumented_unsafe_blocks)]
    impl Lanes for Ymm2 {
        const WIDE: bool = false;
        #[inline(always)]
        fn splat(value: f32) -> Self {
            let half = unsafe { _mm256_set1_ps(value) };
            Self(half, half)
        }
        #[inline(always)]
        unsafe fn load(from: *const f32) -> Self {
            unsafe { Self(_mm256_loadu_ps(from), _mm256_loadu_ps(from.add(8))) }
        }
        #[inline(always)]
        unsafe fn store(self, to: *mut f32) {
            unsafe {
                _mm256_storeu_ps(to, self.0);
                _mm256_storeu_ps(to.add(8), self.1);
            }
        }
        #[inline(always)]
        fn mul_add(self, factor: Self, addend: Self) -> Self {
            unsafe {
                Self(_mm256_fmadd_ps(self.0, factor.0, addend.0), _mm256_fmadd_ps(self.1, factor.1, addend.1))
            }
        }
        #[inline(always)]
        fn relu(self) -> Self {
            unsafe {
                let zero = _mm256_setzero_ps();
                Self(_mm256_max_ps(self.0, zero), _mm256_max_ps(self.1, zero))
            }
        }
        #[inline(always)]
        fn where_positive(self, mask: Self) -> Self {
            unsafe {
                let zero = _mm256_setzero_ps();
                Self(
                    _mm256_and_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(mask.0, zero), self.0),
                    _mm256_and_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(mask.1, zero), self.1),
                )
            }
        }
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            unsafe { Self(_mm256_add_ps(self.0, other.0), _mm256_add_ps(self.1, other.1)) }
        }
        #[inline(always)]
        fn sum(self) -> f32 {
            unsafe {
                let eight = _mm256_add_ps(self.0, self.1);
                let four = _mm_add_ps(_mm256_castps256_ps128(eight), _mm256_extractf128_ps::<1>(eight));
                let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
                _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps::<1>(two, two)))
            }
        }
        #[inline(always)]
        fn first(self) -> Self {
            let half = |x| unsafe { _mm256_castsi256_ps(_mm256_slli_epi32::<16>(_mm256_castps_si256(x))) };
            Self(half(self.0), half(self.1))
        }
        #[inline(always)]
        fn second(self) -> Self {
            unsafe {
                let upper = _mm256_castsi256_ps(_mm256_set1_epi32(0xffff_0000_u32 as i32));
                Self(_mm256_and_ps(self.0, upper), _mm256_and_ps(self.1, upper))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pairs of 32 values and dot products with them.
    struct Pairs([f32; 32]);

    impl Kernel for Pairs {
        type Output = [[f32; 16]; 3];
        #[inline(always)]
        fn run<L: Lanes>(self) -> Self::Output {
            // SAFETY: 16 values each.
            unsafe {
                let (x, y) = (L::load(self.0.as_ptr()), L::load(self.0[16..].as_ptr()));
                let pairs = x.pair(y);
                [pairs.array(), x.pair_neighbours(y).array(), pairs.dot_add(pairs, L::splat(0.5)).array()]
            }
        }
    }

    #[test]
    fn pairs_are_the_nearest_bf16_and_their_dot_products() {
        let nearest = |x: f32| f32::from_bits(u32::from(bf16(x)) << 16);
        // Literal roundings: exact, a tie to even below and above, up, and what has no nearest.
        assert_eq!(
            [1.0, 1.0 + 1.0 / 256.0, 1.0 + 3.0 / 256.0, 1.005].map(nearest),
            [1.0, 1.0, 1.0 + 4.0 / 256.0, 1.0 + 1.0 / 128.0]
        );
        assert_eq!([f32::MAX, -f32::INFINITY, 1e-40].map(nearest), [f32::INFINITY, -f32::INFINITY, 0.0]);
        assert!(nearest(f32::NAN).is_nan() && nearest(f32::from_bits(0x7f80_0001)).is_nan());

        let mut values: [f32; 32] =
            std::array::from_fn(|i| (i as f32 * 0.7).sin() * 10f32.powi(i as i32 - 16));
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
            // SAFETY: all arrays hold 16 values.
            unsafe {
                let (x, mask) = (L::load(x.as_ptr()), L::load(mask.as_ptr()));
                x.mul_add(L::splat(2.0), L::splat(0.25)).store(out[0].as_mut_ptr());
                x.relu().store(out[1].as_mut_ptr());
                x.where_positive(mask).store(out[2].as_mut_ptr());
                x.add(x).store(out[3].as_mut_ptr());
                out[4] = [x.sum(); 16];
            }
            out
        }
    }

    #[test]
    fn every_set_computes_the_same() {
        for set in Simd::available() {
            let out = set.run(Check);
            for i in 0..16 {
                let x = i as f32 - 7.5;
                let expected = [2.0 * x + 0.25, x.max(0.0), if i % 3 == 0 { x } else { 0.0 }, 2.0 * x, 0.0];
                assert_eq!(out.map(|row| row[i]), expected, "{set:?}");
            }
        }
    }
}
