//! Colour patterns on the surfaces of the built-in scene: checkers, rings, stripes and lines of letters, each finer
//! somewhere than a pixel of a coarse scale. Lengths are in world units, colours in [0, 1].

use glam::DVec3;
use std::f64::consts::TAU;

/// Colour pattern on a surface.
#[derive(Clone, Copy)]
pub(super) enum Paint {
    Plain(DVec3),
    /// Checkers whose fields have this side, seen from above; the wall of a drum is striped.
    Checker(DVec3, DVec3, f64),
    /// Rings around the z axis, with this period along z for a pair of rings.
    Rings(DVec3, DVec3, f64),
    /// Stripes that wind upwards around the shape's axis. The numbers are the pairs of stripes around the axis, and the
    /// period of a pair along z.
    Helix(DVec3, DVec3, f64, f64),
    /// Lines of letters around an upright wall, smaller from line to line, below a top of ink. `radius` and `top` are those of the wall.
    Letters {
        ink: DVec3,
        paper: DVec3,
        radius: f64,
        top: f64,
    },
}

/// The text as columns of dots: five columns per letter, and an empty column follows each letter. The lowest bit of a column is at the top.
const WORD: [[u8; 5]; 10] = [
    [0x01, 0x01, 0x7f, 0x01, 0x01], // T
    [0x7f, 0x09, 0x19, 0x29, 0x46], // R
    [0x00, 0x41, 0x7f, 0x41, 0x00], // I
    [0x08, 0x08, 0x08, 0x08, 0x08], // -
    [0x7f, 0x02, 0x0c, 0x02, 0x7f], // M
    [0x00, 0x41, 0x7f, 0x41, 0x00], // I
    [0x7f, 0x09, 0x09, 0x09, 0x06], // P
    [0x7f, 0x09, 0x19, 0x29, 0x46], // R
    [0x7f, 0x09, 0x09, 0x09, 0x01], // F
    [0x00, 0x00, 0x1c, 0x00, 0x00], // a dot between the last letter and the first
];
/// Width of a word in dots: six columns per letter.
const WORD_DOTS: f64 = 60.0;
/// Repetitions of the word around the wall, line by line from the top.
const LINES: [f64; 6] = [1.0, 2.0, 3.0, 4.0, 6.0, 8.0];
/// Dots from the top of a line to the top of the next line: seven for a letter, two for the gap.
const LINE_DOTS: f64 = 9.0;

impl Paint {
    /// Returns the colour at a point of a surface with this normal.
    pub(super) fn color(&self, point: DVec3, normal: DVec3) -> DVec3 {
        let odd = |value: f64| value.floor().rem_euclid(2.0) == 1.0;
        // On the axis of a round shape the angle comes from the normal.
        let turn = normal.y.atan2(normal.x) / TAU;
        match *self {
            Self::Plain(color) => color,
            Self::Checker(a, b, side) => {
                let second = if normal.z.abs() > 0.5 {
                    odd(point.x / side) != odd(point.y / side)
                } else {
                    odd(point.y.atan2(point.x) / TAU * 96.0)
                };
                if second { b } else { a }
            }
            Self::Rings(a, b, period) => {
                if odd(2.0 * point.z / period) {
                    b
                } else {
                    a
                }
            }
            Self::Helix(a, b, turns, period) => {
                if normal.z.abs() < 0.999 && odd(2.0 * (turns * turn + point.z / period)) { b } else { a }
            }
            Self::Letters { ink, paper, radius, top } => {
                let written = if normal.z.abs() > 0.5 {
                    true
                } else {
                    letters(turn, (top - point.z) / (TAU * radius / WORD_DOTS))
                };
                if written { ink } else { paper }
            }
        }
    }
}

/// Returns true where the lines of letters have ink. `turn` is the position around the wall in turns, `down` the
/// distance from its top in dots of the first line. Below the last line everything is ink.
fn letters(turn: f64, down: f64) -> bool {
    let mut start = 2.0;
    for words in LINES {
        let (row, column) = ((down - start) * words, turn.rem_euclid(1.0) * words * WORD_DOTS % WORD_DOTS);
        if row < LINE_DOTS {
            let letter = WORD[(column / 6.0) as usize % WORD.len()];
            // The sixth column and the rows above and below a letter are paper.
            let bits = letter.get((column % 6.0) as usize).copied().unwrap_or(0);
            return (0.0..7.0).contains(&row) && bits >> (row as u32) & 1 == 1;
        }
        start += LINE_DOTS / words;
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_line_is_read_around_the_wall_and_the_second_holds_it_twice() {
        let line = |dots_a_turn: f64, down: f64| -> String {
            let at = |i: u32| letters((f64::from(i) + 0.5) / dots_a_turn, down);
            (0..dots_a_turn as u32).map(|i| if at(i) { '#' } else { '.' }).collect()
        };
        // The top row of T, R, I and -.
        assert_eq!(&line(60.0, 2.5)[..24], "#####.####...###........");
        let second = line(120.0, 2.0 + LINE_DOTS + 0.25);
        assert_eq!(second[..60], second[60..]);
        assert_eq!(second[..60], line(60.0, 2.5));
        assert!(!line(60.0, 1.0).contains('#') && !line(60.0, 30.0).contains('.'));
    }
}
