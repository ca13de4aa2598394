//! Converts arrays of numbers to bytes and back, for messages between ranks. All ranks run the same program on machines
//! of the same kind.

use crate::buffer::Buffer;
use bytemuck::Pod;
use trimip_core::{Error, Result, engine::exchange};

/// Appends the bytes of `values` to the message `out`, without their number.
pub fn put<T: Pod>(out: &mut Vec<u8>, values: &[T]) {
    out.extend_from_slice(bytemuck::cast_slice(values));
}

/// Appends the number of values, then the values, to the message `out`.
pub fn put_counted<T: Pod>(out: &mut Vec<u8>, values: &[T]) {
    put(out, &[values.len() as u64]);
    put(out, values);
}

/// Reader of a message. A read beyond the end of the message is an error of the same kind as a lost rank, because in
/// both cases the results of a rank are unavailable. Nothing is allocated for missing values.
pub struct Reader<'a> {
    rest: &'a [u8],
    /// Number of bytes of the whole message.
    length: usize,
}

impl<'a> Reader<'a> {
    /// Creates a reader at the beginning of `bytes`.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, length: bytes.len() }
    }

    fn fault(&self, expected: impl std::fmt::Display) -> Error {
        let at = self.length - self.rest.len();
        exchange::fault(format_args!("expected {expected} at byte {at} of {}", self.length))
    }

    /// Reads the next value.
    ///
    /// # Errors
    /// When the message is too short.
    pub fn one<T: Pod>(&mut self) -> Result<T> {
        self.bytes(size_of::<T>()).map(bytemuck::pod_read_unaligned)
    }

    /// Overwrites `to` with the next values, as many as `to` has.
    ///
    /// # Errors
    /// When the message has fewer values; `to` is then unchanged.
    pub fn copy<T: Pod>(&mut self, to: &mut [T]) -> Result<()> {
        let to: &mut [u8] = bytemuck::cast_slice_mut(to);
        to.copy_from_slice(self.bytes(to.len())?);
        Ok(())
    }

    /// Reads the next `count` bytes.
    ///
    /// # Errors
    /// When the message has fewer bytes.
    pub fn bytes(&mut self, count: usize) -> Result<&'a [u8]> {
        let Some((bytes, rest)) = self.rest.split_at_checked(count) else {
            return Err(self.fault(format_args!("{count} bytes")));
        };
        self.rest = rest;
        Ok(bytes)
    }

    /// Reads a number of bytes, then that many bytes.
    ///
    /// # Errors
    /// When the message has fewer bytes.
    pub fn counted_bytes(&mut self) -> Result<&'a [u8]> {
        let count = self.count::<u8>()?;
        self.bytes(count)
    }

    /// Reads the number of values that follow, and checks that the message holds them.
    fn count<T: Pod>(&mut self) -> Result<usize> {
        let count: u64 = self.one()?;
        let fits = usize::try_from(count)
            .ok()
            .filter(|count| count.checked_mul(size_of::<T>()).is_some_and(|bytes| bytes <= self.rest.len()));
        fits.ok_or_else(|| self.fault(format_args!("{count} values of {} bytes", size_of::<T>())))
    }

    /// Replaces a buffer with the values that [`put_counted`] wrote.
    ///
    /// # Errors
    /// When the message has fewer values than it states.
    pub fn buffer<T: Pod>(&mut self, to: &mut Buffer<T>) -> Result<()> {
        to.resize(self.count::<T>()?);
        self.copy(to)
    }

    /// Replaces a list with the values that [`put_counted`] wrote.
    ///
    /// # Errors
    /// When the message has fewer values than it states.
    pub fn list<T: Pod>(&mut self, to: &mut Vec<T>) -> Result<()> {
        to.clear();
        to.resize(self.count::<T>()?, T::zeroed());
        self.copy(to)
    }

    /// Replaces a list with the indices that [`put_counted`] wrote, all of which must be below `count`.
    ///
    /// # Errors
    /// When the message has fewer indices than it states, or an index is too large.
    pub fn indices(&mut self, to: &mut Vec<u32>, count: usize) -> Result<()> {
        self.list(to)?;
        match to.iter().all(|index| (*index as usize) < count) {
            true => Ok(()),
            false => Err(self.fault(format_args!("indices below {count} before the values"))),
        }
    }

    /// Checks that `found`, the number of values `what` in the message, is `expected`.
    ///
    /// # Errors
    /// When the numbers differ.
    pub fn expect(&self, what: &str, found: usize, expected: usize) -> Result<()> {
        match found == expected {
            true => Ok(()),
            false => Err(self.fault(format_args!("{expected} {what}, found {found},"))),
        }
    }

    /// Checks that the message is read to its end.
    ///
    /// # Errors
    /// When the message has more bytes.
    pub fn end(&self) -> Result<()> {
        match self.rest.is_empty() {
            true => Ok(()),
            false => Err(self.fault("the end")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip_core::ErrorKind;

    /// Returns a message with every kind of value.
    fn message() -> Vec<u8> {
        let mut bytes = Vec::new();
        put(&mut bytes, &[7_u8]);
        put_counted(&mut bytes, &[1_u32, 2, 3]);
        put_counted::<u32>(&mut bytes, &[]);
        put_counted(&mut bytes, &[[0.5_f32; 3]; 2]);
        put(&mut bytes, &[1.5_f64, 2.5]);
        put_counted(&mut bytes, b"end");
        bytes
    }

    fn read(message: &[u8]) -> Result<()> {
        let (mut list, mut buffer, mut two) = (vec![9_u32], Buffer::<[f32; 3]>::zeros(7), [0.0_f64; 2]);
        let mut reader = Reader::new(message);
        assert_eq!(reader.one::<u8>()?, 7);
        reader.list(&mut list)?;
        assert_eq!(list, [1, 2, 3]);
        reader.list(&mut list)?;
        assert!(list.is_empty());
        reader.buffer(&mut buffer)?;
        assert_eq!(&buffer[..], &[[0.5; 3]; 2]);
        reader.copy(&mut two)?;
        assert_eq!(two, [1.5, 2.5]);
        assert_eq!(reader.counted_bytes()?, b"end");
        reader.end()
    }

    #[test]
    fn arrays_of_all_lengths_and_alignments_come_back() {
        read(&message()).unwrap();
    }

    #[test]
    fn a_message_of_another_length_is_an_error_that_says_where() {
        let whole = message();
        for length in 0..whole.len() {
            let error = read(&whole[..length]).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::Device, "{length}: {error}");
            assert!(
                error.message().contains("expected") && error.message().contains(&format!("of {length}")),
                "{error}"
            );
        }
        let longer = [&whole[..], &[0]].concat();
        let error = read(&longer).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Device);
        assert!(
            error.message().contains(&format!("the end at byte {} of {}", whole.len(), longer.len())),
            "{error}"
        );
    }

    #[test]
    fn nothing_is_allocated_for_values_that_are_not_there() {
        for count in [2, 1 << 40, u64::MAX / 12 + 1, u64::MAX] {
            let mut bytes = Vec::new();
            put(&mut bytes, &[count]);
            put(&mut bytes, &[[0.5_f32; 3]]);
            let (mut list, mut buffer) = (Vec::<[f32; 3]>::new(), Buffer::<[f32; 3]>::zeros(0));
            assert!(Reader::new(&bytes).list(&mut list).is_err() && list.capacity() == 0, "{count}");
            assert!(Reader::new(&bytes).buffer(&mut buffer).is_err() && buffer.is_empty(), "{count}");
        }
        let mut bytes = Vec::new();
        put(&mut bytes, &[u64::MAX]);
        assert!(Reader::new(&bytes).counted_bytes().is_err());
    }
}
