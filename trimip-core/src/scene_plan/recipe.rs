//! Training recipe of a scene: the background, whether the opacity loss makes models solid, and the sizes of networks and
//! steps. The sizes suit the number of samples that this machine can train on within the time budget. A place is a scene in
//! contracted space.

use super::decision::{Context, Proposal};
use super::fineness::significant;
use super::{hash_grid, tri_mip};
use crate::config::{Contraction, Precision};
use crate::{
    Aabb, Config, ViewSet,
    scene::{plain, silhouettes},
};
use toml::Value;

/// Weight of the opacity loss, which makes models solid, if opacity is known.
const OPACITY: f64 = 0.1;

/// Weight of the distortion loss for places whose colours depend on the viewing direction from the start, and after a delay. The loss
/// concentrates the density of a ray at its surface. Too large a weight (0.01 without a delay, 0.03 with one) moves all density in
/// front of the cameras.
const DISTORTIONS: [f64; 2] = [1e-3, 5e-3];

/// Fewest pixels of a place's photographs for a hash grid and opaque rays. With fewer pixels, the grid has more values than the
/// photographs, and explains each photograph by separate density in front of its camera.
const MANY_PIXELS: usize = 1 << 20;

/// Number of training photographs of a place from which colours depend on the viewing direction from the start. With 11 to 43
/// photographs the delay gains 0.7 to 6 dB; with 85 and 255 photographs it loses 0.2 to 0.4 dB.
const MANY_VIEWS: usize = 60;

/// Fraction of the run in which colours ignore the viewing direction, for places with fewer photographs than
/// [`MANY_VIEWS`].
const DIRECTION_DELAY: f64 = 0.2;

/// Weight up to which the samples of a ray merge, and transmittance behind which they are dropped. For an object, a step then has
/// about twice as many rays.
const FAINT: f64 = 0.01;

/// Longest side of the box for which `field.density_scale` is 1: Blender scenes at ±1.5 units.
const USUAL_SIDE: f64 = 3.0;

/// The same side for places. With a quarter of this density scale, *fox* loses 1.1 dB in a minute.
const USUAL_PLACE: f64 = 20.0;

/// Fraction of a step's pixels that are drawn according to their errors.
const BY_ERROR: f64 = 0.8;

/// Largest number of rays per pixel of the photographs in a run with an error map. With 5 rays per pixel (*dtu24*), the pixels
/// that stay wrong are those where photographs contradict each other, and the map gains nothing.
const SEEN_LITTLE: f64 = 3.0;

/// Largest number of rays per pixel of the photographs in a run that starts on coarse scales. With 0.04 rays per pixel, *bonsai*
/// gains 0.2 dB at 1/1 and 0.5 dB at 1/8; with 0.14, nothing.
const SEEN_HARDLY: f64 = 0.1;

/// Schedule of `train.finest_scale` for a run that starts on coarse scales, and the `train.scale_weighting` that gives
/// every scale equally many rays.
const COARSE_FIRST: &[[f64; 2]] = &[[0.0, 1.0], [0.5, 0.0]];
const SCALES_ALIKE: f64 = 1.0;

/// Expected number of kept samples per ray, for objects and for places.
const SAMPLES_PER_RAY: [f64; 2] = [2.0, 5.0];

/// Alpha of an opaque pixel.
const OPAQUE: u8 = 255;

/// Best width of the networks for budgets of fewer samples than the first number; the last width has no upper limit.
const WIDTHS: [(f64, u32); 3] = [(1e8, 32), (1e9, 64), (f64::INFINITY, 128)];

/// Least width of the networks for places. Narrower networks leave density in front of the cameras of *bonsai*.
const PLACE_WIDTH: u32 = 64;

/// Least budgets, in samples, of a long run and of the longest ones, whose final marching step is half of the uniform step.
const LONG_RUNS: [f64; 2] = [1.5e9, 4e9];

/// Fewest steps of a run, so that its schedules have an effect.
const LEAST_STEPS: f64 = 1500.0;

/// Samples per step: for a device that needs large batches, for a long run, and for short runs the least number and the largest
/// ones for objects and for places.
const WIDE_BATCH: i64 = 262_144;
const LONG_BATCH: i64 = 65_536;
const LEAST_BATCH: u64 = 4096;
const SHORT_BATCHES: [u64; 2] = [16_384, 32_768];

/// Most pixels of an object's photographs, all scales together, for which long runs take as few samples per step as short ones. Such runs
/// draw every pixel often, and the noise of small steps keeps the model from fitting the pixels of the photographs alone: with 32,768 or
/// 65,536 samples per step, *dtu24* loses 0.8 to 0.9 dB.
const FEW_PIXELS: usize = 1 << 24;

/// Marching steps over a run of an object: for budgets below both of [`LONG_RUNS`], between them, and above both. Long steps
/// learn the rough shape from few samples. The last fifth of a short run with the uniform step gains 0.2 to 0.4 dB.
const SHORT_STEPS: &[[f64; 2]] = &[[0.0, 8.0], [0.1, 4.0], [0.45, 2.0], [0.8, 1.0]];
const LONG_STEPS: &[[f64; 2]] = &[[0.0, 8.0], [0.1, 4.0], [0.4, 2.0], [0.7, 1.0]];
const LONGEST_STEPS: &[[f64; 2]] = &[[0.0, 8.0], [0.0146, 4.0], [0.0583, 2.0], [0.292, 1.0], [0.972, 0.5]];

/// Marching steps over a run of a place. Surfaces of places are thin and seen at grazing angles. A final step of half the uniform step
/// gains 0.35 dB on *fox* after 600 s and 0.5 dB on *bonsai* after 1300 s of one thread; a final quarter gains nothing more.
const PLACE_STEPS: &[[f64; 2]] = &[[0.0, 8.0], [0.08, 4.0], [0.25, 2.0], [0.45, 1.0], [0.7, 0.5]];

/// Scale of the batch size over a long run: half at first, while samples resemble each other.
const LONG_BATCH_SCALE: &[[f64; 2]] = &[[0.0, 0.5], [0.292, 1.0]];

/// Milestones of the learning rate for the longest runs: the rate falls to a hundredth.
const MILESTONES: [f64; 9] = [0.437, 0.583, 0.68, 0.758, 0.816, 0.865, 0.904, 0.933, 0.98];

/// Width of the hidden layers for the largest budgets (paper).
const WIDEST: u32 = 128;

/// Returns true if any pixel of the training photographs is not opaque. Pixels that a mask leaves out are not transparent.
pub(super) fn has_alpha(views: &ViewSet) -> bool {
    let Some(coarsest) = views.scales.last() else { return false };
    views.alpha.is_opacity() && views.pixels[coarsest.pixels.clone()].iter().any(|pixel| pixel[3] < OPAQUE)
}

pub(super) fn background(context: &Context<'_>) -> Proposal {
    let views = context.facts.train;
    if has_alpha(views) {
        return Proposal::Keep("the photographs have alpha: the configured background is used".into());
    }
    if let Some(colour) = plain::colour(views).filter(|_| context.now.scene.contraction == Contraction::None)
    {
        let colour = colour.map(|value| Value::Float((f64::from(value) * 1000.0).round() / 1000.0));
        return Proposal::Set {
            reason: "the borders of all photographs have one colour, which becomes the background".into(),
            changes: vec![("data.background", Value::Array(colour.to_vec()))],
        };
    }
    let Some(coarsest) = views.scales.last().filter(|scale| !scale.pixels.is_empty()) else {
        return Proposal::Keep("there is no photograph".into());
    };
    let pixels = &views.pixels[coarsest.pixels.clone()];
    let fraction = |pixel: &[u8; 4]| f64::from(views.alpha.fraction(*pixel));
    let all: f64 = pixels.iter().map(fraction).sum();
    if all == 0.0 {
        return Proposal::Keep("every pixel of the photographs is masked".into());
    }
    let mean: [f64; 3] = std::array::from_fn(|c| {
        let sum: f64 = pixels.iter().map(|pixel| fraction(pixel) * f64::from(pixel[c])).sum();
        (sum / (255.0 * all) * 1000.0).round() / 1000.0
    });
    Proposal::Set {
        reason: "the photographs have no alpha: their mean colour becomes the background".into(),
        changes: vec![("data.background", Value::Array(mean.map(Value::Float).to_vec()))],
    }
}

pub(super) fn edges(context: &Context<'_>) -> Proposal {
    let views = context.facts.train;
    if !has_alpha(views) {
        return Proposal::Keep("the photographs have no alpha: all conventions are equivalent".into());
    }
    let Some(exponents) = crate::scene::edge_exponents::fit(views) else {
        return Proposal::Keep("every photograph shows silhouettes as in the scene".into());
    };
    let told: Vec<String> = exponents.iter().map(|exponent| format!("{exponent:.3}")).collect();
    let value = |exponent: &f64| Value::Float((1e3 * exponent).round() / 1e3);
    Proposal::Set {
        reason: format!(
            "coarse photographs are means of straight colours, which darken silhouettes by opacity^{}",
            told.join(", ^")
        ),
        changes: vec![("data.edge_exponents", Value::Array(exponents.iter().map(value).collect()))],
    }
}

pub(super) fn hull(context: &Context<'_>) -> Proposal {
    if context.now.scene.contraction != Contraction::None {
        return Proposal::Keep("space is unbounded: silhouettes do not bound it".into());
    }
    if !silhouettes::any(context.facts.train) {
        return Proposal::Keep("there are no silhouettes".into());
    }
    Proposal::Set {
        reason: "space that two photographs show as background stays empty".into(),
        changes: vec![("occupancy.hull", Value::Boolean(true))],
    }
}

/// Returns true if the opacity of every pixel is known: from alpha, or because space is unbounded and every ray meets
/// something.
pub(super) fn knows_opacity(config: &Config, views: &ViewSet) -> bool {
    has_alpha(views) || config.scene.contraction != Contraction::None
}

/// Returns true if the finest photographs have at least [`MANY_PIXELS`] pixels.
pub(super) fn has_many_pixels(views: &ViewSet) -> bool {
    views.scales.first().is_some_and(|finest| finest.pixels.len() >= MANY_PIXELS)
}

pub(super) fn solids(context: &Context<'_>) -> Proposal {
    if !knows_opacity(context.now, context.facts.train) {
        return Proposal::Keep("the photographs have no alpha to compare opacity with".into());
    }
    if !has_alpha(context.facts.train) && !has_many_pixels(context.facts.train) {
        return Proposal::Keep(
            "with so few pixels, opaque rays would end directly in front of the cameras".into(),
        );
    }
    let known = match has_alpha(context.facts.train) {
        true => "the photographs have alpha: opacity is compared with it",
        false => "space is unbounded: every ray is trained to be opaque",
    };
    Proposal::Set {
        reason: format!("{known}, so that nothing shines through"),
        changes: vec![("loss.opacity", Value::Float(OPACITY))],
    }
}

pub(super) fn surfaces(context: &Context<'_>) -> Proposal {
    let mut changes = vec![("renderer.min_weight", Value::Float(FAINT))];
    let mut reason = "faint samples of a ray are merged, so that a step has more rays";
    if context.now.scene.contraction != Contraction::None {
        let distortion = DISTORTIONS[usize::from(context.now.field.direction_delay > 0.0)];
        changes.push(("loss.distortion", Value::Float(distortion)));
        reason = "rays of places end at thin surfaces; faint samples of a ray are merged, so that a step has more rays";
    }
    changes.retain(|(path, _)| !context.given(path));
    if changes.is_empty() {
        return Proposal::Keep("the weight up to which samples are merged is given".into());
    }
    Proposal::Set { reason: reason.into(), changes }
}

/// Delays view dependence for a place in few photographs: otherwise density in front of each camera could reproduce that
/// camera's photograph.
pub(super) fn direction_delay(context: &Context<'_>) -> Proposal {
    if context.now.scene.contraction == Contraction::None {
        return Proposal::Keep("the scene is bounded".into());
    }
    if !context.now.field.directions {
        return Proposal::Keep("colours do not depend on the viewing direction".into());
    }
    let photographs = context.facts.train.photographs();
    if photographs >= MANY_VIEWS {
        return Proposal::Keep(format!("{photographs} photographs show most places from several sides"));
    }
    Proposal::Set {
        reason: format!(
            "with {photographs} photographs, density in front of a camera could show that camera's picture alone: colours ignore the viewing direction at first"
        ),
        changes: vec![("field.direction_delay", Value::Float(DIRECTION_DELAY))],
    }
}

/// Chooses the scale of the density, which is per unit of length. The scale follows the box, so that the transmittance of a new
/// model does not depend on the unit. Rounding to powers of two gives the usual boxes of objects a scale of 1.
pub(super) fn density(context: &Context<'_>) -> Proposal {
    let side = Aabb::<f64>::new(&context.now.scene).longest();
    let scale = match context.now.scene.contraction {
        Contraction::None => (USUAL_SIDE / side).log2().round().exp2(),
        Contraction::Ball => significant(USUAL_PLACE / side).parse().unwrap_or(1.0),
    };
    if scale == 1.0 || !f64::is_normal(scale) {
        return Proposal::Keep("the box has a usual size".into());
    }
    Proposal::Set {
        reason: format!("the longest side of the box is {} units", significant(side)),
        changes: vec![("field.density_scale", Value::Float(scale))],
    }
}

pub(super) fn error_map(context: &Context<'_>) -> Proposal {
    if !crate::engine::error_map::same_photographs(context.facts.train) {
        return Proposal::Keep("the scales show different photographs".into());
    }
    let (seen, often) = seen(context);
    if seen > SEEN_LITTLE {
        return Proposal::Keep(often);
    }
    Proposal::Set {
        reason: format!("{often}: most rays are drawn where earlier errors are large"),
        changes: vec![("train.error_map", Value::Float(BY_ERROR))],
    }
}

/// Returns the expected number of rays per pixel of the photographs within the budget, and the text that states it.
fn seen(context: &Context<'_>) -> (f64, String) {
    let pixels = context.facts.train.pixels.len() as f64;
    let [object, place] = SAMPLES_PER_RAY;
    let samples_per_ray = match context.now.scene.contraction {
        Contraction::None => object,
        Contraction::Ball => place,
    };
    let seen = context.budget() / samples_per_ray / pixels;
    (
        seen,
        format!("the budget draws each of {:.1} M pixels about {} times", 1e-6 * pixels, significant(seen)),
    )
}

/// Starts a run on coarse scales if it draws few of the pixels: it learns more from coarse pixels, each of which is the
/// mean of many.
pub(super) fn coarse_to_fine(context: &Context<'_>) -> Proposal {
    let (seen, often) = seen(context);
    if seen > SEEN_HARDLY {
        return Proposal::Keep(often);
    }
    if context.facts.train.scales.len() < 2 {
        return Proposal::Keep(format!("{often}, but there is only one scale"));
    }
    let mut changes = vec![("train.finest_scale", pieces(COARSE_FIRST))];
    let mut told = "the first half of the run leaves the finest scale out";
    if !context.given("train.scale_weighting") {
        changes.push(("train.scale_weighting", Value::Float(SCALES_ALIKE)));
        told = "the first half of the run leaves the finest scale out, and all scales get equally many rays";
    }
    Proposal::Set { reason: format!("{often}: {told}"), changes }
}

/// Converts a schedule to the value of a setting.
fn pieces(pieces: &[[f64; 2]]) -> Value {
    Value::Array(pieces.iter().map(|pair| Value::Array(pair.map(Value::Float).to_vec())).collect())
}

pub(super) fn schedule(context: &Context<'_>) -> Proposal {
    let (config, compute) = (context.now, context.facts.compute);
    let samples = context.budget();
    let long = samples >= LONG_RUNS[0];
    let few_pixels =
        config.scene.contraction == Contraction::None && context.facts.train.pixels.len() <= FEW_PIXELS;
    let wide_steps = long && !few_pixels && !compute.wide;
    let hidden = WIDTHS.iter().find(|(most, _)| samples < *most).map_or(WIDEST, |(_, hidden)| *hidden);
    let hidden = match config.scene.contraction {
        Contraction::None => hidden,
        Contraction::Ball => hidden.max(PLACE_WIDTH),
    };
    let per_step = match samples {
        _ if compute.wide => WIDE_BATCH,
        _ if wide_steps => LONG_BATCH,
        _ => {
            let most = SHORT_BATCHES[usize::from(config.scene.contraction == Contraction::Ball)];
            ((samples / LEAST_STEPS).max(1.0) as u64).next_power_of_two().clamp(LEAST_BATCH, most) as i64
        }
    };
    let step_scale: &[[f64; 2]] = match samples {
        _ if config.scene.contraction == Contraction::Ball => PLACE_STEPS,
        _ if samples >= LONG_RUNS[1] => LONGEST_STEPS,
        _ if long => LONG_STEPS,
        _ => SHORT_STEPS,
    };
    let mut changes =
        vec![("field.hidden", Value::Integer(hidden.into())), ("renderer.step_scale", pieces(step_scale))];
    changes.extend(tri_mip::level_bias(context));
    if config.train.steps == 0 {
        changes.push(("train.samples_per_step", Value::Integer(per_step)));
    }
    let width = if context.given("field.hidden") { config.field.hidden } else { hidden };
    if compute.bf16_from.is_some_and(|least| width >= least) && config.field.precision == Precision::F32 {
        changes.push(("field.precision", Value::String("bf16".into())));
    }
    if wide_steps {
        changes.push(("train.batch_scale", pieces(LONG_BATCH_SCALE)));
    }
    if samples >= LONG_RUNS[1] {
        changes.push(("optimizer.milestones", Value::Array(MILESTONES.map(Value::Float).to_vec())));
    }
    changes.retain(|(path, _)| !context.given(path) && config.encoder.kind.takes(path));
    if changes.is_empty() {
        return Proposal::Keep("all settings that follow the budget are given".into());
    }
    let bought = match config.train.steps {
        0 => format!(
            "{:.0} s on {} allow about {:.0} M samples",
            config.train.seconds,
            compute.name,
            1e-6 * hash_grid::pace(config) * samples
        ),
        steps => format!("{steps} steps are {:.0} M samples", 1e-6 * samples),
    };
    let told: Vec<String> = changes.iter().map(|(path, value)| format!("{path} {value}")).collect();
    Proposal::Set { reason: format!("{bought}: {}", told.join(", ")), changes }
}
