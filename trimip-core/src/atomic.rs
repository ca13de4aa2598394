//! Files that are replaced as a whole: they are written under a temporary name and renamed, so a killed run leaves no partial
//! file.

use crate::{Error, Result};
use std::fs::File;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Number of attempts to rename a file that another program has open, and the time between them.
const ATTEMPTS: (u32, Duration) = (20, Duration::from_millis(50));

/// Writes `bytes` to a temporary file and renames it, so that readers see either the old file or the complete new one.
///
/// # Errors
/// When the file cannot be written; the old file is then unchanged.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    replace_atomically(path, |file| file.write_all(bytes))
}

/// Returns the temporary name of a folder while it is filled: `path` with `.tmp` appended.
pub fn temporary(path: &Path) -> PathBuf {
    named(path, ".tmp")
}

/// Returns the temporary name of a file while it is written: `path` with `.trimip.tmp` appended. Only a killed process leaves this
/// file behind, and the next one replaces it.
pub fn temporary_file(path: &Path) -> PathBuf {
    named(path, ".trimip.tmp")
}

fn named(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

/// Lets `fill` write a temporary file next to `path`, flushes it to disk, renames it to `path` and flushes the folder.
/// On failure the old file stays unchanged, and the temporary file is removed.
///
/// # Errors
/// When `fill` fails, or the file cannot be created, flushed or renamed.
pub fn replace_atomically<T>(path: &Path, fill: impl FnOnce(&mut File) -> std::io::Result<T>) -> Result<T> {
    let failed = |error: std::io::Error| {
        let advice = match is_open_elsewhere(&error) {
            true => "close it in the program that has it open, or choose another place",
            false => "free space there or choose another place",
        };
        Error::input(path.display(), format!("cannot write: {error}"), advice)
    };
    let temporary = temporary_file(path);
    let mut file = new_file(&temporary).map_err(failed)?;
    let write = || {
        let result = fill(&mut file)?;
        file.sync_all()?;
        drop(file);
        rename(&temporary, path)?;
        Ok(result)
    };
    let result = write().map_err(|error: std::io::Error| {
        // Remove the partial file: it only takes space, on a disk that may be full.
        let _ = std::fs::remove_file(&temporary);
        failed(error)
    })?;
    sync_folder_of(path);
    Ok(result)
}

/// Creates a file in place of one that a killed process has left behind. A link of this name is replaced, not followed.
fn new_file(path: &Path) -> std::io::Result<File> {
    let create = || File::options().write(true).create_new(true).open(path);
    match create() {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            std::fs::remove_file(path)?;
            create()
        }
        result => result,
    }
}

/// Renames a file. If another program has the target open, tries again for a second.
fn rename(from: &Path, to: &Path) -> std::io::Result<()> {
    for _ in 1..ATTEMPTS.0 {
        match std::fs::rename(from, to) {
            Err(error) if is_open_elsewhere(&error) => std::thread::sleep(ATTEMPTS.1),
            result => return result,
        }
    }
    std::fs::rename(from, to)
}

/// Returns true for the errors with which Windows refuses to replace a file that another program has open: access denied, sharing
/// violation, user-mapped section open.
fn is_open_elsewhere(error: &std::io::Error) -> bool {
    cfg!(windows) && matches!(error.raw_os_error(), Some(5 | 32 | 1224))
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
            Err::<(), _>(ErrorKind::StorageFull.into())
        })
        .unwrap_err();
        assert!(error.to_string().contains("cannot write"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_file_of_the_user_stays_and_that_of_a_killed_process_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(temporary(&path), "the user's").unwrap();
        std::fs::write(temporary_file(&path), "half of the ne").unwrap();
        write_atomically(&path, b"new").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(std::fs::read(temporary(&path)).unwrap(), b"the user's");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_of_the_temporary_name_is_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let (path, target) = (folder.path().join("file"), folder.path().join("target"));
        std::fs::write(&target, "old").unwrap();
        std::os::unix::fs::symlink(&target, temporary_file(&path)).unwrap();
        write_atomically(&path, b"new").unwrap();
        assert_eq!(std::fs::read(&target).unwrap(), b"old");
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert!(!std::fs::symlink_metadata(&path).unwrap().is_symlink());
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
            assert_eq!(names, [temporary_file(&path)]);
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
