//! The built-in scene as a reader: its frames are rendered on request, and no file is needed.

use super::reader::{OpenScene, Reader};
use crate::{
    builtin::{CAMERA_ANGLE_X, FORMAT, test_cameras, train_cameras},
    settings::DataConfig,
    source::{Pixels, Source},
    split::Split,
};
use trimip_core::{Error, Intrinsics, Result};

pub(super) static READER: Reader = Reader {
    format: FORMAT,
    name: "built-in scene",
    files: None,
    recognises: |_| false,
    open: |_, config| Ok(Box::new(Builtin(config.clone()))),
    ..Reader::PLAIN
};

/// The scene with its settings.
struct Builtin(DataConfig);

impl OpenScene for Builtin {
    fn split(&self, name: &str) -> Result<Split> {
        split(&self.0, name)
    }
}

/// Returns the frames of a split, which are rendered on request.
pub(crate) fn split(config: &DataConfig, split: &str) -> Result<Split> {
    for (key, value, range) in [
        ("data.builtin_size", config.builtin_size, 1..=16_384),
        ("data.builtin_train", config.builtin_train, 1..=100_000),
        ("data.builtin_test", config.builtin_test, 1..=100_000),
        ("data.builtin_supersampling", config.builtin_supersampling, 1..=256),
    ] {
        if !range.contains(&value) {
            let expected = format!("expected {} to {}", range.start(), range.end());
            return Err(Error::input(key, format!("is {value}"), expected));
        }
    }
    let k = Intrinsics::from_angle(config.builtin_size, config.builtin_size, CAMERA_ANGLE_X);
    let cameras = match split {
        "train" => train_cameras(k, config.builtin_train as usize),
        "test" => test_cameras(k, config.builtin_test as usize),
        _ => {
            return Err(Error::input(
                "builtin",
                format!("has no split \"{split}\", only train, test"),
                "choose one of them for data.train and data.test",
            ));
        }
    };
    let pixels =
        || Pixels::Rendered { supersampling: config.builtin_supersampling, finish: config.builtin_finish };
    let sources = cameras
        .into_iter()
        .enumerate()
        .map(|(i, camera)| {
            Source::averaged(format!("r_{i}"), camera, config.scales, &"data.builtin_size".into(), pixels())
        })
        .collect::<Result<_>>()?;
    Ok(Split { sources, ..Split::default() })
}
