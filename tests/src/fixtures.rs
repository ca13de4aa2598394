//! Small test problems: random numbers, configurations, parameters with varied densities, photographs of noise at
//! several scales, cameras.

use glam::DVec3;
use trimip_core::{
    Alpha, Camera, Config, Frames, Intrinsics, Layout, Result, Scale, View, ViewSet,
    config::{
        Decomposition, DensityFunction, EncoderConfig, EncoderKind, HashGridConfig, LevelFormula,
        OptimizerConfig, RateSchedule, RendererConfig, Untouched, ViewEncoding, schedule::Schedule,
    },
    field::params::Slot,
    scene::depths::KnownDepth,
};

/// Random numbers for tests: SplitMix64 (Steele et al. 2014).
pub struct TestRandom(u64);

impl TestRandom {
    /// Creates the sequence of a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Returns 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Returns a number that is uniform in [low, high).
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Returns a uniform integer below `count`.
    pub fn below(&mut self, count: usize) -> usize {
        (self.bits() % count as u64) as usize
    }

    /// Returns a random unit vector.
    pub fn direction(&mut self) -> DVec3 {
        loop {
            let v = DVec3::new(self.between(-1.0, 1.0), self.between(-1.0, 1.0), self.between(-1.0, 1.0));
            if (0.01..1.0).contains(&v.length_squared()) {
                return v.normalize();
            }
        }
    }
}

/// Returns the configuration with the optimiser, the occupancy grid and the budget of the authors' code, and defaults
/// for all other settings.
pub fn as_code() -> Config {
    let mut config = Config::default();
    (config.optimizer.plane_scale, config.optimizer.beta2) = (10.0, 0.999);
    config.optimizer.untouched = Untouched::Decay;
    (config.occupancy.warmup_fraction, config.occupancy.fraction) = (1.0, 0.25);
    config.occupancy.threshold = 5e-3;
    (config.train.steps, config.train.seconds) = (25_000, 0.0);
    config
}

/// Returns a configuration small enough for the reference: planes of 16² texels, 16 hidden units, about twenty steps
/// per ray.
pub fn small() -> Config {
    let mut config = Config { threads: 1, ..as_code() };
    (config.encoder.plane_size, config.encoder.levels) = (16, 5);
    config.encoder.level = LevelFormula::Paper;
    config.field.hidden = 16;
    config.renderer.steps_per_diagonal = 32;
    config.occupancy.resolution = 8;
    config.train.samples_per_step = 512;
    config.data.background = [0.9, 0.2, 0.6];
    config
}

/// Returns `small` with a hash grid of four levels. The last two levels are hashed, and feature rows are padded.
fn small_hash_grid() -> Config {
    let (mut config, defaults) = (small(), Config::default());
    // A hash grid rejects settings of the planes.
    config.encoder = EncoderConfig { kind: EncoderKind::HashGrid, ..defaults.encoder };
    config.optimizer.plane_scale = defaults.optimizer.plane_scale;
    config.hash_grid = HashGridConfig {
        levels: 4,
        features: 2,
        log2_entries: 9,
        coarsest: 4,
        finest: 23,
        ..config.hash_grid
    };
    config
}

/// Returns `small_hash_grid` with entries of four features. Only samples of sufficient weight have their colours
/// computed.
fn wide_hash_grid() -> Config {
    let mut config = small_hash_grid();
    (config.hash_grid.features, config.hash_grid.levels) = (4, 5);
    config.renderer.color_weight = Schedule::new(vec![[0.0, 0.02]]);
    config
}

/// Returns a `small_hash_grid` that reads `points` points per sample (1 or 6) and downweights narrow cells.
pub fn small_zip(points: u32) -> Config {
    let mut config = small_hash_grid();
    (config.hash_grid.points, config.hash_grid.downweight) = (points, true);
    config
}

/// Returns small configurations of the encoders that grow during a run.
pub fn growing() -> [Config; 3] {
    [growing_hash_grid(), growing_tensor(), growing_voxels()]
}

/// Returns `small_hash_grid` with levels that become active during a run.
pub fn growing_hash_grid() -> Config {
    let mut config = small_hash_grid();
    let all = f64::from(config.hash_grid.levels);
    config.hash_grid.inactive_levels = Schedule::new(vec![[0.0, all - 1.0], [0.2, 1.0], [0.4, 0.0]]);
    config
}

/// Returns `small` with ripmaps on six planes, three levels along each axis.
fn small_rip_map() -> Config {
    let (mut config, defaults) = (small(), Config::default());
    config.encoder = EncoderConfig { kind: EncoderKind::RipMap, ..defaults.encoder };
    config.optimizer.plane_scale = defaults.optimizer.plane_scale;
    (config.rip_map.planes, config.rip_map.size, config.rip_map.levels) = (6, 16, 3);
    config
}

/// Returns `small_rip_map` with three planes and with ten, each in a box with three different sides.
fn other_rip_maps() -> [Config; 2] {
    [3, 10].map(|planes| {
        let mut config = small_rip_map();
        (config.rip_map.planes, config.rip_map.size, config.rip_map.levels) = (planes, 24, 4);
        config.rip_map.level_bias = -0.5;
        (config.scene.aabb_min, config.scene.aabb_max) = ([-1.0, -1.5, -0.5], [2.0, 1.5, 0.75]);
        config
    })
}

/// Returns `small` with tensor factors, TensoRF's networks, and colours only for samples of sufficient weight.
fn small_tensor() -> Config {
    let (mut config, defaults) = (small(), Config::default());
    config.encoder = EncoderConfig { kind: EncoderKind::Tensor, ..defaults.encoder };
    config.optimizer.plane_scale = defaults.optimizer.plane_scale;
    config.tensor.sides = Schedule::new(vec![[0.0, 9.0]]);
    (config.tensor.density_components, config.tensor.color_components) = (16, 32);
    let field = &mut config.field;
    (field.density_layers, field.biases, field.geometry, field.geometry_frequencies) = (0, true, 6, 2);
    (field.view, field.view_frequencies) = (ViewEncoding::Frequencies, 2);
    (field.density, field.density_shift, field.density_scale) = (DensityFunction::Softplus, 2.0, 3.0);
    config.renderer.color_weight = Schedule::new(vec![[0.0, 0.02]]);
    config
}

/// Returns `small_tensor` with factors that grow twice during a run.
pub fn growing_tensor() -> Config {
    let mut config = small_tensor();
    config.tensor.sides = Schedule::new(vec![[0.0, 5.0], [0.2, 7.0], [0.4, 9.0]]);
    config.optimizer.schedule = RateSchedule::Exponential;
    config
}

/// Returns `small_tensor` with products of three lines (CP), in a box with three different sides.
fn small_lines() -> Config {
    let mut config = small_tensor();
    config.tensor.decomposition = Decomposition::Cp;
    config.tensor.sides = Schedule::new(vec![[0.0, 12.0]]);
    (config.scene.aabb_min, config.scene.aabb_max) = ([-1.0, -1.5, -0.5], [2.0, 1.5, 0.75]);
    config
}

/// Returns `small` with positional encodings: plain, or integrated over the Gaussian of a sample.
fn small_frequencies(integrated: bool) -> Config {
    let (mut config, defaults) = (small(), Config::default());
    config.encoder = EncoderConfig { kind: EncoderKind::Frequencies, ..defaults.encoder };
    config.optimizer.plane_scale = defaults.optimizer.plane_scale;
    let frequencies = &mut config.frequencies;
    (frequencies.count, frequencies.integrated, frequencies.identity) = (7, integrated, !integrated);
    (config.field.density_layers, config.field.joined, config.field.biases) = (3, 2, true);
    config
}

/// The same with a grid of densities and colours, and no networks.
fn small_voxels() -> Config {
    let (mut config, defaults) = (small(), Config::default());
    config.encoder = EncoderConfig { kind: EncoderKind::Voxels, ..defaults.encoder };
    config.optimizer.plane_scale = defaults.optimizer.plane_scale;
    config.voxels.sides = Schedule::new(vec![[0.0, 7.0]]);
    config.voxels.harmonics = 2;
    config.voxels.density_rate = 3.0;
    (config.field.density, config.field.density_shift) = (DensityFunction::Relu, -0.1);
    config
}

/// Returns `small_voxels` with a grid that grows twice during a run.
pub fn growing_voxels() -> Config {
    let mut config = small_voxels();
    config.voxels.sides = Schedule::new(vec![[0.0, 4.0], [0.2, 5.0], [0.4, 7.0]]);
    config
}

/// Returns `small_voxels` with nine harmonics, in a box with three different sides.
fn other_voxels() -> Config {
    let mut config = small_voxels();
    config.voxels.harmonics = 3;
    config.renderer.color_weight = Schedule::new(vec![[0.0, 0.02]]);
    (config.scene.aabb_min, config.scene.aabb_max) = ([-1.0, -1.5, -0.5], [2.0, 1.5, 0.75]);
    config
}

/// Returns `small` with networks like NeRF's: biases, a skip connection, another width for colour, ReLU density.
pub fn nerf_networks() -> Config {
    let mut config = small();
    let field = &mut config.field;
    (field.density_layers, field.joined, field.biases, field.geometry) = (4, 2, true, 16);
    (field.color_layers, field.color_hidden) = (1, 32);
    (field.view, field.view_frequencies) = (ViewEncoding::Frequencies, 4);
    (field.density, field.density_shift) = (DensityFunction::Relu, 0.0);
    config
}

/// Returns `small` with the mip level of a sample as an additional feature.
fn with_level() -> Config {
    let mut config = small();
    config.encoder.level_input = true;
    config
}

/// Returns `config` with the encoder of `by` and the settings that belong to that encoder.
pub fn encoded(config: Config, by: &Config) -> Config {
    let optimizer = OptimizerConfig {
        plane_scale: by.optimizer.plane_scale,
        schedule: by.optimizer.schedule,
        ..config.optimizer
    };
    let (encoder, hash_grid, rip_map) = (by.encoder.clone(), by.hash_grid.clone(), by.rip_map.clone());
    let renderer =
        RendererConfig { color_weight: by.renderer.color_weight.clone(), ..config.renderer.clone() };
    // A tensor's density features sum up to the density, so that encoder needs its own networks.
    let field = if by.encoder.kind == EncoderKind::Tensor { by.field.clone() } else { config.field };
    Config {
        encoder,
        hash_grid,
        rip_map,
        tensor: by.tensor.clone(),
        frequencies: by.frequencies.clone(),
        voxels: by.voxels.clone(),
        field,
        renderer,
        optimizer,
        ..config
    }
}

/// Returns a small configuration for each encoder.
pub fn every_encoder() -> Vec<Config> {
    vec![small(), small_hash_grid(), small_rip_map(), small_tensor(), small_frequencies(true), small_voxels()]
}

/// Returns [`every_encoder`], and variants that compute features or colours in other ways.
pub fn every_variant() -> Vec<Config> {
    let mut all = every_encoder();
    all.push(wide_hash_grid());
    all.extend([small_zip(1), small_zip(6)]);
    all.push(with_level());
    all.extend(other_rip_maps());
    all.extend([small_lines(), nerf_networks(), small_frequencies(false), other_voxels()]);
    all
}

/// Returns parameters far from their small initial values: texels in ±1, weights of layers up to 1.5 times Glorot's
/// bound. Densities then range from nearly transparent to nearly opaque, and no ReLU layer is dead.
pub fn lively(layout: &Layout, seed: u64) -> Vec<f32> {
    let mut random = TestRandom::new(seed);
    let bound = |slot: &Slot| match slot.name.as_str() {
        name if ["planes", "lines", "table", "voxels"].iter().any(|factor| name.ends_with(factor)) => 1.0,
        name if name.ends_with("bias") => 0.3,
        _ => 1.5 * (6.0 / (slot.shape[0] + slot.shape[1]) as f64).sqrt(),
    };
    let mut values = vec![0.0; layout.len()];
    for slot in &layout.slots {
        let bound = bound(slot);
        values[slot.range.clone()].fill_with(|| random.between(-bound, bound) as f32);
    }
    values
}

/// Returns photographs of noise at `scales` scales: `count` square views of `size` pixels, whose cameras look at the
/// origin from a distance of 4 units. The rays of a picture's corners miss the box.
pub fn noise(count: usize, size: u32, scales: u32, seed: u64) -> ViewSet {
    let mut random = TestRandom::new(seed);
    let cameras: Vec<Camera> = (0..count)
        .map(|_| {
            Camera::look_at(
                Intrinsics::from_angle(size, size, 1.1),
                4.0 * random.direction(),
                DVec3::ZERO,
                DVec3::Z,
            )
        })
        .collect();
    photographs(&cameras, scales, |_, _| random.bits().to_le_bytes()[..4].try_into().unwrap_or_default())
}

/// Returns views of `cameras` at `scales` scales; `pixel(view, index)` returns the straight RGBA of a pixel.
pub fn photographs(
    cameras: &[Camera],
    scales: u32,
    mut pixel: impl FnMut(usize, usize) -> [u8; 4],
) -> ViewSet {
    let mut set = ViewSet {
        views: vec![],
        pixels: Default::default(),
        alpha: Alpha::Straight,
        scales: vec![],
        depths: Vec::new(),
    };
    for level in 0..scales {
        let (first_view, first_pixel) = (set.views.len(), set.pixels.len());
        for (i, camera) in cameras.iter().enumerate() {
            let intrinsics = camera.intrinsics.reduced(level);
            let (name, offset) = (format!("view {i}"), set.pixels.len());
            set.views.push(View { name, camera: Camera { intrinsics, ..*camera }, offset });
            set.pixels.extend((0..(intrinsics.width * intrinsics.height) as usize).map(|p| pixel(i, p)));
        }
        set.scales.push(Scale {
            factor: 1 << level,
            weight: 4.0_f32.powi(level as i32),
            views: first_view..set.views.len(),
            pixels: first_pixel..set.pixels.len(),
        });
    }
    set.depths = (0..set.pixels.len() as u32).step_by(3).map(known_depth).collect();
    set
}

/// Returns a known depth for a pixel, near 4: the distance of [`noise`]'s cameras from the origin.
fn known_depth(pixel: u32) -> KnownDepth {
    let varied = |period: u32| (pixel % period) as f32 / period as f32;
    KnownDepth { pixel, distance: 3.0 + 2.0 * varied(17), deviation: 0.05 + 0.4 * varied(7) }
}

/// Returns the parameters of a uniform field: texels of 1, one density, and one colour in every direction.
pub fn constant(config: &Config, layout: &Layout, density: f64, rgb: [f64; 3]) -> Vec<f32> {
    let mut values = vec![0.0_f32; layout.len()];
    let last_density = format!("density.{}.weight", config.field.density_layers);
    let last_color = format!("color.{}.weight", config.field.color_layers);
    for slot in &layout.slots {
        let part = &mut values[slot.range.clone()];
        if slot.name == "planes" {
            part.fill(1.0);
            continue;
        }
        let [inputs, outputs] = [slot.shape[0], slot.shape[1]];
        if slot.name == last_density {
            // Density = exp(logit − 1) with hidden units of 1; the geometry features stay 0.
            let weight = (density.ln() + 1.0) / inputs as f64;
            part.iter_mut().step_by(outputs).for_each(|w| *w = weight as f32);
        } else if slot.name == last_color {
            for row in part.chunks_exact_mut(outputs) {
                for (w, c) in row.iter_mut().zip(rgb) {
                    *w = ((c / (1.0 - c)).ln() / inputs as f64) as f32;
                }
            }
        } else if slot.name == "color.0.weight" {
            // The first spherical harmonic is the constant 1/(2√π), so every hidden unit becomes 1.
            part[..outputs].fill(2.0 * std::f32::consts::PI.sqrt());
        } else {
            part.fill(1.0 / inputs as f32);
        }
    }
    values
}

/// Test frames, one set of views each.
pub struct GivenFrames(pub Vec<ViewSet>);

impl Frames for GivenFrames {
    fn len(&self) -> usize {
        self.0.len()
    }

    fn names(&self) -> Vec<String> {
        self.0.iter().map(|set| set.views[0].name.clone()).collect()
    }

    fn cameras(&self) -> Vec<Camera> {
        self.0.iter().flat_map(|set| set.views.iter().map(|view| view.camera)).collect()
    }

    fn load(&self, index: usize) -> Result<ViewSet> {
        Ok(self.0[index].clone())
    }
}
