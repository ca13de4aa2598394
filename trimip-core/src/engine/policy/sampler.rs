//! The policy of sampling rays: the pixels that a step draws from each scale, their loss weight and cones, and the
//! fraction of random backgrounds, according to the schedules.

use crate::{
    Config, Scale, View, ViewSet,
    config::{CameraPoses, Exposure, LossConfig, TrainConfig},
    engine::{
        error_map::{Drawn, ErrorMap},
        exposure,
        ray_allocation::{RayAllocation, ScaleSampling, ScaleWeights},
    },
    field::losses::{Definition, depth::Depth},
    math::rng::{Random, Sequence, below},
    scene::cones::Division,
};

/// Scales, schedules and random numbers of a sampler.
#[derive(Clone, Debug)]
pub struct SamplerPolicy {
    /// The rule by which pixels of cameras are divided into cones.
    pub division: Division,
    /// Background (RGB) of training pixels that do not get a random background.
    pub background: [f32; 3],
    /// Generator of random pixels and backgrounds.
    pub random: Random,
    /// The scales of the training views, fine to coarse; empty without views.
    pub scales: Vec<Scale>,
    /// Edge exponent of each scale's photographs ([`edge_exponents`](crate::scene::edge_exponents)).
    pub exponents: Vec<f32>,
    /// With `loss.exposure` or refined poses, the photograph of each training view ([`exposure::photographs`]);
    /// otherwise empty.
    pub photographs: Vec<u32>,
    loss: LossConfig,
    knows_depths: bool,
    train: TrainConfig,
    sampling: Option<ScaleSampling>,
    scale_weights: ScaleWeights,
    random_background: f32,
    error_map: Option<ErrorMap>,
}

impl SamplerPolicy {
    /// Creates the policy of a configuration over training views at the start of a run. Without views, the policy is
    /// for camera rays only.
    pub fn new(config: &Config, views: Option<&ViewSet>) -> Self {
        let told_apart =
            config.loss.exposure == Exposure::Gain || config.train.cameras == CameraPoses::Refine;
        let scales = views.map_or_else(Vec::new, |views| views.scales.clone());
        let mut policy = Self {
            division: Division::new(config),
            background: config.data.background,
            random: Random::new(config.seed),
            exponents: scales.iter().map(|scale| config.data.edge_exponent(scale.factor)).collect(),
            scales,
            photographs: views.filter(|_| told_apart).map(exposure::photographs).unwrap_or_default(),
            loss: config.loss.clone(),
            knows_depths: false,
            train: config.train.clone(),
            sampling: views.map(|views| ScaleSampling::new(config, views)),
            scale_weights: ScaleWeights::default(),
            random_background: 0.0,
            // The error is dropped here, because a trainer rejects views that cannot have an error map.
            error_map: views.and_then(|views| ErrorMap::new(config, views).ok().flatten()),
        };
        policy.set_progress(0.0);
        policy
    }

    /// Applies the schedules at `progress` in [0, 1].
    pub fn set_progress(&mut self, progress: f64) {
        if let Some(sampling) = &self.sampling {
            self.scale_weights = sampling.at(progress);
        }
        self.random_background = self.train.random_background(progress);
        self.knows_depths = Depth.weight_at(&self.loss, progress) > 0.0;
    }

    /// Returns the pixels, loss weight and cones of each scale.
    pub fn scale_weights(&self) -> &ScaleWeights {
        &self.scale_weights
    }

    /// Returns the fraction of the training pixels that get a random background.
    #[inline]
    pub fn random_background(&self) -> f32 {
        self.random_background
    }

    /// Returns true while `loss.depth` is above 0: the targets of pixels then include their known depths.
    #[inline]
    pub fn knows_depths(&self) -> bool {
        self.knows_depths
    }

    /// Returns the error map, if `train.error_map` is used.
    pub fn error_map(&self) -> Option<&ErrorMap> {
        self.error_map.as_ref()
    }

    /// Replaces the error map with one of the same photographs.
    pub fn set_error_map(&mut self, map: ErrorMap) {
        self.error_map = Some(map);
    }

    /// Returns pixel `index` of a training step, from the scale that `draw` assigns to the pixel. Within the scale, the
    /// pixel is drawn uniformly or by the error map. `views` are the views of all scales.
    #[inline]
    pub fn pixel(&self, views: &[View], step: u64, draw: &RayAllocation, index: u32) -> Drawn {
        let scale = draw.scale(index);
        let Scale { pixels, views: of_scale, .. } = &self.scales[scale];
        let bits = self.random.bits(Sequence::Pixel, step, index);
        match &self.error_map {
            None => {
                let pixel = pixels.start + below(bits[0], pixels.len() as u32) as usize;
                let view = views[of_scale.clone()].partition_point(|view| view.offset <= pixel) - 1;
                Drawn { scale, view, pixel, importance: 1.0 }
            }
            Some(map) => {
                let (view, pixel, importance) = map.draw(&views[of_scale.clone()], pixels.len(), bits);
                Drawn { scale, view, pixel, importance }
            }
        }
    }

    /// Returns the cell of the error map from which pixel `index` of a training step is drawn.
    #[inline]
    pub fn cell(&self, map: &ErrorMap, step: u64, index: u32) -> usize {
        map.cell(self.random.bits(Sequence::Pixel, step, index)[0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Alpha, Camera, Intrinsics,
        config::{TrainBackground, schedule::Schedule},
    };
    use glam::DVec3;

    /// Returns two scales of one view each.
    fn views() -> ViewSet {
        let view = |side: u32, offset| View {
            name: String::new(),
            camera: Camera::look_at(
                Intrinsics::from_angle(side, side, 0.7),
                DVec3::new(0.0, -4.0, 0.0),
                DVec3::ZERO,
                DVec3::Z,
            ),
            offset,
        };
        ViewSet {
            views: vec![view(8, 0), view(4, 64)],
            pixels: vec![[0; 4]; 80].into(),
            alpha: Alpha::Straight,
            depths: Vec::new(),
            scales: vec![
                Scale { factor: 1, weight: 1.0, views: 0..1, pixels: 0..64 },
                Scale { factor: 2, weight: 4.0, views: 1..2, pixels: 64..80 },
            ],
        }
    }

    #[test]
    fn every_pixel_is_drawn_from_its_scale() {
        let mut config = Config::default();
        config.train.scale_weighting = Schedule::new(vec![[0.0, 1.0]]);
        let policy = SamplerPolicy::new(&config, Some(&views()));
        let draw = policy.scale_weights().allocate(4000);
        let mut counts = [0; 80];
        for index in 0..4000 {
            let Drawn { scale, view, pixel, importance } = policy.pixel(&views().views, 3, &draw, index);
            assert_eq!((view, importance), (0, 1.0), "each scale has one view");
            assert!(policy.scales[scale].pixels.contains(&pixel), "{index}");
            counts[pixel] += 1;
        }
        // 2000 draws of 64 pixels, and 2000 of 16; the tolerance is 4.5 standard deviations.
        for (pixel, &count) in counts.iter().enumerate() {
            let expected = if pixel < 64 { 2000.0 / 64.0 } else { 2000.0 / 16.0_f64 };
            assert!((f64::from(count) - expected).abs() < 4.5 * expected.sqrt(), "{pixel}: {count}");
        }
    }

    #[test]
    fn backgrounds_are_random_by_their_schedule() {
        let mut config = Config::default();
        config.train.background = TrainBackground::Random;
        config.train.background_fraction = Schedule::new(vec![[0.0, 1.0], [0.5, 0.25]]);
        let mut policy = SamplerPolicy::new(&config, None);
        assert_eq!(policy.random_background(), 1.0);
        policy.set_progress(0.75);
        assert_eq!(policy.random_background(), 0.25);
    }

    #[test]
    fn views_have_photographs_with_exposure_or_refined_poses_alone() {
        let mut config = Config::default();
        assert!(SamplerPolicy::new(&config, Some(&views())).photographs.is_empty());
        config.loss.exposure = Exposure::Gain;
        assert_eq!(SamplerPolicy::new(&config, Some(&views())).photographs.len(), 2);
        assert!(SamplerPolicy::new(&config, None).photographs.is_empty());
        config.loss.exposure = Exposure::None;
        config.train.cameras = CameraPoses::Refine;
        assert_eq!(SamplerPolicy::new(&config, Some(&views())).photographs.len(), 2);
    }
}
