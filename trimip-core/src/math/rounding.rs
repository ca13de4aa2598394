//! Rounding in vector registers.

/// 2²³: from this number on, f32 has no fractions.
const WHOLE: f32 = 8_388_608.0;

/// Returns ⌊x⌋ for 0 ≤ x < 2²³, as a float and as an integer. Other arguments, including NaN, give arbitrary results.
///
/// `x as u32` saturates, so it compiles to a chain of scalar instructions. Sums and comparisons are vector instructions on every
/// processor.
#[inline(always)]
pub fn floor(x: f32) -> (f32, u32) {
    let nearest = (x + WHOLE) - WHOLE;
    let lower = if nearest > x { nearest - 1.0 } else { nearest };
    (lower, (lower + WHOLE).to_bits() & 0x7f_ffff)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_rounded_down() {
        let last = f32::from_bits(WHOLE.to_bits() - 1);
        for x in
            [0.0, -0.0, f32::MIN_POSITIVE, 0.499_999_97, 0.5, 0.999_999_94, 1.0, 1.5, 2.5, 4_194_304.5, last]
        {
            assert_eq!(floor(x), (x.floor(), x as u32), "{x}");
        }
        for i in 0..100_000_u32 {
            let x = f32::from_bits(i.wrapping_mul(2_654_435_761) % WHOLE.to_bits());
            assert_eq!(floor(x), (x.floor(), x as u32), "{x}");
        }
        // No argument panics.
        for x in [-1.0, f32::NAN, f32::INFINITY, 1e30] {
            floor(x);
        }
    }
}
