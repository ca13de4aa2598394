//! The folder of a capture: its file names, and which stages are done. A stage writes its outputs under temporary names, renames them once
//! all are complete, and writes its state last: its inputs and its result. A stage whose state is missing or has other inputs is repeated,
//! and so are all stages after it.

use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::Value;
use std::{
    fs::{self, File, TryLockError},
    io,
    path::{Path, PathBuf},
};
use trimip::{Advice, Error, Result, run::folder::create_writable};
use trimip_core::{
    atomic::{sync_folder_of, write_atomically},
    plain_file,
    scene::fingerprint,
};

/// The stages of a capture, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// Copies photographs, or takes frames out of a film; written to `images/`.
    Pictures,
    /// Features of each picture; written to `features.db`.
    Features,
    /// Matches of pairs of pictures; written to `database.db` together with the features.
    Matches,
    /// Cameras and points: all models in `models/`, the best one in `sparse/0`.
    Model,
    /// The page with the results, `inspect.html`.
    Page,
}

/// Name of the output of a second mapper run, kept until one of the two results is chosen.
pub const AGAIN: &str = "again";

/// All stages, in order.
const STAGES: [Stage; 5] = [Stage::Pictures, Stage::Features, Stage::Matches, Stage::Model, Stage::Page];

impl Stage {
    /// Returns the stage's name in file names and events.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pictures => "pictures",
            Self::Features => "features",
            Self::Matches => "matches",
            Self::Model => "model",
            Self::Page => "page",
        }
    }

    /// Returns the files and folders that the stage writes.
    fn outputs(self) -> &'static [&'static str] {
        match self {
            Self::Pictures => &["images"],
            Self::Features => &["features.db", "features.db-wal", "features.db-shm"],
            Self::Matches => &["database.db", "database.db-wal", "database.db-shm"],
            Self::Model => &["sparse", "models", AGAIN],
            Self::Page => &["inspect.html"],
        }
    }
}

/// The state of a finished stage.
#[derive(Debug, Serialize, Deserialize)]
pub struct Done<T> {
    /// The inputs that the stage was computed from.
    pub inputs: Value,
    /// Duration of the stage, seconds.
    pub seconds: f64,
    /// Result of the stage.
    pub result: T,
}

/// Lock file, held by the process that works on the capture.
const LOCK: &str = "capture.lock";

/// Content of `capture.json`, which marks a folder as a capture's.
#[derive(Serialize, Deserialize)]
struct Mark {
    /// The path of the film, folder or archive.
    input: String,
}

impl Mark {
    /// Returns true if this is the capture of `input`. The paths are equal; or, if the input was moved, its file name is equal and the
    /// recorded path does not exist.
    fn is_of(&self, input: &Path) -> bool {
        let own = Path::new(&self.input);
        self.input == input.to_string_lossy() || own.file_name() == input.file_name() && !own.exists()
    }
}

/// The folder of a capture. Only this process writes to it.
pub struct Folder {
    root: PathBuf,
    /// Holds the lock while the file is open.
    _lock: File,
}

impl Folder {
    /// Opens or creates the folder for an input, given by its absolute path.
    ///
    /// # Errors
    /// Of kind `Input`: the folder belongs to something else or to another input, another process works on it, or it cannot be written.
    pub fn open(root: &Path, input: &Path) -> Result<Self> {
        let path = root.join("capture.json");
        let refused = |what: String| Error::input(root.display(), what, Advice::OtherFolder);
        // True if `capture.json` names this input.
        let marked = || {
            let found =
                plain_file::read(&path).ok().and_then(|bytes| serde_json::from_slice::<Mark>(&bytes).ok());
            match found {
                Some(found) if found.is_of(input) => Ok(true),
                Some(found) => Err(refused(format!("holds the capture of {}", found.input))),
                None if is_others(root) => Err(refused("holds files that no capture wrote".into())),
                None => Ok(false),
            }
        };
        if !marked()? {
            create_writable(root)?;
        }
        let path_of_lock = root.join(LOCK);
        let lock = File::options().create(true).truncate(false).write(true).open(&path_of_lock);
        let lock = lock.map_err(|error| unwritable(&path_of_lock, &error))?;
        if matches!(lock.try_lock(), Err(TryLockError::WouldBlock)) {
            return Err(Error::input(
                root.display(),
                "another process works on this capture",
                Advice::AnyOf(vec!["wait until it has ended, or stop it".into(), Advice::OtherFolder]),
            ));
        }
        // Another process may have created the capture of another input before the lock was taken.
        if !marked()? {
            write_atomically(&path, &json(&Mark { input: input.to_string_lossy().into_owned() })?)?;
        }
        let root = std::path::absolute(root).map_err(|error| unwritable(root, &error))?;
        Ok(Self { root, _lock: lock })
    }

    /// Returns the absolute path of the folder.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Returns the path of a file or folder in the capture.
    pub fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// Returns the path of a program's log.
    pub fn log(&self, name: &str) -> PathBuf {
        self.root.join("log").join(format!("{name}.log"))
    }

    /// Returns the state of a stage, if it is done and its first output exists.
    pub fn done<T: DeserializeOwned>(&self, stage: Stage) -> Option<Done<T>> {
        let done = serde_json::from_slice(&plain_file::read(&self.state(stage)).ok()?).ok()?;
        let first = stage.outputs().first()?;
        self.path(first).exists().then_some(done)
    }

    /// Discards a stage and all later ones: their states first, then their outputs.
    ///
    /// # Errors
    /// When something cannot be removed.
    pub fn begin(&self, stage: Stage) -> Result<()> {
        let later = || STAGES.into_iter().filter(|other| *other >= stage).rev();
        for stage in later() {
            remove(&self.state(stage))?;
        }
        sync_folder_of(&self.state(stage));
        for output in later().flat_map(Stage::outputs) {
            remove(&self.path(output))?;
            remove(&self.temporary(output))?;
        }
        Ok(())
    }

    /// Returns the path that an output has while it is incomplete.
    pub fn temporary(&self, output: &str) -> PathBuf {
        self.path(&temporary(output))
    }

    /// Renames a complete output from its temporary to its final name.
    ///
    /// # Errors
    /// When it cannot be renamed.
    pub fn keep(&self, output: &str) -> Result<()> {
        let (from, to) = (self.temporary(output), self.path(output));
        fs::rename(&from, &to).map_err(|error| unwritable(&to, &error))?;
        sync_folder_of(&to);
        Ok(())
    }

    /// Renames the temporary file or folder of `by` to that of `output`, and removes the latter first.
    ///
    /// # Errors
    /// When something cannot be removed or renamed.
    pub fn replace(&self, output: &str, by: &str) -> Result<()> {
        let (from, to) = (self.temporary(by), self.temporary(output));
        remove(&to)?;
        fs::rename(&from, &to).map_err(|error| unwritable(&to, &error))
    }

    /// Removes the temporary file or folder of an output.
    ///
    /// # Errors
    /// When it cannot be removed.
    pub fn discard(&self, output: &str) -> Result<()> {
        remove(&self.temporary(output))
    }

    /// Renames a complete database, together with the `-wal` and `-shm` files that its program may have left next to it.
    ///
    /// # Errors
    /// When it cannot be renamed.
    pub fn keep_database(&self, output: &str) -> Result<()> {
        for end in ["-wal", "-shm"] {
            let beside = self.path(&(temporary(output) + end));
            let to = self.path(&format!("{output}{end}"));
            if beside.exists() {
                fs::rename(&beside, &to).map_err(|error| unwritable(&to, &error))?;
            }
        }
        self.keep(output)
    }

    /// Records that a stage is done.
    ///
    /// # Errors
    /// When the state cannot be written.
    pub fn finish<T: Serialize>(&self, stage: Stage, done: &Done<T>) -> Result<()> {
        let path = self.state(stage);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(|error| unwritable(folder, &error))?;
        }
        write_atomically(&path, &json(done)?)
    }

    fn state(&self, stage: Stage) -> PathBuf {
        state(&self.root, stage)
    }
}

/// Returns the path of a stage's state file, which exists if the stage is done.
pub fn state(root: &Path, stage: Stage) -> PathBuf {
    root.join("state").join(format!("{}.json", stage.name()))
}

/// Returns the name that an output has while it is incomplete, with the same file extension.
pub fn temporary(output: &str) -> String {
    match output.split_once('.') {
        Some((stem, ending)) => format!("{stem}.part.{ending}"),
        None => format!("{output}.part"),
    }
}

/// Returns a hash that distinguishes values, as 16 hexadecimal digits.
pub fn digest(value: &impl Serialize) -> Result<String> {
    Ok(format!("{:016x}", fingerprint::hash(&json(value)?)))
}

/// Returns the error for a path that the system cannot write.
pub fn unwritable(path: &Path, error: &io::Error) -> Error {
    Error::input(
        path.display(),
        format!("cannot write: {error}"),
        Advice::AnyOf(vec!["free space there".into(), Advice::OtherFolder]),
    )
}

fn json(value: &impl Serialize) -> Result<Vec<u8>> {
    let mut bytes = serde_json::to_vec_pretty(value).map_err(Error::run)?;
    bytes.push(b'\n');
    Ok(bytes)
}

/// Removes a file or a folder, if it exists.
fn remove(path: &Path) -> Result<()> {
    let Ok(found) = path.symlink_metadata() else { return Ok(()) };
    let removed = if found.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    removed.map_err(|error| unwritable(path, &error))
}

/// Returns true if the path is not a folder, or if the folder holds files that no capture left. A capture that was killed at its start
/// leaves an empty folder, its lock, or the temporary file of its mark.
fn is_others(root: &Path) -> bool {
    let own = |name: &std::ffi::OsStr| {
        [LOCK, "capture.json.trimip.tmp", "capture.json"].iter().any(|own| name == *own)
    };
    match root.read_dir() {
        Ok(mut entries) => entries.any(|entry| entry.is_ok_and(|entry| !own(&entry.file_name()))),
        Err(error) => error.kind() != io::ErrorKind::NotFound,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_stage_is_done_with_its_outputs_until_it_or_an_earlier_one_begins_again() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("walk");
        let capture = Folder::open(&root, Path::new("walk.mp4")).unwrap();
        let number = |stage| capture.done::<u32>(stage).map(|done| done.result);
        for (stage, output, result) in
            [(Stage::Features, "features.db", 3), (Stage::Matches, "database.db", 4)]
        {
            fs::write(capture.temporary(output), "x").unwrap();
            fs::write(capture.path(&(temporary(output) + "-wal")), "y").unwrap();
            assert_eq!(number(stage), None);
            capture.keep_database(output).unwrap();
            assert!(capture.path(&format!("{output}-wal")).exists());
            capture.finish(stage, &Done { inputs: json!({ "a": 1 }), seconds: 0.5, result }).unwrap();
            assert_eq!(number(stage), Some(result));
        }
        capture.begin(Stage::Matches).unwrap();
        assert_eq!((number(Stage::Features), number(Stage::Matches)), (Some(3), None));
        assert!(!capture.path("database.db").exists() && !capture.path("database.db-wal").exists());
        fs::remove_file(capture.path("features.db")).unwrap();
        assert_eq!(number(Stage::Features), None, "what is gone is not done");
    }

    #[test]
    fn a_folder_belongs_to_one_input_and_one_process() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path().join("walk");
        let refused = |input: &Path| Folder::open(&root, input).err().map(|error| error.message());
        let [walk, run] = ["a/walk.mp4", "a/run.mp4"].map(|name| folder.path().join(name));
        fs::create_dir(folder.path().join("a")).unwrap();
        fs::write(&walk, "").unwrap();
        fs::create_dir(&root).unwrap();
        fs::write(root.join("other"), "").unwrap();
        assert!(refused(&walk).unwrap().contains("no capture wrote"));
        fs::remove_file(root.join("other")).unwrap();
        fs::write(root.join("capture.json.trimip.tmp"), "{").unwrap();
        let first = Folder::open(&root, &walk).unwrap();
        assert!(refused(&walk).unwrap().contains("another process"));
        drop(first);
        assert!(refused(&run).unwrap().contains(&format!("holds the capture of {}", walk.display())));
        assert_eq!(refused(&walk), None);
        // A different film with the same file name is refused; a film that was moved is accepted.
        let moved = folder.path().join("walk.mp4");
        assert!(refused(&moved).unwrap().contains("holds the capture of"));
        fs::rename(&walk, &moved).unwrap();
        assert_eq!(refused(&moved), None);
    }
}
