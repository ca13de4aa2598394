//! What settings must be together, beyond the range of each number, which the table of defaults states.

use super::{
    ConePattern, Config, Contraction, Convention, DataConfig, EncoderKind, EvalConfig, FieldConfig,
    OccupancyConfig, Precision, RendererConfig, SceneConfig, TrainConfig,
};
use crate::{Error, Result, Settings, encoders, range, settings::shown};

/// Refuses settings by their dotted path.
pub(super) struct Checker<'a> {
    /// Where the value of a dotted path was set, as text for an error.
    place: &'a dyn Fn(&str) -> String,
    /// True for settings that are not defaults.
    given: &'a dyn Fn(&str) -> bool,
}

impl Checker<'_> {
    pub fn check(&self, ok: bool, path: &str, expected: &str) -> Result<()> {
        match ok {
            true => Ok(()),
            false => Err(Error::input((self.place)(path), "out of range", format!("expected {expected}"))),
        }
    }

    /// As `check`, for what several settings must be together: names the first that was given.
    pub fn together(&self, ok: bool, paths: &[&str], expected: &str) -> Result<()> {
        let given = paths.iter().find(|path| (self.given)(path)).or(paths.first());
        self.check(ok, given.unwrap_or(&""), expected)
    }
}

impl Config {
    /// Checks that every setting is in its range. Settings read from text are checked while they are read; this is for
    /// configurations built or changed in code. Training and rendering call it before they begin.
    ///
    /// # Errors
    /// Names the first setting that is out of range, its value and what is expected.
    pub fn validate(&self) -> Result<()> {
        // TOML, in which a configuration is stored, has signed numbers of 64 bits.
        for (path, number) in [("seed", self.seed), ("train.steps", self.train.steps)] {
            if i64::try_from(number).is_err() {
                let place = format!("configuration: {path} = {number}");
                return Err(Error::input(place, "out of range", "expected 0 to 2^63 - 1"));
            }
        }
        let settings = self.as_settings();
        let value = |path: &str| settings.iter().find(|(other, ..)| *other == path);
        let place = |path: &str| match value(path) {
            Some((_, value, _)) => format!("configuration: {path} = {}", shown(value)),
            None => path.to_string(),
        };
        range::check(&settings, &place)?;
        let defaults = Settings::defaults();
        let given =
            |path: &str| value(path).is_some_and(|(_, value, _)| value.to_string() != defaults.value(path));
        self.check_together(&place, &given)
    }

    /// Checks what the range of a single number does not say; `place` turns a dotted path into the place where its value
    /// was set, and `given` is false for defaults.
    pub(super) fn check_together(
        &self,
        place: &dyn Fn(&str) -> String,
        given: &dyn Fn(&str) -> bool,
    ) -> Result<()> {
        let checker = Checker { place, given };
        self.data.check(&checker)?;
        self.scene.check(&checker)?;
        if self.scene.contraction != Contraction::None {
            checker.together(
                self.renderer.step_per_radius == 0.0,
                &["renderer.step_per_radius", "scene.contraction"],
                "0 where scene.contraction is not \"none\": contracted steps grow with the distance",
            )?;
            checker.together(
                !self.occupancy.hull,
                &["occupancy.hull", "scene.contraction"],
                "false where scene.contraction is not \"none\": silhouettes bound a scene",
            )?;
        }
        self.encoder.check(&checker)?;
        self.hash_grid.check(&checker)?;
        self.rip_map.check(&checker)?;
        self.tensor.check(&checker)?;
        self.voxels.check(&checker)?;
        checker.together(
            self.field.density_layers == 0 || encoders::of(self).summed(self) == 0,
            &["field.density_layers", "encoder.kind"],
            "field.density_layers = 0 for an encoder whose features sum up to the density",
        )?;
        self.field.check(&checker)?;
        self.renderer.check(&checker)?;
        self.occupancy.check(&checker)?;
        checker.check(self.optimizer.milestones.is_sorted(), "optimizer.milestones", "rising fractions")?;
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
        to.check(self.holdout != 1, "data.holdout", "0, or 2 and more")?;
        to.check(
            self.holdout == 0 || self.test_list.is_empty(),
            "data.test_list",
            "\"\" where data.holdout keeps frames back",
        )?;
        to.check(!self.train.is_empty(), "data.train", "at least one split")?;
        let once = |(i, split)| !self.train[..i].contains(split);
        to.check(self.train.iter().enumerate().all(once), "data.train", "each split once")?;
        to.together(
            self.convention == Convention::Public
                || self.edge_exponents.iter().all(|&exponent| exponent == 0.0),
            &["data.edge_exponents", "data.convention"],
            "[] where data.convention = \"premultiplied\", whose silhouettes are as in the scene",
        )
    }
}

impl SceneConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        let sides = (0..3).map(|axis| self.aabb_max[axis] - self.aabb_min[axis]);
        to.together(
            sides.into_iter().all(|side| side > 0.0),
            &["scene.aabb_max", "scene.aabb_min"],
            "a corner above aabb_min on every axis, all finite",
        )?;
        to.check(self.up.iter().any(|&x| x != 0.0), "scene.up", "three numbers that are not all 0")?;
        let [x, y, z] = std::array::from_fn(|axis| self.aabb_max[axis] - self.aabb_min[axis]);
        to.together(
            self.contraction == Contraction::None || x.max(y).max(z) <= 1.001 * x.min(y).min(z),
            &["scene.contraction", "scene.aabb_max", "scene.aabb_min"],
            "\"none\", or a box from scene.aabb_min to scene.aabb_max that is a cube",
        )
    }
}

impl FieldConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check(self.hidden.is_multiple_of(16), "field.hidden", "a multiple of 16 from 16 to 512")?;
        to.check(
            self.color_hidden.is_multiple_of(16),
            "field.color_hidden",
            "0 or a multiple of 16 up to 512",
        )?;
        to.together(
            self.joined == 0 || self.joined < self.density_layers,
            &["field.joined", "field.density_layers"],
            "field.joined below field.density_layers: the input joins at a hidden layer",
        )?;
        to.together(
            self.precision != Precision::F16 || !(self.biases || self.joined > 0),
            &["field.precision", "field.biases", "field.joined"],
            "field.precision = \"f32\" for networks with biases or an input that joins again",
        )
    }
}

impl RendererConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.together(
            self.pattern == ConePattern::Grid || (self.cones == 1 && self.cone_width == 0.0),
            &["renderer.pattern", "renderer.cones", "renderer.cone_width"],
            "renderer.cones = 1 and renderer.cone_width = 0 for the quincunx, which has five cones a pixel",
        )?;
        to.check(
            self.step_scale.is_whole(),
            "renderer.step_scale",
            "[[0.0, scale], ...] with rising fractions below 1 and scales from 0.25 to 64",
        )?;
        to.check(
            self.color_weight.is_whole(),
            "renderer.color_weight",
            "[[0.0, weight], ...] with rising fractions below 1 and weights from 0 to 0.999",
        )
    }
}

impl OccupancyConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check(self.resolution.is_multiple_of(4), "occupancy.resolution", "a multiple of 4 from 4 to 1024")
    }
}

impl TrainConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check(self.parts.is_power_of_two(), "train.parts", "a power of two from 1 to 64")?;
        to.together(
            self.steps > 0 || self.seconds > 0.0,
            &["train.seconds", "train.steps"],
            "a budget: train.seconds or train.steps above 0",
        )?;
        to.check(
            self.batch_scale.is_whole(),
            "train.batch_scale",
            "[[0.0, scale], ...] with rising fractions below 1 and scales from 0.01 to 1",
        )?;
        to.check(
            self.background_share.is_whole(),
            "train.background_share",
            "[[0.0, share], ... [fraction, share]] with rising fractions below 1 and shares from 0 to 1",
        )?;
        to.check(
            self.scale_balance.is_whole(),
            "train.scale_balance",
            "[[0.0, balance], ...] with rising fractions below 1 and balances from 0 to 1",
        )?;
        to.check(
            self.cones.is_whole() && self.cones.values().all(|n| n.fract() == 0.0),
            "train.cones",
            "[[0.0, cones], ...] with rising fractions below 1 and whole numbers from 1 to 8",
        )
    }
}

impl EvalConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.together(
            self.min_psnr <= 0.0 || self.final_stride(1).is_some(),
            &["eval.min_psnr", "eval.final"],
            "0, where eval.final = false measures nothing",
        )
    }
}
