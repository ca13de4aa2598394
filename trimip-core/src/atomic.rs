//! Files that are replaced as a whole: they are written under a temporary name and renamed, so a killed run leaves no partial
//! file.

use crate::{Error, Result};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Writes `bytes` to a temporary file and renames it, so that readers see either the old file or the complete new one.
///
/// # Errors
/// When the file cannot be written; the old file is then unchanged.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    replace_atomically(path, |file| file.write_all(bytes))
}

/// Returns the temporary name of `path` while it is written: `path` with `.tmp` appended. Only a killed process leaves
/// this file behind.
pub fn temporary(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".tmp");
    name.into()
}

/// Lets `fill` write a temporary file next to `path`, flushes it to disk, renames it to `path` and flushes the folder.
/// On failure the old file stays unchanged, and the temporary file is removed.
pub(crate) fn replace_atomically<T>(
    path: &Path,
    fill: impl FnOnce(&mut File) -> std::io::Result<T>,
) -> Result<T> {
    let temporary = temporary(path);
    let write = || {
        let mut file = File::create(&temporary)?;
        let result = fill(&mut file)?;
        file.sync_all()?;
        std::fs::rename(&temporary, path)?;
        Ok(result)
    };
    let result = write().map_err(|error: std::io::Error| {
        // Remove the partial file: it only takes space, on a disk that may be full.
        let _ = std::fs::remove_file(&temporary);
        Error::input(
            path.display(),
            format!("cannot write: {error}"),
            "free space there or choose another place",
        )
    })?;
    sync_folder_of(path);
    Ok(result)
}

/// Flushes the folder entry of a file or folder to disk; without this a power failure may undo a rename. Does nothing
/// where the system cannot open a folder or the file system cannot flush one.
pub fn sync_folder_of(path: &Path) {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if let Ok(folder) = File::open(folder) {
        let _ = folder.sync_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_write_that_fails_leaves_the_old_file_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        write_atomically(&path, b"old").unwrap();
        let error = replace_atomically(&path, |file| {
            file.write_all(b"half of the ne")?;
            Err::<(), _>(std::io::ErrorKind::StorageFull.into())
        })
        .unwrap_err();
        assert!(error.to_string().contains("cannot write"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn a_write_makes_one_temporary_file_of_a_known_name() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        replace_atomically(&path, |_| {
            let names: Vec<_> =
                std::fs::read_dir(folder.path())?.flatten().map(|entry| entry.path()).collect();
            assert_eq!(names, [temporary(&path)]);
            Ok(())
        })
        .unwrap();
        // The permissions are those of any new file of the user.
        let rights = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode();
        std::fs::write(folder.path().join("plain"), "").unwrap();
        write_atomically(&path, b"new").unwrap();
        assert_eq!(rights(&path), rights(&folder.path().join("plain")));
    }
}
