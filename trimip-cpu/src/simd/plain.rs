//! Lanes without processor-specific instructions.

use super::lanes::Lanes;

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
        // SAFETY: guaranteed by the caller.
        Self(unsafe { from.cast::<[f32; 16]>().read_unaligned() })
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: guaranteed by the caller.
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
