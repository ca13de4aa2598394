//! Checks that go beyond the ranges in the table of defaults: multiples, schedules, and settings that depend on each other.

use super::{
    ConePattern, Config, Contraction, Convention, EncoderKind, EvalConfig, FieldConfig, LossConfig,
    OccupancyConfig, PhotographsConfig, PlanChoice, Precision, RendererConfig, SceneConfig, TrainConfig,
};
use crate::config::settings::{checker::Checker, section::in_memory};
use crate::{Error, Result, Settings};
use toml::{Table, Value};

impl Config {
    /// Checks that every setting is in its range. Settings read from text are checked while they are read, so this function
    /// is for configurations that are built or changed in code. Training and rendering call it before they begin.
    ///
    /// # Errors
    /// The error names the first setting that is out of range, its value and what is expected.
    pub fn validate(&self) -> Result<()> {
        // Configurations are stored as TOML, whose integers are signed and have 64 bits.
        for (path, number) in [("seed", self.seed), ("train.steps", self.train.steps)] {
            if i64::try_from(number).is_err() {
                let place = format!("configuration: {path} = {number}");
                return Err(Error::input(place, "out of range", "expected 0 to 2^63 - 1"));
            }
        }
        let settings = self.as_settings();
        let place = |path: &str| in_memory(path, settings.get(path));
        let defaults = settings.definitions();
        let given = |path: &str| {
            settings.get(path).map(Value::to_string) != defaults.default(path).map(Value::to_string)
        };
        self.check_all(&settings, &Checker::new(&place, &given))
    }

    /// Checks the ranges, the sections of other crates, and the relations between core's settings. `settings` are the
    /// settings of this configuration.
    pub(super) fn check_all(&self, settings: &Settings, to: &Checker<'_>) -> Result<()> {
        settings.check_ranges(to)?;
        let table = settings.table();
        for section in settings.definitions().registered() {
            let own = table.get(section.name).and_then(Value::as_table);
            (section.check)(own.unwrap_or(&Table::new()), to)?;
        }
        self.check_together(to)
    }

    /// Runs the checks of core's settings that go beyond the ranges of single numbers.
    fn check_together(&self, to: &Checker<'_>) -> Result<()> {
        self.data.check(to)?;
        self.scene.check(to)?;
        if self.scene.contraction != Contraction::None {
            to.together(
                self.renderer.step_per_radius == 0.0,
                &["renderer.step_per_radius", "scene.contraction"],
                "0 where scene.contraction is not \"none\": contracted steps grow with the distance",
            )?;
            to.together(
                !self.occupancy.hull,
                &["occupancy.hull", "scene.contraction"],
                "false where scene.contraction is not \"none\": silhouettes do not bound contracted space",
            )?;
        }
        to.together(
            !self.occupancy.hull || (self.occupancy.seeded == 0.0 && self.occupancy.cleared == 0.0),
            &["occupancy.hull", "occupancy.seeded", "occupancy.cleared"],
            "occupancy.hull, or occupancy.seeded and occupancy.cleared, but not both: silhouettes bound the grid for the whole run, points for a part of it; leave the others at 0 or false",
        )?;
        self.encoder.check(to)?;
        self.hash_grid.check(to)?;
        self.rip_map.check(to)?;
        self.tensor.check(to)?;
        self.voxels.check(to)?;
        self.check_density_of_encoder(to)?;
        self.field.check(to)?;
        self.check_deferred(to)?;
        self.renderer.check(to)?;
        self.loss.check(to)?;
        self.occupancy.check(to)?;
        to.check(self.optimizer.milestones.is_sorted(), "optimizer.milestones", "rising fractions")?;
        self.train.check(to)?;
        self.eval.check(to)?;
        // The scene plan may still choose the hash grid.
        let open = self.plan.encoder != PlanChoice::Off && !to.given("encoder.kind");
        self.refuse_settings_of_other_encoders(to, |owner| open && owner == EncoderKind::HashGrid)
    }

    /// Checks the settings that deferred shading excludes: the colours of its samples are those of their rays.
    fn check_deferred(&self, to: &Checker<'_>) -> Result<()> {
        if !self.field.deferred {
            return Ok(());
        }
        to.together(
            self.encoder.kind != EncoderKind::Voxels,
            &["field.deferred", "encoder.kind"],
            "field.deferred = false for encoder.kind = \"voxels\", whose field has no colour network",
        )?;
        to.together(
            self.train.backward_fraction.values().all(|fraction| fraction == 1.0),
            &["field.deferred", "train.backward_fraction"],
            "field.deferred = false, or train.backward_fraction = [[0.0, 1.0]]: one colour belongs to all samples of its ray",
        )
    }

    /// Refuses a setting that belongs to an encoder not in use and differs from its default, unless `may_follow` is true for that
    /// encoder.
    pub(crate) fn refuse_settings_of_other_encoders(
        &self,
        to: &Checker<'_>,
        may_follow: impl Fn(EncoderKind) -> bool,
    ) -> Result<()> {
        let defaults = Settings::defaults().table().try_into::<Self>();
        let defaults = defaults.unwrap_or_else(|error| unreachable!("defaults.toml is tested: {error}"));
        let (own, defaults) = (self.as_settings(), defaults.as_settings());
        for (path, value, _) in own.iter() {
            let other =
                EncoderKind::owner(path).filter(|owner| *owner != self.encoder.kind && !may_follow(*owner));
            if let Some(owner) = other.filter(|_| value.to_string() != defaults.value(path)) {
                return Err(Error::input(
                    to.place(path),
                    format!("is a setting of encoder.kind = {}", owner.name()),
                    format!(
                        "set encoder.kind to it, or leave this setting out: encoder.kind is {}",
                        self.encoder.kind.name()
                    ),
                ));
            }
        }
        Ok(())
    }
}

impl PhotographsConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check([0, 3].contains(&self.origin.len()), "data.origin", "[] or [x, y, z]")?;
        to.together(
            self.convention == Convention::Public
                || self.edge_exponents.iter().all(|&exponent| exponent == 0.0),
            &["data.edge_exponents", "data.convention"],
            "[] where data.convention = \"premultiplied\", whose silhouettes are not darkened",
        )
    }
}

impl SceneConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        let sides = (0..3).map(|axis| self.aabb_max[axis] - self.aabb_min[axis]);
        to.together(
            sides.into_iter().all(|side| side > 0.0),
            &["scene.aabb_max", "scene.aabb_min"],
            "scene.aabb_max above scene.aabb_min on every axis, all finite",
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
            "field.precision = \"f32\" for networks with field.biases or field.joined",
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

impl LossConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check(
            self.depth.is_whole(),
            "loss.depth",
            "[[0.0, weight], ...] with rising fractions below 1 and weights from 0 to 100",
        )
    }
}

impl TrainConfig {
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check(self.leaves.is_power_of_two(), "train.leaves", "a power of two from 1 to 64")?;
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
            self.background_fraction.is_whole(),
            "train.background_fraction",
            "[[0.0, fraction], ...] with rising fractions of the run below 1 and fractions of the rays from 0 to 1",
        )?;
        to.check(
            self.backward_fraction.is_whole(),
            "train.backward_fraction",
            "[[0.0, fraction], ...] with rising fractions of the run below 1 and fractions of the samples from 0.01 to 1",
        )?;
        to.check(
            self.error_map.is_whole(),
            "train.error_map",
            "[[0.0, fraction], ...] with rising fractions of the run below 1 and fractions of the pixels from 0 to 0.95",
        )?;
        to.check(
            self.scale_weighting.is_whole(),
            "train.scale_weighting",
            "[[0.0, weighting], ...] with rising fractions below 1 and weightings from 0 to 1",
        )?;
        to.check(
            self.finest_scale.is_whole() && self.finest_scale.values().all(|n| n.fract() == 0.0),
            "train.finest_scale",
            "[[0.0, scale], ...] with rising fractions below 1 and whole numbers from 0 to 7",
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
            "0 where eval.final = false: nothing is measured at the end",
        )
    }
}
