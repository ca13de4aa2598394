//! Sixteen f32 lanes as AVX-512, AVX2, NEON or plain Rust, chosen at run time. A [`Kernel`] is written once over [`Lanes`];
//! [`Simd::run`] compiles it for each instruction set. Results differ between the sets only in rounding (fused
//! multiply-adds or not).

#[cfg(target_arch = "x86_64")]
pub(crate) mod amx;
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod bf16;
mod lanes;
#[cfg(target_arch = "aarch64")]
mod neon;
mod plain;
#[cfg(test)]
mod tests;

use std::fmt;

pub use bf16::{bf16, pair};
pub use lanes::{Kernel, Lanes};
pub use plain::Plain;

/// An instruction set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Simd {
    /// x86-64 with the set [`Simd::Avx512Bf16`], and matrix tiles for products of bf16 pairs.
    Amx,
    /// x86-64 with AVX-512F, BW and BF16: one register, and dot products of bf16 pairs.
    Avx512Bf16,
    /// x86-64 with AVX-512F: one register.
    Avx512,
    /// x86-64 with AVX2 and FMA: two registers.
    Avx2,
    /// AArch64: four NEON registers.
    Neon,
    /// Any processor.
    Portable,
}

impl fmt::Display for Simd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Amx => "AVX-512 BF16 with AMX",
            Self::Avx512Bf16 => "AVX-512 BF16",
            Self::Avx512 => "AVX-512",
            Self::Avx2 => "AVX2",
            Self::Neon => "NEON",
            Self::Portable => "no vector instructions",
        })
    }
}

impl Simd {
    /// Returns the widest set that this processor supports.
    pub fn detect() -> Self {
        Self::available()[0]
    }

    /// Returns true if bf16 products have their own instructions and are faster than f32 products. On Intel's processors, dot
    /// products of bf16 pairs are slower than f32 products: on one thread of an Emerald Rapids, the networks take 1.6 to 1.8
    /// times as long with them.
    pub fn has_bf16(self) -> bool {
        match self {
            Self::Amx => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx512Bf16 => !is_of_intel(),
            _ => false,
        }
    }

    /// Returns the minimum width of hidden layers at which bf16 products are faster than f32 products. Tiles are not faster
    /// for narrow layers, because each value that is rounded and moved takes part in only a few products. On two threads of an
    /// Emerald Rapids, training of *lego* with tiles processes 10 % fewer samples per second than in f32 at 64 units, and 28 %
    /// more at 128.
    pub fn bf16_from(self) -> Option<u32> {
        match self {
            Self::Amx => Some(128),
            _ => self.has_bf16().then_some(1),
        }
    }

    /// Returns true if this set has matrix tiles and the processor supports them.
    pub(crate) fn has_tiles(self) -> bool {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Amx => amx::is_available(),
            _ => false,
        }
    }

    /// Returns all sets that this processor supports, widest first.
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut)]
        let mut sets = vec![];
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            let avx512 = avx2 && is_x86_feature_detected!("avx512f");
            if avx512 && is_x86_feature_detected!("avx512bw") && is_x86_feature_detected!("avx512bf16") {
                if amx::is_available() {
                    sets.push(Self::Amx);
                }
                sets.push(Self::Avx512Bf16);
            }
            if avx512 {
                sets.push(Self::Avx512);
            }
            if avx2 {
                sets.push(Self::Avx2);
            }
        }
        #[cfg(target_arch = "aarch64")]
        sets.push(Self::Neon);
        sets.push(Self::Portable);
        sets
    }

    /// Runs a kernel with this set.
    ///
    /// # Panics
    /// When the processor does not support the set.
    #[inline]
    pub fn run<K: Kernel>(self, kernel: K) -> K::Output {
        match self {
            #[cfg(target_arch = "x86_64")]
            Self::Amx | Self::Avx512Bf16 => {
                let wide = is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512bw");
                let fused = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
                assert!(wide && fused && is_x86_feature_detected!("avx512bf16"));
                assert!(self != Self::Amx || self.has_tiles());
                // SAFETY: the processor supports the whole set; otherwise the assertion above has panicked.
                unsafe { avx512::run_bf16(kernel) }
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                let fused = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
                assert!(fused && is_x86_feature_detected!("avx512f"));
                // SAFETY: as above.
                unsafe { avx512::run(kernel) }
            }
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => {
                assert!(is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"));
                // SAFETY: as above.
                unsafe { avx2::run(kernel) }
            }
            // Every AArch64 processor has NEON.
            #[cfg(target_arch = "aarch64")]
            Self::Neon => kernel.run::<neon::Neon>(),
            Self::Portable => kernel.run::<Plain>(),
            #[allow(unreachable_patterns)]
            _ => panic!("{self:?} is not of this processor's architecture"),
        }
    }
}

/// Returns the registers that CPUID reports for `leaf`, sub-leaf 0.
#[cfg(target_arch = "x86_64")]
#[allow(unused_unsafe, reason = "recent versions of Rust declare the function safe")]
fn cpuid(leaf: u32) -> std::arch::x86_64::CpuidResult {
    // SAFETY: every x86-64 processor has the instruction.
    unsafe { std::arch::x86_64::__cpuid_count(leaf, 0) }
}

/// Returns true if CPUID names Intel as the processor's maker.
#[cfg(target_arch = "x86_64")]
fn is_of_intel() -> bool {
    let maker = cpuid(0);
    [maker.ebx, maker.edx, maker.ecx].map(u32::to_le_bytes).concat() == *b"GenuineIntel"
}

/// Prefetches the cache line at `from`, which need not be a valid address.
#[inline(always)]
pub fn fetch<T>(from: *const T) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch reads nothing; every x86-64 has it.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(from.cast()) };
    }
    #[cfg(target_arch = "aarch64")]
    // SAFETY: a prefetch reads nothing; every AArch64 has it.
    unsafe {
        std::arch::asm!("prfm pldl1keep, [{}]", in(reg) from, options(nostack, readonly, preserves_flags));
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    let _ = from;
}
