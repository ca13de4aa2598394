//! Compressed bytes as tensors of files (DEFLATE, RFC 1951).

use crate::{
    Error, Result,
    field::tensors::{Tensor, Values},
};
use flate2::{Compression, read::DeflateDecoder, write::DeflateEncoder};
use std::io::{Read, Write};

/// Compresses bytes.
///
/// # Errors
/// When there is not enough memory.
pub(crate) fn deflated(bytes: &[u8], effort: Compression) -> Result<Tensor> {
    let mut encoder = DeflateEncoder::new(Vec::new(), effort);
    encoder.write_all(bytes).map_err(Error::run)?;
    let packed = encoder.finish().map_err(Error::run)?;
    Ok(Tensor::u8(&[packed.len()], packed))
}

/// Decompresses the `expected` bytes of a compressed tensor, and never more than one byte beyond them.
///
/// # Errors
/// A description of the fault, which a message can put after the tensor's name.
pub(crate) fn inflated(packed: &Tensor, expected: usize) -> std::result::Result<Vec<u8>, String> {
    let Values::U8(packed) = &packed.values else { return Err("is not u8".into()) };
    let mut bytes = Vec::new();
    // One byte more than expected is enough to detect that there are too many.
    match DeflateDecoder::new(&packed[..]).take(expected as u64 + 1).read_to_end(&mut bytes) {
        Ok(count) if count == expected => Ok(bytes),
        Ok(_) => Err(format!("does not hold {expected} bytes")),
        Err(error) => Err(format!("cannot be read: {error}")),
    }
}
