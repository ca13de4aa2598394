//! The loss on the CPU: evaluates core's registered terms in f32, over the pixels and the rays of a tile.

use crate::buffer::Buffer;
use crate::{CpuBackend, WorkerScratch};
use trimip_core::config::{LossConfig, LossRays};
use trimip_core::engine::backend::{Loss, RenderedTile};
use trimip_core::engine::batch::{Interval, Radiance, Segment, StepResult, Target};
use trimip_core::field::losses::exposure::exposed;
use trimip_core::field::losses::{
    self, ConeSamples, Held, PhotometricTerm, PhotometricVisitor, PixelTerm, RaySample, RayTerm, Terms,
};
use trimip_core::scene::edge_exponents::{shown, shown_gradient};
use trimip_core::{Config, Pixel, Result, Space};

/// The loss terms that a configuration uses.
pub struct CpuLoss {
    config: LossConfig,
    /// All terms, enabled or not.
    terms: Terms,
    /// Enabled pixel terms in addition to the photometric term, with their weights.
    pixel_terms: Vec<(Held<dyn PixelTerm>, f32)>,
    /// Enabled ray terms, with their weights.
    ray_terms: Vec<(Held<dyn RayTerm>, f32)>,
    space: Space<f32>,
    /// Exposure gains of the photographs; empty if the loss applies none.
    gains: Vec<[f32; 3]>,
}

impl CpuLoss {
    /// Creates the configured loss.
    ///
    /// # Errors
    /// When the section of another crate that adds terms cannot be read.
    pub fn new(config: &Config) -> Result<Self> {
        let terms = Terms::of(config)?;
        Ok(Self {
            config: config.loss.clone(),
            pixel_terms: losses::at_work(&terms.pixel, &config.loss, 0.0),
            ray_terms: losses::at_work(&terms.ray, &config.loss, 0.0),
            terms,
            space: Space::new(&config.scene),
            gains: Vec::new(),
        })
    }

    /// Replaces `out` with the samples of ray `index`, in the form that ray terms read.
    fn collect(&self, tile: &RenderedTile<'_, CpuBackend>, index: usize, out: &mut Vec<RaySample<f32>>) {
        let (ray, own) = (&tile.rays.rays[index], tile.samples.segments[index].range());
        let parameterisation = self.space.parameterisation(ray.origin, ray.direction);
        let sample = |(interval, radiance): (&Interval, &Radiance)| {
            let Interval { t, length } = *interval;
            let point = std::array::from_fn(|axis| ray.origin[axis] + t * ray.direction[axis]);
            let [place, width] = self.space.along(&parameterisation, point, t, length);
            RaySample { depth: radiance.density * length, t, length, place, width }
        };
        out.clear();
        out.extend(tile.samples.intervals[own.clone()].iter().zip(&tile.radiance[own]).map(sample));
    }
}

impl Loss<CpuBackend> for CpuLoss {
    fn set_gains(&mut self, gains: &[[f32; 3]]) {
        self.gains = gains.to_vec();
    }

    fn set_progress(&mut self, progress: f64) {
        self.pixel_terms = losses::at_work(&self.terms.pixel, &self.config, progress);
        self.ray_terms = losses::at_work(&self.terms.ray, &self.config, progress);
    }

    fn evaluate_pixels(
        &self,
        _: &mut WorkerScratch,
        tile: &RenderedTile<'_, CpuBackend>,
        pixel_gradients: &mut Buffer<[f32; 4]>,
        sums: &mut StepResult,
    ) {
        pixel_gradients.resize(tile.pixels.len());
        let [marched, kept] = tile.samples.counts[0];
        sums.sums.rays += tile.pixels.len() as u64;
        sums.sums.marched += u64::from(marched);
        sums.sums.kept += u64::from(kept);
        sums.sums.drawn += u64::from(kept);
        sums.exposures.resize(self.gains.len(), [0.0; 3]);
        let pixels = Pixels { loss: self, tile, gradients: pixel_gradients, result: sums };
        self.config.photometric.visit(pixels);
    }

    fn evaluate_rays(
        &self,
        _: &mut WorkerScratch,
        tile: &RenderedTile<'_, CpuBackend>,
        radiance_gradients: &mut Buffer<Radiance>,
        sums: &mut StepResult,
    ) {
        if self.ray_terms.is_empty() {
            return;
        }
        let (mut samples, mut by_depth) = (Vec::new(), Vec::new());
        for (group, target) in tile.rays.groups.iter().zip(tile.rays.targets.iter()) {
            for index in group.range() {
                self.collect(tile, index, &mut samples);
                // A cone without samples has no gradient, so its terms are skipped.
                if samples.is_empty() {
                    continue;
                }
                let own = tile.samples.segments[index].range();
                let intervals = &tile.samples.intervals[own.clone()];
                let gradients = &mut radiance_gradients[own];
                let cone = ConeSamples { target, samples: &samples };
                for (term, weight) in &self.ray_terms {
                    let fraction = weight * target.weight / group.count as f32;
                    by_depth.clear();
                    by_depth.resize(samples.len(), 0.0);
                    let value = term.evaluate(&self.config, &cone, &mut by_depth);
                    for ((gradient, by_depth), interval) in gradients.iter_mut().zip(&by_depth).zip(intervals)
                    {
                        gradient.density += fraction * by_depth * interval.length;
                    }
                    sums.sums.loss += f64::from(fraction * value);
                }
            }
        }
    }
}

/// The pixels of a tile, which a photometric term compares with their targets.
struct Pixels<'a> {
    loss: &'a CpuLoss,
    tile: &'a RenderedTile<'a, CpuBackend>,
    gradients: &'a mut [[f32; 4]],
    result: &'a mut StepResult,
}

/// A pixel's gradient, the pixel with its target, and whether it has any samples.
type Row<'a> = ((&'a mut [f32; 4], (&'a Pixel, &'a Target)), bool);

impl PhotometricVisitor for Pixels<'_> {
    type Output = ();

    fn visit<T: PhotometricTerm>(self, term: &T) {
        let Self { loss, tile, gradients, result } = self;
        let (segments, groups): (&[Segment], &[Segment]) = (&tile.samples.segments, &tile.rays.groups);
        let pixels = tile.pixels.iter().zip(tile.rays.targets.iter());
        let rows = gradients.iter_mut().zip(pixels);
        if segments.len() == groups.len() {
            // Each pixel has one cone, which is the usual case.
            let rows = rows.zip(segments).map(|(row, segment)| (row, segment.count > 0));
            loss.add(term, rows, &tile.rays.photographs, result);
        } else {
            let any = |group: &Segment| segments[group.range()].iter().any(|segment| segment.count > 0);
            let rows = rows.zip(groups).map(|(row, group)| (row, any(group)));
            loss.add(term, rows, &tile.rays.photographs, result);
        }
    }
}

impl CpuLoss {
    /// Adds the losses of pixels to the sums, and writes their gradients. `photographs` holds the index of each pixel's
    /// photograph, which selects the exposure gain, if there are gains.
    #[inline]
    fn add<'a, T: PhotometricTerm>(
        &self,
        term: &T,
        rows: impl Iterator<Item = Row<'a>>,
        photographs: &[u32],
        result: &mut StepResult,
    ) {
        let StepResult { sums, exposures, .. } = result;
        for (i, ((gradient, (pixel, target)), live)) in rows.enumerate() {
            *gradient = [0.0; 4];
            let Target { background, exponent, .. } = *target;
            let mut seen = shown(pixel.rgb, pixel.opacity, background, exponent);
            let photograph = photographs.get(i).map_or(usize::MAX, |&photograph| photograph as usize);
            let exposure = self.gains.get(photograph).zip(exposures.get_mut(photograph));
            let behind = background.map(|channel| (1.0 - target.opacity) * channel);
            if let Some((gain, _)) = &exposure {
                seen = exposed(seen, behind, **gain);
            }
            let difference: [f32; 3] = std::array::from_fn(|c| seen[c] - target.rgb[c]);
            // Pixels of weight 0 are excluded from the squared error, as they are from the loss, whatever colour they
            // store.
            if target.weight > 0.0 {
                let squared = difference.iter().map(|&d| f64::from(d) * f64::from(d)).sum::<f64>();
                sums.squared_error += f64::from(target.importance) * squared;
            }
            if !difference.iter().all(|d| d.is_finite()) {
                sums.non_finite += 1;
                continue;
            }
            if self.config.rays == LossRays::Live && !live {
                continue;
            }
            sums.weight += f64::from(target.weight);
            let mut by_colour = [0.0; 3];
            for c in 0..3 {
                let (value, slope) = term.evaluate(&self.config, difference[c]);
                sums.loss += f64::from(target.weight * value) / 3.0;
                by_colour[c] = target.weight * slope / 3.0;
            }
            if let Some((gain, by_log_gain)) = exposure {
                for c in 0..3 {
                    by_log_gain[c] += f64::from(by_colour[c] * (seen[c] - behind[c]));
                    by_colour[c] *= gain[c];
                }
            }
            *gradient = shown_gradient(pixel.rgb, pixel.opacity, background, exponent, by_colour);
            for (term, weight) in &self.pixel_terms {
                let factor = target.weight * weight;
                let value = term.evaluate(&self.config, pixel, target, factor, gradient);
                sums.loss += f64::from(factor * value);
            }
        }
    }
}
