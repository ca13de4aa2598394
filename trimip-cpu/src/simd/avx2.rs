//! Lanes of two AVX2 registers.

use super::lanes::{Kernel, Lanes};
use std::arch::x86_64::*;

#[target_feature(enable = "avx2,fma")]
pub unsafe fn run<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Ymm2>()
}

/// Two AVX2 registers.
#[derive(Clone, Copy)]
pub struct Ymm2(__m256, __m256);

// The unsafe blocks below rely on this: the instruction set is available, because `run` is the only entry point and its
// caller has checked the processor.
impl Lanes for Ymm2 {
    const WIDE: bool = false;
    #[inline(always)]
    fn splat(value: f32) -> Self {
        // SAFETY: this set is available.
        let half = unsafe { _mm256_set1_ps(value) };
        Self(half, half)
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: this set is available, and the caller has 16 values.
        unsafe { Self(_mm256_loadu_ps(from), _mm256_loadu_ps(from.add(8))) }
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: this set is available, and the caller has room for 16 values.
        unsafe {
            _mm256_storeu_ps(to, self.0);
            _mm256_storeu_ps(to.add(8), self.1);
        }
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, addend: Self) -> Self {
        // SAFETY: this set is available.
        unsafe {
            Self(_mm256_fmadd_ps(self.0, factor.0, addend.0), _mm256_fmadd_ps(self.1, factor.1, addend.1))
        }
    }
    #[inline(always)]
    fn relu(self) -> Self {
        // SAFETY: this set is available.
        unsafe {
            let zero = _mm256_setzero_ps();
            Self(_mm256_max_ps(self.0, zero), _mm256_max_ps(self.1, zero))
        }
    }
    #[inline(always)]
    fn where_positive(self, mask: Self) -> Self {
        // SAFETY: this set is available.
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
        // SAFETY: this set is available.
        unsafe { Self(_mm256_add_ps(self.0, other.0), _mm256_add_ps(self.1, other.1)) }
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        // SAFETY: this set is available.
        unsafe {
            let eight = _mm256_add_ps(self.0, self.1);
            let four = _mm_add_ps(_mm256_castps256_ps128(eight), _mm256_extractf128_ps::<1>(eight));
            let two = _mm_add_ps(four, _mm_movehl_ps(four, four));
            _mm_cvtss_f32(_mm_add_ss(two, _mm_shuffle_ps::<1>(two, two)))
        }
    }
    #[inline(always)]
    fn first(self) -> Self {
        // SAFETY: this set is available.
        let half = |x| unsafe { _mm256_castsi256_ps(_mm256_slli_epi32::<16>(_mm256_castps_si256(x))) };
        Self(half(self.0), half(self.1))
    }
    #[inline(always)]
    fn second(self) -> Self {
        // SAFETY: this set is available.
        unsafe {
            let upper = _mm256_castsi256_ps(_mm256_set1_epi32(0xffff_0000_u32 as i32));
            Self(_mm256_and_ps(self.0, upper), _mm256_and_ps(self.1, upper))
        }
    }
}
