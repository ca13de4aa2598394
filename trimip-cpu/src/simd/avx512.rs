//! Lanes of one AVX-512 register.

use super::lanes::{Kernel, Lanes};
use std::arch::x86_64::*;

#[target_feature(enable = "avx512f,avx512bw,avx512bf16,avx2,fma")]
pub unsafe fn run_bf16<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Zmm<true>>()
}

#[target_feature(enable = "avx512f,avx2,fma")]
pub unsafe fn run<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Zmm<false>>()
}

/// One AVX-512 register, with or without BF16 instructions.
#[derive(Clone, Copy)]
pub struct Zmm<const BF16: bool>(__m512);

// The unsafe blocks below rely on this: the instruction set is available, because `run` and `run_bf16` are the only
// entry points and their caller has checked the processor.
impl<const BF16: bool> Lanes for Zmm<BF16> {
    const WIDE: bool = true;
    #[inline(always)]
    fn splat(value: f32) -> Self {
        // SAFETY: this set is available.
        Self(unsafe { _mm512_set1_ps(value) })
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: this set is available, and the caller has 16 values.
        Self(unsafe { _mm512_loadu_ps(from) })
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: this set is available, and the caller has room for 16 values.
        unsafe { _mm512_storeu_ps(to, self.0) }
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, addend: Self) -> Self {
        // SAFETY: this set is available.
        Self(unsafe { _mm512_fmadd_ps(self.0, factor.0, addend.0) })
    }
    #[inline(always)]
    fn relu(self) -> Self {
        // SAFETY: this set is available.
        Self(unsafe { _mm512_max_ps(self.0, _mm512_setzero_ps()) })
    }
    #[inline(always)]
    fn where_positive(self, mask: Self) -> Self {
        // SAFETY: this set is available.
        unsafe {
            let positive = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(mask.0, _mm512_setzero_ps());
            Self(_mm512_maskz_mov_ps(positive, self.0))
        }
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        // SAFETY: this set is available.
        Self(unsafe { _mm512_add_ps(self.0, other.0) })
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        // SAFETY: this set is available.
        unsafe { _mm512_reduce_add_ps(self.0) }
    }
    #[inline(always)]
    fn first(self) -> Self {
        // SAFETY: this set is available.
        unsafe { Self(_mm512_castsi512_ps(_mm512_slli_epi32::<16>(_mm512_castps_si512(self.0)))) }
    }
    #[inline(always)]
    fn second(self) -> Self {
        // SAFETY: this set is available.
        unsafe {
            let upper = _mm512_set1_epi32(0xffff_0000_u32 as i32);
            Self(_mm512_castsi512_ps(_mm512_and_si512(_mm512_castps_si512(self.0), upper)))
        }
    }
    #[inline(always)]
    fn dot_add(self, factor: Self, addend: Self) -> Self {
        if BF16 {
            // SAFETY: this set is available.
            Self(unsafe { _mm512_dpbf16_ps(addend.0, words(self.0), words(factor.0)) })
        } else {
            self.first().mul_add(factor.first(), self.second().mul_add(factor.second(), addend))
        }
    }
    #[inline(always)]
    fn pair(self, second: Self) -> Self {
        if !BF16 {
            // SAFETY: this set is available.
            return Self(unsafe { round(self.0, second.0) });
        }
        // SAFETY: this set is available.
        unsafe {
            // The low half of the register holds `self`, the high half `second`.
            let halves: __m512i = std::mem::transmute(_mm512_cvtne2ps_pbh(second.0, self.0));
            let firsts = _mm512_cvtepu16_epi32(_mm512_castsi512_si256(halves));
            let seconds = _mm512_cvtepu16_epi32(_mm512_extracti64x4_epi64::<1>(halves));
            Self(_mm512_castsi512_ps(_mm512_or_si512(firsts, _mm512_slli_epi32::<16>(seconds))))
        }
    }
    #[inline(always)]
    fn pair_neighbours(self, next: Self) -> Self {
        // SAFETY: this set is available.
        unsafe {
            if BF16 {
                return Self(std::mem::transmute::<__m512bh, __m512>(_mm512_cvtne2ps_pbh(next.0, self.0)));
            }
            let lanes = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
            let even = _mm512_permutex2var_ps(self.0, lanes, next.0);
            let odd = _mm512_add_epi32(lanes, _mm512_set1_epi32(1));
            Self(round(even, _mm512_permutex2var_ps(self.0, odd, next.0)))
        }
    }
}

/// Reinterprets the bits as pairs of bf16.
#[inline(always)]
unsafe fn words(bits: __m512) -> __m512bh {
    // SAFETY: both types are 512 bits without invalid values.
    unsafe { std::mem::transmute(bits) }
}

/// Rounds values to bf16 and packs them into words of pairs, without BF16 instructions. The result equals that of
/// [`super::pair`].
#[inline(always)]
unsafe fn round(first: __m512, second: __m512) -> __m512 {
    // SAFETY: the caller runs with AVX-512F, as `Zmm` does.
    unsafe {
        let first = _mm512_srli_epi32::<16>(round_up(first));
        let second = _mm512_and_si512(round_up(second), _mm512_set1_epi32(0xffff_0000_u32 as i32));
        _mm512_castsi512_ps(_mm512_or_si512(first, second))
    }
}

/// Returns words whose upper halves are the nearest bf16 values. They equal the results of [`super::bf16`].
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
