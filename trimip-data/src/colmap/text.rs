//! The text files of a COLMAP model: numbers are separated by white space, and lines that begin with # are comments. An
//! image has two lines; its second holds its features and may be empty.

use super::{
    lenses::{ADVICE, Kind, ModelCamera},
    model::{File, ModelImage, ModelPoint},
};
use std::str::{FromStr, SplitAsciiWhitespace};
use trimip_core::{Error, Result, text::without_mark};

/// Least bytes of a camera: `1 PINHOLE 1 1 1 1 1 1` and a line break.
const CAMERA: usize = 22;
/// Least bytes of a point: eight numbers of one digit.
const POINT: usize = 16;
/// Least bytes of an image's two lines: nine numbers and a name of one character.
const IMAGE: usize = 21;

pub(super) fn cameras(file: File<'_>) -> Result<Vec<ModelCamera>> {
    let lines = Lines::new(file);
    let mut cameras = Vec::with_capacity(lines.entries().min(file.bytes.len() / CAMERA + 1));
    for line in lines.filter(|line| line.as_ref().map_or(true, Line::has_entry)) {
        let mut line = line?;
        let id = line.number("a camera's number")?;
        let kind = line.word("a camera model")?;
        let kind = Kind::of_name(kind).map_err(|what| line.wrong(format!("camera {id} {what}"), ADVICE))?;
        let size = [line.side("a width")?, line.side("a height")?];
        let count = line.words.clone().count();
        let mut parameters = Vec::with_capacity(count);
        for _ in 0..count {
            parameters.push(line.parameter()?);
        }
        let camera = ModelCamera::new(id, kind, size, parameters.into());
        cameras.push(
            camera.map_err(|what| line.wrong(format!("camera {id} {what}"), "export the model again"))?,
        );
    }
    Ok(cameras)
}

pub(super) fn images(file: File<'_>) -> Result<Vec<ModelImage>> {
    let mut lines = Lines::new(file);
    let mut images = Vec::with_capacity(lines.entries().div_ceil(2).min(file.bytes.len() / IMAGE + 1));
    while let Some(line) = lines.next() {
        let mut line = line?;
        if !line.has_entry() {
            continue;
        }
        let id = line.number("an image's number")?;
        let rotation = line.numbers("a rotation")?;
        if rotation == [0.0; 4] {
            return Err(
                line.wrong(format!("image {id} has a rotation of length 0"), "export the model again")
            );
        }
        let translation = line.numbers("a translation")?;
        let camera = line.number("a camera's number")?;
        // Names may hold blanks.
        let name = after_words(line.text, 9);
        if name.is_empty() {
            return Err(line.wrong(format!("image {id} has no name"), "export the model again"));
        }
        let places = match lines.next() {
            None => Vec::new(),
            Some(features) => places(features?, id)?,
        };
        images.push(ModelImage {
            id,
            camera,
            rotation,
            translation,
            name: name.into(),
            places: places.into(),
        });
    }
    Ok(images)
}

/// Reads the positions of features in the second line of an image.
fn places(mut line: Line<'_>, image: u32) -> Result<Vec<[f64; 2]>> {
    let count = line.words.clone().count();
    if !count.is_multiple_of(3) {
        return Err(line.wrong(
            format!(
                "the features of image {image} are {count} words, not triples of x, y and a point's number"
            ),
            "each image has two lines, of which the second may be empty: export the model again",
        ));
    }
    let mut places = Vec::with_capacity(count / 3);
    for _ in 0..count / 3 {
        places.push(line.numbers("a place")?);
        line.number::<i128>("a point's number or -1")?;
    }
    Ok(places)
}

pub(super) fn points(file: File<'_>) -> Result<Vec<ModelPoint>> {
    let lines = Lines::new(file);
    let mut points = Vec::with_capacity(lines.entries().min(file.bytes.len() / POINT + 1));
    for line in lines.filter(|line| line.as_ref().map_or(true, Line::has_entry)) {
        let mut line = line?;
        let id = line.number("a point's number")?;
        let position = line.numbers("a position")?;
        let color = [line.number("a colour")?, line.number("a colour")?, line.number("a colour")?];
        let error = line.finite("an error")?;
        let count = line.words.clone().count();
        if !count.is_multiple_of(2) {
            let what = format!("the track of point {id} is {count} numbers, not pairs of image and feature");
            return Err(line.wrong(what, "export the model again"));
        }
        let mut track = Vec::with_capacity(count / 2);
        for _ in 0..count / 2 {
            track.push([line.number("an image's number")?, line.number("a feature's index")?]);
        }
        points.push(ModelPoint { id, position, color, error, track: track.into() });
    }
    Ok(points)
}

/// Returns the rest of a line after its first `count` words.
fn after_words(line: &str, count: usize) -> &str {
    let mut rest = line.trim_ascii();
    for _ in 0..count {
        let end = rest.find(|c: char| c.is_ascii_whitespace()).unwrap_or(rest.len());
        rest = rest[end..].trim_ascii_start();
    }
    rest
}

/// The lines of a file with their numbers.
#[derive(Clone)]
struct Lines<'a> {
    file: File<'a>,
    at: usize,
    number: usize,
}

impl<'a> Lines<'a> {
    fn new(file: File<'a>) -> Self {
        let bytes = without_mark(file.bytes);
        Self { file: File { bytes, ..file }, at: 0, number: 0 }
    }

    /// Returns the number of lines that are neither empty nor comments.
    fn entries(&self) -> usize {
        let lines = self.file.bytes.split(|&byte| byte == b'\n').map(<[u8]>::trim_ascii);
        lines.filter(|line| !line.is_empty() && line[0] != b'#').count()
    }
}

impl<'a> Iterator for Lines<'a> {
    type Item = Result<Line<'a>>;

    fn next(&mut self) -> Option<Self::Item> {
        let rest = self.file.bytes.get(self.at..).filter(|rest| !rest.is_empty())?;
        let length = rest.iter().position(|&byte| byte == b'\n').unwrap_or(rest.len());
        (self.at, self.number) = (self.at + length + 1, self.number + 1);
        let (file, number) = (self.file.name, self.number);
        Some(match std::str::from_utf8(&rest[..length]) {
            Ok(text) => Ok(Line { file, number, text, words: text.split_ascii_whitespace() }),
            Err(_) => Err(Error::input(format!("{file}:{number}"), "is not UTF-8", "export the model again")),
        })
    }
}

/// A line, and the words of it that have not been read.
struct Line<'a> {
    file: &'a str,
    number: usize,
    text: &'a str,
    words: SplitAsciiWhitespace<'a>,
}

impl<'a> Line<'a> {
    fn has_entry(&self) -> bool {
        self.words.clone().next().is_some_and(|word| !word.starts_with('#'))
    }

    fn wrong(&self, what: impl std::fmt::Display, advice: &str) -> Error {
        Error::input(format!("{}:{}", self.file, self.number), what, advice)
    }

    fn word(&mut self, expected: &str) -> Result<&'a str> {
        let word = self.words.next();
        word.ok_or_else(|| self.wrong(format!("ends where {expected} belongs"), "export the model again"))
    }

    fn number<T: FromStr>(&mut self, expected: &str) -> Result<T> {
        let word = self.word(expected)?;
        word.parse().map_err(|_| {
            let word: String = word.chars().take(40).collect();
            self.wrong(format!("\"{word}\" is not {expected}"), "correct the line or export the model again")
        })
    }

    fn finite(&mut self, expected: &str) -> Result<f64> {
        let value: f64 = self.number(expected)?;
        if value.is_finite() {
            return Ok(value);
        }
        Err(self.wrong(format!("{expected} is {value}, not a finite number"), "export the model again"))
    }

    /// Reads a number of pixels; some exporters write 1920.0.
    fn side(&mut self, expected: &str) -> Result<u64> {
        let side: f64 = self.number(expected)?;
        // The cast saturates; [`ModelCamera::new`] checks the range.
        if side.fract() == 0.0 && side >= 0.0 {
            return Ok(side as u64);
        }
        Err(self.wrong(format!("{side} is not {expected}"), "correct the line or export the model again"))
    }

    /// Reads a parameter of a camera. After a failed calibration it is NaN, which each system's library writes in its own way.
    fn parameter(&mut self) -> Result<f64> {
        let word = self.words.clone().next().unwrap_or_default().to_ascii_lowercase();
        let unsigned = word.trim_start_matches(['-', '+']);
        if unsigned.starts_with("nan") || unsigned.starts_with("1.#") {
            self.words.next();
            return Ok(f64::NAN);
        }
        self.number("a parameter")
    }

    fn numbers<const N: usize>(&mut self, expected: &str) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.finite(expected)?;
        }
        Ok(values)
    }
}
