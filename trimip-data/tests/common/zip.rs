//! Writes zip archives, including invalid ones: every field can be set.

use std::{fs, path::Path};

/// Methods of compression.
pub const STORED: u16 = 0;
pub const DEFLATE: u16 = 8;

/// A file of an archive, possibly an invalid one.
#[derive(Clone, Debug)]
pub struct Entry {
    pub name: Vec<u8>,
    pub method: u16,
    /// General purpose flags: 1 means encrypted, 0x800 a name in UTF-8.
    pub flags: u16,
    /// Unix mode.
    pub mode: u32,
    pub checksum: u32,
    /// Stated size of the unpacked bytes.
    pub bytes: u32,
    pub packed: Vec<u8>,
    /// Stated size of the packed bytes.
    pub packed_bytes: u32,
}

impl Entry {
    /// Creates a file without compression.
    pub fn stored(name: &str, bytes: &[u8]) -> Self {
        let mut crc = flate2::Crc::new();
        crc.update(bytes);
        Self {
            name: name.into(),
            method: STORED,
            flags: 0x800,
            mode: 0o100_644,
            checksum: crc.sum(),
            bytes: bytes.len() as u32,
            packed: bytes.to_vec(),
            packed_bytes: bytes.len() as u32,
        }
    }

    /// Creates a compressed file.
    pub fn deflated(name: &str, bytes: &[u8]) -> Self {
        use std::io::Write;
        let mut encoder = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::new(6));
        encoder.write_all(bytes).unwrap();
        let packed = encoder.finish().unwrap();
        Self { method: DEFLATE, packed_bytes: packed.len() as u32, packed, ..Self::stored(name, bytes) }
    }

    /// Returns the fields that both headers of an entry have: version, flags, method, time, checksum, sizes, length of
    /// the name, no extra field.
    fn header(&self) -> Vec<u8> {
        let mut header = Vec::new();
        for part in [20, self.flags, self.method, 0, 0x21] {
            header.extend(part.to_le_bytes());
        }
        for part in [self.checksum, self.packed_bytes, self.bytes] {
            header.extend(part.to_le_bytes());
        }
        header.extend((self.name.len() as u16).to_le_bytes());
        header.extend(0_u16.to_le_bytes());
        header
    }
}

/// Returns the bytes of an archive.
pub fn archive(entries: &[Entry]) -> Vec<u8> {
    let (mut archive, mut directory) = (Vec::new(), Vec::new());
    for entry in entries {
        let at = archive.len() as u32;
        archive.extend(b"PK\x03\x04");
        archive.extend(entry.header());
        archive.extend(&entry.name);
        archive.extend(&entry.packed);
        directory.extend(b"PK\x01\x02");
        directory.extend([20, 3]);
        directory.extend(entry.header());
        directory.extend([0; 6]);
        directory.extend((entry.mode << 16).to_le_bytes());
        directory.extend(at.to_le_bytes());
        directory.extend(&entry.name);
    }
    let (at, length) = (archive.len() as u32, directory.len() as u32);
    archive.extend(directory);
    archive.extend(b"PK\x05\x06");
    archive.extend([0; 4]);
    (0..2).for_each(|_| archive.extend((entries.len() as u16).to_le_bytes()));
    archive.extend(length.to_le_bytes());
    archive.extend(at.to_le_bytes());
    archive.extend([0; 2]);
    archive
}

/// Returns the files below a folder, compressed, with the prefix `before` on their paths.
pub fn packed(folder: &Path, before: &str) -> Vec<Entry> {
    let mut paths: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    let mut entries = Vec::new();
    for path in paths {
        let name = format!("{before}{}", path.file_name().unwrap().to_str().unwrap());
        match path.is_dir() {
            true => {
                entries.push(Entry::stored(&format!("{name}/"), b""));
                entries.extend(packed(&path, &format!("{name}/")));
            }
            false => entries.push(Entry::deflated(&name, &fs::read(path).unwrap())),
        }
    }
    entries
}
