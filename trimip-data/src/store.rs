//! Storage of decoded photographs: memory, or a file without a name that the system pages in and drops as memory
//! allows. Both hold the same pixels, so the results of a run have the same bits.

use crate::settings::PixelStore;
use memmap2::{Mmap, MmapMut};
use std::{fs, io::Write};
use trimip_core::{Error, Pixels, Result, memory::available_memory, plural::count};

/// Largest share of the available memory that photographs may take before they are kept on disk.
const SHARE: f64 = 0.5;

/// Bytes that are written at once to reserve the file's space.
const CHUNK: usize = 1 << 20;

/// Returns true if `store` keeps `pixels` pixels in a file.
pub(crate) fn is_on_disk(store: PixelStore, pixels: usize) -> bool {
    match store {
        PixelStore::Memory => false,
        PixelStore::Disk => true,
        PixelStore::Auto => {
            available_memory().is_some_and(|bytes| 4.0 * pixels as f64 > SHARE * bytes as f64)
        }
    }
}

/// Allocates pixels of zeros and has `fill` write them.
///
/// # Errors
/// If there is no room for them, and errors of `fill`.
pub(crate) fn filled(
    on_disk: bool,
    pixels: usize,
    fill: impl FnOnce(&mut [[u8; 4]]) -> Result<()>,
) -> Result<Pixels> {
    if pixels == 0 {
        fill(&mut [])?;
        return Ok(Pixels::default());
    }
    if !on_disk {
        let mut map = in_memory(pixels).map_err(|_| too_large())?;
        fill(map.as_chunks_mut().0)?;
        return Ok(Pixels::in_memory_of(Mapped(map.make_read_only().map_err(|_| too_large())?)));
    }
    let mut map = reserve(pixels).map_err(|error| {
        let needed = format!("{:.1} GB", 4e-9 * pixels as f64);
        Error::input(
            "data.pixels",
            format!(
                "{} need {needed} in a file in {}: {error}",
                count(pixels, "pixel"),
                std::env::temp_dir().display()
            ),
            "free space there, set TMPDIR to another disk, or lower data.most_pixels",
        )
    })?;
    fill(map.as_chunks_mut().0)?;
    let map = map.make_read_only().map_err(|error| Error::run(format!("photographs on disk: {error}")))?;
    Ok(Pixels::elsewhere(Mapped(map)))
}

/// Maps memory of zeros. Training reads single pixels of all photographs at random, so large pages are requested where
/// the system has them: with small pages most of these reads wait for the page table.
fn in_memory(pixels: usize) -> std::io::Result<MmapMut> {
    let map = MmapMut::map_anon(pixels.checked_mul(4).ok_or(std::io::ErrorKind::OutOfMemory)?)?;
    // A refusal is harmless: small pages hold the same pixels.
    #[cfg(target_os = "linux")]
    let _ = map.advise(memmap2::Advice::HugePage);
    Ok(map)
}

/// Maps a file of zeros that is deleted when this process ends. Writing the zeros reserves its space, so a full disk is
/// an error here and not a signal later.
#[allow(unsafe_code)] // the only way to map a file
fn reserve(pixels: usize) -> std::io::Result<MmapMut> {
    let mut file: fs::File = tempfile::tempfile()?;
    let (zeros, mut left) = (vec![0; CHUNK], 4 * pixels);
    while left > 0 {
        let part = left.min(CHUNK);
        file.write_all(&zeros[..part])?;
        left -= part;
    }
    // SAFETY: the file has no name, so no other process opens, changes or truncates it.
    unsafe { MmapMut::map_mut(&file) }
}

/// Pixels in mapped memory, with or without a file.
struct Mapped(Mmap);

impl AsRef<[[u8; 4]]> for Mapped {
    fn as_ref(&self) -> &[[u8; 4]] {
        self.0.as_chunks().0
    }
}

fn too_large() -> Error {
    Error::input(
        "data",
        "the images do not fit into memory",
        "set data.pixels = \"disk\", or use fewer or smaller images",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_places_hold_the_same_pixels() {
        let fill = |pixels: &mut [[u8; 4]]| {
            assert!(pixels.iter().all(|pixel| *pixel == [0; 4]));
            pixels.iter_mut().enumerate().for_each(|(i, pixel)| *pixel = (i as u32).to_le_bytes());
            Ok(())
        };
        for count in [0, 1, 600_001] {
            let [memory, disk] = [false, true].map(|on_disk| filled(on_disk, count, fill).unwrap());
            assert_eq!(memory, disk);
            assert_eq!((memory.bytes_in_memory(), disk.bytes_in_memory()), (4 * count, 0));
        }
        let failing = filled(true, 5, |_| Err(Error::input("a", "b", "c"))).unwrap_err();
        assert_eq!(failing.kind(), trimip_core::ErrorKind::Input);
    }

    #[test]
    fn few_pixels_stay_in_memory_and_more_than_there_is_do_not() {
        assert!(!is_on_disk(PixelStore::Auto, 1000) && !is_on_disk(PixelStore::Memory, usize::MAX));
        assert!(is_on_disk(PixelStore::Disk, 1));
        if available_memory().is_some() {
            assert!(is_on_disk(PixelStore::Auto, 1 << 50));
        }
    }
}
