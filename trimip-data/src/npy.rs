//! Tables of numbers in NumPy's file format (`numpy.lib.format`, versions 1 to 3): f4 and f8, little- and big-endian,
//! in row-major or column-major order.

use trimip_core::{Error, Result};

/// Reads the rows of a table, of N numbers each. `name` names the file in errors, and `advice` says what to do about an
/// invalid one. Memory is allocated only after the file proves to be as long as its header states.
///
/// # Errors
/// Of kind `Input`: an unexpected format, number type or shape; a length of the file that differs from its header;
/// numbers that are not finite.
pub(crate) fn rows<const N: usize>(name: &str, bytes: &[u8], advice: &str) -> Result<Vec<[f64; N]>> {
    let wrong = |what: String| Error::input(name, what, advice);
    let header = Header::of(name, bytes, advice)?;
    let Header { rows, columns, planes, .. } = header;
    if planes || columns != N || rows == 0 {
        return Err(wrong(format!(
            "holds {rows} x {columns}{} numbers, expected {N} in each of one or more rows",
            if planes { " x 1" } else { "" }
        )));
    }
    header.expect_whole(name, bytes, advice)?;
    let row = |row: usize| {
        let own = std::array::from_fn(|column| header.number(bytes, row, column));
        match own.iter().all(|value: &f64| value.is_finite()) {
            true => Ok(own),
            false => Err(wrong(format!("holds a number that is not finite in row {row}"))),
        }
    };
    (0..rows).map(row).collect()
}

/// A table of any size, whose numbers are read from its bytes one by one.
#[derive(Debug)]
pub(crate) struct Table {
    header: Header,
    bytes: Vec<u8>,
}

impl Table {
    /// Reads a table from the bytes of a file. Its shape may have a third dimension, of 1.
    ///
    /// # Errors
    /// Of kind `Input`: an unexpected format, number type or shape; a length of the file that differs from its header.
    pub(crate) fn new(name: &str, bytes: Vec<u8>, advice: &str) -> Result<Self> {
        let header = Header::of(name, &bytes, advice)?;
        header.expect_whole(name, &bytes, advice)?;
        Ok(Self { header, bytes })
    }

    /// Reads the numbers of rows and columns. `bytes` is the start of a file: at least [`HEAD`] bytes, or the whole file.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub(crate) fn sides(name: &str, bytes: &[u8], advice: &str) -> Result<[usize; 2]> {
        let Header { rows, columns, .. } = Header::of(name, bytes, advice)?;
        Ok([rows, columns])
    }

    /// Returns the number in a row and a column, which must lie within the table.
    pub(crate) fn number(&self, row: usize, column: usize) -> f64 {
        self.header.number(&self.bytes, row, column)
    }
}

/// Number of bytes at the start of a file that hold its header.
pub(crate) const HEAD: u64 = 1 << 17;

/// Decodes a number of four or eight bytes: big-endian if `big`, otherwise little-endian.
fn number(bytes: &[u8], big: bool) -> f64 {
    let mut own = [0; 8];
    for (index, byte) in bytes.iter().enumerate() {
        own[if big { bytes.len() - 1 - index } else { index }] = *byte;
    }
    match (bytes.len(), own) {
        (8, own) => f64::from_le_bytes(own),
        (_, [a, b, c, d, ..]) => f32::from_le_bytes([a, b, c, d]).into(),
    }
}

/// The header of a table.
#[derive(Debug)]
struct Header {
    /// True if the numbers are big-endian.
    big: bool,
    /// Bytes of a number.
    size: usize,
    /// True for column-major order.
    by_columns: bool,
    rows: usize,
    columns: usize,
    /// True if the shape has a third dimension, of 1.
    planes: bool,
    /// Offset of the numbers in the file, bytes.
    start: usize,
}

impl Header {
    fn of(name: &str, bytes: &[u8], advice: &str) -> Result<Self> {
        let wrong = |what: String| Error::input(name, format!("is not a table of NumPy: {what}"), advice);
        Self::parse(bytes).map_err(wrong)
    }

    /// Refuses a file whose length differs from the one that its header states.
    fn expect_whole(&self, name: &str, bytes: &[u8], advice: &str) -> Result<()> {
        let Self { size, rows, columns, start, .. } = *self;
        let follow = bytes.len() - start;
        let stated = rows.checked_mul(columns).and_then(|count| count.checked_mul(size));
        if stated == Some(follow) {
            return Ok(());
        }
        let what = format!("states {rows} x {columns} numbers of {size} bytes, but {follow} bytes follow");
        Err(Error::input(name, what, advice))
    }

    /// Returns the number in a row and a column of a complete file.
    fn number(&self, bytes: &[u8], row: usize, column: usize) -> f64 {
        let index = if self.by_columns { column * self.rows + row } else { row * self.columns + column };
        number(&bytes[self.start + index * self.size..][..self.size], self.big)
    }

    /// Parses the header. The error describes what is wrong.
    fn parse(bytes: &[u8]) -> std::result::Result<Self, String> {
        let rest = bytes.strip_prefix(b"\x93NUMPY").ok_or("its first bytes are wrong")?;
        let (&[major, _], rest) = rest.split_first_chunk().ok_or("it ends early")?;
        let (length, rest) = match (major, rest) {
            (1, [a, b, rest @ ..]) => (usize::from(u16::from_le_bytes([*a, *b])), rest),
            (2 | 3, [a, b, c, d, rest @ ..]) => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, rest),
            (1..=3, _) => return Err("it ends early".into()),
            _ => return Err(format!("it has version {major} of the format, but only 1 to 3 are known")),
        };
        let (text, values) = rest.split_at_checked(length).ok_or("its header ends early")?;
        let text = std::str::from_utf8(text).map_err(|_| "its header is no text")?;
        // A Python dictionary with these three keys, in any order.
        let after = |key: &str| {
            let (_, value) =
                text.split_once(&format!("'{key}':")).ok_or(format!("its header has no '{key}'"))?;
            Ok::<&str, String>(value.trim_start())
        };
        let kind = after("descr")?
            .strip_prefix('\'')
            .and_then(|kind| kind.split_once('\''))
            .map_or("", |kind| kind.0);
        let (big, size) = match kind {
            "<f8" => (false, 8),
            "<f4" => (false, 4),
            ">f8" => (true, 8),
            ">f4" => (true, 4),
            _ => {
                return Err(format!(
                    "its numbers are '{}', but only f8 and f4 are known",
                    kind.escape_debug()
                ));
            }
        };
        let order = after("fortran_order")?;
        let by_columns = order.starts_with("True");
        if !by_columns && !order.starts_with("False") {
            return Err("its 'fortran_order' is neither True nor False".into());
        }
        let shape = after("shape")?
            .strip_prefix('(')
            .and_then(|shape| shape.split_once(')'))
            .map_or("", |shape| shape.0);
        let sides: Vec<Option<usize>> =
            shape.trim_end_matches(',').split(',').map(|side| side.trim().parse().ok()).collect();
        let start = bytes.len() - values.len();
        match sides[..] {
            [Some(rows), Some(columns)] => {
                Ok(Self { big, size, by_columns, rows, columns, planes: false, start })
            }
            [Some(rows), Some(columns), Some(1)] => {
                Ok(Self { big, size, by_columns, rows, columns, planes: true, start })
            }
            _ => Err(format!("its shape is ({}), expected two numbers", shape.escape_debug())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a file with this header and these numbers.
    fn file(version: u8, header: &str, numbers: impl Iterator<Item = Vec<u8>>) -> Vec<u8> {
        let length = match version {
            1 => (header.len() as u16).to_le_bytes().to_vec(),
            _ => (header.len() as u32).to_le_bytes().to_vec(),
        };
        let start = [b"\x93NUMPY", &[version, 0][..], &length, header.as_bytes()].concat();
        start.into_iter().chain(numbers.flatten()).collect()
    }

    fn header(kind: &str, order: &str, shape: &str) -> String {
        format!("{{'descr': '{kind}', 'fortran_order': {order}, 'shape': {shape}, }}   \n")
    }

    #[test]
    fn every_way_to_write_a_table_is_the_same_table() {
        let expected = [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]];
        for (kind, bytes) in [
            ("<f8", (|v| f64::from(v).to_le_bytes().to_vec()) as fn(u8) -> Vec<u8>),
            (">f8", |v| f64::from(v).to_be_bytes().to_vec()),
            ("<f4", |v| f32::from(v).to_le_bytes().to_vec()),
            (">f4", |v| f32::from(v).to_be_bytes().to_vec()),
        ] {
            for version in [1, 2, 3] {
                for (order, numbers) in [("False", [0, 1, 2, 3, 4, 5]), ("True", [0, 3, 1, 4, 2, 5])] {
                    let bytes = file(version, &header(kind, order, "(2, 3)"), numbers.into_iter().map(bytes));
                    assert_eq!(
                        rows::<3>("a.npy", &bytes, "again").unwrap(),
                        expected,
                        "{kind} {version} {order}"
                    );
                }
            }
        }
    }

    #[test]
    fn what_is_no_table_of_that_width_is_refused() {
        let numbers = || (0..6).map(|v| f64::from(v).to_le_bytes().to_vec());
        let of = |header: &str| file(1, header, numbers());
        let plain = of(&header("<f8", "False", "(2, 3)"));
        let mut infinite = plain.clone();
        let end = infinite.len();
        infinite[end - 8..].copy_from_slice(&f64::INFINITY.to_le_bytes());
        let cases: [(Vec<u8>, &str); 14] = [
            (Vec::new(), "its first bytes"),
            (b"\x93NUMPY".to_vec(), "ends early"),
            (b"\x93NUMPY\x01\0\x05".to_vec(), "ends early"),
            (b"\x93NUMPY\x09\0\0\0".to_vec(), "version 9"),
            (b"\x93NUMPY\x02\0\xff\xff\xff\xff{".to_vec(), "header ends early"),
            (of("{}"), "no 'descr'"),
            (of(&header("<i8", "False", "(2, 3)")), "'<i8', but only f8 and f4 are known"),
            (of(&header("<f8", "Maybe", "(2, 3)")), "neither True nor False"),
            (of(&header("<f8", "False", "(2, 3, 1)")), "holds 2 x 3 x 1 numbers, expected 3"),
            (of(&header("<f8", "False", "(6,)")), "expected two numbers"),
            (of(&header("<f8", "False", "(3, 2)")), "holds 3 x 2 numbers, expected 3"),
            (of(&header("<f8", "False", "(9223372036854775808, 3)")), "but 48 bytes follow"),
            (plain[..end - 1].to_vec(), "but 47 bytes follow"),
            (infinite, "not finite in row 1"),
        ];
        for (bytes, expected) in cases {
            let error = rows::<3>("a.npy", &bytes, "again").unwrap_err();
            assert_eq!(error.kind(), trimip_core::ErrorKind::Input);
            assert!(
                error.message().starts_with("a.npy: ") && error.message().ends_with("; again"),
                "{error}"
            );
            assert!(error.message().contains(expected), "{expected}: {error}");
        }
    }
}
