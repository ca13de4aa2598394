//! Text files as people and their editors write them: UTF-8, with or without a byte order mark.

use crate::{Error, Result};
use std::path::Path;

/// The bytes of a text without the byte order mark that editors of some systems put first.
pub fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix("\u{feff}".as_bytes()).unwrap_or(bytes)
}

/// Reads a text file; `advice` says what to do if it cannot be read.
///
/// # Errors
/// When the file cannot be read or is not UTF-8.
pub fn read(path: &Path, advice: &str) -> Result<String> {
    let bytes = std::fs::read(path)
        .map_err(|error| Error::input(path.display(), format!("cannot be read: {error}"), advice))?;
    match std::str::from_utf8(without_mark(&bytes)) {
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
        std::fs::write(&path, b"\xff\xfes\0").unwrap();
        let error = read(&path, "").unwrap_err();
        assert!(error.exit_code() == 2 && error.message.contains("a.txt: is not UTF-8"), "{error}");
    }
}
