//! Frames and their pixels: the images of each frame, and the view sets assembled from them. Pixels are allocated once
//! and filled in parallel. Training views and single test frames use the same code.

use crate::settings::{Finish, PixelStore};
use crate::{
    builtin,
    depth_image::DepthFile,
    mask::Mask,
    photograph::Photograph,
    pyramid, store,
    watch::{Meter, unwatched},
};
use rayon::prelude::*;
use trimip_core::{Alpha, Camera, Error, Frames, Place, Result, Scale, View, ViewSet};

/// Most memory for the photographs that are decoded at once, bytes, unless a single one takes more.
const MOST_AT_ONCE: u64 = 2 << 30;

/// One frame: a camera per scale, and the source of its pixels.
#[derive(Debug)]
pub(crate) struct Source {
    pub(crate) name: String,
    /// Level (log2 of the reduction) and camera of each view, fine to coarse.
    pub(crate) views: Vec<(u32, Camera)>,
    /// Number of times that the photograph is halved before its first view.
    pub(crate) halvings: u32,
    pub(crate) pixels: Pixels,
    /// The mask of its photograph, once it is found.
    pub(crate) mask: Option<Mask>,
    /// Path of the mask that its entry states.
    pub(crate) mask_path: Option<String>,
    /// The depth image that is stated for its photograph. The file may be missing.
    pub(crate) depth: Option<DepthFile>,
}

/// The source of a frame's pixels.
#[derive(Debug)]
pub(crate) enum Pixels {
    /// One file for the finest view; the other views are averaged from it.
    Photograph(Photograph),
    /// A file for each view.
    Stored(Vec<Photograph>),
    /// The built-in scene, with n × n rays per pixel.
    Rendered {
        /// The number n.
        supersampling: u32,
        /// Selects the glossy surfaces.
        finish: Finish,
    },
}

impl Source {
    /// Creates a frame whose views at `scales` levels are averaged from the finest one, which `camera` sees.
    pub(crate) fn averaged(
        name: String,
        camera: Camera,
        scales: u32,
        place: &Place,
        pixels: Pixels,
    ) -> Result<Self> {
        let side = camera.intrinsics.width.min(camera.intrinsics.height);
        let most = side.checked_ilog2().map_or(0, |log| log + 1);
        if scales > most {
            return Err(Error::input(
                place,
                format!(
                    "an image of {}x{} pixels is too small for {scales} scales",
                    camera.intrinsics.width, camera.intrinsics.height
                ),
                format!("set data.scales to {most} or less"),
            ));
        }
        let views = (0..scales)
            .map(|level| (level, Camera { intrinsics: camera.intrinsics.reduced(level), ..camera }))
            .collect();
        Ok(Self { name, views, halvings: 0, pixels, mask: None, mask_path: None, depth: None })
    }

    /// Returns the number of pixels of all its views.
    pub(crate) fn pixels_in_memory(&self) -> f64 {
        self.views.iter().filter_map(|(_, camera)| area(camera)).map(|area| area as f64).sum()
    }

    /// Returns how many times the frame can be halved without losing a scale; 0 for files of a multi-scale set.
    pub(crate) fn halvings_possible(&self) -> u32 {
        let Some((_, coarsest)) = self.views.last() else { return 0 };
        match self.pixels {
            Pixels::Photograph(_) => {
                coarsest.intrinsics.width.min(coarsest.intrinsics.height).checked_ilog2().unwrap_or(0)
            }
            Pixels::Stored(_) | Pixels::Rendered { .. } => 0,
        }
    }

    /// Returns the frame with its photograph halved `halvings` times before its first view.
    pub(crate) fn shrunk(mut self, halvings: u32) -> Self {
        self.halvings += halvings;
        for (_, camera) in &mut self.views {
            camera.intrinsics = camera.intrinsics.reduced(halvings);
        }
        self
    }

    /// Removes the distortion of the lens from its cameras.
    pub(crate) fn straighten(&mut self) {
        for (_, camera) in &mut self.views {
            camera.intrinsics.lens = camera.intrinsics.lens.without_distortion();
        }
    }

    /// Returns the number of rows of its finest view, the unit of progress.
    pub(crate) fn rows(&self) -> u64 {
        self.views.first().map_or(0, |(_, camera)| camera.intrinsics.height.into())
    }

    /// Returns the image files of the frame.
    pub(crate) fn files(&self) -> &[Photograph] {
        match &self.pixels {
            Pixels::Photograph(file) => std::slice::from_ref(file),
            Pixels::Stored(files) => files,
            Pixels::Rendered { .. } => &[],
        }
    }

    /// Decodes its photograph to RGBA and applies its mask. `alpha` is the meaning of alpha in the set.
    fn masked(&self, file: &Photograph, alpha: Alpha) -> Result<Vec<u8>> {
        let mut pixels = file.decode()?;
        let (all, _) = pixels.as_chunks_mut();
        if !alpha.is_opacity() && all.iter().any(|pixel| pixel[3] < 255) {
            return Err(Error::input(
                &file.place,
                format!(
                    "image {} has transparent pixels, and the masks mark pixels to ignore: alpha cannot mean both",
                    file.path.display()
                ),
                "set data.mask_role = \"object\" or data.masks = \"none\"",
            ));
        }
        if let Some(mask) = &self.mask {
            mask.apply(all)?;
        }
        Ok(pixels)
    }

    /// Writes the pixels of each view to its slice.
    fn fill(&self, alpha: Alpha, slots: &mut [&mut [[u8; 4]]], meter: &Meter<'_>) -> Result<()> {
        meter.goes_on()?;
        let Some((_, camera)) = self.views.first() else { return Ok(()) };
        let size = (camera.intrinsics.width as usize, camera.intrinsics.height as usize);
        match &self.pixels {
            Pixels::Photograph(file) => {
                let pixels = self.masked(file, alpha)?;
                let (width, height) = (file.width as usize, file.height as usize);
                // Levels finer than the first view are dropped.
                let mut levels: Vec<&mut [[u8; 4]]> = (0..self.halvings).map(|_| &mut [][..]).collect();
                levels.extend(slots.iter_mut().map(|slot| &mut **slot));
                pyramid::fill(pixels.as_chunks().0, width, height, alpha, &mut levels);
                meter.add(self.rows());
            }
            Pixels::Rendered { supersampling, finish } => {
                let pixels = builtin::render(camera, *supersampling, *finish, &|| meter.add(1));
                pyramid::fill(&pixels, size.0, size.1, alpha, slots);
            }
            Pixels::Stored(files) => {
                for (file, slot) in files.iter().zip(slots) {
                    slot.copy_from_slice(file.decode()?.as_chunks().0);
                }
                meter.add(self.rows());
            }
        }
        Ok(())
    }
}

/// Returns the number of rows of the finest views of `sources`, the total of progress.
pub(crate) fn rows<'a>(sources: impl IntoIterator<Item = &'a Source>) -> u64 {
    sources.into_iter().map(Source::rows).sum()
}

/// Assembles all views of `sources`, sorted by scale, then by frame; `meter` counts their rows.
pub(crate) fn assemble(sources: &[Source], alpha: Alpha, meter: &Meter<'_>) -> Result<ViewSet> {
    assemble_in(PixelStore::Memory, sources, alpha, meter)
}

/// Assembles views as [`assemble`] does, with the pixels in memory or in a file, as `store` says.
pub(crate) fn assemble_in(
    store: PixelStore,
    sources: &[Source],
    alpha: Alpha,
    meter: &Meter<'_>,
) -> Result<ViewSet> {
    let mut levels: Vec<u32> =
        sources.iter().flat_map(|source| source.views.iter().map(|(level, _)| *level)).collect();
    levels.sort_unstable();
    levels.dedup();

    let (mut views, mut scales, mut end) = (Vec::new(), Vec::new(), 0_usize);
    // The frame of each view, in the order of the views.
    let mut owners = Vec::new();
    for level in levels {
        let (first_view, first_pixel) = (views.len(), end);
        for (index, source) in sources.iter().enumerate() {
            for (_, camera) in source.views.iter().filter(|(at, _)| *at == level) {
                views.push(View { name: source.name.clone(), camera: *camera, offset: end });
                owners.push(index);
                end = area(camera).and_then(|area| end.checked_add(area)).ok_or_else(too_large)?;
            }
        }
        scales.push(Scale {
            factor: 1 << level,
            weight: 4_f32.powi(level as i32),
            views: first_view..views.len(),
            pixels: first_pixel..end,
        });
    }

    let fill = |mut rest: &mut [[u8; 4]]| {
        let mut slots: Vec<Vec<&mut [[u8; 4]]>> = sources.iter().map(|_| Vec::new()).collect();
        for (index, view) in owners.into_iter().zip(&views) {
            let (slot, tail) = rest.split_at_mut(area(&view.camera).unwrap_or(0));
            slots[index].push(slot);
            rest = tail;
        }
        let mut work: Vec<_> = sources.iter().zip(slots).collect();
        let at_once = at_once(sources)?;
        let failure = work.chunks_mut(at_once).find_map(|part| {
            let filled = part.par_iter_mut().map(|(source, slots)| source.fill(alpha, slots, meter));
            filled.find_map_first(Result::err)
        });
        failure.map_or(Ok(()), Err)
    };
    let pixels = store::filled(store::is_on_disk(store, end), end, fill)?;
    Ok(ViewSet { views, pixels, alpha, scales, depths: Vec::new() })
}

/// Returns how many of these frames are decoded at once. Very large photographs are decoded few at a time.
fn at_once(sources: &[Source]) -> Result<usize> {
    let files = sources.iter().flat_map(Source::files);
    let Some(largest) = files.max_by_key(|file| file.bytes_to_decode()) else {
        return Ok(sources.len().max(1));
    };
    let bytes = largest.bytes_to_decode();
    largest.expect_memory()?;
    match bytes * (rayon::current_num_threads() as u64) <= MOST_AT_ONCE {
        true => Ok(sources.len().max(1)),
        false => Ok((MOST_AT_ONCE / bytes).max(1) as usize),
    }
}

fn area(camera: &Camera) -> Option<usize> {
    (camera.intrinsics.width as usize).checked_mul(camera.intrinsics.height as usize)
}

fn too_large() -> Error {
    Error::input("data", "the images have more pixels than can be counted", "use fewer or smaller images")
}

/// Frames decoded one at a time.
pub(crate) struct FrameList {
    pub(crate) sources: Vec<Source>,
    pub(crate) alpha: Alpha,
}

impl Frames for FrameList {
    fn len(&self) -> usize {
        self.sources.len()
    }

    fn names(&self) -> Vec<String> {
        self.sources.iter().map(|source| source.name.clone()).collect()
    }

    fn cameras(&self) -> Vec<Camera> {
        self.sources.iter().flat_map(|source| source.views.iter().map(|(_, camera)| *camera)).collect()
    }

    fn load(&self, index: usize) -> Result<ViewSet> {
        let source = self.sources.get(index..=index).ok_or_else(|| {
            Error::run(format!("there is no frame {index}: there are {}", self.sources.len()))
        })?;
        assemble(source, self.alpha, &Meter::new(rows(source), &unwatched))
    }
}

/// Maps items in parallel. If several fail, the first error in order is returned, so that it does not depend on the threads.
pub(crate) fn map_in_order<T: Sync, R: Send>(
    items: &[T],
    map: impl Fn(usize, &T) -> Result<R> + Sync,
) -> Result<Vec<R>> {
    let results: Vec<_> = items.par_iter().enumerate().map(|(index, item)| map(index, item)).collect();
    results.into_iter().collect()
}
