//! Rounding to bf16.

/// Rounds to the nearest bf16, ties to even; a bf16 is the upper half of an f32. Values whose magnitude is below the
/// smallest normal f32 become zero.
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

/// Packs two values into a word of two bf16; the first is in the low half.
#[inline(always)]
pub fn pair(first: f32, second: f32) -> f32 {
    f32::from_bits(u32::from(bf16(first)) | u32::from(bf16(second)) << 16)
}
