//! Checks of the entries of a TIFF file before it is decoded: the decoder allocates the memory that entries state
//! before it reads them (TIFF 6.0, section 2; entries of BigTIFF are longer).

use std::io::{self, ErrorKind, Read, Seek, SeekFrom};

/// Bytes of a value of each type from type 1 on: byte, text, short, long, rational, signed byte, undefined, signed short,
/// signed long, signed rational, float, double, directory; then two types that do not exist, and three of BigTIFF.
const SIZES: [u64; 18] = [1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 0, 0, 8, 8, 8];

/// Checks that the values of the first directory of a TIFF file end within the file. Files of other formats pass. The
/// source is rewound afterwards.
///
/// # Errors
/// Values that end beyond the file, and errors of reading it.
pub(crate) fn check(source: &mut (impl Read + Seek)) -> io::Result<()> {
    let end = source.seek(SeekFrom::End(0))?;
    source.rewind()?;
    let found = directory(source, end);
    source.rewind()?;
    found
}

fn directory(source: &mut (impl Read + Seek), end: u64) -> io::Result<()> {
    let mut head = Vec::new();
    source.by_ref().take(16).read_to_end(&mut head)?;
    let little = head.starts_with(b"II");
    if !(little || head.starts_with(b"MM")) {
        return Ok(());
    }
    let number = |bytes: &[u8]| {
        let add = |sum: u64, byte: &u8| sum << 8 | u64::from(*byte);
        if little { bytes.iter().rev().fold(0, add) } else { bytes.iter().fold(0, add) }
    };
    // Sizes of an offset and of the number of entries in bytes, and the offset of the first directory.
    let (offset, counted, at) = match head.get(2..4).map(number) {
        Some(42) => (4, 2, head.get(4..8)),
        Some(43) => (8, 8, head.get(8..16)),
        _ => return Ok(()),
    };
    let Some(at) = at.map(number) else { return Ok(()) };
    source.seek(SeekFrom::Start(at))?;
    let mut count = vec![0; counted];
    source.read_exact(&mut count)?;
    let mut entry = vec![0; 4 + 2 * offset];
    for _ in 0..number(&count) {
        source.read_exact(&mut entry)?;
        let kind = number(&entry[2..4]) as usize;
        let size = SIZES.get(kind.wrapping_sub(1)).copied().unwrap_or(0);
        let bytes = number(&entry[4..4 + offset]).saturating_mul(size);
        if bytes > offset as u64 && bytes.saturating_add(number(&entry[4 + offset..])) > end {
            return Err(io::Error::new(ErrorKind::InvalidData, "the values of an entry end beyond the file"));
        }
    }
    Ok(())
}
