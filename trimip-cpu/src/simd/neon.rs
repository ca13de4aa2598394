//! Lanes of four NEON registers.

use super::lanes::Lanes;
use std::arch::aarch64::*;

/// Four NEON registers.
#[derive(Clone, Copy)]
pub struct Neon([float32x4_t; 4]);

impl Neon {
    /// Applies `f` to each of the four registers.
    #[inline(always)]
    fn each(f: impl Fn(usize) -> float32x4_t) -> Self {
        Self([f(0), f(1), f(2), f(3)])
    }
}

// The unsafe blocks below rely on this: every processor of this architecture has NEON, and the target enables it.
#[allow(unused_unsafe)]
impl Lanes for Neon {
    const WIDE: bool = false;
    #[inline(always)]
    fn splat(value: f32) -> Self {
        // SAFETY: this set is available.
        Self([unsafe { vdupq_n_f32(value) }; 4])
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: this set is available, and the caller has 16 values.
        Self::each(|i| unsafe { vld1q_f32(from.add(4 * i)) })
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        for (i, four) in self.0.into_iter().enumerate() {
            // SAFETY: this set is available, and the caller has room for 16 values.
            unsafe { vst1q_f32(to.add(4 * i), four) }
        }
    }
    #[inline(always)]
    fn mul_add(self, factor: Self, addend: Self) -> Self {
        // SAFETY: this set is available.
        Self::each(|i| unsafe { vfmaq_f32(addend.0[i], self.0[i], factor.0[i]) })
    }
    #[inline(always)]
    fn relu(self) -> Self {
        // If one operand is NaN, `maxnm` returns the other one, so NaN becomes zero as with the other instruction sets.
        // SAFETY: this set is available.
        Self::each(|i| unsafe { vmaxnmq_f32(self.0[i], vdupq_n_f32(0.0)) })
    }
    #[inline(always)]
    fn where_positive(self, mask: Self) -> Self {
        // SAFETY: this set is available.
        Self::each(|i| unsafe {
            let positive = vcgtq_f32(mask.0[i], vdupq_n_f32(0.0));
            vreinterpretq_f32_u32(vandq_u32(positive, vreinterpretq_u32_f32(self.0[i])))
        })
    }
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        // SAFETY: this set is available.
        Self::each(|i| unsafe { vaddq_f32(self.0[i], other.0[i]) })
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        let [a, b, c, d] = self.0;
        // SAFETY: this set is available.
        unsafe { vaddvq_f32(vaddq_f32(vaddq_f32(a, b), vaddq_f32(c, d))) }
    }
    #[inline(always)]
    fn first(self) -> Self {
        // SAFETY: this set is available.
        Self::each(|i| unsafe { vreinterpretq_f32_u32(vshlq_n_u32::<16>(vreinterpretq_u32_f32(self.0[i]))) })
    }
    #[inline(always)]
    fn second(self) -> Self {
        // SAFETY: this set is available.
        Self::each(|i| unsafe {
            let upper = vdupq_n_u32(0xffff_0000);
            vreinterpretq_f32_u32(vandq_u32(vreinterpretq_u32_f32(self.0[i]), upper))
        })
    }
}
