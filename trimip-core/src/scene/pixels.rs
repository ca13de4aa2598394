//! The pixels of a set of photographs: RGBA, 8 bits each, in memory or in other storage that provides a slice, such as a file
//! that the system pages in.

use std::ops::{Deref, DerefMut};
use std::sync::Arc;

/// Storage of pixels other than a vector, such as a memory map.
pub trait Holder: AsRef<[[u8; 4]]> + Send + Sync {}

impl<T: AsRef<[[u8; 4]]> + Send + Sync> Holder for T {}

/// RGBA pixels, read as a slice. Writing to pixels in other storage first copies them into a vector.
#[derive(Clone)]
pub struct Pixels(Storage);

#[derive(Clone)]
enum Storage {
    Memory(Vec<[u8; 4]>),
    /// Pixels in `holder`; `in_memory` is true if they take memory of this process.
    Elsewhere {
        holder: Arc<dyn Holder>,
        in_memory: bool,
    },
}

impl Pixels {
    /// Returns pixels in `holder`, which take no memory of this process.
    pub fn elsewhere(holder: impl Holder + 'static) -> Self {
        Self(Storage::Elsewhere { holder: Arc::new(holder), in_memory: false })
    }

    /// Returns pixels in memory of this process that `holder` has reserved.
    pub fn in_memory_of(holder: impl Holder + 'static) -> Self {
        Self(Storage::Elsewhere { holder: Arc::new(holder), in_memory: true })
    }

    /// Returns the bytes of this process's memory that the pixels take.
    pub fn bytes_in_memory(&self) -> usize {
        match &self.0 {
            Storage::Memory(pixels) => size_of_val(pixels.as_slice()),
            Storage::Elsewhere { holder, in_memory: true } => size_of_val(holder.as_ref().as_ref()),
            Storage::Elsewhere { in_memory: false, .. } => 0,
        }
    }

    /// Appends a pixel.
    pub fn push(&mut self, pixel: [u8; 4]) {
        self.in_memory().push(pixel);
    }

    fn in_memory(&mut self) -> &mut Vec<[u8; 4]> {
        if let Storage::Elsewhere { holder, .. } = &self.0 {
            self.0 = Storage::Memory(holder.as_ref().as_ref().to_vec());
        }
        match &mut self.0 {
            Storage::Memory(pixels) => pixels,
            Storage::Elsewhere { .. } => unreachable!("they were copied"),
        }
    }
}

impl Default for Pixels {
    fn default() -> Self {
        Vec::new().into()
    }
}

impl From<Vec<[u8; 4]>> for Pixels {
    fn from(pixels: Vec<[u8; 4]>) -> Self {
        Self(Storage::Memory(pixels))
    }
}

impl FromIterator<[u8; 4]> for Pixels {
    fn from_iter<I: IntoIterator<Item = [u8; 4]>>(pixels: I) -> Self {
        Vec::from_iter(pixels).into()
    }
}

impl Extend<[u8; 4]> for Pixels {
    fn extend<I: IntoIterator<Item = [u8; 4]>>(&mut self, pixels: I) {
        self.in_memory().extend(pixels);
    }
}

impl Deref for Pixels {
    type Target = [[u8; 4]];

    #[inline]
    fn deref(&self) -> &[[u8; 4]] {
        match &self.0 {
            Storage::Memory(pixels) => pixels,
            Storage::Elsewhere { holder, .. } => holder.as_ref().as_ref(),
        }
    }
}

impl DerefMut for Pixels {
    fn deref_mut(&mut self) -> &mut [[u8; 4]] {
        self.in_memory()
    }
}

impl PartialEq for Pixels {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl std::fmt::Debug for Pixels {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} pixels, {} bytes in memory", self.len(), self.bytes_in_memory())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_elsewhere_are_the_same_pixels_and_are_copied_to_be_changed() {
        let own = vec![[1, 2, 3, 4], [5, 6, 7, 8]];
        let here = Pixels::from(own.clone());
        for (there, bytes) in [(Pixels::elsewhere(own.clone()), 0), (Pixels::in_memory_of(own), 8)] {
            assert_eq!(here, there);
            assert_eq!((here.bytes_in_memory(), there.bytes_in_memory()), (8, bytes));
            let mut changed = there.clone();
            changed[1][0] = 9;
            changed.push([0; 4]);
            changed.extend([[7; 4]]);
            assert_eq!(*changed, [[1, 2, 3, 4], [9, 6, 7, 8], [0; 4], [7; 4]]);
            assert_eq!((there.len(), changed.bytes_in_memory()), (2, 16));
        }
    }
}
