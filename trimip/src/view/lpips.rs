//! LPIPS (Zhang et al. 2018): the distance of two pictures in the features of a network, whose weights come from an ONNX file.

use rten::{Model, Value};
use std::path::Path;
use trimip_core::{Error, Result};

/// Minimum side of measured pictures, pixels: the networks halve it four times.
const LEAST_SIDE: usize = 32;

/// Side of the two equal pictures with which a file is tested, pixels.
const TRIAL: usize = 64;

/// Largest distance between equal pictures that rounding can cause.
const ROUNDING: f32 = 1e-3;

/// A loaded network.
pub struct Lpips {
    model: Model,
}

impl Lpips {
    /// Reads an ONNX file and checks that the distance of two equal pictures is 0.
    ///
    /// # Errors
    /// Of kind `Input`, when the file cannot be read, or is not a network from two pictures to one number.
    pub fn open(path: &Path) -> Result<Self> {
        let refuse = |what: String| {
            Error::input(
                format!("eval.lpips = \"{}\"", path.display()),
                what,
                "make the file with tools/lpips_onnx.py, or set eval.lpips=\"\" to do without LPIPS",
            )
        };
        let bytes =
            trimip_core::plain_file::read(path).map_err(|error| refuse(format!("cannot read: {error}")))?;
        let model = Model::load(bytes).map_err(|error| refuse(format!("is no ONNX network: {error}")))?;
        let (inputs, outputs) = (model.input_ids().len(), model.output_ids().len());
        if (inputs, outputs) != (2, 1) {
            return Err(refuse(format!(
                "has {inputs} inputs and {outputs} outputs instead of two pictures and one number"
            )));
        }
        let mut lpips = Self { model };
        let grey = vec![[0.5; 3]; TRIAL * TRIAL];
        let distance = lpips.distance(&grey, &grey, TRIAL).map_err(&refuse)?;
        if !(distance.abs() <= ROUNDING) {
            return Err(refuse(format!("gives {distance} instead of 0 for equal pictures")));
        }
        Ok(lpips)
    }

    /// Returns the distance of two pictures with colours in [0, 1] and rows of `width` pixels; NaN if a side has less than 32 pixels.
    ///
    /// # Errors
    /// When the network fails.
    pub fn measure(&mut self, rendered: &[[f32; 3]], target: &[[f32; 3]], width: usize) -> Result<f64> {
        if width < LEAST_SIDE || rendered.len() < LEAST_SIDE * width {
            return Ok(f64::NAN);
        }
        let failed = |what| Error::run(format!("LPIPS failed: {what}; set eval.lpips=\"\" to do without it"));
        self.distance(rendered, target, width).map(f64::from).map_err(failed)
    }

    fn distance(
        &mut self,
        rendered: &[[f32; 3]],
        target: &[[f32; 3]],
        width: usize,
    ) -> std::result::Result<f32, String> {
        let height = rendered.len() / width;
        // Planes of red, green and blue in [-1, 1].
        let planes = |rgb: &[[f32; 3]]| {
            let values =
                (0..3).flat_map(|c| rgb.iter().map(move |pixel| 2.0 * pixel[c].clamp(0.0, 1.0) - 1.0));
            Value::from_shape(&[1, 3, height, width], values.collect::<Vec<f32>>())
                .map_err(|error| error.to_string())
        };
        let ids = self.model.input_ids();
        let inputs = vec![(ids[0], planes(rendered)?.into()), (ids[1], planes(target)?.into())];
        let outputs =
            self.model.run(inputs, self.model.output_ids(), None).map_err(|error| error.to_string())?;
        let output = outputs.into_iter().next().and_then(Value::into_tensor::<f32>);
        let values: Vec<f32> = output.map(|tensor| tensor.into_data()).unwrap_or_default();
        match values[..] {
            [distance] => Ok(distance),
            _ => Err(format!("the network gives {} numbers instead of one", values.len())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a bytes field of a protobuf message.
    fn field(number: u8, bytes: &[u8]) -> Vec<u8> {
        let mut text = vec![number << 3 | 2];
        let mut length = bytes.len();
        while length >= 128 {
            text.push(length as u8 | 128);
            length >>= 7;
        }
        text.push(length as u8);
        [text, bytes.to_vec()].concat()
    }

    /// Returns the ONNX file of a graph. Each node has an operator, its inputs and its output; `inputs` are pictures,
    /// and the result is the output of the last node.
    fn onnx(inputs: &[&str], nodes: &[(&str, &[&str], &str)]) -> Vec<u8> {
        let node = |(operator, inputs, output): &(&str, &[&str], &str)| {
            let names: Vec<u8> = inputs.iter().flat_map(|name| field(1, name.as_bytes())).collect();
            // Means drop the reduced axes: keepdims = 0, an integer.
            let whole = [field(1, b"keepdims"), vec![3 << 3, 0], vec![0xa0, 1, 2]].concat();
            let attribute = if *operator == "ReduceMean" { field(5, &whole) } else { Vec::new() };
            [names, field(2, output.as_bytes()), field(4, operator.as_bytes()), attribute].concat()
        };
        // Tensors of f32.
        let value = |name: &str| [field(1, name.as_bytes()), field(2, &field(1, &[1 << 3, 1]))].concat();
        let nodes_text: Vec<u8> = nodes.iter().flat_map(|one| field(1, &node(one))).collect();
        let inputs: Vec<u8> = inputs.iter().flat_map(|name| field(11, &value(name))).collect();
        let output = nodes.last().map_or("", |node| node.2);
        let graph = [nodes_text, field(2, b"g"), inputs, field(12, &value(output))].concat();
        // Version 8 of the format, version 13 of the operators.
        [vec![1 << 3, 8], field(7, &graph), field(8, &[2 << 3, 13])].concat()
    }

    /// A graph for the mean of the squared differences.
    const SQUARES: [(&str, &[&str], &str); 3] =
        [("Sub", &["a", "b"], "d"), ("Mul", &["d", "d"], "s"), ("ReduceMean", &["s"], "out")];

    fn open(bytes: &[u8]) -> Result<Lpips> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("net.onnx");
        std::fs::write(&path, bytes).unwrap();
        Lpips::open(&path)
    }

    #[test]
    fn a_graph_whose_answer_is_known_is_computed_at_any_size() {
        let mut lpips = open(&onnx(&["a", "b"], &SQUARES)).unwrap();
        for (width, height) in [(32, 32), (50, 41), (50, 41), (97, 33)] {
            let color = |i: usize, k: usize| [(i * k % 7) as f32 / 6.0, (i * k % 5) as f32 / 4.0, 0.25];
            let picture = |k| (0..width * height).map(|i| color(i, k)).collect::<Vec<[f32; 3]>>();
            let (a, b) = (picture(3), picture(4));
            // The network sees values in [-1, 1], which are twice as far apart as values in [0, 1].
            let squares =
                a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| f64::from(2.0 * (a - b)).powi(2));
            let expected = squares.sum::<f64>() / (3 * width * height) as f64;
            let found = lpips.measure(&a, &b, width).unwrap();
            assert!((found - expected).abs() < 1e-5 && expected > 0.1, "{found}, not {expected}");
        }
        let small = vec![[0.0; 3]; 31 * 40];
        assert!(lpips.measure(&small, &small, 31).unwrap().is_nan());
    }

    #[test]
    fn the_rendering_is_the_first_input_and_values_are_from_minus_one_to_one() {
        let nodes: [(&str, &[&str], &str); 3] =
            [("ReduceMean", &["a"], "m"), ("ReduceMean", &["b"], "n"), ("Sub", &["m", "n"], "out")];
        let mut lpips = open(&onnx(&["a", "b"], &nodes)).unwrap();
        let (white, grey) = (vec![[1.0; 3]; 40 * 40], vec![[0.25; 3]; 40 * 40]);
        assert!((lpips.measure(&white, &grey, 40).unwrap() - 1.5).abs() < 1e-6);
    }

    #[test]
    fn files_that_are_no_lpips_are_refused_before_anything_is_measured() {
        let whole = onnx(&["a", "b"], &SQUARES);
        let three = onnx(&["a", "b", "c"], &SQUARES);
        let pictures = onnx(&["a", "b"], &SQUARES[..1]);
        let one_sided = onnx(
            &["a", "b"],
            &[("Exp", &["a"], "e"), ("Add", &["e", "b"], "f"), ("ReduceMean", &["f"], "out")],
        );
        for (bytes, what) in [
            (&b"not a network"[..], "is no ONNX network"),
            (&[], ""),
            (&whole[..whole.len() / 2], ""),
            (&three, "has 3 inputs and 1 outputs"),
            (&pictures, "12288 numbers instead of one"),
            (&one_sided, "for equal pictures"),
        ] {
            let error = open(bytes).err().unwrap_or_else(|| panic!("{what}: accepted"));
            assert_eq!(error.kind(), trimip_core::ErrorKind::Input, "{error}");
            for part in [what, "net.onnx", "tools/lpips_onnx.py"] {
                assert!(error.message().contains(part), "{part}: {error}");
            }
        }
    }
}
