//! Pictures whose cameras were not placed, each with its most likely reason.

use super::{
    database::{self, Counts},
    models::Models,
    pictures::{Picture, Pictures},
};
use serde::{Deserialize, Serialize};
use std::{cell::OnceCell, path::Path};
use trimip::formatting::count;
use trimip_core::scene::strays::LOST;

/// A picture counts as blurred if its sharpness, divided by that of its neighbours, is below this share.
const BLURRED: f64 = 0.4;

/// Number of neighbours on each side of a frame, and number of placed photographs that a photograph is compared with.
const NEIGHBOURS: usize = 4;
const COMPARED: usize = 16;

/// Minimum features, and minimum matches with one picture: with fewer, a camera can hardly be placed. COLMAP's mapper needs 30 matches with
/// known points.
const FEW_FEATURES: u64 = 300;
const FEW_MATCHES: u64 = 60;

/// Longest side of the pictures whose sharpness is measured, pixels.
const MEASURED: u32 = 960;

/// A picture that was not placed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Unplaced {
    /// Path in `images/`.
    pub name: String,
    /// Name of the picture in the user's input.
    pub source: String,
    /// Most likely reason.
    pub reason: String,
}

/// Returns the pictures whose cameras are missing or lost in the first model, with reasons.
pub fn find(pictures: &Pictures, models: &Models, images: &Path, database: &Path) -> Vec<Unplaced> {
    let all = &pictures.pictures;
    let Some((best, others)) = models.models.split_first() else { return Vec::new() };
    let placed =
        |picture: &Picture| best.pictures.contains(&picture.name) && !best.lost.contains(&picture.name);
    let left: Vec<usize> = (0..all.len()).filter(|&index| !placed(&all[index])).collect();
    if left.is_empty() {
        return Vec::new();
    }
    let counts = database::counts(database).unwrap_or_default();
    let sharpness = Sharpness { all, images, placed: &placed, of_placed: OnceCell::new() };
    let unplaced = |index: usize| {
        let picture = &all[index];
        let other = others.iter().find(|other| other.pictures.contains(&picture.name));
        let reason = match other {
            _ if best.lost.contains(&picture.name) => {
                format!("its camera is more than {LOST} times as far from the centre as the median camera")
            }
            Some(other) => format!(
                "in another model of {}, which shares too little with the best one (models/{})",
                count(other.pictures.len() as u64, "picture"),
                other.folder
            ),
            None => reason(sharpness.of_neighbours(index), counts.get(&picture.name).copied()),
        };
        Unplaced { name: picture.name.clone(), source: picture.source.clone(), reason }
    };
    left.into_iter().map(unplaced).collect()
}

/// Returns the most likely reason. `sharpness` is relative to that of the neighbours; `counts` come from the database.
fn reason(sharpness: Option<f64>, counts: Option<Counts>) -> String {
    let blurred = sharpness.filter(|share| *share < BLURRED);
    let matched = |Counts { features, pairs, most }: Counts| {
        format!("{features} features, at most {most} matches with one of {}", count(pairs, "picture"))
    };
    match (blurred, counts) {
        (Some(share), counts) => {
            let more = counts.map_or(String::new(), |counts| format!("; {}", matched(counts)));
            format!("too blurred: {:.0} % of the sharpness of its neighbours{more}", 100.0 * share)
        }
        (None, Some(counts)) if counts.features < FEW_FEATURES => {
            format!("too few features ({}): little texture, or too dark", counts.features)
        }
        (None, Some(counts)) if counts.pairs == 0 => {
            format!("no picture matches it ({} features)", counts.features)
        }
        (None, Some(counts)) if counts.most < FEW_MATCHES => format!("too few matches: {}", matched(counts)),
        (None, Some(counts)) => format!("no pose agrees with its matches: {}", matched(counts)),
        (None, None) => "too few matches with the pictures that were placed".into(),
    }
}

/// Sharpness of pictures relative to that of other pictures.
struct Sharpness<'a> {
    all: &'a [Picture],
    images: &'a Path,
    placed: &'a dyn Fn(&Picture) -> bool,
    /// Median sharpness of the placed photographs that were measured.
    of_placed: OnceCell<Option<f64>>,
}

impl Sharpness<'_> {
    /// Returns the sharpness of a picture divided by a median: for a frame, that of its neighbours; for a photograph, that of up to 16
    /// placed photographs. `None` if a sharpness cannot be measured.
    fn of_neighbours(&self, index: usize) -> Option<f64> {
        let own = self.of(&self.all[index])?;
        let median = match self.all[index].sharpness {
            Some(_) => {
                let from = index.saturating_sub(NEIGHBOURS);
                let near = self.all.iter().enumerate().skip(from).take(2 * NEIGHBOURS + 1);
                self.median(near.filter(|(other, _)| *other != index).map(|(_, picture)| picture))
            }
            // Photographs have to be decoded first, so only some are measured, once.
            None => *self.of_placed.get_or_init(|| {
                let placed: Vec<&Picture> =
                    self.all.iter().filter(|picture| (self.placed)(picture)).collect();
                let step = placed.len().div_ceil(COMPARED).max(1);
                self.median(placed.into_iter().step_by(step))
            }),
        }?;
        (median > 0.0).then(|| own / median)
    }

    fn median<'b>(&self, pictures: impl Iterator<Item = &'b Picture>) -> Option<f64> {
        let mut all: Vec<f64> = pictures.filter_map(|picture| self.of(picture)).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied()
    }

    fn of(&self, picture: &Picture) -> Option<f64> {
        picture.sharpness.or_else(|| sharpness(&self.images.join(&picture.name)))
    }
}

/// Returns the sharpness of a photograph at a reduced size, because its detail at the level of pixels says little.
fn sharpness(path: &Path) -> Option<f64> {
    let reader = image::ImageReader::open(path).ok()?.with_guessed_format().ok()?;
    let grey = reader.decode().ok()?.into_luma8();
    let side = grey.width().max(grey.height()).div_ceil(MEASURED).max(1) as usize;
    let (width, height) = (grey.width() as usize, grey.height() as usize);
    Some(super::grey::Grey { width, height, pixels: grey.into_raw() }.reduced(side).sharpness())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::models::Placed;

    #[test]
    fn every_reason_has_its_sign() {
        let counts = |features, pairs, most| Some(Counts { features, pairs, most });
        for (sharpness, counts, expected) in [
            (Some(0.2), counts(900, 3, 20), "too blurred: 20 %"),
            (Some(0.9), counts(100, 3, 20), "too few features (100)"),
            (None, counts(900, 0, 0), "no picture matches it"),
            (
                Some(1.1),
                counts(900, 3, 20),
                "too few matches: 900 features, at most 20 matches with one of 3 pictures",
            ),
            (Some(1.1), counts(900, 3, 200), "no pose agrees"),
            (None, None, "too few matches"),
        ] {
            let told = reason(sharpness, counts);
            assert!(told.starts_with(expected), "{told}");
        }
    }

    #[test]
    fn pictures_of_other_models_and_blurred_frames_are_told() {
        let picture = |index: usize| Picture {
            name: format!("{index}.jpg"),
            source: format!("frame {index}"),
            size: [8, 8],
            seconds: Some(0.0),
            sharpness: Some(if index == 5 { 3.0 } else { 100.0 }),
        };
        let pictures = Pictures { pictures: (0..10).map(picture).collect(), ..Pictures::default() };
        let named = |of: &[usize]| of.iter().map(|index| format!("{index}.jpg")).collect();
        let model = |folder: &str, of: &[usize], lost: &[usize]| Placed {
            folder: folder.into(),
            pictures: named(of),
            lost: named(lost),
            points: 5,
            error: None,
        };
        let models = Models { models: vec![model("1", &[0, 1, 2, 3, 4, 6], &[3]), model("0", &[7, 8], &[])] };
        let nowhere = Path::new("nowhere");
        let found = find(&pictures, &models, nowhere, nowhere);
        let told: Vec<_> = found.iter().map(|one| (one.source.as_str(), one.reason.as_str())).collect();
        assert_eq!(told.len(), 5);
        assert!(told[0].0 == "frame 3" && told[0].1.contains("1000 times as far"), "{told:?}");
        assert!(told[1].0 == "frame 5" && told[1].1.starts_with("too blurred: 3 %"), "{told:?}");
        assert!(
            told[2].1.contains("in another model of 2 pictures") && told[2].1.contains("models/0"),
            "{told:?}"
        );
        assert!(told[4].1.starts_with("too few matches"));
    }
}
