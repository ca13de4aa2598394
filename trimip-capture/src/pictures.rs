//! The pictures of a capture: what the first stage came to.

use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, path::Path};
use trimip::{Error, Result, formatting::count};

/// Fewest pictures of which cameras can be found.
const FEWEST: usize = 3;

/// A picture that COLMAP sees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Picture {
    /// Its path in `images/`, with slashes.
    pub name: String,
    /// The photograph below the folder of the user, or the frame of the film.
    pub source: String,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Time in the film, seconds.
    pub seconds: Option<f64>,
    /// Variance of the Laplacian of a frame, grey levels squared; `None` if it was not measured.
    pub sharpness: Option<f64>,
}

/// A photograph that is no picture of the capture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// The photograph.
    pub name: String,
    /// Why.
    pub reason: String,
}

/// All pictures, in the order of their names.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pictures {
    /// Those that are there.
    pub pictures: Vec<Picture>,
    /// Those that are not.
    pub left_out: Vec<LeftOut>,
    /// True for frames of a film.
    pub of_film: bool,
    /// The program that converted photographs.
    pub converted_by: Option<String>,
    /// What was found on the way, a line each.
    pub notes: Vec<String>,
}

impl Pictures {
    /// Refuses too few.
    ///
    /// # Errors
    /// Of kind `Input`.
    pub fn expect_enough(&self, place: &Path) -> Result<()> {
        if self.pictures.len() >= FEWEST {
            return Ok(());
        }
        let why =
            self.left_out.first().map_or(String::new(), |out| format!(" ({}: {})", out.name, out.reason));
        Err(Error::input(
            place.display(),
            format!("holds {} alone{why}", count(self.pictures.len() as u64, "picture")),
            format!("cameras need at least {FEWEST} that overlap"),
        ))
    }

    /// True if every picture is a file in `folder`.
    pub fn are_in(&self, folder: &Path) -> bool {
        self.pictures.iter().all(|picture| folder.join(&picture.name).is_file())
    }

    /// Number of pictures of each size.
    pub fn sizes(&self) -> BTreeMap<[u32; 2], usize> {
        let mut sizes = BTreeMap::new();
        self.pictures.iter().for_each(|picture| *sizes.entry(picture.size).or_default() += 1);
        sizes
    }
}
