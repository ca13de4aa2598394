//! Protects a run folder. A folder with files that no run wrote is refused before anything is written, and a lock keeps
//! a second process out. A folder belongs to a run if `metrics.jsonl` contains an event, which the run writes first and
//! removes last, or if its checkpoint begins with the header of a checkpoint.

use super::folder::RunFolder;
use std::fs::{File, TryLockError};
use std::io::Read;
use std::path::{Path, PathBuf};
use trimip_core::{
    Advice, Error, Result,
    engine::{checkpoint::FORMAT, events::Event},
    plain_file,
};

/// Number of leading bytes of a checkpoint that are searched for its format.
const HEAD: u64 = 1 << 16;

impl RunFolder {
    /// Returns true if a run of this program wrote the folder.
    pub fn is_ours(&self) -> bool {
        has_event(&self.metrics()) || is_checkpoint(&self.checkpoint())
    }

    /// Refuses a folder that no run wrote but that contains files which a run would replace or remove. Writes nothing.
    ///
    /// # Errors
    /// When there is such a file; the message names one.
    pub fn expect_no_others(&self) -> Result<()> {
        if self.is_ours() {
            return Ok(());
        }
        let mut others: Vec<PathBuf> = self.files().into_iter().chain(self.pictures()).collect();
        // An empty event file contains no data: a run that was killed at its start leaves one.
        let empty = |path: &Path| std::fs::metadata(path).is_ok_and(|metadata| metadata.len() == 0);
        others.retain(|path| path.exists() && !(*path == self.metrics() && empty(path)));
        let Some(first) = others.first() else { return Ok(()) };
        let more = match others.len() - 1 {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        Err(Error::input(
            format!("{}{more}", first.display()),
            "would be replaced, and no run wrote this folder",
            Advice::AnyOf(vec![Advice::OtherFolder, "move these files away".into()]),
        ))
    }

    /// Locks the folder for this process until the lock is dropped or the process ends, however it ends.
    ///
    /// # Errors
    /// When another process holds the lock, or the lock file cannot be written.
    pub fn lock(&self) -> Result<Lock> {
        self.lock_with(File::try_lock)
    }

    /// Locks the folder with `try_lock`.
    fn lock_with(&self, try_lock: impl Fn(&File) -> std::result::Result<(), TryLockError>) -> Result<Lock> {
        let path = self.root().join("run.lock");
        loop {
            // Windows locks only files that are open for reading, or for writing at any place.
            let file = File::options()
                .create(true)
                .read(true)
                .write(true)
                .truncate(false)
                .open(&path)
                .map_err(|error| Error::input(path.display(), error, Advice::OtherFolder))?;
            match try_lock(&file) {
                Ok(()) if is_at(&file, &path) => return Ok(Lock { path, _file: file, warning: None }),
                // The previous holder has removed its file meanwhile, so this lock is on a deleted file: try again.
                Ok(()) => {}
                Err(TryLockError::WouldBlock) => {
                    return Err(Error::input(
                        self.root().display(),
                        "another process works on this run",
                        Advice::AnyOf(vec![
                            "wait until it has ended, or stop it".into(),
                            Advice::OtherFolder,
                        ]),
                    ));
                }
                // A file system without locks cannot exclude other processes.
                Err(TryLockError::Error(error)) => {
                    let warning = format!(
                        "{}: cannot be locked ({error}): a second process could write into this folder; start none",
                        self.root().display()
                    );
                    return Ok(Lock { path, _file: file, warning: Some(warning) });
                }
            }
        }
    }
}

/// Locks the run folder to which the file `path` belongs, before the file is replaced; `None` if no run wrote the folder, or the
/// file is none of a run's files.
///
/// # Errors
/// For the reasons of [`RunFolder::lock`].
pub fn lock_for_writing(path: &Path) -> Result<Option<Lock>> {
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    let folder = RunFolder::new(parent.unwrap_or(Path::new(".")));
    let name = path.file_name();
    let is_of_run = folder.files().iter().any(|file| file.file_name() == name);
    (is_of_run && folder.is_ours()).then(|| folder.lock()).transpose()
}

/// A lock on a folder. Dropping it removes the lock file.
#[derive(Debug)]
pub struct Lock {
    path: PathBuf,
    /// One line if the file system has no locks: other processes are not excluded.
    pub(crate) warning: Option<String>,
    /// The lock is held while the file is open.
    _file: File,
}

impl Drop for Lock {
    fn drop(&mut self) {
        // A leftover file blocks no process: the operating system holds the lock, not the file. A file with content is not ours and stays.
        if std::fs::metadata(&self.path).is_ok_and(|metadata| metadata.len() == 0) {
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

/// Returns true if the open file is the one at `path`.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let place = |metadata: std::fs::Metadata| (metadata.dev(), metadata.ino());
    let (open, there) = (file.metadata().map(place), std::fs::metadata(path).map(place));
    matches!((open, there), (Ok(open), Ok(there)) if open == there)
}

/// Assumes that the open file is the one at `path`: this system offers no check.
#[cfg(not(unix))]
fn is_at(_file: &File, _path: &Path) -> bool {
    true
}

/// Returns true if some line is an event of a run.
fn has_event(path: &Path) -> bool {
    let bytes = plain_file::read(path).unwrap_or_default();
    String::from_utf8_lossy(&bytes).lines().any(|line| serde_json::from_str::<Event>(line).is_ok())
}

/// Returns true if the beginning of the file is that of a checkpoint, whether the file is complete or not.
fn is_checkpoint(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = plain_file::open(path).and_then(|file| file.take(HEAD).read_to_end(&mut head));
    read.is_ok() && head.windows(FORMAT.len()).any(|part| part == FORMAT.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::fixtures::evaluation;
    use crate::run::folder::picture_stem;
    use trimip_core::{
        Config,
        engine::checkpoint::{Checkpoint, TrainState},
    };

    fn folder() -> (tempfile::TempDir, RunFolder) {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        (temporary, folder)
    }

    #[test]
    fn every_file_that_a_run_would_replace_is_spared() {
        let (_keep, folder) = folder();
        folder.prepare_images().unwrap();
        folder.expect_no_others().unwrap();
        let picture = folder.images().join(format!("{}.png", picture_stem(0, "r_0", 1)));
        for path in folder.files().into_iter().chain([picture]) {
            std::fs::write(&path, "mine").unwrap();
            let error = folder.expect_no_others().unwrap_err();
            assert_eq!(error.kind(), trimip_core::ErrorKind::Input);
            assert!(
                error.message().contains(&path.display().to_string())
                    && error.message().contains("choose another folder"),
                "{error}"
            );
            std::fs::remove_file(&path).unwrap();
        }
        for name in ["notes.txt", "images/0001.png", "run.lock"] {
            std::fs::write(folder.root().join(name), "mine").unwrap();
        }
        folder.expect_no_others().unwrap();
    }

    #[test]
    fn events_or_a_checkpoint_make_a_folder_a_runs_own() {
        let (_keep, folder) = folder();
        std::fs::write(folder.config(), "seed = 1").unwrap();
        for (text, ours) in [("", false), ("{\"kind\":\"mine\"}\n", false), ("{\"kind\":\"st", false)] {
            std::fs::write(folder.metrics(), text).unwrap();
            assert_eq!(folder.is_ours(), ours, "{text}");
        }
        drop(folder.restart_events(&[evaluation(10, 1, false, 20.0)]).unwrap());
        assert!(folder.is_ours() && folder.expect_no_others().is_ok());
        std::fs::remove_file(folder.metrics()).unwrap();
        assert!(folder.expect_no_others().is_err());
        let (config, state) = (Config::default(), TrainState::default());
        Checkpoint { config, state, file: Default::default() }.write(&folder.checkpoint()).unwrap();
        assert!(folder.is_ours() && folder.expect_no_others().is_ok());
    }

    #[test]
    fn a_lock_holds_until_it_is_dropped_and_leaves_nothing() {
        let (_keep, folder) = folder();
        let lock = folder.lock().unwrap();
        let error = folder.lock().unwrap_err();
        assert!(
            error.kind() == trimip_core::ErrorKind::Input && error.message().contains("another process"),
            "{error}"
        );
        drop(lock);
        drop(folder.lock().unwrap());
        assert_eq!(std::fs::read_dir(folder.root()).unwrap().count(), 0);
        // The leftover file of a killed process blocks no other process.
        std::fs::write(folder.root().join("run.lock"), "").unwrap();
        folder.lock().unwrap();
    }

    #[test]
    fn a_file_of_a_run_is_written_under_the_lock_of_the_run() {
        let (_keep, folder) = folder();
        // Without a run, nothing is locked.
        assert!(lock_for_writing(&folder.model()).unwrap().is_none());
        std::fs::write(folder.metrics(), serde_json::to_string(&evaluation(1, 1, true, 20.0)).unwrap())
            .unwrap();
        assert!(lock_for_writing(&folder.root().join("copy.safetensors")).unwrap().is_none());
        let held = folder.lock().unwrap();
        let error = lock_for_writing(&folder.model()).unwrap_err();
        assert!(error.message().contains("another process works on this run"), "{error}");
        drop(held);
        assert!(lock_for_writing(&folder.model()).unwrap().is_some());
    }

    #[test]
    fn a_file_system_without_locks_is_a_warning() {
        let (_keep, folder) = folder();
        let refused = |_: &File| Err(TryLockError::Error(std::io::ErrorKind::Unsupported.into()));
        let lock = folder.lock_with(refused).unwrap();
        let warning = lock.warning.as_deref().unwrap();
        assert!(warning.contains("cannot be locked (unsupported)"), "{warning}");
        drop(lock);
        assert_eq!(folder.lock().unwrap().warning, None);
    }
}
