//! Named tensors and their files. The format is safetensors, which every backend and Python read.

use crate::{Error, Result, atomic::replace_atomically};
use safetensors::{
    Dtype, SafeTensors,
    tensor::{Metadata, TensorInfo},
};
use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::Path;

/// Key of the file format's metadata whose value holds all of our metadata as one JSON object. We use one key because
/// the format's keys have no order, and the same run must write the same file.
const METADATA: &str = "trimip";

/// Size in bytes of the field for the header's length, which precedes the header. The header is padded to a multiple of
/// this size.
const LENGTH: usize = size_of::<u64>();

/// Values of a tensor.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Values {
    /// 32-bit floats.
    F32(Vec<f32>),
    /// 16-bit floats.
    F16(Vec<half::f16>),
    /// Bytes.
    U8(Vec<u8>),
}

/// A dense tensor, last axis contiguous.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Extent of each axis.
    pub shape: Vec<usize>,
    /// The values; their number is the product of `shape`.
    pub values: Values,
}

impl Tensor {
    /// Creates a tensor of floats. The number of `values` is the product of `shape`; the last axis is contiguous.
    pub fn f32(shape: &[usize], values: Vec<f32>) -> Self {
        debug_assert_eq!(shape.iter().product::<usize>(), values.len());
        Self { shape: shape.to_vec(), values: Values::F32(values) }
    }

    /// Creates a tensor of bytes. The number of `values` is the product of `shape`; the last axis is contiguous.
    pub fn u8(shape: &[usize], values: Vec<u8>) -> Self {
        debug_assert_eq!(shape.iter().product::<usize>(), values.len());
        Self { shape: shape.to_vec(), values: Values::U8(values) }
    }

    /// Returns the size of the values in bytes.
    pub fn size(&self) -> usize {
        self.bytes().0.len()
    }

    /// Returns the tensor with its values rounded to f16, or unchanged if a value would become infinite.
    pub fn to_f16(&self) -> Self {
        match &self.values {
            Values::F32(values) if values.iter().all(|value| value.abs() < 65_504.0) => {
                let values = values.iter().map(|&value| half::f16::from_f32(value)).collect();
                Self { shape: self.shape.clone(), values: Values::F16(values) }
            }
            _ => self.clone(),
        }
    }

    /// Converts f16 values to f32 in place.
    pub fn widen(&mut self) {
        if let Values::F16(values) = &self.values {
            self.values = Values::F32(values.iter().map(|value| value.to_f32()).collect());
        }
    }

    /// Returns index and value of the first number that is not finite.
    pub fn not_finite(&self) -> Option<(usize, f32)> {
        match &self.values {
            Values::F32(values) => {
                values.iter().position(|value| !value.is_finite()).map(|index| (index, values[index]))
            }
            Values::F16(values) => values
                .iter()
                .position(|value| !value.is_finite())
                .map(|index| (index, values[index].to_f32())),
            Values::U8(_) => None,
        }
    }

    fn bytes(&self) -> (&[u8], Dtype) {
        match &self.values {
            Values::F32(values) => (bytemuck::cast_slice(values), Dtype::F32),
            Values::F16(values) => (bytemuck::cast_slice(values), Dtype::F16),
            Values::U8(values) => (values, Dtype::U8),
        }
    }
}

/// Tensors by name, with metadata.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TensorFile {
    /// Tensors by name.
    pub tensors: BTreeMap<String, Tensor>,
    /// Metadata by key.
    pub metadata: BTreeMap<String, String>,
}

impl TensorFile {
    /// Returns the tensor `name` as floats of the given shape, last axis contiguous. Errors name the tensor and its
    /// file, `file`.
    ///
    /// # Errors
    /// When there is no such tensor, or it has another type or shape.
    pub fn f32(&self, file: &str, name: &str, shape: &[usize]) -> Result<&[f32]> {
        match self.tensors.get(name) {
            Some(Tensor { shape: found, values: Values::F32(values) }) if found == shape => Ok(values),
            found => Err(wrong_tensor(file, name, "f32", shape, found)),
        }
    }

    /// Returns the tensor `name` as bytes of the given shape, last axis contiguous.
    ///
    /// # Errors
    /// When there is no such tensor, or it has another type or shape.
    pub fn u8(&self, file: &str, name: &str, shape: &[usize]) -> Result<&[u8]> {
        match self.tensors.get(name) {
            Some(Tensor { shape: found, values: Values::U8(values) }) if found == shape => Ok(values),
            found => Err(wrong_tensor(file, name, "u8", shape, found)),
        }
    }

    /// Rejects a file with a number that is not finite; the error names the tensor and the index of that number.
    ///
    /// # Errors
    /// When there is such a number.
    pub fn expect_finite(&self, file: &str) -> Result<()> {
        for (name, tensor) in &self.tensors {
            if let Some((index, value)) = tensor.not_finite() {
                return Err(Error::input(
                    file,
                    format!("tensor `{name}` has {value} at index {index}"),
                    "use an earlier file, or train again (with a lower optimizer.learning_rate)",
                ));
            }
        }
        Ok(())
    }

    /// Returns the metadata under `key`.
    ///
    /// # Errors
    /// When there is no such entry.
    pub fn text(&self, file: &str, key: &str) -> Result<&str> {
        self.metadata.get(key).map(String::as_str).ok_or_else(|| {
            Error::input(file, format!("no metadata `{key}`"), "use a file that trimip-cli wrote")
        })
    }

    /// Writes the file at `path`, atomically, with `metadata` in addition to its own; returns its size in bytes. Tensors
    /// are written directly to the disk, without a second copy in memory.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path, metadata: &[(&str, String)]) -> Result<u64> {
        self.encode(metadata, |parts| {
            replace_atomically(path, |file| {
                parts.iter().try_for_each(|part| file.write_all(part))?;
                Ok(parts.iter().map(|part| part.len() as u64).sum())
            })
        })
    }

    /// Returns the bytes of the file that [`write`](Self::write) writes.
    ///
    /// # Errors
    /// When the metadata cannot be written as JSON.
    pub fn to_bytes(&self, metadata: &[(&str, String)]) -> Result<Vec<u8>> {
        self.encode(metadata, |parts| Ok(parts.concat()))
    }

    /// Calls `write` with the parts of the file, in order.
    fn encode<R>(&self, metadata: &[(&str, String)], write: impl FnOnce(&[&[u8]]) -> Result<R>) -> Result<R> {
        let mut all = self.metadata.clone();
        all.extend(metadata.iter().map(|(key, value)| ((*key).to_string(), value.clone())));
        // Wider types come first, so that every tensor is aligned.
        let mut tensors: Vec<_> =
            self.tensors.iter().map(|(name, tensor)| (name, tensor, tensor.bytes())).collect();
        tensors.sort_by(|(a, _, (_, left)), (b, _, (_, right))| right.cmp(left).then(a.cmp(b)));
        let mut end = 0;
        let infos = tensors.iter().map(|(name, tensor, (bytes, dtype))| {
            let start = end;
            end += bytes.len();
            let info = TensorInfo { dtype: *dtype, shape: tensor.shape.clone(), data_offsets: (start, end) };
            ((*name).clone(), info)
        });
        let own = HashMap::from([(METADATA.to_string(), serde_json::to_string(&all).map_err(Error::run)?)]);
        let header = Metadata::new(Some(own), infos.collect()).map_err(Error::run)?;
        let mut header = serde_json::to_vec(&header).map_err(Error::run)?;
        header.resize(header.len().next_multiple_of(LENGTH), b' ');
        let length = (header.len() as u64).to_le_bytes();
        let mut parts: Vec<&[u8]> = vec![&length, &header];
        parts.extend(tensors.iter().map(|(.., (bytes, _))| &bytes[..]));
        write(&parts)
    }

    /// Parses the bytes of a file; `file` names the file in errors.
    ///
    /// # Errors
    /// When the bytes are not a safetensors file of known types.
    pub fn from_bytes(file: &str, bytes: &[u8]) -> Result<Self> {
        let broken = |error: safetensors::SafeTensorError| {
            Error::input(
                file,
                format!("not a complete safetensors file: {error}"),
                "use a file that was written completely",
            )
        };
        let views = SafeTensors::deserialize(bytes).map_err(broken)?;
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(broken)?;
        let mut tensors = BTreeMap::new();
        for (name, view) in views.tensors() {
            let values = match view.dtype() {
                Dtype::F32 => Values::F32(bytemuck::allocation::pod_collect_to_vec(view.data())),
                Dtype::F16 => Values::F16(bytemuck::allocation::pod_collect_to_vec(view.data())),
                Dtype::U8 => Values::U8(view.data().to_vec()),
                other => {
                    return Err(Error::input(
                        file,
                        format!("tensor `{name}` is {other:?}"),
                        "expected f32, f16 or u8",
                    ));
                }
            };
            tensors.insert(name, Tensor { shape: view.shape().to_vec(), values });
        }
        let metadata = match header.metadata().as_ref().and_then(|metadata| metadata.get(METADATA)) {
            Some(text) => serde_json::from_str(text).map_err(|error| {
                Error::input(file, format!("its metadata: {error}"), "use a file of this version")
            })?,
            None => BTreeMap::new(),
        };
        Ok(Self { tensors, metadata })
    }

    /// Reads the file at `path`.
    ///
    /// # Errors
    /// When the file cannot be read or is not a safetensors file of known types.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = crate::plain_file::read(path)
            .map_err(|error| Error::input(path.display(), error, "name an existing .safetensors file"))?;
        Self::from_bytes(&path.display().to_string(), &bytes)
    }
}

fn wrong_tensor(file: &str, name: &str, kind: &str, shape: &[usize], found: Option<&Tensor>) -> Error {
    let found =
        found.map_or("missing".to_string(), |tensor| format!("{:?} {:?}", tensor.bytes().1, tensor.shape));
    Error::input(
        file,
        format!("tensor `{name}` is {found}, expected {kind} {shape:?}"),
        "use a file of the same configuration",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> TensorFile {
        let mut file = TensorFile::default();
        file.tensors.insert(
            "a.weight".into(),
            Tensor::f32(&[2, 3], vec![0.0, -1.5, f32::MIN_POSITIVE, 1e30, 0.1, 7.0]),
        );
        file.tensors.insert("bits".into(), Tensor::u8(&[3], vec![1, 0, 255]));
        file.metadata.insert("format".into(), "test".into());
        file
    }

    /// Returns the bytes of the sample's file.
    fn bytes() -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sample.safetensors");
        let written = sample().write(&path, &[("more", "text".into())]).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "no temporary file stays behind");
        let bytes = std::fs::read(path).unwrap();
        assert_eq!(bytes.len() as u64, written);
        bytes
    }

    #[test]
    fn the_bytes_are_those_of_the_format() {
        let file = sample();
        let views = file.tensors.iter().map(|(name, tensor)| {
            let (bytes, dtype) = tensor.bytes();
            (name, safetensors::tensor::TensorView::new(dtype, tensor.shape.clone(), bytes).unwrap())
        });
        let own = [("format", "test"), ("more", "text")].map(|(key, value)| (key.to_string(), value));
        let own = serde_json::to_string(&BTreeMap::from(own)).unwrap();
        let expected =
            safetensors::serialize(views, Some(HashMap::from([(METADATA.to_string(), own)]))).unwrap();
        assert!(bytes() == expected);
    }

    #[test]
    fn what_is_written_is_read() {
        let mut expected = sample();
        expected.metadata.insert("more".into(), "text".into());
        assert_eq!(TensorFile::from_bytes("x", &bytes()).unwrap(), expected);
    }

    #[test]
    fn every_truncation_is_an_error_and_none_a_panic() {
        let bytes = bytes();
        for length in 0..bytes.len() {
            let error = TensorFile::from_bytes("cut.safetensors", &bytes[..length]).unwrap_err();
            assert_eq!(error.kind(), crate::ErrorKind::Input);
            assert!(error.message().starts_with("cut.safetensors: "));
        }
    }

    #[test]
    fn a_wrong_tensor_is_named_with_both_shapes() {
        let error = sample().f32("m", "a.weight", &[3, 2]).unwrap_err();
        assert!(
            error.message().contains("a.weight")
                && error.message().contains("[2, 3]")
                && error.message().contains("[3, 2]")
        );
        assert!(sample().f32("m", "none", &[1]).unwrap_err().message().contains("missing"));
    }
}
