//! Reads files by paths that a user or a file states. Only plain files are read: a pipe or a device could block for ever or have no
//! end.

use crate::memory::available_memory;
use std::fs::{self, File};
use std::io::{Error, ErrorKind, Read, Result};
use std::path::Path;

/// Opens a plain file for reading.
///
/// # Errors
/// When the file cannot be opened, or is a folder, a pipe or a device.
pub fn open(path: &Path) -> Result<File> {
    // Opening a pipe would wait for a writer, so its kind is examined first.
    if !fs::metadata(path)?.is_file() {
        return Err(Error::new(ErrorKind::InvalidInput, "it is not a plain file"));
    }
    File::open(path)
}

/// Reads a plain file, in bytes.
///
/// # Errors
/// For the reasons of [`open`], when the file cannot be read, or when it is larger than the available memory.
pub fn read(path: &Path) -> Result<Vec<u8>> {
    let mut file = open(path)?;
    let length = file.metadata()?.len();
    if available_memory().is_some_and(|available| length > available) {
        let gigabytes = length as f64 / 1e9;
        let message = format!("it has {gigabytes:.1} GB, more than the available memory");
        return Err(Error::new(ErrorKind::OutOfMemory, message));
    }
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or_default());
    file.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Reads a plain file as text.
///
/// # Errors
/// For the reasons of [`read`], or when the bytes are not UTF-8.
pub fn read_to_string(path: &Path) -> Result<String> {
    String::from_utf8(read(path)?).map_err(|error| Error::new(ErrorKind::InvalidData, error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plain_file_is_read_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        fs::write(&path, "text").unwrap();
        assert_eq!(read(&path).unwrap(), b"text");
        assert_eq!(read_to_string(&path).unwrap(), "text");
        assert_eq!(read(folder.path()).unwrap_err().to_string(), "it is not a plain file");
        assert_eq!(read(&folder.path().join("b")).unwrap_err().kind(), ErrorKind::NotFound);
        fs::write(&path, [0xff]).unwrap();
        assert_eq!(read_to_string(&path).unwrap_err().kind(), ErrorKind::InvalidData);
    }

    #[cfg(unix)]
    #[test]
    fn a_device_without_an_end_is_refused() {
        for path in ["/dev/zero", "/dev/null"] {
            assert_eq!(read(Path::new(path)).unwrap_err().to_string(), "it is not a plain file");
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_file_larger_than_the_memory_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        // The file is sparse: it takes no space on the disk.
        if File::create(&path).unwrap().set_len(1 << 44).is_ok() {
            assert!(read(&path).unwrap_err().to_string().contains("more than the available memory"));
        }
    }
}
