//! Scenes in zip archives. `NAME.zip` is unpacked once, to the folder `NAME` next to it. Files are written to a
//! temporary folder, which is renamed once all files are written, so a folder `NAME` is complete.

use crate::{
    advice::Next,
    zip::{self, Limits, Zip},
};
use serde_json::{Value, json};
use std::{
    collections::BTreeSet,
    fs::{self, File, OpenOptions},
    io::Write,
    path::{Path, PathBuf},
};
use trimip_core::{
    Error, Result,
    atomic::{sync_folder_of, temporary},
    plain_file,
    plural::count,
};

/// The file that marks a folder as unpacked by this program and names the archive. No archive can supply this file,
/// since hidden files are not unpacked.
const MARK: &str = ".unpacked.json";

/// Number of levels below the folder that are searched for a scene, and most folders of a level.
const MOST_DEPTH: usize = 3;
const MOST_FOLDERS: usize = 1000;

/// The scene of an archive.
pub(crate) struct Unpacked {
    /// Its folder.
    pub(crate) root: PathBuf,
    /// Archive, folder and size, in words.
    pub(crate) note: String,
}

/// The kind of scene that an archive must hold.
pub(crate) struct Wanted<'a> {
    /// True if a folder is such a scene.
    pub(crate) is_scene: &'a dyn Fn(&Path) -> bool,
    /// The files that identify such a scene, in words.
    pub(crate) files: &'a str,
}

/// Unpacks an archive, unless its unpacked folder exists already, and finds the scene in it.
///
/// # Errors
/// Of kind `Input`: an archive that is broken, unsafe or without a scene, and a folder that cannot be written or that
/// was not made from this archive. Files written so far are removed.
pub(crate) fn unpacked(archive: &Path, wanted: &Wanted<'_>) -> Result<Unpacked> {
    let wrong = |error: std::io::Error| {
        Error::input(
            archive.display(),
            format!("cannot be read: {error}"),
            "check the path and its permissions",
        )
    };
    plain_file::open(archive).map_err(wrong)?;
    // Network file systems lock only files that are open for writing.
    let file = OpenOptions::new().read(true).write(true).open(archive).or_else(|_| File::open(archive));
    let file = file.map_err(wrong)?;
    let length = file.metadata().map_err(wrong)?.len();
    let zip = Zip::of_file(&archive.into(), file.try_clone().map_err(wrong)?, &Limits::USUAL)?;
    let folder = archive.with_extension("");
    let name = archive.file_name().unwrap_or_default().to_string_lossy();
    let mark =
        json!({ "archive": name, "bytes": length, "fingerprint": format!("{:016x}", zip.fingerprint) });
    if !is_there(archive, &folder, &mark, wanted)? {
        // If several processes open the archive, one unpacks it and the others wait. The lock ends with the process.
        file.lock().map_err(|error| {
            let what = format!("cannot be locked: {error}");
            Error::input(archive.display(), what, "unpack it and name the folder")
        })?;
        if !is_there(archive, &folder, &mark, wanted)? {
            unpack(archive, &zip, &folder, &mark, wanted)?;
        }
    }
    let bytes: u64 = zip.files.iter().map(zip::File::bytes).sum();
    let note = format!(
        "{} is unpacked in {}: {}, {:.1} MB",
        archive.display(),
        folder.display(),
        count(zip.files.len(), "file"),
        1e-6 * bytes as f64
    );
    Ok(Unpacked { root: scene(archive, &folder, &folder, wanted)?, note })
}

/// Returns true if the folder is the unpacked archive, false if it does not exist.
///
/// # Errors
/// If the folder is anything else.
fn is_there(archive: &Path, folder: &Path, mark: &Value, wanted: &Wanted<'_>) -> Result<bool> {
    if folder.symlink_metadata().is_err() {
        return Ok(false);
    }
    let refused = |what: String, advice: String| Err(Error::input(folder.display(), what, advice));
    let name_it = format!("or name {} if it holds the scene", folder.display());
    match marked(folder) {
        Some(found) if ["bytes", "fingerprint"].iter().all(|key| found[*key] == mark[*key]) => Ok(true),
        Some(found) => refused(
            format!(
                "was unpacked from another archive ({}), not from {}",
                found["archive"],
                archive.display()
            ),
            format!("remove or rename it, {name_it}"),
        ),
        None if (wanted.is_scene)(folder) => refused(
            format!("already holds a scene, so {} cannot be unpacked there", archive.display()),
            format!("name {}, or rename one of the two", folder.display()),
        ),
        None => refused(
            format!("was not made by this program, so {} cannot be unpacked there", archive.display()),
            format!("rename one of the two, {name_it}"),
        ),
    }
}

/// Returns the contents of [`MARK`] in a folder; `None` if this program did not unpack the folder.
fn marked(folder: &Path) -> Option<Value> {
    let is_folder = folder.symlink_metadata().is_ok_and(|found| found.is_dir());
    let mark = fs::read(folder.join(MARK)).ok().filter(|_| is_folder)?;
    serde_json::from_slice(&mark).ok().filter(|mark: &Value| mark["fingerprint"].is_string())
}

/// A temporary folder that is removed on drop, unless it was renamed.
struct Unfinished(PathBuf);

impl Drop for Unfinished {
    fn drop(&mut self) {
        let _ = remove(&self.0);
    }
}

/// Removes a temporary folder, its mark last: if the process is killed, the mark still identifies the remains.
fn remove(root: &Path) -> std::io::Result<()> {
    for entry in root.read_dir()? {
        let entry = entry?;
        match entry.file_type()?.is_dir() {
            true => fs::remove_dir_all(entry.path())?,
            false if entry.file_name() != MARK => fs::remove_file(entry.path())?,
            false => {}
        }
    }
    fs::remove_dir_all(root)
}

/// Writes the files of an archive to a temporary folder, which is renamed to `folder` once it is complete and holds a scene.
fn unpack(
    archive: &Path,
    zip: &Zip<impl rawzip::ReaderAt>,
    folder: &Path,
    mark: &Value,
    wanted: &Wanted<'_>,
) -> Result<()> {
    let unwritable = |path: &Path, error: std::io::Error| {
        let what = format!("cannot write {}: {error}", path.display());
        Error::input(
            archive.display(),
            what,
            "copy the archive to a disk with more space, or unpack it elsewhere and name the folder",
        )
    };
    let root = temporary(archive);
    remove_left(&root, archive)?;
    fs::create_dir(&root).map_err(|error| unwritable(&root, error))?;
    let root = Unfinished(root);
    let mark_path = root.0.join(MARK);
    fs::write(&mark_path, mark.to_string()).map_err(|error| unwritable(&mark_path, error))?;
    let paths: Vec<PathBuf> = zip.files.iter().map(|file| root.0.join(&file.path)).collect();
    // The set sorts parents before their subfolders.
    let above = |path| Path::ancestors(path).skip(1).take_while(|above| *above != root.0);
    let folders: BTreeSet<&Path> = paths.iter().flat_map(|path| above(path)).collect();
    for folder in &folders {
        fs::create_dir(folder).map_err(|error| unwritable(folder, error))?;
    }
    for (file, path) in zip.files.iter().zip(&paths) {
        let mut out = File::create_new(path).map_err(|error| unwritable(path, error))?;
        zip.read(file, |bytes| out.write_all(bytes).map_err(|error| unwritable(path, error)))?;
    }
    scene(archive, &root.0, folder, wanted)?;
    // Files are flushed after all are written: systems write many at once faster than one by one.
    for path in paths.iter().chain([&mark_path]) {
        let flushed = OpenOptions::new().write(true).open(path).and_then(|file| file.sync_all());
        flushed.map_err(|error| unwritable(path, error))?;
    }
    folders.iter().for_each(|folder| sync_folder_of(folder));
    sync_folder_of(&mark_path);
    fs::rename(&root.0, folder).map_err(|error| unwritable(folder, error))?;
    sync_folder_of(folder);
    Ok(())
}

/// Removes the temporary folder of a process that was killed.
///
/// # Errors
/// If the folder was not made by this program.
fn remove_left(root: &Path, archive: &Path) -> Result<()> {
    if root.symlink_metadata().is_err() {
        return Ok(());
    }
    // A process that was killed before its mark was complete leaves a folder with at most that file.
    let is_bare = root
        .read_dir()
        .is_ok_and(|mut entries| entries.all(|entry| entry.is_ok_and(|entry| entry.file_name() == MARK)));
    let is_folder = root.symlink_metadata().is_ok_and(|found| found.is_dir());
    if is_folder && (is_bare || marked(root).is_some()) && remove(root).is_ok() {
        return Ok(());
    }
    let what = format!("is in the way of unpacking {}", archive.display());
    Err(Error::input(root.display(), what, "remove or rename it"))
}

/// Returns the folder of the scene: `root`, or the only scene in the first level below it that has any. Messages show `root` as `named`.
fn scene(archive: &Path, root: &Path, named: &Path, wanted: &Wanted<'_>) -> Result<PathBuf> {
    let mut level = vec![root.to_path_buf()];
    for _ in 0..=MOST_DEPTH {
        let mut scenes = level.iter().filter(|folder| (wanted.is_scene)(folder));
        match (scenes.next(), scenes.next()) {
            (None, _) => {}
            (Some(scene), None) => return Ok(scene.clone()),
            (Some(first), Some(second)) => {
                let shown =
                    |path: &Path| named.join(path.strip_prefix(root).unwrap_or(path)).display().to_string();
                return Err(Error::input(
                    archive.display(),
                    format!(
                        "holds several scenes: {}, {}{}",
                        shown(first),
                        shown(second),
                        if scenes.next().is_some() { ", …" } else { "" }
                    ),
                    "unpack it and name one of them",
                ));
            }
        }
        level = below(&level);
    }
    let looked = format!("holds no scene: looked for {}", wanted.files);
    let (what, advice) = match Next::of(root, named, archive) {
        Some(next) if next.takes_archive => (looked, next.text),
        Some(next) => (looked, format!("unpack it to {}: {}", named.display(), next.text)),
        None => (
            format!("{looked}, and found {}", held(root)),
            "name an archive or a folder with one of these files".into(),
        ),
    };
    Err(Error::input(archive.display(), what, advice))
}

/// Returns the subfolders of these folders, sorted by path.
fn below(folders: &[PathBuf]) -> Vec<PathBuf> {
    let entries = folders.iter().flat_map(|folder| folder.read_dir().into_iter().flatten().flatten());
    let mut below: Vec<PathBuf> =
        entries.map(|entry| entry.path()).filter(|path| path.is_dir()).take(MOST_FOLDERS).collect();
    below.sort();
    below
}

/// Lists the first names in a folder, for a message.
fn held(root: &Path) -> String {
    let entries = root.read_dir().into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names.filter(|name| name != MARK).collect();
    names.sort();
    let more = names.len().saturating_sub(3);
    names.truncate(3);
    match more {
        0 => names.join(", "),
        more => format!("{} and {more} more", names.join(", ")),
    }
}
