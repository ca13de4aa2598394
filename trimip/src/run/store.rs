//! Stores a run's checkpoint, model and test pictures as files of its run folder. Pictures show evenly spaced test
//! views, and the worst and best view of the finest scale.

use super::folder::{RunFolder, picture_stem};
use super::nearest::TrainingCameras;
use crate::view::{flip_colors, flip_of_pictures, pictures, write_cameras};
use image::RgbImage;
use serde::{Deserialize, Serialize};
use std::path::Path;
use trimip_core::{
    Camera, Config, Error, Result,
    atomic::write_atomically,
    engine::checkpoint::Checkpoint,
    field::model::Model,
    plain_file,
    run::{Store, evaluate::ViewResult},
    scene::origin::LocalOrigin,
};

/// Suffix of a comparison's file name, after the stem of its picture.
const COMPARISON: &str = "_compare";

/// Suffix of the file name of a map of FLIP errors, after the stem of its picture.
const FLIP: &str = "_flip";

/// Maximum bytes of a photograph's name in the file name of its picture. File names have up to 255 bytes.
const LONGEST: usize = 160;

/// One view of the final evaluation, as stored in `views.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewRecord {
    /// Index of the frame in the test split.
    pub index: usize,
    /// Name of the photograph.
    pub name: String,
    /// Reduction factor of the view.
    pub scale: u32,
    /// PSNR in dB; `None` if it is not finite.
    pub psnr: Option<f64>,
    /// Structural similarity.
    pub ssim: Option<f64>,
    /// Structural similarity at five scales; `None` if it was not measured, as in files of earlier versions.
    #[serde(default)]
    pub ms_ssim: Option<f64>,
    /// Mean FLIP error; `None` if it was not measured.
    #[serde(default)]
    pub flip: Option<f64>,
    /// LPIPS distance; `None` if it was not measured.
    #[serde(default)]
    pub lpips: Option<f64>,
    /// Distance of its camera to the nearest training camera, world units; `None` in files of earlier versions.
    #[serde(default)]
    pub nearest_distance: Option<f64>,
    /// The distance as a multiple of the median distance between a training camera and its nearest neighbour; `None` also if that median is
    /// 0.
    #[serde(default)]
    pub nearest_spacings: Option<f64>,
    /// File in `images/` with rendered | photograph | difference, if the view was selected for a picture.
    pub comparison: Option<String>,
    /// File in `images/` with the FLIP error of each pixel in the colours of magma, 0 to 1; `None` without a picture, or in a build
    /// without FLIP.
    #[serde(default)]
    pub flip_map: Option<String>,
}

/// A candidate for the worst or the best view; its pictures are kept until all views are seen.
struct Extreme {
    /// Index of the view's record.
    record: usize,
    /// PSNR in dB; a value that is not finite counts as the worst.
    psnr: f64,
    stem: String,
    shown: Shown,
}

/// Pictures of a view.
#[derive(Clone)]
struct Shown {
    rendered: RgbImage,
    sheet: RgbImage,
    /// The FLIP error of each pixel, if it was measured.
    errors: Option<Vec<f32>>,
}

/// Stores a run in its folder.
pub struct FileStore<'a> {
    folder: &'a RunFolder,
    /// Origin of the run's coordinates in the coordinates of the photographs.
    origin: LocalOrigin,
    /// The training cameras. The record of a test view has its distance to the nearest one.
    training: TrainingCameras,
    /// Indices of the test frames with pictures. `images` is their maximum number.
    picked: Vec<usize>,
    images: usize,
    records: Vec<ViewRecord>,
    worst: Option<Extreme>,
    best: Option<Extreme>,
}

impl<'a> FileStore<'a> {
    /// Creates a store for the run of `config`. Stores pictures of the first `eval.images` test frames that it receives; an evaluation
    /// renders evenly spaced frames first. The records have the distances of test views to the nearest `training` camera.
    pub fn new(folder: &'a RunFolder, config: &Config, training: TrainingCameras) -> Self {
        let (origin, images) = (LocalOrigin::of(&config.data), config.eval.images as usize);
        let (picked, records) = (Vec::new(), Vec::new());
        Self { folder, origin, training, picked, images, records, worst: None, best: None }
    }

    /// Writes the worst and the best view and `views.json`, and removes pictures of an earlier evaluation. With
    /// `eval.images = 0` it writes no pictures.
    fn finish(&mut self) -> Result<()> {
        for extreme in [self.worst.take(), self.best.take()].into_iter().flatten() {
            let (comparison, flip_map) = self.write(&extreme.stem, extreme.shown)?;
            let record = &mut self.records[extreme.record];
            (record.comparison, record.flip_map) = (Some(comparison), flip_map);
        }
        let names = |record: &ViewRecord| [record.comparison.clone(), record.flip_map.clone()];
        let kept: Vec<String> = self.records.iter().flat_map(names).flatten().collect();
        for path in self.folder.pictures() {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if !kept.iter().any(|keep| *keep == name || keep.replace(COMPARISON, "") == name) {
                // A picture that cannot be removed does no harm: no file refers to it.
                let _ = std::fs::remove_file(path);
            }
        }
        let mut records = self.records.clone();
        records.sort_by_key(|record| (record.index, record.scale));
        let text = serde_json::to_string_pretty(&records).map_err(Error::run)?;
        write_atomically(&self.folder.views(), text.as_bytes())
    }

    /// Writes a view's picture, its comparison and its FLIP errors, and computes these errors if they were not measured. Returns the file
    /// names of the comparison and of the errors.
    fn write(&self, stem: &str, shown: Shown) -> Result<(String, Option<String>)> {
        let Shown { rendered, sheet, errors } = shown;
        let (images, comparison) = (self.folder.images(), format!("{stem}{COMPARISON}.png"));
        let (width, height) = rendered.dimensions();
        let [_, photograph, _] = pictures::panels(&sheet);
        let errors = errors.or_else(|| flip_of_pictures(&rendered, &photograph));
        let map = errors.and_then(|errors| flip_colors(width, height, &errors));
        pictures::write_png(&images.join(format!("{stem}.png")), rendered)?;
        pictures::write_png(&images.join(&comparison), sheet)?;
        let Some(map) = map else { return Ok((comparison, None)) };
        let name = format!("{stem}{FLIP}.png");
        pictures::write_png(&images.join(&name), map)?;
        Ok((comparison, Some(name)))
    }

    /// Reads the views of the final evaluation; empty if there was none.
    pub fn read(folder: &RunFolder) -> Vec<ViewRecord> {
        Self::recorded(folder).unwrap_or_default()
    }

    /// Returns true if `views.json` and every picture that it names exist.
    pub fn is_whole(folder: &RunFolder) -> bool {
        let there = |name: &str| folder.images().join(name).is_file();
        let pictured = |comparison: &String| there(comparison) && there(&comparison.replace(COMPARISON, ""));
        let whole = |view: &ViewRecord| {
            view.comparison.as_ref().is_none_or(pictured)
                && view.flip_map.as_ref().is_none_or(|map| there(map))
        };
        Self::recorded(folder).is_some_and(|views| views.iter().all(whole))
    }

    fn recorded(folder: &RunFolder) -> Option<Vec<ViewRecord>> {
        serde_json::from_slice(&plain_file::read(&folder.views()).ok()?).ok()
    }
}

impl Store for FileStore<'_> {
    fn checkpoint(&mut self, checkpoint: &Checkpoint) -> Result<u64> {
        checkpoint.write(&self.folder.checkpoint())
    }

    fn model(&mut self, model: &Model) -> Result<u64> {
        model.write(&self.folder.model())
    }

    fn cameras(&mut self, cameras: &[(String, Camera)]) -> Result<()> {
        write_cameras(&self.folder.cameras(), cameras, self.origin, None)
    }

    fn view(&mut self, view: &ViewResult<'_>) -> Result<()> {
        let psnr = finite(view.psnr).unwrap_or(f64::NEG_INFINITY);
        let finest = self.records.first().is_none_or(|first| first.scale == view.scale);
        let wanted = finest && self.images > 0;
        let worst = wanted && self.worst.as_ref().is_none_or(|extreme| psnr < extreme.psnr);
        let best = wanted && self.best.as_ref().is_none_or(|extreme| psnr > extreme.psnr);
        let (mut comparison, mut flip_map) = (None, None);
        if self.picked.len() < self.images && !self.picked.contains(&view.index) {
            self.picked.push(view.index);
        }
        if worst || best || self.picked.contains(&view.index) {
            let stem = picture_stem(view.index, &file_stem(view.name), view.scale);
            let (width, height, rgb) = (view.rendered.width, view.rendered.height, view.rendered.rgb());
            let rendered = pictures::rgb_image(width, height, &rgb);
            let sheet = pictures::side_by_side(width, height, &rgb, view.target);
            let shown = Shown { rendered, sheet, errors: view.perceptual.flip_map.clone() };
            let record = self.records.len();
            for (place, _) in [(&mut self.worst, worst), (&mut self.best, best)].into_iter().filter(|p| p.1) {
                *place = Some(Extreme { record, psnr, stem: stem.clone(), shown: shown.clone() });
            }
            if self.picked.contains(&view.index) {
                let (sheet, map) = self.write(&stem, shown)?;
                (comparison, flip_map) = (Some(sheet), map);
            }
        }
        let nearest = self.training.nearest(view.camera);
        self.records.push(ViewRecord {
            index: view.index,
            name: view.name.to_string(),
            scale: view.scale,
            psnr: finite(view.psnr),
            ssim: finite(view.ssim),
            ms_ssim: finite(view.perceptual.ms_ssim),
            flip: finite(view.perceptual.flip),
            lpips: finite(view.perceptual.lpips),
            nearest_distance: nearest.map(|nearest| nearest.distance),
            nearest_spacings: nearest.and_then(|nearest| nearest.spacings),
            comparison,
            flip_map,
        });
        Ok(())
    }

    fn evaluated(&mut self) -> Result<()> {
        self.finish()
    }
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// Returns the last component of a photograph's name without extension, safe as a file name: at most 160 bytes, which leaves room for the
/// rest of a picture's name.
pub fn file_stem(name: &str) -> String {
    let stem = Path::new(name).file_stem().unwrap_or_default().to_string_lossy();
    let safe = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let mut length = 0;
    let fits = |letter: &char| {
        length += letter.len_utf8();
        length <= LONGEST
    };
    stem.chars().map(safe).take_while(fits).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use trimip_core::{Frame, Intrinsics, measures::perception::PerceptualScores};

    #[test]
    fn the_worst_and_the_best_view_have_pictures_too() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        folder.prepare_images().unwrap();
        let mut config = Config::default();
        config.eval.images = 1;
        let at = |x: f64| {
            let k = Intrinsics::from_angle(2, 1, 0.7);
            Camera::look_at(k, DVec3::new(x, 4.0, 0.0), DVec3::ZERO, DVec3::Z)
        };
        let training = TrainingCameras::new(&[at(0.0), at(2.0), at(4.0)]);
        let mut store = FileStore::new(&folder, &config, training);
        let rendered = Frame { width: 2, height: 1, pixels: vec![Default::default(); 2] };
        let target = [[0.5; 3]; 2];
        // Frame 0 is selected; scale 2 has the lowest and the highest PSNR overall.
        for (index, psnr) in [20.0, 30.0, 25.0, 10.0, 22.0].into_iter().enumerate() {
            for (scale, psnr) in [(1, psnr), (2, if index == 0 { 1.0 } else { 50.0 })] {
                let name = format!("r_{index}");
                let (rendered, target, ssim) = (&rendered, &target[..], 0.5);
                let perceptual = &PerceptualScores { flip: 0.25, ..PerceptualScores::NOTHING };
                let (name, camera) = (&name[..], &at(5.0 + index as f64));
                let view =
                    ViewResult { index, name, scale, camera, rendered, target, psnr, ssim, perceptual };
                store.view(&view).unwrap();
            }
        }
        assert!(!FileStore::is_whole(&folder), "its evaluation is not over");
        store.evaluated().unwrap();
        assert!(FileStore::is_whole(&folder));
        let pictured: Vec<_> = FileStore::read(&folder)
            .into_iter()
            .filter_map(|view| view.comparison.map(|file| (view.index, view.scale, file)))
            .collect();
        let places: Vec<_> = pictured.iter().map(|(index, scale, _)| (*index, *scale)).collect();
        assert_eq!(places, [(0, 1), (0, 2), (1, 1), (3, 1)]);
        assert!(pictured.iter().all(|(_, _, file)| folder.images().join(file).exists()));
        assert_eq!(folder.pictures().len(), if cfg!(feature = "flip") { 12 } else { 8 });
        let views = FileStore::read(&folder);
        assert!(views.iter().all(|view| {
            let distance = 1.0 + view.index as f64;
            (view.nearest_distance, view.nearest_spacings) == (Some(distance), Some(0.5 * distance))
        }));
        assert!(views.iter().all(|view| (view.flip, view.ms_ssim, view.lpips) == (Some(0.25), None, None)));
        for map in views.iter().filter_map(|view| view.flip_map.as_ref()) {
            assert_eq!(image::open(folder.images().join(map)).unwrap().into_rgb8().dimensions(), (2, 1));
        }
        for path in folder.pictures().into_iter().chain([folder.views()]) {
            let bytes = std::fs::read(&path).unwrap();
            std::fs::remove_file(&path).unwrap();
            assert!(!FileStore::is_whole(&folder), "{} is missing", path.display());
            std::fs::write(&path, bytes).unwrap();
        }
        assert!(FileStore::is_whole(&folder));
    }

    #[test]
    fn names_of_photographs_become_safe_file_names() {
        assert_eq!(file_stem("./test/r 0.png"), "r_0");
        assert_eq!(file_stem("../../etc/pass:wd"), "pass_wd");
        // The longest names that a file system allows, with one and with several bytes per letter.
        for letter in ["n", "é", "視"] {
            let name = letter.repeat(251 / letter.len());
            let stem = picture_stem(usize::MAX, &file_stem(&format!("{name}.png")), u32::MAX);
            assert!(format!("{stem}{COMPARISON}.png.trimip.tmp").len() <= 255, "{stem}");
            assert!(name.starts_with(&file_stem(&name)) && file_stem(&name).len() > LONGEST - letter.len());
        }
    }
}
