//! The ranges in which a run makes sense.

use super::{
    Config, Contraction, Convention, DataConfig, EncoderKind, EvalConfig, FieldConfig, HybridConfig,
    LossConfig, OccupancyConfig, OptimizerConfig, RendererConfig, SceneConfig, TrainConfig,
};
use crate::{Error, Result, Settings};

/// Refuses settings by their dotted path.
pub(super) struct Checker<'a> {
    /// Where the value of a dotted path was set, as text for an error.
    place: &'a dyn Fn(&str) -> String,
}

impl Checker<'_> {
    pub fn check(&self, ok: bool, path: &str, expected: &str) -> Result<()> {
        match ok {
            true => Ok(()),
            false => Err(Error::input((self.place)(path), "out of range", format!("expected {expected}"))),
        }
    }
}

pub(super) fn positive(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

pub(super) fn finite_from_zero(value: f64) -> bool {
    value.is_finite() && value >= 0.0
}

impl Config {
    /// Checks that every setting is in its range. Settings read from text are checked while they are read; this is for
    /// configurations built or changed in code. Training and rendering call it before they begin.
    ///
    /// # Errors
    /// Names the first setting that is out of range, its value and what is expected.
    pub fn validate(&self) -> Result<()> {
        let value = |path: &str| {
            let table = toml::Value::try_from(self).ok()?;
            path.split('.').try_fold(&table, |value, key| value.get(key)).map(ToString::to_string)
        };
        self.validate_at(&|path| match value(path) {
            Some(value) => format!("configuration: {path} = {value}"),
            None => path.to_string(),
        })
    }

    /// As [`validate`](Self::validate); `place` turns a dotted path into the place where its value was set.
    pub(super) fn validate_at(&self, place: &dyn Fn(&str) -> String) -> Result<()> {
        let checker = Checker { place };
        // TOML, in which a configuration is stored, has signed numbers of 64 bits.
        let storable = |number: u64| i64::try_from(number).is_ok();
        checker.check(storable(self.seed), "seed", "0 to 2^63 - 1")?;
        checker.check(storable(self.train.steps), "train.steps", "0 to 2^63 - 1")?;
        self.data.check(&checker)?;
        self.scene.check(&checker)?;
        if self.scene.contraction != Contraction::None {
            checker.check(
                self.renderer.step_per_radius == 0.0,
                "renderer.step_per_radius",
                "0 where scene.contraction is not \"none\": contracted steps grow with the distance",
            )?;
            checker.check(
                !self.occupancy.hull,
                "occupancy.hull",
                "false where scene.contraction is not \"none\": silhouettes bound a scene",
            )?;
        }
        self.encoder.check(&checker)?;
        self.hash_grid.check(&checker)?;
        self.rip_map.check(&checker)?;
        self.field.check(&checker)?;
        self.renderer.check(&checker)?;
        self.hybrid.check(&checker)?;
        self.occupancy.check(&checker)?;
        self.loss.check(&checker)?;
        self.optimizer.check(&checker)?;
        self.train.check(&checker)?;
        self.eval.check(&checker)?;
        self.refuse_settings_of_other_encoders(place)
    }

    /// Refuses settings of encoders that are not in use, if they differ from the defaults.
    fn refuse_settings_of_other_encoders(&self, place: &dyn Fn(&str) -> String) -> Result<()> {
        let defaults = Settings::defaults().table().try_into::<Self>();
        let defaults = defaults.unwrap_or_else(|error| unreachable!("defaults.toml is tested: {error}"));
        for ((path, own), (_, default)) in self.settings().into_iter().zip(defaults.settings()) {
            let other = EncoderKind::owner(&path).filter(|owner| *owner != self.encoder.kind);
            if let Some(owner) = other.filter(|_| own != default) {
                return Err(Error::input(
                    place(&path),
                    format!("is a setting of encoder.kind = {}", owner.name()),
                    format!("set encoder.kind to it, or leave this out: it is {}", self.encoder.kind.name()),
                ));
            }
        }
        Ok(())
    }
}

impl DataConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check((1..=8).contains(&self.scales), "data.scales", "1 to 8")?;
        to.check(self.holdout != 1, "data.holdout", "0, or 2 and more")?;
        to.check(
            self.holdout == 0 || self.test_list.is_empty(),
            "data.test_list",
            "\"\" where data.holdout keeps frames back",
        )?;
        to.check(!self.train.is_empty(), "data.train", "at least one split")?;
        let exponents = &self.edge_exponents;
        to.check(
            exponents.iter().all(|g| (0.0..=1.0).contains(g)),
            "data.edge_exponents",
            "values from 0 to 1",
        )?;
        to.check(
            self.convention == Convention::Public || exponents.iter().all(|&exponent| exponent == 0.0),
            "data.edge_exponents",
            "[] where data.convention = \"premultiplied\", whose silhouettes are as in the scene",
        )?;
        to.check(
            self.background.iter().all(|c| (0.0..=1.0).contains(c)),
            "data.background",
            "three values from 0 to 1",
        )?;
        to.check(self.most_pixels >= 1.0, "data.most_pixels", "1 or more")?;
        to.check((8..=4096).contains(&self.builtin_size), "data.builtin_size", "8 to 4096")?;
        to.check((1..=10_000).contains(&self.builtin_train), "data.builtin_train", "1 to 10000")?;
        to.check((1..=10_000).contains(&self.builtin_test), "data.builtin_test", "1 to 10000")?;
        to.check((1..=64).contains(&self.builtin_supersampling), "data.builtin_supersampling", "1 to 64")
    }
}

impl SceneConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        let sides = (0..3).map(|axis| self.aabb_max[axis] - self.aabb_min[axis]);
        to.check(
            sides.into_iter().all(|side| side.is_finite() && side > 0.0),
            "scene.aabb_max",
            "a corner above aabb_min on every axis, all finite",
        )?;
        to.check(
            self.up.iter().all(|x| x.is_finite()) && self.up.iter().any(|&x| x != 0.0),
            "scene.up",
            "three finite numbers that are not all 0",
        )?;
        let [x, y, z] = std::array::from_fn(|axis| self.aabb_max[axis] - self.aabb_min[axis]);
        to.check(
            self.contraction == Contraction::None || x.max(y).max(z) <= 1.001 * x.min(y).min(z),
            "scene.contraction",
            "\"none\", or a box from scene.aabb_min to scene.aabb_max that is a cube",
        )
    }
}

impl FieldConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check(
            (16..=512).contains(&self.hidden) && self.hidden.is_multiple_of(16),
            "field.hidden",
            "a multiple of 16 from 16 to 512",
        )?;
        to.check((1..=8).contains(&self.density_layers), "field.density_layers", "1 to 8")?;
        to.check((1..=8).contains(&self.color_layers), "field.color_layers", "1 to 8")?;
        to.check((4..=63).contains(&self.geometry), "field.geometry", "4 to 63")?;
        to.check((1..=4).contains(&self.harmonics), "field.harmonics", "1 to 4")
    }
}

impl RendererConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check((1..=8).contains(&self.cones), "renderer.cones", "1 to 8")?;
        to.check(finite_from_zero(self.cone_width.into()), "renderer.cone_width", "0 or more")?;
        to.check(
            (16..=65_536).contains(&self.steps_per_diagonal),
            "renderer.steps_per_diagonal",
            "16 to 65536",
        )?;
        to.check(
            self.step_scale.is_whole() && self.step_scale.values().all(|s| (0.25..=64.0).contains(&s)),
            "renderer.step_scale",
            "[[0.0, scale], ...] with rising fractions below 1 and scales from 0.25 to 64",
        )?;
        to.check((0.0..=64.0).contains(&self.step_per_radius), "renderer.step_per_radius", "0 to 64")?;
        to.check((0.0..1.0).contains(&self.min_transmittance), "renderer.min_transmittance", "0 to below 1")?;
        to.check((0.0..1.0).contains(&self.min_weight), "renderer.min_weight", "0 to below 1")
    }
}

impl HybridConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check((16..=4096).contains(&self.resolution), "hybrid.resolution", "16 to 4096")?;
        to.check((0.05..=8.0).contains(&self.step), "hybrid.step", "0.05 to 8")?;
        to.check((0.0..=1.0).contains(&self.share), "hybrid.share", "0 to 1")?;
        to.check((1e-6..=0.5).contains(&self.least), "hybrid.least", "1e-6 to 0.5")?;
        to.check(finite_from_zero(self.reach.into()), "hybrid.reach", "0 or more")?;
        to.check((1e-6..=0.5).contains(&self.opaque), "hybrid.opaque", "1e-6 to 0.5")?;
        to.check(positive(self.delta.into()), "hybrid.delta", "a positive number")?;
        to.check((1..=256).contains(&self.samples), "hybrid.samples", "1 to 256")?;
        to.check((1..=64).contains(&self.layers), "hybrid.layers", "1 to 64")?;
        to.check(positive(self.surface.into()), "hybrid.surface", "a positive number")?;
        to.check(positive(self.widest.into()), "hybrid.widest", "a positive number")
    }
}

impl OccupancyConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check(
            (4..=1024).contains(&self.resolution) && self.resolution.is_multiple_of(4),
            "occupancy.resolution",
            "a multiple of 4 from 4 to 1024",
        )?;
        to.check(self.every >= 1, "occupancy.every", "1 or more")?;
        to.check((0.0..=1.0).contains(&self.warmup_fraction), "occupancy.warmup_fraction", "0 to 1")?;
        to.check((0.0..=1.0).contains(&self.fraction), "occupancy.fraction", "0 to 1")?;
        to.check((0.0..=1.0).contains(&self.decay), "occupancy.decay", "0 to 1")?;
        to.check(self.threshold >= 0.0, "occupancy.threshold", "0 or more")
    }
}

impl LossConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check(positive(self.beta.into()), "loss.beta", "a number above 0")?;
        to.check(finite_from_zero(self.opacity.into()), "loss.opacity", "0 or more")?;
        to.check(finite_from_zero(self.distortion.into()), "loss.distortion", "0 or more")
    }
}

impl OptimizerConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check(positive(self.learning_rate), "optimizer.learning_rate", "a number above 0")?;
        to.check(positive(self.plane_scale), "optimizer.plane_scale", "a number above 0")?;
        to.check((0.0..=1.0).contains(&self.exposure_rate), "optimizer.exposure_rate", "0 to 1")?;
        to.check((0.0..1.0).contains(&self.beta1), "optimizer.beta1", "0 to below 1")?;
        to.check((0.0..1.0).contains(&self.beta2), "optimizer.beta2", "0 to below 1")?;
        to.check(positive(self.epsilon), "optimizer.epsilon", "a number above 0")?;
        to.check(finite_from_zero(self.weight_decay), "optimizer.weight_decay", "0 or more")?;
        to.check(positive(self.decay_factor), "optimizer.decay_factor", "a number above 0")?;
        to.check(
            self.milestones.iter().all(|m| (0.0..=1.0).contains(m)) && self.milestones.is_sorted(),
            "optimizer.milestones",
            "rising fractions from 0 to 1",
        )?;
        to.check((0.0..=1.0).contains(&self.final_factor), "optimizer.final_factor", "0 to 1")
    }
}

impl TrainConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check(finite_from_zero(self.seconds), "train.seconds", "0 or more")?;
        to.check(
            self.steps > 0 || self.seconds > 0.0,
            "train.seconds",
            "a budget: train.seconds or train.steps above 0",
        )?;
        to.check(
            (256..=4_194_304).contains(&self.samples_per_step),
            "train.samples_per_step",
            "256 to 4194304",
        )?;
        to.check(
            self.batch_scale.is_whole() && self.batch_scale.values().all(|s| (0.01..=1.0).contains(&s)),
            "train.batch_scale",
            "[[0.0, scale], ...] with rising fractions below 1 and scales from 0.01 to 1",
        )?;
        to.check(
            self.background_share.is_whole()
                && self.background_share.values().all(|share| (0.0..=1.0).contains(&share)),
            "train.background_share",
            "[[0.0, share], ... [fraction, share]] with rising fractions below 1 and shares from 0 to 1",
        )?;
        to.check(
            self.scale_balance.is_whole() && self.scale_balance.values().all(|b| (0.0..=1.0).contains(&b)),
            "train.scale_balance",
            "[[0.0, balance], ...] with rising fractions below 1 and balances from 0 to 1",
        )?;
        to.check(
            self.cones.is_whole()
                && self.cones.values().all(|n| (1.0..=8.0).contains(&n) && n.fract() == 0.0),
            "train.cones",
            "[[0.0, cones], ...] with rising fractions below 1 and whole numbers from 1 to 8",
        )?;
        to.check(self.checkpoint_seconds >= 0.0, "train.checkpoint_seconds", "0 or more")?;
        to.check(positive(self.log_seconds), "train.log_seconds", "a number above 0")
    }
}

impl EvalConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check((0.0..=100.0).contains(&self.share), "eval.share", "0 to 100")?;
        to.check(self.min_gain.is_finite(), "eval.min_gain", "a number")?;
        to.check(self.min_psnr.is_finite(), "eval.min_psnr", "a number")?;
        to.check(
            self.min_psnr <= 0.0 || self.final_stride(1).is_some(),
            "eval.min_psnr",
            "0, where eval.final = false measures nothing",
        )
    }
}
