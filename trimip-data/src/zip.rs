//! Untrusted zip archives: their directory, and the bytes of their files. Names, sizes and kinds are checked before a
//! file is read, and each file is checked against its stated size and checksum while it is read. Memory is never
//! allocated for a size merely because the archive states it.

use flate2::read::DeflateDecoder;
use rawzip::{
    CompressionMethod, FileReader, ReaderAt, ZipArchive, ZipArchiveEntryWayfinder, ZipFileHeaderRecord,
    ZipLocator,
};
use std::{
    fmt::Display,
    io::{ErrorKind, Read},
    path::Path,
};
use trimip_core::{Error, Place, Result, plural::count, scene::fingerprint};

/// Ends of the names of zip archives, in lower case. Record3D names its own `.r3d`.
const ENDINGS: [&str; 2] = ["zip", "r3d"];

/// The folder that macOS adds for metadata that other file systems cannot hold.
const MACOS: &str = "__MACOSX";

/// Bytes of a file that are unpacked at once.
const CHUNK: usize = 1 << 16;

const UNPACK: &str = "if you trust it, unpack it with another program and name the folder";
const AGAIN: &str = "copy or download the archive again";

/// Limits of an archive that is accepted.
#[derive(Clone, Copy)]
pub(crate) struct Limits {
    /// Number of entries.
    pub(crate) entries: u64,
    /// Total bytes of its unpacked files; if `ratio` times the bytes of the archive is more, that is the limit. DEFLATE
    /// expands a byte to at most 1032 bytes, and photographs hardly expand.
    pub(crate) bytes: u64,
    pub(crate) ratio: u64,
    /// Number of parts of a path: nested folders and the file.
    pub(crate) depth: usize,
}

impl Limits {
    pub(crate) const USUAL: Self = Self { entries: 500_000, bytes: 1 << 30, ratio: 100, depth: 32 };
}

/// Returns true for a path with the ending of a zip archive that is no folder.
pub fn is_archive(path: &Path) -> bool {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str())) && !path.is_dir()
}

/// An archive and the files in it.
pub(crate) struct Zip<R> {
    /// Its name in errors.
    name: String,
    archive: ZipArchive<R>,
    /// Files in the order of the archive's directory, without hidden files and those of macOS.
    pub(crate) files: Vec<File>,
    /// Hash of its directory, which holds the name, the size and the checksum of each file.
    pub(crate) fingerprint: u64,
}

/// A file in an archive.
pub(crate) struct File {
    /// Its path: plain names with `/` between them.
    pub(crate) path: String,
    is_stored: bool,
    place: ZipArchiveEntryWayfinder,
}

impl File {
    /// Returns its size as the archive states it. [`Zip::read`] passes on exactly as many bytes, or fails.
    pub(crate) fn bytes(&self) -> u64 {
        self.place.uncompressed_size_hint()
    }
}

impl Zip<FileReader> {
    /// Reads the directory of an archive on disk.
    pub(crate) fn of_file(name: &Place, file: std::fs::File, limits: &Limits) -> Result<Self> {
        let length = file.metadata().map_err(|error| unreadable(name, &error))?.len();
        Self::open(name, file.into(), length, limits)
    }
}

impl<R: ReaderAt> Zip<R> {
    /// Reads the directory of an archive of `length` bytes.
    pub(crate) fn open(name: &Place, reader: R, length: u64, limits: &Limits) -> Result<Self> {
        let mut buffer = vec![0; rawzip::MAX_CENTRAL_DIRECTORY_RECORD_SIZE];
        let archive = ZipLocator::new().locate_in_reader(reader, &mut buffer, length);
        let archive = archive.map_err(|(_, error)| match error.kind() {
            rawzip::ErrorKind::IO(error) if error.kind() != ErrorKind::UnexpectedEof => {
                unreadable(name, error)
            }
            rawzip::ErrorKind::InvalidEndOfCentralDirectory => {
                damaged(name, &"its directory is not at the stated position")
            }
            _ => Error::input(name, "is no zip archive, or its end is missing", AGAIN),
        })?;
        let (mut files, mut hashes, mut listed, mut bytes) = (Vec::new(), Vec::new(), 0_u64, 0_u64);
        let most = limits.bytes.max(length.saturating_mul(limits.ratio));
        let mut entries = archive.entries(&mut buffer);
        while let Some(entry) = entries.next_entry().map_err(|error| damaged(name, &error))? {
            listed += 1;
            if listed > limits.entries {
                let what = format!("has more than {} entries", limits.entries);
                return Err(Error::input(name, what, UNPACK));
            }
            hashes.extend(hash(&entry).to_le_bytes());
            let Some(file) = file(name, &entry, limits)? else { continue };
            bytes = bytes.saturating_add(file.bytes());
            if bytes > most {
                let what = format!(
                    "states files of more than {:.1} GB, but has only {length} bytes itself",
                    1e-9 * most as f64
                );
                return Err(Error::input(name, what, UNPACK));
            }
            files.push(file);
        }
        // Some programs write only the lowest 16 bits of the number of entries.
        if listed % (1 << 16) != archive.entries_hint() % (1 << 16) {
            let what = format!("states {} entries but lists {listed}", archive.entries_hint());
            return Err(Error::input(name, what, AGAIN));
        }
        if files.is_empty() {
            return Err(Error::input(
                name,
                "holds no file",
                "name another archive, or the folder of a scene",
            ));
        }
        let mut paths: Vec<&str> = files.iter().map(|file| file.path.as_str()).collect();
        paths.sort_unstable();
        if let Some(pair) = paths.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(Error::input(format!("{name}: {}", pair[0]), "is in the archive twice", UNPACK));
        }
        let is_file = |above: &str| paths.binary_search(&above).is_ok();
        let above = |path: &'_ str| {
            path.match_indices('/').map(|(at, _)| path[..at].to_string()).find(|above| is_file(above))
        };
        if let Some(both) = paths.iter().find_map(|path| above(path)) {
            return Err(Error::input(
                format!("{name}: {both}"),
                "is both a file and a folder in the archive",
                UNPACK,
            ));
        }
        Ok(Self { name: name.to_string(), archive, files, fingerprint: fingerprint::hash(&hashes) })
    }

    /// Passes the bytes of a file to `take`, part by part.
    ///
    /// # Errors
    /// If size or checksum differ from those that the archive states, and errors of `take`. Surplus bytes are never passed to `take`.
    pub(crate) fn read(&self, file: &File, mut take: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
        let place = Place::part(self.name.clone(), &file.path);
        let entry = self.archive.get_entry(file.place).map_err(|error| damaged(&place, &error))?;
        let packed: Box<dyn Read + '_> = match file.is_stored {
            true => Box::new(entry.reader()),
            false => Box::new(DeflateDecoder::new(entry.reader())),
        };
        let mut plain = entry.verifying_reader(packed);
        let mut buffer = vec![0; CHUNK];
        loop {
            let length = plain.read(&mut buffer).map_err(|error| unequal(&place, &error))?;
            if length == 0 {
                return Ok(());
            }
            take(&buffer[..length])?;
        }
    }
}

/// Returns a hash of the record of an entry in the directory.
fn hash(entry: &ZipFileHeaderRecord<'_>) -> u64 {
    let numbers = [
        entry.crc32().into(),
        entry.compressed_size_hint(),
        entry.uncompressed_size_hint(),
        entry.local_header_offset(),
    ];
    let numbers: Vec<u8> = numbers.into_iter().flat_map(u64::to_le_bytes).collect();
    fingerprint::hash_of([entry.file_path().as_ref(), &numbers])
}

/// Returns the file of an entry, or `None` for a folder, a hidden file and a file of macOS.
fn file(name: &Place, entry: &ZipFileHeaderRecord<'_>, limits: &Limits) -> Result<Option<File>> {
    let raw = entry.file_path();
    if raw.as_ref().is_empty() {
        return Err(Error::input(name, "has an entry without a name", UNPACK));
    }
    let place = Place::part(name.to_string(), String::from_utf8_lossy(raw.as_ref()));
    let refused = |what: &str, advice: &str| Err(Error::input(&place, what, advice));
    let Ok(text) = std::str::from_utf8(raw.as_ref()) else {
        return refused(
            "its name is not UTF-8",
            "unpack it with the program that made it and name the folder",
        );
    };
    // Some programs for Windows write backslashes.
    let separators = ['/', '\\'];
    let parts: Vec<&str> = text.split(separators).filter(|part| !part.is_empty() && *part != ".").collect();
    // Windows strips dots and blanks from the end of a name.
    let leads_out = |part: &&str| part.trim_end_matches(['.', ' ']).is_empty() || has_drive(part);
    if text.starts_with(separators) || parts.iter().any(leads_out) {
        return refused("its name leads out of the folder", UNPACK);
    }
    if parts.len() > limits.depth {
        return refused(&format!("lies in more than {} folders", limits.depth - 1), UNPACK);
    }
    if parts.iter().any(|part| part.starts_with('.') || *part == MACOS) || text.ends_with(separators) {
        return Ok(None);
    }
    let reserved = |c: char| c.is_control() || cfg!(windows) && "<>:\"|?*".contains(c);
    if parts.is_empty() || text.contains(reserved) {
        return refused("its name is not a valid file name", UNPACK);
    }
    if entry.mode().is_symlink() {
        return refused(
            "is a symbolic link",
            "pack the file that the link points to, or unpack the archive and name the folder",
        );
    }
    if entry.flags().is_encrypted() {
        return refused("is encrypted", "unpack it with its password and name the folder");
    }
    let method = entry.compression_method();
    let is_stored = method == CompressionMethod::STORE;
    if !is_stored && method != CompressionMethod::DEFLATE {
        let what = format!("is compressed by method {method}, but only 8 (DEFLATE) is read");
        return refused(&what, "unpack it with the program that made it and name the folder");
    }
    Ok(Some(File { path: parts.join("/"), is_stored, place: entry.wayfinder() }))
}

/// Returns true for a part that begins with a drive, such as `C:`.
fn has_drive(part: &str) -> bool {
    let bytes = part.as_bytes();
    bytes.len() > 1 && bytes[0].is_ascii_alphabetic() && bytes[1] == b':'
}

fn unreadable(place: &Place, error: &dyn Display) -> Error {
    Error::input(place, format!("cannot be read: {error}"), "check the path and its permissions")
}

fn damaged(place: &Place, error: &dyn Display) -> Error {
    Error::input(place, format!("is damaged: {error}"), AGAIN)
}

/// Returns the error for a file whose bytes differ from those that the archive states.
fn unequal(place: &Place, error: &std::io::Error) -> Error {
    let inner = error.get_ref().and_then(|inner| inner.downcast_ref::<rawzip::Error>());
    match inner.map(rawzip::Error::kind) {
        Some(rawzip::ErrorKind::InvalidSize { expected, actual }) if actual > expected => Error::input(
            place,
            format!("unpacks to more than the stated {}", count(*expected, "byte")),
            UNPACK,
        ),
        Some(rawzip::ErrorKind::InvalidSize { expected, actual }) => {
            damaged(place, &format!("ends after {actual} of {}", count(*expected, "byte")))
        }
        Some(rawzip::ErrorKind::InvalidChecksum { .. }) => damaged(place, &"its checksum is wrong"),
        _ => damaged(place, error),
    }
}

#[cfg(test)]
#[allow(dead_code, missing_docs)]
#[path = "../tests/common/zip.rs"]
mod writer;

#[cfg(test)]
mod tests {
    use super::{
        writer::{Entry, archive},
        *,
    };

    fn opened<'a>(bytes: &'a [u8], limits: &Limits) -> Result<Zip<&'a [u8]>> {
        Zip::open(&"a.zip".into(), bytes, bytes.len() as u64, limits)
    }

    #[test]
    fn an_archive_is_within_its_limits_or_refused() {
        let entries = ["a/b/c.txt", "d.txt", "e.txt"].map(|name| Entry::deflated(name, &[0; 1000]));
        let bytes = archive(&entries);
        let limits = Limits { entries: 3, bytes: 3000, ratio: 0, depth: 3 };
        assert_eq!(opened(&bytes, &limits).unwrap().files.len(), 3);
        let ratio = 3000 / bytes.len() as u64 + 1;
        opened(&bytes, &Limits { bytes: 0, ratio, ..limits }).unwrap();
        for (limits, what) in [
            (Limits { entries: 2, ..limits }, "a.zip: has more than 2 entries; "),
            (Limits { bytes: 2999, ..limits }, "a.zip: states files of more than 0.0 GB"),
            (Limits { bytes: 0, ratio: ratio - 1, ..limits }, "a.zip: states files of more than"),
            (Limits { depth: 2, ..limits }, "a.zip: a/b/c.txt: lies in more than 1 folders; "),
        ] {
            let error = opened(&bytes, &limits).err().unwrap();
            assert!(error.message().starts_with(what), "{what}: {error}");
        }
    }

    #[test]
    fn names_contents_and_their_order_are_in_the_fingerprint() {
        let of = |entries: &[Entry]| opened(&archive(entries), &Limits::USUAL).unwrap().fingerprint;
        let [a, b] = ["a.txt", "b.txt"].map(|name| Entry::stored(name, b"xyz"));
        let one = of(&[a.clone(), b.clone()]);
        assert_eq!(one, of(&[a.clone(), b.clone()]));
        let other = Entry::stored("b.txt", b"xyw");
        for entries in [vec![a.clone()], vec![b, a.clone()], vec![a, other]] {
            assert_ne!(of(&entries), one);
        }
    }

    #[test]
    fn archives_are_told_by_their_names() {
        let is = |name: &str| is_archive(Path::new(name));
        assert!(is("a.zip") && is("b/A.B.ZIP") && is("c.r3d"));
        assert!(!is("zip") && !is(".zip") && !is("a.tar.gz") && !is("a.zip.tmp") && !is("transforms.json"));
    }
}
