//! Reads a model from the bytes of its files, and checks that entries are unique and refer to existing entries of the other files.

use super::{
    binary,
    model::{Encoding, File, Model, ModelImage},
    text,
};
use std::fmt::Display;
use trimip_core::{Error, Result};

impl Model {
    /// Reads a model from the bytes of its files. In memory, the model takes at most twice the size of its files, if
    /// they are binary or text as COLMAP writes it. Text with the shortest possible lines takes six times its size.
    ///
    /// # Errors
    /// Of kind `Input`: invalid syntax, numbers that are not finite, entries that occur twice, references to missing
    /// entries. The message names the file, and the line, the byte or the entry.
    pub fn parse(
        encoding: Encoding,
        cameras: File<'_>,
        images: File<'_>,
        points: Option<File<'_>>,
    ) -> Result<Self> {
        let mut model = match encoding {
            Encoding::Text => Self {
                cameras: text::cameras(cameras)?,
                images: text::images(images)?,
                points: points.map(text::points).transpose()?.unwrap_or_default(),
            },
            Encoding::Binary => Self {
                cameras: binary::cameras(cameras)?,
                images: binary::images(images)?,
                points: points.map(binary::points).transpose()?.unwrap_or_default(),
            },
        };
        model.drop_unknown_images();
        model.check(cameras.name, images.name, points.map_or("", |file| file.name))?;
        Ok(model)
    }

    /// Removes from each track the images that the model does not hold: users delete photographs from models.
    fn drop_unknown_images(&mut self) {
        let known = sorted(self.images.iter().map(|image| image.id));
        for point in &mut self.points {
            let is_known = |step: &[u32; 2]| known.binary_search(&step[0]).is_ok();
            if !point.track.iter().all(is_known) {
                point.track = point.track.iter().copied().filter(is_known).collect();
            }
        }
    }

    /// Checks that entries are unique and refer to existing ones.
    fn check(&self, cameras: &str, images: &str, points: &str) -> Result<()> {
        let broken = |place: &str, entry: String, what: String| {
            Err(Error::input(format!("{place}: {entry}"), what, "export the model again"))
        };
        let twice = || "is listed twice".to_string();
        let known = sorted(self.cameras.iter().map(|camera| camera.id));
        if let Some(id) = double(&known) {
            return broken(cameras, format!("camera {id}"), twice());
        }
        let mut order: Vec<usize> = (0..self.images.len()).collect();
        order.sort_unstable_by_key(|&index| self.images[index].id);
        for pair in order.windows(2) {
            let [a, b] = [&self.images[pair[0]], &self.images[pair[1]]];
            if a.id == b.id {
                return broken(images, b.place(), twice());
            }
        }
        for image in &self.images {
            if known.binary_search(&image.camera).is_err() {
                let what = format!("has the camera {}, which {cameras} does not hold", image.camera);
                return broken(images, image.place(), what);
            }
        }
        if let Some(id) = double(&sorted(self.points.iter().map(|point| point.id))) {
            return broken(points, format!("point {id}"), twice());
        }
        for point in &self.points {
            for [image, feature] in &point.track {
                let Ok(at) = order.binary_search_by_key(image, |&index| self.images[index].id) else {
                    continue;
                };
                let places = self.images[order[at]].places.len();
                // Some programs drop the features but keep the tracks.
                if places > 0 && *feature as usize >= places {
                    let what = format!("names feature {feature} of image {image}, which has {places}");
                    return broken(points, format!("point {}", point.id), what);
                }
            }
        }
        let mut names: Vec<&ModelImage> = self.images.iter().collect();
        names.sort_unstable_by_key(|image| image.name.as_str());
        if let Some(pair) = names.windows(2).find(|pair| pair[0].name == pair[1].name) {
            return broken(images, pair[1].place(), format!("has the name of image {}", pair[0].id));
        }
        Ok(())
    }
}

fn sorted<T: Ord>(ids: impl ExactSizeIterator<Item = T>) -> Vec<T> {
    let mut ids: Vec<T> = ids.collect();
    ids.sort_unstable();
    ids
}

/// Returns the first of the sorted numbers that occurs twice.
fn double<T: Copy + PartialEq + Display>(ids: &[T]) -> Option<T> {
    ids.windows(2).find(|pair| pair[0] == pair[1]).map(|pair| pair[0])
}
