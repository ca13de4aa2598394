//! Checks of the chunks of a WebP file before it is decoded: the decoder allocates the memory that chunks state before
//! it reads them (RFC 9649, WebP Image Format).

use std::io::{self, ErrorKind, Read, Seek, SeekFrom};

/// Bytes of a chunk before its data: its name and length.
const HEAD: u64 = 8;

/// Checks that the chunks of a WebP file end within it, and that its pictures have the size that its header states.
/// Files of other formats pass. The source is rewound afterwards.
///
/// # Errors
/// A chunk that ends beyond the file, a picture of another size, and errors of reading.
pub(crate) fn check(source: &mut (impl Read + Seek)) -> io::Result<()> {
    let end = source.seek(SeekFrom::End(0))?;
    source.rewind()?;
    let mut head = [0; 12];
    let is_webp = end >= 12 && {
        source.read_exact(&mut head)?;
        head.starts_with(b"RIFF") && head.ends_with(b"WEBP")
    };
    let found = if is_webp { parts(source, 12..end, None, false) } else { Ok(()) };
    source.rewind()?;
    found
}

/// Checks the chunks in a range of the file. Their pictures must have the size `size`, if it is given. An animation frame
/// (`ANMF`) has chunks of its own but no further frames (RFC 9649, 2.7.1.1), so that frames cannot be nested without end.
fn parts(
    source: &mut (impl Read + Seek),
    range: std::ops::Range<u64>,
    mut size: Option<[u32; 2]>,
    in_picture: bool,
) -> io::Result<()> {
    let mut at = range.start;
    while range.end - at >= HEAD {
        source.seek(SeekFrom::Start(at))?;
        let mut head = [0; HEAD as usize];
        source.read_exact(&mut head)?;
        let ([a, b, c, d], length) = (head[..4].first_chunk().copied().unwrap_or_default(), &head[4..]);
        let length = u64::from(u32::from_le_bytes(length.first_chunk().copied().unwrap_or_default()));
        let data = at + HEAD..at + HEAD + length;
        // Data of odd length is padded by a byte, which some programs omit at the end of the file.
        at = (data.end + length % 2).min(range.end);
        if data.end > range.end {
            return Err(wrong("a part ends beyond the file"));
        }
        match &[a, b, c, d] {
            b"VP8X" => {
                let [_, _, _, _, w0, w1, w2, h0, h1, h2] = first(source)?;
                size = Some([[w0, w1, w2], [h0, h1, h2]].map(side));
            }
            b"ANMF" if in_picture => return Err(wrong("a picture of the animation contains another")),
            b"ANMF" => {
                let [_, _, _, _, _, _, w0, w1, w2, h0, h1, h2, _, _, _, _] = first(source)?;
                let own = [[w0, w1, w2], [h0, h1, h2]].map(side);
                if size.is_some_and(|size| own[0] > size[0] || own[1] > size[1]) || length < 16 {
                    return Err(wrong("a picture is larger than the file states"));
                }
                parts(source, data.start + 16..data.end, Some(own), true)?;
            }
            b"VP8 " => {
                let [t0, t1, t2, _, _, _, w0, w1, h0, h1] = first(source)?;
                // The length of the first partition follows one bit for the frame type, three for the version and one for the display.
                let first = u32::from_le_bytes([t0, t1, t2, 0]) >> 5;
                let own = [[w0, w1], [h0, h1]].map(|side| u32::from(u16::from_le_bytes(side) & 0x3fff));
                expect(own, size)?;
                if 10 + u64::from(first) > length {
                    return Err(wrong("a part ends beyond the file"));
                }
            }
            b"VP8L" => {
                let [_, b0, b1, b2, b3] = first(source)?;
                let bits = u32::from_le_bytes([b0, b1, b2, b3]);
                expect([1 + (bits & 0x3fff), 1 + (bits >> 14 & 0x3fff)], size)?;
            }
            _ => {}
        }
    }
    Ok(())
}

/// Returns a side of a picture, which is stored minus one.
fn side([a, b, c]: [u8; 3]) -> u32 {
    1 + u32::from_le_bytes([a, b, c, 0])
}

fn first<const N: usize>(source: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    source.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn expect(own: [u32; 2], size: Option<[u32; 2]>) -> io::Result<()> {
    match size {
        Some(size) if size != own => Err(wrong("a picture has another size than the file states")),
        _ => Ok(()),
    }
}

fn wrong(what: &str) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, what)
}
