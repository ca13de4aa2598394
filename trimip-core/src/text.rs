//! Text files as people and their editors write them: UTF-8 with or without a byte order mark, UTF-16 with a byte order
//! mark.

use crate::{Error, Result};
use std::{borrow::Cow, path::Path};

/// Returns the bytes of a text without the byte order mark that editors of some systems put first.
pub fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix("\u{feff}".as_bytes()).unwrap_or(bytes)
}

/// Returns the bytes of a text in UTF-8: without a byte order mark, and recoded from UTF-16 if the text begins with a
/// UTF-16 mark. Invalid UTF-16 is replaced by U+FFFD.
pub fn decoded(bytes: &[u8]) -> Cow<'_, [u8]> {
    let units = |from: fn([u8; 2]) -> u16| {
        let (pairs, _) = bytes[2..].as_chunks();
        let characters = char::decode_utf16(pairs.iter().map(|pair| from(*pair)));
        let text: String = characters.map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect();
        Cow::Owned(text.into_bytes())
    };
    match bytes {
        [0xff, 0xfe, ..] => units(u16::from_le_bytes),
        [0xfe, 0xff, ..] => units(u16::from_be_bytes),
        _ => Cow::Borrowed(without_mark(bytes)),
    }
}

/// Reads a text file; `advice` says what to do if the file cannot be read.
///
/// # Errors
/// When the file cannot be read, or is neither UTF-8 nor UTF-16 with a byte order mark.
pub fn read(path: &Path, advice: &str) -> Result<String> {
    let bytes = crate::plain_file::read(path)
        .map_err(|error| Error::input(path.display(), format!("cannot be read: {error}"), advice))?;
    of_bytes(path, &bytes)
}

/// Returns the text of a file with these bytes.
///
/// # Errors
/// When the bytes are neither UTF-8 nor UTF-16 with a byte order mark.
pub fn of_bytes(path: &Path, bytes: &[u8]) -> Result<String> {
    match std::str::from_utf8(&decoded(bytes)) {
        Ok(text) => Ok(text.into()),
        Err(error) => Err(Error::input(
            path.display(),
            format!("is not UTF-8 text (byte {})", error.valid_up_to()),
            "save it as UTF-8 text",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_is_read_over_and_what_is_no_text_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        for (bytes, text) in [(&b"\xef\xbb\xbfseed = 1"[..], "seed = 1"), (b"\xef\xbb\xbf", ""), (b"x", "x")]
        {
            std::fs::write(&path, bytes).unwrap();
            assert_eq!(read(&path, "").unwrap(), text);
        }
        for (bytes, text) in
            [(&b"\xff\xfes\0\xfc\0"[..], "sü"), (b"\xfe\xff\0s", "s"), (b"\xff\xfe\0\xd8s\0", "\u{fffd}s")]
        {
            std::fs::write(&path, bytes).unwrap();
            assert_eq!(read(&path, "").unwrap(), text);
        }
        std::fs::write(&path, b"s\xff").unwrap();
        let error = read(&path, "").unwrap_err();
        assert!(
            error.kind() == crate::ErrorKind::Input && error.message().contains("a.txt: is not UTF-8"),
            "{error}"
        );
    }
}
