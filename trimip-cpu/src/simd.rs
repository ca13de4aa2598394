//! Sixteen f32 lanes as AVX-512, AVX2 or plain Rust, chosen at run time. A [`Kernel`] is written once over [`Lanes`];
//! [`Simd::run`] compiles it for each instruction set. The sets differ in rounding alone (fused or not).

/// An instruction set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Simd {
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

    /// All sets of this processor, widest first.
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut)]
        let mut sets = vec![];
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            if avx2 && is_x86_feature_detected!("avx512f") {
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
            Self::Avx512 => {
                debug_assert!(is_x86_feature_detected!("avx512f"));
                // SAFETY: `Simd::available` offers the set only where the processor has it.
                unsafe { x86::run_avx512(kernel) }
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => {
                debug_assert!(is_x86_feature_detected!("avx2"));
                // SAFETY: as above.
                unsafe { x86::run_avx2(kernel) }
            }
            #[allow(unreachable_patterns)]
            _ => kernel.run::<Plain>(),
        }
    }
}

/// A computation written over lanes. `run` and all it calls must be `#[inline(always)]`: only then is it compiled with
/// the instruction set's features.
pub trait Kernel {
    /// What it returns.
    type Output;
    /// Computes.
    fn run<L: Lanes>(self) -> Self::Output;
}

/// Sixteen f32.
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
    /// Asks for the cache line at `from`, which need not be valid.
    fn fetch(from: *const f32);
    /// Sum.
    fn add(self, other: Self) -> Self;
    /// Sum of all lanes.
    fn sum(self) -> f32;
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
    fn fetch(_: *const f32) {}
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
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{Kernel, Lanes};
    use std::arch::x86_64::*;

    #[target_feature(enable = "avx512f,avx2,fma")]
    pub unsafe fn run_avx512<K: Kernel>(kernel: K) -> K::Output {
        kernel.run::<Zmm>()
    }

    #[target_feature(enable = "avx2,fma")]
    pub unsafe fn run_avx2<K: Kernel>(kernel: K) -> K::Output {
        kernel.run::<Ymm2>()
    }

    /// One AVX-512 register.
    #[derive(Clone, Copy)]
    pub struct Zmm(__m512);

    // SAFETY of all intrinsics below: reached only through `run_avx512`, whose caller checked the processor.
    #[allow(clippy::undocumented_unsafe_blocks)]
    impl Lanes for Zmm {
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
        fn fetch(from: *const f32) {
            unsafe { _mm_prefetch::<_MM_HINT_T0>(from.cast()) };
        }
        #[inline(always)]
        fn add(self, other: Self) -> Self {
            Self(unsafe { _mm512_add_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn sum(self) -> f32 {
            unsafe { _mm512_reduce_add_ps(self.0) }
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
        fn fetch(from: *const f32) {
            unsafe { _mm_prefetch::<_MM_HINT_T0>(from.cast()) };
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
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
