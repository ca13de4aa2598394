//! The content that the viewer shows: the renderers of a model, its box, and its photographs.

use crate::protocol::{Photo, Renderer, Split};
use image::RgbImage;
use image::imageops::{self, FilterType};
use serde_json::{Value, json};
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard};
use trimip::run::folder::RunFolder;
use trimip::view::pictures::rgb_image;
use trimip::{backends, settings};
use trimip_core::field::model::{Model, assets};
use trimip_core::scene::origin::LocalOrigin;
use trimip_core::{
    Aabb, Camera, Config, Crop, Error, Frames, Result, Viewer, config::EncoderKind, engine::proxy::Proxy,
};

/// Maximum number of photographs that are kept decoded.
const KEPT: usize = 4;

/// A model and its photographs.
pub struct Scene {
    /// Name of the model, for the title.
    pub name: String,
    /// Configuration of the model.
    pub config: Config,
    /// The crop that a page has set, which replaces `scene.crop`.
    kept: Mutex<Option<Crop>>,
    /// True if pages initially show only the model's crop (`scene.crop`).
    pub cropped: bool,
    /// Training and test photographs, if they are found.
    pub photographs: Photographs,
    /// Remarks for the user, one per line.
    pub notes: Vec<String>,
    /// Path of the run's report, which may not exist yet.
    pub report: Option<PathBuf>,
}

impl Scene {
    /// Opens the model of a run folder or a model file, and its photographs. `assignments` change its settings.
    ///
    /// # Errors
    /// When there is no model, a setting is wrong, or the backend cannot load the model. Missing photographs only cause a note.
    pub fn open(path: &Path, assignments: &[String]) -> Result<(Self, Renderers)> {
        let mut model = trimip::read_model(path)?;
        settings::override_model(&mut model, assignments)?;
        let stem = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
        let name = if path.is_dir() { stem(path) } else { path.parent().and_then(stem) };
        let (mut scene, renderers) = Self::of(name.unwrap_or_else(|| "model".into()), model)?;
        scene.report = path.is_dir().then(|| RunFolder::new(path).html());
        Ok((scene, renderers))
    }

    /// Creates a scene with this name and model, and opens its photographs.
    ///
    /// # Errors
    /// When the backend cannot load the model. Missing photographs only cause a note.
    pub fn of(name: String, model: Model) -> Result<(Self, Renderers)> {
        let renderers = Renderers::open(&model)?;
        let (photographs, mut notes) = match Photographs::open(&model.config) {
            Ok(photographs) => (photographs, Vec::new()),
            Err(error) => (Photographs::none(), vec![format!("no photographs: {error}")]),
        };
        notes.extend(renderers.notes());
        let (config, kept) = (model.config, Mutex::new(None));
        Ok((Self { name, config, kept, cropped: false, photographs, notes, report: None }, renderers))
    }

    /// Returns the crop that pages may show alone.
    pub fn crop(&self) -> Crop {
        self.kept().unwrap_or(self.config.scene.crop)
    }

    /// Returns the part of the scene's box between two corners.
    ///
    /// # Errors
    /// When the part lies outside the box.
    pub fn part(&self, [low, high]: [[f64; 3]; 2]) -> Result<Crop> {
        let whole = Aabb::<f64>::new(&self.config.scene);
        let min = std::array::from_fn(|axis| low[axis].max(whole.min[axis]));
        let max = std::array::from_fn(|axis| high[axis].min(whole.max[axis]));
        if !(0..3).all(|axis| min[axis] < max[axis]) {
            return Err(Error::input("crop", "lies outside the scene's box", "move the ends of the clip"));
        }
        Ok(Crop::Box { min, max })
    }

    /// Makes `crop` the crop that pages may show alone.
    pub fn keep(&self, crop: Crop) {
        *self.kept() = Some(crop);
    }

    /// Returns a crop in the coordinates of the photographs.
    pub fn stated(&self, crop: Crop) -> Crop {
        LocalOrigin::of(&self.config.data).stated(crop)
    }

    fn kept(&self) -> MutexGuard<'_, Option<Crop>> {
        self.kept.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// Returns the description that a page receives when it opens.
    pub fn describe(&self, renderers: &[Renderer], device: &str) -> Value {
        let scene = &self.config.scene;
        json!({
            "name": self.name,
            "device": device,
            "encoder": self.config.encoder.kind,
            "box": { "min": scene.aabb_min, "max": scene.aabb_max },
            "up": scene.up,
            "origin": self.config.data.origin,
            "crop": self.stated(self.crop()),
            "cropped": self.cropped,
            "background": self.config.data.background,
            "renderers": renderers,
            "flip": cfg!(feature = "flip"),
            "levels": self.config.encoder.kind == EncoderKind::TriMip,
            "notes": self.notes,
            "report": self.report.as_ref().is_some_and(|path| path.is_file()),
            "cameras": self.photographs.describe(),
            "home": trimip::view::home(scene, self.photographs.cameras(Split::Train)),
        })
    }
}

/// The renderers of a model.
pub struct Renderers {
    all: BTreeMap<Renderer, Box<dyn Viewer>>,
}

impl Renderers {
    /// Loads the model once per renderer. Hybrid rendering needs a proxy (`trimip-cli bake`).
    ///
    /// # Errors
    /// When the backend cannot load the model.
    pub fn open(model: &Model) -> Result<Self> {
        let load = |kind: &str| {
            let mut model = model.clone();
            settings::override_model(&mut model, &[format!("renderer.kind={kind}")])?;
            backends::load(&model)
        };
        let mut all = BTreeMap::from([(Renderer::Volume, load("volume")?)]);
        if Proxy::is_in(&assets(&model.file)) {
            all.insert(Renderer::Hybrid, load("hybrid")?);
        }
        Ok(Self { all })
    }

    /// Returns the renderers that are loaded.
    pub fn names(&self) -> Vec<Renderer> {
        self.all.keys().copied().collect()
    }

    /// Returns the name of the device that renders.
    pub fn device(&self) -> String {
        self.all.values().next().map_or_else(String::new, |viewer| viewer.device_name())
    }

    /// Returns `renderer` if it is loaded, otherwise volume rendering.
    pub fn known(&self, renderer: Renderer) -> Renderer {
        if self.all.contains_key(&renderer) { renderer } else { Renderer::Volume }
    }

    /// Returns a renderer, if it is loaded.
    pub fn get(&mut self, renderer: Renderer) -> Option<&mut Box<dyn Viewer>> {
        self.all.get_mut(&renderer)
    }

    fn notes(&self) -> Vec<String> {
        self.all.values().next().map_or_else(Vec::new, |viewer| viewer.notes())
    }
}

/// Photographs with their cameras, decoded on demand.
pub struct Photographs {
    sets: BTreeMap<Split, Set>,
    background: [f32; 3],
    decoded: Mutex<VecDeque<(Photo, RgbImage)>>,
}

struct Set {
    frames: Box<dyn Frames>,
    /// The name of each frame.
    names: Vec<String>,
    /// The camera of each frame at its finest scale.
    cameras: Vec<Camera>,
}

impl Photographs {
    fn none() -> Self {
        Self { sets: BTreeMap::new(), background: [1.0; 3], decoded: Mutex::default() }
    }

    fn open(config: &Config) -> Result<Self> {
        let test = trimip_data::open_test(&config.section()?)?;
        let finest = |frames: &dyn Frames| {
            // Cameras are ordered by frame, and within a frame from fine to coarse.
            let all = frames.cameras();
            let each = all.len() / frames.len().max(1);
            all.into_iter().step_by(each.max(1)).collect::<Vec<_>>()
        };
        let set = |frames: Box<dyn Frames>| Set { names: frames.names(), cameras: finest(&*frames), frames };
        let sets = BTreeMap::from([(Split::Test, set(test.frames)), (Split::Train, set(test.photographs))]);
        Ok(Self { sets, background: config.data.background, decoded: Mutex::default() })
    }

    fn describe(&self) -> Value {
        let view = |(name, camera): (&String, &Camera)| {
            let (r, t, k) = (camera.rotation, camera.origin, camera.intrinsics);
            let row = |i: usize| [r.col(0)[i], r.col(1)[i], r.col(2)[i], t[i]];
            let pose = [row(0), row(1), row(2)].concat();
            let fov = 2.0 * (0.5 * f64::from(k.width) / k.fx).atan();
            let fov = fov.to_degrees();
            json!({ "name": name, "pose": pose, "fov": fov, "width": k.width, "height": k.height })
        };
        let sets = self.sets.iter().map(|(split, set)| {
            let views: Vec<Value> = set.names.iter().zip(&set.cameras).map(view).collect();
            json!({ "split": split, "views": views })
        });
        sets.collect()
    }

    /// Returns the cameras of a set.
    fn cameras(&self, split: Split) -> &[Camera] {
        self.sets.get(&split).map_or(&[], |set| &set.cameras)
    }

    /// Returns the camera of a photograph.
    ///
    /// # Errors
    /// When there is no such photograph.
    pub fn camera(&self, photo: Photo) -> Result<Camera> {
        let own = self.sets.get(&photo.split).and_then(|set| set.cameras.get(photo.index));
        own.copied().ok_or_else(|| {
            Error::input(
                format!("photograph {} of {:?}", photo.index, photo.split),
                "does not exist",
                "choose another",
            )
        })
    }

    /// Returns a photograph composited over the background and resampled to `width` by `height` pixels.
    ///
    /// # Errors
    /// When there is no such photograph, or it cannot be decoded.
    pub fn image(&self, photo: Photo, width: u32, height: u32) -> Result<RgbImage> {
        self.camera(photo)?;
        let mut decoded = self.decoded.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let whole = match decoded.iter().position(|(own, _)| *own == photo) {
            Some(at) => decoded.remove(at).map(|(_, image)| image),
            None => None,
        };
        let whole = match (whole, self.sets.get(&photo.split)) {
            (Some(whole), _) => whole,
            (None, Some(set)) => {
                let views = set.frames.load(photo.index)?;
                let Some(view) = views.views.first() else {
                    return Err(Error::run(format!("photograph {} has no pixels", photo.index)));
                };
                let k = view.camera.intrinsics;
                rgb_image(k.width, k.height, &views.composited(0, self.background))
            }
            (None, None) => return Err(Error::run("there are no photographs")),
        };
        let resized = match whole.dimensions() == (width, height) {
            true => whole.clone(),
            false => imageops::resize(&whole, width.max(1), height.max(1), FilterType::Triangle),
        };
        decoded.push_front((photo, whole));
        decoded.truncate(KEPT);
        Ok(resized)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_learns_the_name_of_each_photograph() {
        let mut settings = settings::defaults();
        for assignment in [
            "data.format=builtin",
            "data.builtin_size=16",
            "data.builtin_train=3",
            "data.builtin_test=2",
            "data.scales=2",
        ] {
            settings.apply_assignment(assignment).unwrap();
        }
        let photographs = Photographs::open(&Config::from_settings(&settings).unwrap()).unwrap();
        let told = photographs.describe();
        let views = |set: usize| told[set]["views"].as_array().unwrap();
        assert_eq!((&told[0]["split"], &told[1]["split"]), (&json!("test"), &json!("train")));
        for (set, names) in [(0, &["r_0", "r_1"][..]), (1, &["r_0", "r_1", "r_2"][..])] {
            assert!(views(set).iter().map(|view| &view["name"]).eq(names), "{told}");
            assert!(views(set).iter().all(|view| view["width"] == 16), "the finest scale: {told}");
        }
        assert_eq!(Photographs::none().describe(), json!([]));
    }
}
