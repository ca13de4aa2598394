//! Sets of cells or bricks, stored as bits: eight to a byte, the first in the lowest bit. Model files and devices exchange
//! occupancy in this form.

/// Returns true if the set holds `index`.
///
/// # Panics
/// If the bytes end before `index`.
pub fn is_set(bits: &[u8], index: usize) -> bool {
    bits[index / 8] >> (index % 8) & 1 == 1
}

/// Adds `index` to the set.
///
/// # Panics
/// If the bytes end before `index`.
pub fn set(bits: &mut [u8], index: usize) {
    bits[index / 8] |= 1 << (index % 8);
}

/// Removes `index` from the set.
///
/// # Panics
/// If the bytes end before `index`.
pub fn clear(bits: &mut [u8], index: usize) {
    bits[index / 8] &= !(1 << (index % 8));
}

/// Returns the set of the indices in `0..count` for which `holds` is true; the bits after the last index are 0.
pub fn of(count: usize, holds: impl Fn(usize) -> bool) -> Vec<u8> {
    let mut bits = vec![0; count.div_ceil(8)];
    (0..count).filter(|&index| holds(index)).for_each(|index| set(&mut bits, index));
    bits
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_holds_what_was_added_and_not_removed() {
        let mut bits = of(21, |index| index % 3 == 0);
        assert_eq!(bits, [0b0100_1001, 0b1001_0010, 0b0000_0100]);
        assert!((0..21).all(|index| is_set(&bits, index) == (index % 3 == 0)));
        clear(&mut bits, 18);
        set(&mut bits, 20);
        assert_eq!(bits[2], 0b0001_0000);
    }
}
