//! Random changes of valid files: flipped bits, truncations, replaced numbers and words, duplicated parts, and parts of other
//! files. A hash of the seed and the number of a case determines the case, so it can be repeated.

/// A generator of random numbers (SplitMix64).
pub(super) struct Random(pub(super) u64);

impl Random {
    pub(super) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a number below `end`, which must be at least 1.
    pub(super) fn below(&mut self, end: usize) -> usize {
        (self.next() % end as u64) as usize
    }

    fn of<'a, T: ?Sized>(&mut self, all: &[&'a T]) -> &'a T {
        all[self.below(all.len())]
    }
}

/// Texts that replace words and lines.
const WORDS: [&str; 30] = [
    "nan",
    "-inf",
    "1e999",
    "-1e308",
    "1e-320",
    "0",
    "-0.0",
    "-1",
    "1",
    "2",
    "255",
    "256",
    "4294967295",
    "4294967296",
    "9223372036854775807",
    "18446744073709551615",
    "18446744073709551616",
    "0.5",
    "x",
    "",
    "#",
    "\"",
    "[",
    "]",
    "{}",
    "null",
    "true",
    "é",
    "\u{feff}",
    "\r\n",
];

/// Numbers that replace bytes of binary files.
const NUMBERS: [u64; 12] = [
    0,
    1,
    0xff,
    0xffff,
    1 << 31,
    0xffff_ffff,
    1 << 32,
    1 << 62,
    u64::MAX,
    0x7ff8_0000_0000_0000,
    0x7ff0_0000_0000_0000,
    0x7fef_ffff_ffff_ffff,
];

/// Returns `bytes` after one to four changes, some of which insert parts of `other`.
pub(super) fn changed(bytes: &[u8], other: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..1 + random.below(4) {
        if bytes.is_empty() {
            break;
        }
        change(&mut bytes, other, random);
    }
    bytes
}

fn change(bytes: &mut Vec<u8>, other: &[u8], random: &mut Random) {
    let end = bytes.len();
    let at = random.below(end);
    let part = |from: usize, random: &mut Random| from..(from + 1 + random.below(200)).min(end);
    match random.below(11) {
        0 => bytes[at] ^= 1 << random.below(8),
        1 => bytes[at] = random.next() as u8,
        2 => bytes.truncate(at),
        3 => drop(bytes.drain(part(at, random))),
        4 => {
            let number = NUMBERS[random.below(NUMBERS.len())].to_le_bytes();
            let length = [1, 2, 4, 8][random.below(4)];
            // Most counts and numbers of binary files begin at multiples of 4.
            let at = if length >= 4 { at / 4 * 4 } else { at };
            bytes.splice(at..(at + length).min(end), number[..length].iter().copied());
        }
        5 => instead(bytes, at, random.of(&WORDS), |byte| {
            !byte.is_ascii_alphanumeric() && !b"+-._".contains(&byte)
        }),
        6 => instead(bytes, at, random.of(&WORDS), |byte| byte.is_ascii_whitespace()),
        7 => instead(bytes, at, random.of(&WORDS), |byte| byte == b'\n'),
        8 => {
            let copy = bytes[part(at, random)].to_vec();
            bytes.splice(at..at, copy);
        }
        9 => {
            let range = part(at, random);
            let copy = bytes[range.clone()].to_vec();
            bytes.drain(range);
            let to = random.below(bytes.len() + 1);
            bytes.splice(to..to, copy);
        }
        _ if other.is_empty() => {}
        _ => {
            let from = random.below(other.len());
            let length = 1 + random.below(200);
            bytes.splice(part(at, random), other[from..(from + length).min(other.len())].iter().copied());
        }
    }
}

/// Replaces the bytes around `at` with `with`, on both sides up to the nearest byte for which `ends` is true.
fn instead(bytes: &mut Vec<u8>, at: usize, with: &str, ends: fn(u8) -> bool) {
    let start = bytes[..at].iter().rposition(|&byte| ends(byte)).map_or(0, |before| before + 1);
    let stop = bytes[at..].iter().position(|&byte| ends(byte)).map_or(bytes.len(), |length| at + length);
    bytes.splice(start..stop.max(start), with.bytes());
}
