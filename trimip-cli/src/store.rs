//! Where a run keeps its checkpoint, model and test pictures: files of its run folder.

use crate::{
    pictures,
    run_folder::{RunFolder, picture_stem},
};
use serde::{Deserialize, Serialize};
use std::path::Path;
use trimip_core::{
    Error, Result, checkpoint::Checkpoint, evaluate::ViewResult, model::Model, run::Store,
    tensors::write_atomically,
};

/// One view of the final evaluation, as kept in `views.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewRecord {
    /// Index of the frame in the test split.
    pub index: usize,
    /// Name of the photograph.
    pub name: String,
    /// Reduction of the view.
    pub scale: u32,
    /// dB; `None` where it is no number.
    pub psnr: Option<f64>,
    /// Structural similarity.
    pub ssim: Option<f64>,
    /// File in `images/` with rendered | photograph | difference, where the view was picked for a picture.
    pub comparison: Option<String>,
}

/// Files of a run folder as the run's store.
pub struct FileStore<'a> {
    folder: &'a RunFolder,
    /// Test frames that are pictured, and how many may be.
    picked: Vec<usize>,
    images: usize,
    records: Vec<ViewRecord>,
}

impl<'a> FileStore<'a> {
    /// The first `images` test frames that it sees will be written as pictures: evaluations begin with evenly spread ones.
    pub fn new(folder: &'a RunFolder, images: usize) -> Self {
        Self { folder, picked: Vec::new(), images, records: Vec::new() }
    }

    /// Writes `views.json` and removes pictures of an earlier evaluation; call when the final evaluation is whole.
    pub fn finish(&self) -> Result<()> {
        if self.records.is_empty() {
            return Ok(());
        }
        let kept: Vec<_> = self.records.iter().filter_map(|record| record.comparison.as_deref()).collect();
        for path in self.folder.pictures() {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if !kept.iter().any(|keep| *keep == name || keep.replace("_compare", "") == name) {
                // A picture that cannot be removed does no harm: nothing refers to it.
                let _ = std::fs::remove_file(path);
            }
        }
        let mut records = self.records.clone();
        records.sort_by_key(|record| (record.index, record.scale));
        let text = serde_json::to_string_pretty(&records).map_err(Error::run)?;
        write_atomically(&self.folder.views(), text.as_bytes())
    }

    /// The views of the final evaluation that `finish` wrote; none where there was none.
    pub fn read(folder: &RunFolder) -> Vec<ViewRecord> {
        let text = std::fs::read_to_string(folder.views()).unwrap_or_default();
        serde_json::from_str(&text).unwrap_or_default()
    }
}

impl Store for FileStore<'_> {
    fn checkpoint(&mut self, checkpoint: &Checkpoint) -> Result<u64> {
        checkpoint.write(&self.folder.checkpoint())
    }

    fn model(&mut self, model: &Model) -> Result<u64> {
        model.write(&self.folder.model())
    }

    fn view(&mut self, view: &ViewResult<'_>) -> Result<()> {
        let mut comparison = None;
        if self.picked.len() < self.images && !self.picked.contains(&view.index) {
            self.picked.push(view.index);
        }
        if self.picked.contains(&view.index) {
            let stem = picture_stem(view.index, &file_stem(view.name), view.scale);
            let (width, height, rgb) = (view.rendered.width, view.rendered.height, view.rendered.rgb());
            let images = self.folder.images();
            pictures::write_png(
                &images.join(format!("{stem}.png")),
                pictures::rgb_image(width, height, &rgb),
            )?;
            let sheet = format!("{stem}_compare.png");
            pictures::write_png(
                &images.join(&sheet),
                pictures::side_by_side(width, height, &rgb, view.target),
            )?;
            comparison = Some(sheet);
        }
        self.records.push(ViewRecord {
            index: view.index,
            name: view.name.to_string(),
            scale: view.scale,
            psnr: finite(view.psnr),
            ssim: finite(view.ssim),
            comparison,
        });
        Ok(())
    }
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// The last part of a photograph's name without extension, safe as a file name.
pub fn file_stem(name: &str) -> String {
    let stem = Path::new(name).file_stem().unwrap_or_default().to_string_lossy();
    stem.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_photographs_become_safe_file_names() {
        assert_eq!(file_stem("./test/r 0.png"), "r_0");
        assert_eq!(file_stem("../../etc/pass:wd"), "pass_wd");
    }
}
