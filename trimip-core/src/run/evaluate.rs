//! Evaluation: test frames rendered at every scale and compared with their photographs.

use crate::{
    Camera, Frame, Frames, Result, ViewSet, Viewer,
    config::PhotographsConfig,
    engine::exposure::exposed_by_the_other_half,
    measures::{
        metrics::{psnr, psnr_8bit, psnr_of_constant, ssim},
        perception::{Pair, PerceptualScores},
        quality::{Measures, ViewQuality, capped},
    },
};

/// One rendered test view and its measures.
pub struct ViewResult<'a> {
    /// Index of the frame in the test split.
    pub index: usize,
    /// Name of the photograph.
    pub name: &'a str,
    /// Reduction of the view: 1, 2, 4, 8.
    pub scale: u32,
    /// The camera with which the view was rendered.
    pub camera: &'a Camera,
    /// The rendered view, with silhouettes as the set's photographs show them.
    pub rendered: &'a Frame,
    /// The photograph on the same background.
    pub target: &'a [[f32; 3]],
    /// PSNR, in dB.
    pub psnr: f64,
    /// Structural similarity.
    pub ssim: f64,
    /// The scores of [`Watch::measure_perception`].
    pub perceptual: &'a PerceptualScores,
}

/// Returns the background that makes transparency most visible: per channel, black if the colour is bright and white if
/// it is dark.
pub fn opposite(background: [f32; 3]) -> [f32; 3] {
    background.map(|channel| if channel < 0.5 { 1.0 } else { 0.0 })
}

/// Callbacks of an evaluation. A callback that returns false stops the evaluation.
pub trait Watch {
    /// Called when `rows` of the `of` rows of a frame, over all of its scales, are rendered.
    fn rows(&mut self, rows: u32, of: u32) -> bool {
        let _ = (rows, of);
        true
    }
    /// Returns the measures of perception of a view of frame `index`; none by default.
    ///
    /// # Errors
    /// When a measure cannot be computed.
    fn measure_perception(&mut self, index: usize, pair: &Pair<'_>) -> Result<PerceptualScores> {
        let _ = (index, pair);
        Ok(PerceptualScores::NOTHING)
    }
    /// Called when a view was rendered and measured. Returns false to end the evaluation.
    ///
    /// # Errors
    /// When the result cannot be kept, for example because its pictures cannot be written.
    fn view(&mut self, view: &ViewResult<'_>) -> Result<bool>;
}

/// A watch for views only.
struct OnView<F>(F);

impl<F: FnMut(&ViewResult<'_>) -> Result<bool>> Watch for OnView<F> {
    fn view(&mut self, view: &ViewResult<'_>) -> Result<bool> {
        (self.0)(view)
    }
}

/// Test frames, and how they are compared with renderings.
#[derive(Clone, Copy)]
pub struct TestFrames<'a> {
    /// The frames.
    pub frames: &'a dyn Frames,
    /// The background, and the convention of the photographs.
    pub data: &'a PhotographsConfig,
    /// The finest scale that is compared: 1, 2, 4, ... A frame that has no scale as coarse as this is compared at its
    /// coarsest scale.
    pub finest: u32,
}

/// Renders every `stride`-th frame at every scale, with the background and the convention of `data`; `on_view` receives
/// each result and returns false to stop early. Returns one element per view: frame by frame, fine to coarse.
///
/// # Errors
/// As [`evaluate_frame`].
pub fn evaluate(
    viewer: &mut dyn Viewer,
    frames: &dyn Frames,
    stride: usize,
    data: &PhotographsConfig,
    on_view: impl FnMut(&ViewResult<'_>) -> Result<bool>,
) -> Result<Vec<ViewQuality>> {
    let (mut qualities, mut watch) = (Vec::new(), OnView(on_view));
    let test = TestFrames { frames, data, finest: 1 };
    for index in (0..frames.len()).step_by(stride.max(1)) {
        if !evaluate_frame(viewer, test, index, &mut watch, &mut qualities)? {
            break;
        }
    }
    Ok(qualities)
}

/// Renders frame `index` at the scale `test.finest` and all coarser scales, and appends the measures of each view, fine
/// to coarse, to `qualities`. The comparison leaves out pixels for which the lens has no ray and pixels of which a mask
/// keeps less than half; a view in which all pixels are left out is skipped. Returns false if `watch` stopped the
/// evaluation; a view whose rendering was stopped is not included.
///
/// # Errors
/// When a photograph cannot be read, the device fails, or `watch` fails.
pub fn evaluate_frame(
    viewer: &mut dyn Viewer,
    test: TestFrames<'_>,
    index: usize,
    watch: &mut dyn Watch,
    qualities: &mut Vec<ViewQuality>,
) -> Result<bool> {
    let TestFrames { frames, data, finest } = test;
    let (set, background) = (frames.load(index)?, data.background);
    let finest = set.scales.iter().map(|scale| scale.factor).filter(|&f| f <= finest).max().unwrap_or(1);
    let scales = || set.scales.iter().filter(|scale| scale.factor >= finest);
    let views = || scales().flat_map(|scale| scale.views.clone().map(move |view| (scale.factor, view)));
    let rows = |view: usize| set.views[view].camera.intrinsics.height;
    let (all, mut before) = (views().map(|(_, view)| rows(view)).sum::<u32>(), 0);
    for (factor, view) in views() {
        let target = set.composited(view, background);
        let camera = &set.views[view].camera;
        let excluded = excluded(&set, view);
        if !excluded.is_empty() && excluded.iter().all(|&excluded| excluded) {
            before += rows(view);
            continue;
        }
        let Some(rendered) = viewer.render_watched(camera, &mut |done, _| watch.rows(before + done, all))?
        else {
            return Ok(false);
        };
        before += rows(view);
        let (exponent, other) = (data.edge_exponent(factor), opposite(background));
        let seen = |rgb: Vec<[f32; 3]>| without(&excluded, rgb);
        let target_seen = seen(target.clone());
        let psnr_plain = capped(psnr(&seen(rendered.rgb()), &target_seen));
        // Each block drops its pictures, so that few are in memory at once.
        let psnr_box = {
            let truth =
                set.box_filtered(set.scales[0].views.start, factor / set.scales[0].factor, background);
            // The photographs of a multi-scale set may be smaller or larger than the box-filtered finest photographs.
            if truth.len() == target.len() {
                capped(psnr(&seen(rendered.rgb()), &seen(truth)))
            } else {
                f64::NAN
            }
        };
        let psnr_opposite = {
            let moved = rendered.moved(background, other).shown(other, exponent).rgb();
            capped(psnr(&seen(moved), &seen(set.composited(view, other))))
        };
        let rendered = rendered.shown(background, exponent);
        let (psnr, psnr_8bit, psnr_exposed, ssim, perceptual) = {
            let mut rgb = rendered.rgb();
            let pairs = rgb.iter_mut().zip(&target).zip(&excluded);
            for (pixel, target) in pairs.filter_map(|(pair, excluded)| excluded.then_some(pair)) {
                *pixel = *target;
            }
            let (width, height) = (rendered.width as usize, rendered.height as usize);
            let ssim = ssim(&rgb, &target, width, height);
            let pair = Pair { rendered: &rgb, target: &target, width, height, excluded: &excluded };
            let perceptual = watch.measure_perception(index, &pair)?;
            let rgb = seen(rgb);
            let left = (0..target.len() as u32).map(|i| 2 * (i % rendered.width) < rendered.width).collect();
            let left = without(&excluded, left);
            let behind = seen(photographed_background(&set, view, background));
            let exposed = exposed_by_the_other_half(&rgb, &behind, &target_seen, &left);
            let against = |rgb: &[[f32; 3]]| capped(psnr(rgb, &target_seen));
            (against(&rgb), capped(psnr_8bit(&rgb, &target_seen)), against(&exposed), ssim, perceptual)
        };
        let psnr_constant = capped(psnr_of_constant(&target_seen));
        let measures = Measures {
            psnr,
            psnr_8bit,
            psnr_opposite,
            psnr_plain,
            psnr_box,
            psnr_exposed,
            psnr_constant,
            ssim,
            ms_ssim: perceptual.ms_ssim,
            flip: perceptual.flip,
            lpips: perceptual.lpips,
        };
        let result = ViewResult {
            index,
            name: &set.views[view].name,
            scale: factor,
            camera,
            rendered: &rendered,
            target: &target,
            psnr,
            ssim,
            perceptual: &perceptual,
        };
        qualities.push(ViewQuality { index, scale: factor, measures });
        if !watch.view(&result)? {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Returns the compared colours of `rgb`, a picture of view `view`, row by row: those of all pixels, in their order,
/// except pixels for which the lens has no ray and pixels of which a mask keeps less than half.
pub fn compared(set: &ViewSet, view: usize, rgb: Vec<[f32; 3]>) -> Vec<[f32; 3]> {
    without(&excluded(set, view), rgb)
}

/// Returns for each pixel whether the comparison leaves it out; empty if no pixel is left out.
fn excluded(set: &ViewSet, view: usize) -> Vec<bool> {
    let (camera, pixels) = (&set.views[view].camera, set.pixels_of(view));
    let k = &camera.intrinsics;
    let blind = k.blind_pixels() > 0;
    if !blind && !pixels.iter().any(|&pixel| set.alpha.leaves_out(pixel)) {
        return Vec::new();
    }
    let unseen = |i: u32| blind && camera.cone::<f32>(i % k.width, i / k.width).is_none();
    (0..).zip(pixels).map(|(i, &pixel)| set.alpha.leaves_out(pixel) || unseen(i)).collect()
}

/// Removes the values of `excluded` pixels; `values` has one value per pixel.
fn without<T>(excluded: &[bool], mut values: Vec<T>) -> Vec<T> {
    let mut flags = excluded.iter();
    values.retain(|_| !flags.next().copied().unwrap_or(false));
    values
}

/// Returns the part (RGB of each pixel) of a photograph's colours that comes from the background behind its transparent
/// part.
fn photographed_background(set: &ViewSet, view: usize, background: [f32; 3]) -> Vec<[f32; 3]> {
    let clear = |&pixel: &[u8; 4]| 1.0 - set.alpha.opacity(pixel);
    set.pixels_of(view).iter().map(|pixel| background.map(|channel| clear(pixel) * channel)).collect()
}
