//! Compact model files for transfer: `export web` writes them, and every program of the workspace reads them.
//!
//! A tensor that model files hold as f16 (an encoder's) is quantised to 8 bits per value. Every channel (index of the
//! last axis) has its own range, from its least to its greatest value. Codes are stored channel by channel, each as the
//! difference to the previous code, which is zero for untouched texels. The differences are compressed (DEFLATE, RFC
//! 1951). Network weights stay f32. Assets are left out.

use crate::{
    Config, Error, Layout, Result,
    field::{
        deflate::{deflated, inflated},
        tensor_names::{ASSET, OCCUPANCY},
        tensors::{Tensor, TensorFile, Values},
    },
};
use flate2::Compression;

/// Value of the metadata `format` of a packed file.
pub(crate) const FORMAT: &str = "trimip-packed-1";

/// Suffix of the tensor with the least value and the step of each channel, shape [channels, 2].
const SCALES: &str = ".scales";

/// Largest code of a channel; the smallest code is 0.
const MOST: f32 = 255.0;

/// Decompresses the tensor `tensor` of `file` to `expected` bytes.
fn bytes(file: &str, tensor: &str, packed: &Tensor, expected: usize) -> Result<Vec<u8>> {
    inflated(packed, expected)
        .map_err(|what| Error::input(file, format!("tensor `{tensor}` {what}"), "export the model again"))
}

/// Returns codes and scales of a tensor with `channels` values per row.
fn coded(values: &[f32], channels: usize) -> (Vec<u8>, Vec<f32>) {
    let (mut codes, mut scales) = (Vec::with_capacity(values.len()), Vec::with_capacity(2 * channels));
    for channel in 0..channels {
        let own = || values[channel..].iter().step_by(channels);
        let (low, high) = own().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &value| {
            (low.min(value), high.max(value))
        });
        let step = (high - low) / MOST;
        let inverse = if step > 0.0 { step.recip() } else { 0.0 };
        let mut before = 0_u8;
        codes.extend(own().map(|value| {
            let code = ((value - low) * inverse).round() as u8;
            code.wrapping_sub(std::mem::replace(&mut before, code))
        }));
        scales.extend([low, step]);
    }
    (codes, scales)
}

/// Inverts [`coded`].
fn decoded(codes: &[u8], scales: &[f32], channels: usize) -> Vec<f32> {
    let rows = codes.len() / channels;
    let mut values = vec![0.0; codes.len()];
    for (channel, codes) in codes.chunks_exact(rows.max(1)).enumerate() {
        let (low, step) = (scales[2 * channel], scales[2 * channel + 1]);
        let mut code = 0_u8;
        for (row, difference) in codes.iter().enumerate() {
            code = code.wrapping_add(*difference);
            values[row * channels + channel] = low + step * f32::from(code);
        }
    }
    values
}

/// Returns the tensors of a model, packed; `coarse` names the tensors that are quantised to 8 bits per value.
///
/// # Errors
/// When the tensors cannot be compressed.
pub(crate) fn pack(file: &TensorFile, coarse: &[String]) -> Result<TensorFile> {
    let mut packed = TensorFile { metadata: file.metadata.clone(), ..TensorFile::default() };
    for (name, tensor) in file.tensors.iter().filter(|(name, _)| !name.starts_with(ASSET)) {
        let mut wide = tensor.clone();
        wide.widen();
        let channels = tensor.shape.last().copied().unwrap_or(1);
        match &wide.values {
            Values::F32(values) if coarse.contains(name) => {
                let (codes, scales) = coded(values, channels);
                packed.tensors.insert(name.clone(), deflated(&codes, Compression::best())?);
                packed.tensors.insert(format!("{name}{SCALES}"), Tensor::f32(&[channels, 2], scales));
            }
            Values::U8(bytes) => {
                packed.tensors.insert(name.clone(), deflated(bytes, Compression::best())?);
            }
            _ => {
                packed.tensors.insert(name.clone(), wide);
            }
        }
    }
    Ok(packed)
}

/// Returns the tensors of a packed file in the form that its configuration declares. `name` names the file in errors.
///
/// # Errors
/// When a tensor is missing or has a wrong number of bytes.
pub(crate) fn unpack(name: &str, packed: &TensorFile, config: &Config) -> Result<TensorFile> {
    let mut file = TensorFile { metadata: packed.metadata.clone(), ..TensorFile::default() };
    let missing =
        |tensor: &str| Error::input(name, format!("no tensor `{tensor}`"), "export the model again");
    let find = |tensor: &str| packed.tensors.get(tensor).ok_or_else(|| missing(tensor));
    for slot in Layout::new(&config.centred().0).slots {
        let (found, scales) = (find(&slot.name)?, format!("{}{SCALES}", slot.name));
        if !packed.tensors.contains_key(&scales) {
            file.tensors.insert(slot.name, found.clone());
            continue;
        }
        let channels = slot.shape.last().copied().unwrap_or(1).max(1);
        let scales = packed.f32(name, &scales, &[channels, 2])?;
        let codes = bytes(name, &slot.name, found, slot.shape.iter().product())?;
        file.tensors.insert(slot.name, Tensor::f32(&slot.shape, decoded(&codes, scales, channels)));
    }
    let bits = bytes(name, OCCUPANCY, find(OCCUPANCY)?, config.occupancy.cells().div_ceil(8))?;
    file.tensors.insert(OCCUPANCY.into(), Tensor::u8(&[bits.len()], bits));
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_back_within_half_a_step_of_their_channel() {
        let channels = 5;
        let value = |i: usize| ((i * i * 7919) % 1009) as f32 / 500.0 - 1.0;
        let values: Vec<f32> = (0..channels * 400).map(|i| value(i) * (1 + i % channels) as f32).collect();
        let (codes, scales) = coded(&values, channels);
        let found = decoded(&codes, &scales, channels);
        for (i, (value, found)) in values.iter().zip(&found).enumerate() {
            let step = scales[2 * (i % channels) + 1];
            assert!((value - found).abs() <= 0.5001 * step, "{i}: {value} became {found}, a step is {step}");
        }
        // The least value of a channel is exact, and so are all values of a constant channel.
        assert!(
            (0..channels).all(|c| found.iter().skip(c).step_by(channels).any(|own| *own == scales[2 * c]))
        );
        let (codes, scales) = coded(&[0.3; 12], 4);
        assert_eq!(decoded(&codes, &scales, 4), [0.3; 12]);
    }
}
