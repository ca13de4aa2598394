//! The loss on the CPU: of pixels, and of the samples' weights.

use crate::buffer::Buffer;
use crate::{CpuBackend, Lane};
use trimip_core::backend::Loss;
use trimip_core::batch::{Interval, Radiance, Rays, Samples, Segment, StepResult, Target};
use trimip_core::config::{LossConfig, LossRays};
use trimip_core::distortion::{Part, distortion};
use trimip_core::edges::{shown, shown_gradient};
use trimip_core::exposure::exposed;
use trimip_core::loss::smooth_l1;
use trimip_core::{Config, Pixel, Space};

/// Area-weighted smooth-L1 of colour and opacity, and the distortion of cones.
pub struct CpuLoss {
    config: LossConfig,
    space: Space<f32>,
    /// Gains of the photographs, if they are compared with them.
    gains: Vec<[f32; 3]>,
}

impl CpuLoss {
    /// Creates the configured loss.
    pub fn new(config: &Config) -> Self {
        Self { config: config.loss.clone(), space: Space::new(&config.scene), gains: Vec::new() }
    }
}

impl Loss<CpuBackend> for CpuLoss {
    fn expose(&mut self, gains: &[[f32; 3]]) {
        self.gains = gains.to_vec();
    }

    fn evaluate(
        &self,
        _: &mut Lane,
        rays: &Rays<CpuBackend>,
        samples: &Samples<CpuBackend>,
        pixels: &Buffer<Pixel>,
        pixel_gradients: &mut Buffer<[f32; 4]>,
        sums: &mut StepResult,
    ) {
        pixel_gradients.resize(pixels.len());
        let [marched, kept] = samples.counts[0];
        sums.sums.rays += pixels.len() as u64;
        sums.sums.marched += u64::from(marched);
        sums.sums.kept += u64::from(kept);
        sums.exposures.resize(self.gains.len(), [0.0; 3]);
        let (segments, groups): (&[Segment], &[Segment]) = (&samples.segments, &rays.groups);
        let pixels = pixels.iter().zip(rays.targets.iter());
        let rows = pixel_gradients.iter_mut().zip(pixels);
        if segments.len() == groups.len() {
            // Pixels of one cone each, which is the usual case.
            let rows = rows.zip(segments).map(|(row, segment)| (row, segment.count > 0));
            self.add(rows, &rays.photographs, sums);
        } else {
            let any = |group: &Segment| segments[group.range()].iter().any(|segment| segment.count > 0);
            let rows = rows.zip(groups).map(|(row, group)| (row, any(group)));
            self.add(rows, &rays.photographs, sums);
        }
    }

    fn distort(
        &self,
        _: &mut Lane,
        rays: &Rays<CpuBackend>,
        samples: &Samples<CpuBackend>,
        radiance: &Buffer<Radiance>,
        radiance_gradients: &mut Buffer<Radiance>,
        sums: &mut StepResult,
    ) {
        if self.config.distortion == 0.0 {
            return;
        }
        for (group, target) in rays.groups.iter().zip(rays.targets.iter()) {
            let share = self.config.distortion * target.weight / group.count as f32;
            for (ray, segment) in rays.rays[group.range()].iter().zip(&samples.segments[group.range()]) {
                let course = self.space.course(ray.origin, ray.direction);
                let (own, intervals) = (&radiance[segment.range()], &samples.intervals[segment.range()]);
                let gradients = &mut radiance_gradients[segment.range()];
                let part = |i: usize| {
                    let Interval { t, length } = intervals[i];
                    let point = std::array::from_fn(|axis| ray.origin[axis] + t * ray.direction[axis]);
                    let [place, width] = self.space.along(&course, point, t, length);
                    Part { depth: own[i].density * length, place, width }
                };
                let value = distortion(own.len(), part, |i, by_depth| {
                    gradients[i].density += share * by_depth * intervals[i].length;
                });
                sums.sums.loss += f64::from(share * value);
            }
        }
    }
}

/// A pixel's gradient, the pixel with its target, and whether it has any samples.
type Row<'a> = ((&'a mut [f32; 4], (&'a Pixel, &'a Target)), bool);

impl CpuLoss {
    /// Adds the losses of pixels, of these photographs if they are compared with gains, to the sums, and writes their
    /// gradients.
    #[inline]
    fn add<'a>(&self, rows: impl Iterator<Item = Row<'a>>, photographs: &[u32], result: &mut StepResult) {
        let StepResult { sums, exposures } = result;
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
            // What is left out of the loss is left out of the error, whatever colour is stored there.
            if target.weight > 0.0 {
                sums.squared_error += difference.iter().map(|&d| f64::from(d) * f64::from(d)).sum::<f64>();
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
                let (value, slope) = smooth_l1(difference[c], self.config.beta);
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
            if self.config.opacity > 0.0 {
                let (value, slope) = smooth_l1(pixel.opacity - target.opacity, self.config.beta);
                sums.loss += f64::from(target.weight * self.config.opacity * value);
                gradient[3] += target.weight * self.config.opacity * slope;
            }
        }
    }
}
