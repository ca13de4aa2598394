//! Arrays of numbers as bytes, for messages between ranks of one program on machines of one kind.

use crate::buffer::Buffer;
use bytemuck::Pod;

/// Appends values.
pub fn put<T: Pod>(out: &mut Vec<u8>, values: &[T]) {
    out.extend_from_slice(bytemuck::cast_slice(values));
}

/// Appends a number of values and the values.
pub fn put_counted<T: Pod>(out: &mut Vec<u8>, values: &[T]) {
    put(out, &[values.len() as u64]);
    put(out, values);
}

/// A message that is being read.
pub struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    /// Reads from the beginning.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self(bytes)
    }

    /// The next value; zero behind the end.
    pub fn one<T: Pod>(&mut self) -> T {
        let mut value = [T::zeroed()];
        self.copy(&mut value);
        value[0]
    }

    /// Overwrites `to` with the next values. Those behind the end are left.
    pub fn copy<T: Pod>(&mut self, to: &mut [T]) {
        let to: &mut [u8] = bytemuck::cast_slice_mut(to);
        let now = self.bytes(to.len());
        to[..now.len()].copy_from_slice(now);
    }

    /// The next bytes; fewer at the end.
    pub fn bytes(&mut self, count: usize) -> &'a [u8] {
        let (now, rest) = self.0.split_at(count.min(self.0.len()));
        self.0 = rest;
        now
    }

    /// The next bytes, whose number comes first.
    pub fn counted_bytes(&mut self) -> &'a [u8] {
        let count = self.one::<u64>() as usize;
        self.bytes(count)
    }

    /// Replaces a buffer by what [`put_counted`] wrote.
    pub fn buffer<T: Pod>(&mut self, to: &mut Buffer<T>) {
        to.resize(self.one::<u64>() as usize);
        self.copy(to);
    }

    /// Replaces a list by what [`put_counted`] wrote.
    pub fn list<T: Pod>(&mut self, to: &mut Vec<T>) {
        to.clear();
        to.resize(self.one::<u64>() as usize, T::zeroed());
        self.copy(to);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_of_all_lengths_and_alignments_come_back() {
        let (mut bytes, mut list, mut buffer) = (Vec::new(), vec![9_u32], Buffer::<[f32; 3]>::zeros(7));
        put(&mut bytes, &[7_u8]);
        put_counted(&mut bytes, &[1_u32, 2, 3]);
        put_counted::<u32>(&mut bytes, &[]);
        put_counted(&mut bytes, &[[0.5_f32; 3]; 2]);
        let mut reader = Reader::new(&bytes);
        assert_eq!(reader.one::<u8>(), 7);
        reader.list(&mut list);
        assert_eq!(list, [1, 2, 3]);
        reader.list(&mut list);
        assert!(list.is_empty());
        reader.buffer(&mut buffer);
        assert_eq!(&buffer[..], &[[0.5; 3]; 2]);
        assert_eq!(reader.one::<u64>(), 0, "behind the end");
    }
}
