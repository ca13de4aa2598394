//! Vertices of a PLY file, ASCII or binary: positions and colours. Elements before the vertices are skipped, and elements
//! after them are not read. Memory is allocated only after the rest of the file proves to be long enough for a stated count.

use crate::points::Point;
use std::str::SplitAsciiWhitespace;
use trimip_core::{Error, Result};

/// Type of a number in a row.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn of(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Returns the number of bytes in a binary file.
    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Returns the value of little-endian bytes, of which only the first are used if the type is shorter.
    fn value(self, bytes: [u8; 8]) -> f64 {
        let [a, b, c, d, ..] = bytes;
        match self {
            Self::I8 => f64::from(a as i8),
            Self::U8 => f64::from(a),
            Self::I16 => f64::from(i16::from_le_bytes([a, b])),
            Self::U16 => f64::from(u16::from_le_bytes([a, b])),
            Self::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Self::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Self::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Self::F64 => f64::from_le_bytes(bytes),
        }
    }
}

/// A property of an element: a number, or a list, which is a count followed by so many numbers.
struct Property<'a> {
    name: &'a str,
    count: Option<Scalar>,
    scalar: Scalar,
}

struct Element<'a> {
    name: &'a str,
    rows: usize,
    properties: Vec<Property<'a>>,
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

impl Element<'_> {
    /// Returns the least number of bytes of a row. In a text row, each property takes at least a digit and a blank or line end.
    fn least(&self, encoding: Encoding) -> usize {
        let binary = |property: &Property<'_>| property.count.unwrap_or(property.scalar).size();
        match encoding {
            Encoding::Ascii => 2 * self.properties.len(),
            Encoding::Little | Encoding::Big => self.properties.iter().map(binary).sum(),
        }
    }
}

/// Reads the vertices of the file `name`; those whose position is not finite are left out.
///
/// # Errors
/// Of kind `Input`: an incomplete header, and numbers that are missing or malformed. The message names the file, and the line or the byte.
pub(crate) fn points(name: &str, bytes: &[u8]) -> Result<Vec<Point>> {
    let mut rest = Rest { name, bytes, at: 0, line: 0 };
    let (encoding, elements) = rest.header()?;
    for element in &elements {
        rest.needs(element, encoding)?;
        if element.name == "vertex" {
            return rest.vertices(element, encoding);
        }
        let mut values = vec![0.0; element.properties.len()];
        // Rows without properties have no bytes.
        for row in 0..if values.is_empty() { 0 } else { element.rows } {
            rest.row(element, row, encoding, &mut values)?;
        }
    }
    Err(rest.wrong_file("has no element \"vertex\""))
}

/// The unread part of a file.
struct Rest<'a> {
    name: &'a str,
    bytes: &'a [u8],
    at: usize,
    line: usize,
}

impl<'a> Rest<'a> {
    fn left(&self) -> &'a [u8] {
        self.bytes.get(self.at..).unwrap_or(&[])
    }

    fn wrong(&self, place: impl std::fmt::Display, what: impl std::fmt::Display) -> Error {
        let advice = "export the points again, or remove \"ply_file_path\" from the camera file";
        Error::input(format!("{}:{place}", self.name), what, advice)
    }

    fn wrong_file(&self, what: &str) -> Error {
        Error::input(
            self.name,
            what,
            "export the points again, or remove \"ply_file_path\" from the camera file",
        )
    }

    fn wrong_line(&self, what: impl std::fmt::Display) -> Error {
        self.wrong(self.line, what)
    }

    fn line(&mut self) -> Option<&'a [u8]> {
        let left = self.left();
        if left.is_empty() {
            return None;
        }
        let length = left.iter().position(|&byte| byte == b'\n').unwrap_or(left.len());
        (self.at, self.line) = (self.at + length + 1, self.line + 1);
        Some(left[..length].trim_ascii())
    }

    fn header(&mut self) -> Result<(Encoding, Vec<Element<'a>>)> {
        if self.line() != Some(b"ply") {
            return Err(self.wrong(1, "is not \"ply\": this is no PLY file"));
        }
        let (mut encoding, mut elements): (_, Vec<Element<'_>>) = (None, Vec::new());
        while let Some(line) = self.line() {
            let line = std::str::from_utf8(line).unwrap_or("comment");
            let wrong = || self.wrong_line(format!("\"{}\" is no line of a header", shown(line)));
            let mut words = line.split_ascii_whitespace();
            match words.next() {
                None | Some("comment" | "obj_info") => {}
                Some("format") => {
                    encoding = Some(match words.next() {
                        Some("ascii") => Encoding::Ascii,
                        Some("binary_little_endian") => Encoding::Little,
                        Some("binary_big_endian") => Encoding::Big,
                        _ => return Err(wrong()),
                    });
                }
                Some("element") => {
                    let (name, rows) = (words.next(), words.next().and_then(|count| count.parse().ok()));
                    let (name, rows) = name.zip(rows).ok_or_else(wrong)?;
                    elements.push(Element { name, rows, properties: Vec::new() });
                }
                Some("property") => {
                    let property = property(words).ok_or_else(wrong)?;
                    elements.last_mut().ok_or_else(wrong)?.properties.push(property);
                }
                Some("end_header") => {
                    let encoding = encoding.ok_or_else(|| self.wrong_line("the header states no format"))?;
                    return Ok((encoding, elements));
                }
                Some(_) => return Err(wrong()),
            }
        }
        Err(self.wrong_line("the file ends within its header"))
    }

    /// Refuses an element with more rows than the rest of the file can hold.
    fn needs(&self, element: &Element<'_>, encoding: Encoding) -> Result<()> {
        let left = self.left().len();
        // The last line of a text may lack its line break.
        if element.least(encoding).checked_mul(element.rows).is_some_and(|bytes| bytes <= left + 1) {
            return Ok(());
        }
        let what = format!(
            "{} rows of element \"{}\" do not fit into the {left} bytes after the header",
            element.rows,
            shown(element.name)
        );
        Err(self.wrong_line(what))
    }

    fn vertices(&mut self, element: &Element<'_>, encoding: Encoding) -> Result<Vec<Point>> {
        let find = |name: &str, fits: fn(Scalar) -> bool| {
            let own = |p: &Property<'_>| p.name == name && p.count.is_none() && fits(p.scalar);
            element.properties.iter().position(own)
        };
        let place = |name| find(name, |scalar| matches!(scalar, Scalar::F32 | Scalar::F64));
        let (Some(x), Some(y), Some(z)) = (place("x"), place("y"), place("z")) else {
            return Err(self.wrong_file("its vertices have no x, y and z of type float or double"));
        };
        let color = ["red", "green", "blue"].map(|name| find(name, |scalar| scalar == Scalar::U8));
        let mut values = vec![0.0; element.properties.len()];
        let mut points = Vec::with_capacity(element.rows);
        for row in 0..element.rows {
            self.row(element, row, encoding, &mut values)?;
            let position = [values[x], values[y], values[z]];
            if position.iter().all(|value| value.is_finite()) {
                let color = color.map(|place| place.map_or(0, |place| values[place] as u8));
                points.push(Point { position, color, error: None, seen: None, track: Vec::new() });
            }
        }
        Ok(points)
    }

    /// Reads the numbers of the next row and skips its lists.
    fn row(
        &mut self,
        element: &Element<'_>,
        row: usize,
        encoding: Encoding,
        values: &mut [f64],
    ) -> Result<()> {
        if encoding == Encoding::Ascii {
            return self.text_row(element, values);
        }
        let start = self.at;
        for (property, value) in element.properties.iter().zip(values) {
            let read = match property.count {
                None => self.number(property.scalar, encoding).map(|number| *value = number),
                Some(count) => self.number(count, encoding).and_then(|count| {
                    // Counts below 0 are cast to 0.
                    self.skip((count as usize).checked_mul(property.scalar.size())?)
                }),
            };
            if read.is_none() {
                let what = format!("the file ends within row {row} of element \"{}\"", shown(element.name));
                return Err(self.wrong(format_args!(" byte {start}"), what));
            }
        }
        Ok(())
    }

    fn skip(&mut self, bytes: usize) -> Option<()> {
        self.at = self.at.checked_add(bytes).filter(|end| *end <= self.bytes.len())?;
        Some(())
    }

    fn number(&mut self, scalar: Scalar, encoding: Encoding) -> Option<f64> {
        let own = self.left().get(..scalar.size())?;
        self.at += own.len();
        let mut bytes = [0; 8];
        bytes[..own.len()].copy_from_slice(own);
        if encoding == Encoding::Big {
            bytes[..own.len()].reverse();
        }
        Some(scalar.value(bytes))
    }

    fn text_row(&mut self, element: &Element<'_>, values: &mut [f64]) -> Result<()> {
        let line = loop {
            match self.line() {
                Some(b"") => {}
                Some(line) => break line,
                None => {
                    let what =
                        format!("the file ends within the rows of element \"{}\"", shown(element.name));
                    return Err(self.wrong_line(what));
                }
            }
        };
        let text = std::str::from_utf8(line).map_err(|_| self.wrong_line("is not UTF-8"))?;
        let mut words = text.split_ascii_whitespace();
        for (property, value) in element.properties.iter().zip(values) {
            let read = self.word(&mut words, property)?;
            match property.count {
                None => *value = read,
                Some(_) => {
                    for _ in 0..read as u64 {
                        self.word(&mut words, property)?;
                    }
                }
            }
        }
        match words.next() {
            None => Ok(()),
            Some(word) => Err(self.wrong_line(format!("\"{}\" follows the last property", shown(word)))),
        }
    }

    fn word(&self, words: &mut SplitAsciiWhitespace<'_>, property: &Property<'_>) -> Result<f64> {
        let name = shown(property.name);
        let word = words.next().ok_or_else(|| self.wrong_line(format!("ends where \"{name}\" belongs")))?;
        word.parse().map_err(|_| self.wrong_line(format!("\"{name}\" is \"{}\", not a number", shown(word))))
    }
}

/// Parses a property from the words after the keyword `property`.
fn property<'a>(mut words: SplitAsciiWhitespace<'a>) -> Option<Property<'a>> {
    let first = words.next()?;
    let count = if first == "list" { Some(Scalar::of(words.next()?)?) } else { None };
    let scalar = Scalar::of(if count.is_some() { words.next()? } else { first })?;
    Some(Property { name: words.next()?, count, scalar })
}

/// Returns the beginning of a text, for messages.
fn shown(text: &str) -> String {
    text.chars().take(40).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PROPERTIES: &str = "element face 2\nproperty list uchar int vertex_indices\nelement vertex 2\nproperty double x\n\
                              property float y\nproperty uchar red\nproperty list ushort float more\nproperty float z\n\
                              element edge 7\nend_header\n";

    fn read(text: &str) -> Result<Vec<Point>> {
        points("p.ply", text.as_bytes())
    }

    #[test]
    fn text_and_both_orders_of_bytes_hold_the_same_points() {
        let text = format!(
            "ply\r\nformat ascii 1.0\ncomment \u{e9}\n{PROPERTIES}3 0 1 2\n0\n1.5 -2 255 0 3\n\n0.25 1e3 7 2 9 9 -1"
        );
        let found = read(&text).unwrap();
        assert_eq!(
            found.iter().map(|point| point.position).collect::<Vec<_>>(),
            [[1.5, -2.0, 3.0], [0.25, 1e3, -1.0]]
        );
        assert_eq!(found[0].color, [255, 0, 0]);
        for order in ["little", "big"] {
            let mut bytes = format!("ply\nformat binary_{order}_endian 1.0\n{PROPERTIES}").into_bytes();
            let mut put = |value: &[u8]| {
                let turned = value.iter().rev().copied();
                if order == "big" { bytes.extend(turned) } else { bytes.extend(value) }
            };
            put(&[3]);
            (0..3_i32).for_each(|index| put(&index.to_le_bytes()));
            put(&[0]);
            for (x, y, red, more, z) in
                [(1.5_f64, -2.0_f32, 255, &[][..], 3.0_f32), (0.25, 1e3, 7, &[9.0_f32, 9.0], -1.0)]
            {
                put(&x.to_le_bytes());
                put(&y.to_le_bytes());
                put(&[red]);
                put(&(more.len() as u16).to_le_bytes());
                more.iter().for_each(|value| put(&value.to_le_bytes()));
                put(&z.to_le_bytes());
            }
            assert_eq!(points("p.ply", &bytes).unwrap(), found, "{order}");
            for length in 0..bytes.len() {
                let error = points("p.ply", &bytes[..length]).unwrap_err();
                assert!(
                    error.kind() == trimip_core::ErrorKind::Input && error.message().starts_with("p.ply"),
                    "{length}: {error}"
                );
            }
        }
    }

    #[test]
    fn what_is_wrong_is_named_with_its_line_or_byte() {
        let head =
            "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n";
        for (text, parts) in [
            ("{\"frames\": []}".to_string(), "p.ply:1: is not \"ply\""),
            ("ply\nformat utf8 1.0\n".into(), "p.ply:2: "),
            ("ply\nelement vertex 0\nend_header\n".into(), "p.ply:3: the header states no format"),
            (format!("{head}property vec3 w\n"), "p.ply:7: \"property vec3 w\""),
            (head.to_string(), "p.ply:6: the file ends within its header"),
            (format!("{head}end_header\n1.00 2 3\n4 5\n"), "p.ply:9: ends where \"z\" belongs"),
            (format!("{head}end_header\n1 2 3\n4 5 six\n"), "p.ply:9: \"z\" is \"six\", not a number"),
            (format!("{head}end_header\n1 2 3 4\n4 5 6\n"), "p.ply:8: \"4\" follows"),
            (format!("{head}end_header\n1 2 3\n           \n"), "p.ply:9: the file ends"),
            (format!("{head}end_header\n1 2 3\n"), "2 rows of element \"vertex\" do not fit into the 6 bytes"),
            ("ply\nformat ascii 1.0\nelement face 0\nend_header\n".into(), "p.ply: has no element \"vertex\""),
            (
                "ply\nformat binary_little_endian 1.0\nelement vertex 18446744073709551615\nproperty float x\n\
                 property float y\nproperty float z\nend_header\n"
                    .into(),
                "18446744073709551615 rows",
            ),
            (
                "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n".into(),
                "p.ply: its vertices have no x, y and z",
            ),
        ] {
            let error = read(&text).unwrap_err();
            assert!(error.kind() == trimip_core::ErrorKind::Input && error.message().contains(parts), "{parts}: {error}");
        }
        // Rows without properties have no bytes, so the reader must not loop over them.
        let endless = "ply\nformat ascii 1.0\nelement nothing 18446744073709551615\nelement vertex 1\nproperty float x\n\
                       property float y\nproperty float z\nend_header\n1 2 nan\n";
        assert_eq!(read(endless).unwrap(), []);
    }
}
