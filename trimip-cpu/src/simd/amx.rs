//! Matrix tiles of AMX (Intel, *Architecture Instruction Set Extensions*, chapter 3): eight registers of up to 16 rows of 64
//! bytes, and an instruction that multiplies two tiles of bf16 pairs and adds the product to a tile of f32. Rust has no
//! stable intrinsics for AMX, so this module uses inline assembly.
//!
//! Each thread has its own registers. Call [`Shapes::load`] before their first use and [`release`] after the last.

use super::cpuid;
use std::arch::x86_64::*;
use std::sync::OnceLock;

/// Returns true if this processor has AMX with bf16 and the system lets this process use it. The first call asks the
/// system.
pub fn is_available() -> bool {
    static AVAILABLE: OnceLock<bool> = OnceLock::new();
    *AVAILABLE.get_or_init(|| has_tiles() && is_permitted())
}

/// Returns true if CPUID leaf 7 reports AMX-TILE and AMX-BF16.
fn has_tiles() -> bool {
    const TILE_AND_BF16: u32 = 1 << 24 | 1 << 22;
    // Leaf 0 reports the highest leaf.
    cpuid(0).eax >= 7 && cpuid(7).edx & TILE_AND_BF16 == TILE_AND_BF16
}

/// Requests permission from Linux to use the tile registers, as a process must do before their first use (`arch_prctl`,
/// since Linux 5.16). Older kernels refuse the request.
#[cfg(target_os = "linux")]
fn is_permitted() -> bool {
    const ARCH_PRCTL: i64 = 158;
    const REQUEST_PERMISSION: i64 = 0x1023;
    const TILE_DATA: i64 = 18;
    let answer: i64;
    // SAFETY: this call reads and writes no memory of the process; the kernel changes rax, rcx and r11.
    unsafe {
        std::arch::asm!(
            "syscall",
            inlateout("rax") ARCH_PRCTL => answer,
            in("rdi") REQUEST_PERMISSION,
            in("rsi") TILE_DATA,
            lateout("rcx") _,
            lateout("r11") _,
            options(nostack),
        );
    }
    answer == 0
}

#[cfg(not(target_os = "linux"))]
fn is_permitted() -> bool {
    false
}

/// Rows, and bytes per row, of the eight tiles, in the layout of `LDTILECFG`, palette 1.
#[repr(C, align(64))]
pub struct Shapes([u8; 64]);

impl Shapes {
    /// Creates the shapes of tiles 0 to 7: for each, the number of rows (1 to 16) and of words of four bytes in a row
    /// (1 to 16).
    pub fn new(tiles: [[usize; 2]; 8]) -> Self {
        let mut bytes = [0; 64];
        bytes[0] = 1;
        for (tile, [rows, words]) in tiles.into_iter().enumerate() {
            bytes[16 + 2 * tile] = 4 * words as u8;
            bytes[48 + tile] = rows as u8;
        }
        Self(bytes)
    }

    /// Configures the tiles of this thread with these shapes, and sets them to zero.
    ///
    /// # Safety
    /// [`is_available`] is true.
    #[inline(always)]
    pub unsafe fn load(&self) {
        // SAFETY: the 64 bytes are a valid configuration.
        unsafe {
            std::arch::asm!("ldtilecfg [{}]", in(reg) self, options(nostack, readonly, preserves_flags));
        };
    }
}

/// Releases the tiles of this thread, so that the system need not save them.
///
/// # Safety
/// [`is_available`] is true.
#[inline(always)]
pub unsafe fn release() {
    // SAFETY: as the caller guarantees.
    unsafe { std::arch::asm!("tilerelease", options(nostack, nomem, preserves_flags)) };
}

/// Sets a tile to zero, loads or stores its rows at an address with a stride in bytes, or adds the product of two tiles
/// to a third.
macro_rules! tile {
    (zero $tile:literal) => {
        std::arch::asm!(concat!("tilezero tmm", $tile), options(nostack, nomem, preserves_flags))
    };
    (load $tile:literal, $from:expr, $stride:expr) => {
        std::arch::asm!(
            concat!("tileloadd tmm", $tile, ", [{} + {} * 1]"),
            in(reg) $from,
            in(reg) $stride,
            options(nostack, readonly, preserves_flags)
        )
    };
    (store $tile:literal, $to:expr, $stride:expr) => {
        std::arch::asm!(
            concat!("tilestored [{} + {} * 1], tmm", $tile),
            in(reg) $to,
            in(reg) $stride,
            options(nostack, preserves_flags)
        )
    };
    (add $sum:literal, $a:literal, $b:literal) => {
        std::arch::asm!(
            concat!("tdpbf16ps tmm", $sum, ", tmm", $a, ", tmm", $b),
            options(nostack, nomem, preserves_flags)
        )
    };
}
pub(crate) use tile;

/// Writes the transpose of 16 rows of 16 words; the rows are `stride` words apart.
///
/// # Safety
/// The processor has AVX-512F, and `from` holds these words.
#[inline(always)]
pub unsafe fn transpose(from: *const f32, stride: usize, to: &mut [f32; 256]) {
    // SAFETY: as the caller guarantees.
    unsafe {
        let mut r = [_mm512_setzero_si512(); 16];
        for (row, r) in r.iter_mut().enumerate() {
            *r = _mm512_loadu_si512(from.add(row * stride).cast());
        }
        // Interleaves pairs of rows, then groups of four rows: the 128-bit part p of r[4 i + j] then holds column 4 p + j of
        // rows 4 i to 4 i + 3.
        let mut t = r;
        for i in (0..16).step_by(2) {
            t[i] = _mm512_unpacklo_epi32(r[i], r[i + 1]);
            t[i + 1] = _mm512_unpackhi_epi32(r[i], r[i + 1]);
        }
        for i in (0..16).step_by(4) {
            r[i] = _mm512_unpacklo_epi64(t[i], t[i + 2]);
            r[i + 1] = _mm512_unpackhi_epi64(t[i], t[i + 2]);
            r[i + 2] = _mm512_unpacklo_epi64(t[i + 1], t[i + 3]);
            r[i + 3] = _mm512_unpackhi_epi64(t[i + 1], t[i + 3]);
        }
        // For each j, transposes the 4×4 matrix of the 128-bit parts of r[j], r[4 + j], r[8 + j] and r[12 + j].
        for j in 0..4 {
            let low = [0, 8].map(|i| _mm512_shuffle_i32x4::<0b10_00_10_00>(r[i + j], r[i + 4 + j]));
            let high = [0, 8].map(|i| _mm512_shuffle_i32x4::<0b11_01_11_01>(r[i + j], r[i + 4 + j]));
            t[j] = _mm512_shuffle_i32x4::<0b10_00_10_00>(low[0], low[1]);
            t[8 + j] = _mm512_shuffle_i32x4::<0b11_01_11_01>(low[0], low[1]);
            t[4 + j] = _mm512_shuffle_i32x4::<0b10_00_10_00>(high[0], high[1]);
            t[12 + j] = _mm512_shuffle_i32x4::<0b11_01_11_01>(high[0], high[1]);
        }
        for (column, t) in t.into_iter().enumerate() {
            _mm512_storeu_si512(to.as_mut_ptr().add(16 * column).cast(), t);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_transpose_has_rows_for_columns() {
        if !is_x86_feature_detected!("avx512f") {
            return println!("skipped: this processor does not have AVX-512");
        }
        let from: Vec<f32> = (0..16 * 20).map(|i| i as f32).collect();
        let mut to = [0.0; 256];
        // SAFETY: the processor has AVX-512F, and there are 16 rows of 20 words.
        unsafe { transpose(from.as_ptr(), 20, &mut to) };
        for (place, found) in to.into_iter().enumerate() {
            assert_eq!(found, from[place % 16 * 20 + place / 16]);
        }
    }
}
