//! JSON documents with errors that name their place: `file:line:column` for syntax, `file: frame 17 (path)` for content.

use crate::files;
use serde_json::{Map, Value};
use std::path::Path;
use trimip_core::{Error, Place, Result, text::decoded};

/// Reads and parses a file.
pub(crate) fn read(path: &Path) -> Result<Value> {
    let bytes = files::read(path)?;
    parse(path, &bytes)
}

/// Parses the bytes of a file.
pub(crate) fn parse(path: &Path, bytes: &[u8]) -> Result<Value> {
    let bytes = &*decoded(bytes);
    serde_json::from_slice(bytes).map_err(|error| {
        let (line, column) = (error.line(), error.column());
        let place = Place::Text { file: path.into(), line, column: Some(column) };
        match not_a_number(bytes, line, column) {
            Some(word) => Error::input(
                place,
                format!("{word} is not a finite number"),
                "export the camera again or remove its frame",
            ),
            None => {
                let text = error.to_string();
                let what = text.split(" at line ").next().unwrap_or(&text);
                Error::input(place, format!("invalid JSON: {what}"), "correct the file or export it again")
            }
        }
    })
}

/// Returns the word at which the parser stopped, if it is a number that is not finite, such as Python's NaN and Infinity.
fn not_a_number(bytes: &[u8], line: usize, column: usize) -> Option<String> {
    let line = bytes.split(|&byte| byte == b'\n').nth(line.checked_sub(1)?)?;
    let is_word = |byte: &u8| byte.is_ascii_alphanumeric() || b"+-.".contains(byte);
    let at = column.saturating_sub(1).min(line.len());
    let start = line[..at].iter().rposition(|byte| !is_word(byte)).map_or(0, |index| index + 1);
    let word: Vec<u8> = line[start..].iter().copied().take_while(is_word).take(40).collect();
    let word = String::from_utf8(word).ok()?;
    let number = word.parse::<f64>().ok()?;
    (!number.is_finite()).then_some(word)
}

/// A JSON object, and its place for errors.
pub(crate) struct Node<'a> {
    pub(crate) place: Place,
    object: &'a Map<String, Value>,
}

impl<'a> Node<'a> {
    pub(crate) fn new(place: impl Into<Place>, value: &'a Value) -> Result<Self> {
        let place = place.into();
        match value {
            Value::Object(object) => Ok(Self { place, object }),
            other => Err(Error::input(
                place,
                format!("expected an object, found {}", kind(other)),
                "export the file again",
            )),
        }
    }

    /// Returns the value of a key, or `None` if it is absent or null.
    pub(crate) fn get(&self, key: &str) -> Option<&'a Value> {
        self.object.get(key).filter(|value| !value.is_null())
    }

    pub(crate) fn keys(&self) -> impl Iterator<Item = &'a str> {
        self.object.keys().map(String::as_str)
    }

    /// Returns the value of a required key.
    pub(crate) fn required(&self, key: &str) -> Result<&'a Value> {
        self.get(key).ok_or_else(|| {
            Error::input(&self.place, format!("has no \"{key}\""), "add the key or export the file again")
        })
    }

    /// Returns the array under a required key.
    pub(crate) fn array(&self, key: &str) -> Result<&'a [Value]> {
        let value = self.required(key)?;
        value.as_array().map(Vec::as_slice).ok_or_else(|| self.unexpected(key, "an array", value))
    }

    /// Returns the number under a key, or `None` if it is absent or null.
    pub(crate) fn number(&self, key: &str) -> Result<Option<f64>> {
        self.get(key)
            .map(|value| value.as_f64().ok_or_else(|| self.unexpected(key, "a number", value)))
            .transpose()
    }

    /// Returns the number under a key, which may be written as a text, or `None` if it is absent or null.
    pub(crate) fn number_or_text(&self, key: &str) -> Result<Option<f64>> {
        let number = self.get(key).and_then(|value| value.as_str()?.trim().parse().ok());
        match number.filter(|value: &f64| value.is_finite()) {
            Some(number) => Ok(Some(number)),
            None => self.number(key),
        }
    }

    /// Returns the text under a key, or `None` if it is absent or null.
    pub(crate) fn text(&self, key: &str) -> Result<Option<&'a str>> {
        let text = |value: &'a Value| value.as_str().ok_or_else(|| self.unexpected(key, "a text", value));
        self.get(key).map(text).transpose()
    }

    /// Returns the text under a required key.
    pub(crate) fn required_text(&self, key: &str) -> Result<&'a str> {
        let value = self.required(key)?;
        value.as_str().ok_or_else(|| self.unexpected(key, "a text", value))
    }

    /// Returns an error about the value of a key.
    pub(crate) fn unexpected(&self, key: &str, expected: &str, value: &Value) -> Error {
        Error::input(
            &self.place,
            format!("\"{key}\" is {}", kind(value)),
            format!("expected {expected}: correct the file or export it again"),
        )
    }
}

/// Formats a value for a message, shortened if it is long.
fn kind(value: &Value) -> String {
    match value {
        Value::Null => "null".into(),
        Value::Bool(value) => value.to_string(),
        Value::Number(number) => number.to_string(),
        Value::String(text) => format!("the text {:?}", text.chars().take(40).collect::<String>()),
        Value::Array(values) => format!("an array of {}", values.len()),
        Value::Object(_) => "an object".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn syntax_errors_name_line_and_column() {
        let error = parse(Path::new("a.json"), b"{\n \"frames\": [1,, 2]\n}").unwrap_err();
        assert!(error.message().starts_with("a.json:2:15: invalid JSON: expected value;"), "{error}");
    }

    #[test]
    fn numbers_that_are_not_finite_are_named() {
        for (text, word) in [
            ("{\n\"a\": [0.0, NaN]}", "NaN"),
            ("[1, Infinity]", "Infinity"),
            ("[-Infinity, 2]", "-Infinity"),
            ("[1, 1e999]", "1e999"),
        ] {
            let error = parse(Path::new("a.json"), text.as_bytes()).unwrap_err();
            assert!(error.message().contains(&format!(": {word} is not a finite number")), "{text}: {error}");
        }
    }

    #[test]
    fn a_byte_order_mark_is_read_over() {
        for bytes in [&b"\xef\xbb\xbf[]"[..], b"\xff\xfe[\0]\0", b"\xfe\xff\0[\0]"] {
            assert_eq!(parse(Path::new("a"), bytes).unwrap(), Value::Array(vec![]));
        }
    }
}
