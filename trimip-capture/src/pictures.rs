//! The pictures of a capture: the result of the first stage.

use serde::{Deserialize, Serialize};
use std::{collections::BTreeMap, path::Path};
use trimip::{Error, Result, formatting::count};

/// Minimum number of pictures from which cameras can be estimated.
const FEWEST: usize = 3;

/// A picture that COLMAP uses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Picture {
    /// Path in `images/`, with slashes.
    pub name: String,
    /// Path of the photograph in the user's folder, or number of the frame in the film.
    pub source: String,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Time of the frame in the film, seconds.
    pub seconds: Option<f64>,
    /// Variance of the frame's Laplacian, grey levels squared; `None` if it was not measured.
    pub sharpness: Option<f64>,
}

/// A photograph that is not used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Path of the photograph in the user's folder.
    pub name: String,
    /// Reason why it is left out.
    pub reason: String,
}

/// All pictures, in the order of their names.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pictures {
    /// Pictures that COLMAP uses.
    pub pictures: Vec<Picture>,
    /// Photographs that are left out.
    pub left_out: Vec<LeftOut>,
    /// True for frames of a film.
    pub of_film: bool,
    /// The program that converted photographs.
    pub converted_by: Option<String>,
    /// Remarks for the user, one per line.
    pub notes: Vec<String>,
}

impl Pictures {
    /// Refuses fewer than three pictures.
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
            format!("holds only {}{why}", count(self.pictures.len() as u64, "picture")),
            format!("take more: cameras need at least {FEWEST} that overlap"),
        ))
    }

    /// Returns true if every picture exists in `folder`.
    pub fn are_in(&self, folder: &Path) -> bool {
        self.pictures.iter().all(|picture| folder.join(&picture.name).is_file())
    }

    /// Returns the number of pictures of each size.
    pub fn sizes(&self) -> BTreeMap<[u32; 2], usize> {
        let mut sizes = BTreeMap::new();
        self.pictures.iter().for_each(|picture| *sizes.entry(picture.size).or_default() += 1);
        sizes
    }
}
