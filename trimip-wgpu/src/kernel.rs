//! Kernels of the stages. A kernel is an entry point in WGSL files, preceded by constants, and the bindings that it
//! uses. Every constant is generated from Rust, so that none is defined twice. The kernels of an encoder are in its
//! file.

use crate::device::GROUP;
use crate::occupancy::SIDE;
use crate::projections::PROJECTIONS;
use trimip_core::proxy::BRICK;
use trimip_core::sh::FACTORS;

/// How a kernel uses a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Reads values.
    Read,
    /// Reads and writes values.
    Write,
    /// The dispatch's own parameters.
    Parameters,
}

use Access::{Parameters, Read, Write};

/// A compute kernel.
#[derive(Clone, Debug, PartialEq)]
pub struct Kernel {
    /// Name of the entry point.
    pub entry: &'static str,
    /// WGSL sources, in order.
    files: &'static [&'static str],
    /// `enable` directives, placed before everything else.
    enables: &'static str,
    /// Constants of this variant.
    constants: Vec<(&'static str, u32)>,
    /// Binding numbers and their access.
    pub bindings: &'static [(u32, Access)],
}

impl Kernel {
    pub const fn new(
        entry: &'static str,
        files: &'static [&'static str],
        bindings: &'static [(u32, Access)],
    ) -> Self {
        Self { entry, files, enables: "", constants: Vec::new(), bindings }
    }

    /// The kernel with f16 and cooperative matrices enabled.
    pub const fn cooperative(mut self) -> Self {
        self.enables = "enable f16;\nenable wgpu_cooperative_matrix;\n";
        self
    }

    /// The kernel with additional constants.
    pub fn with(mut self, constants: &[(&'static str, u32)]) -> Self {
        self.constants = constants.to_vec();
        self
    }

    /// Key that distinguishes the variants.
    pub fn key(&self) -> String {
        format!("{} {:p} {:?}", self.entry, self.files, self.constants)
    }

    /// The complete WGSL source.
    pub fn source(&self) -> String {
        let constants =
            self.constants.iter().copied().chain([("GROUP", GROUP), ("SIDE", SIDE), ("BRICK", BRICK)]);
        let constants: String =
            constants.map(|(name, value)| format!("const {name}: u32 = {value}u;\n")).collect();
        let factors = FACTORS.map(|factor| format!("{factor:?}")).join(", ");
        let factors = format!("const SH = array<f32, {}>({factors});\n", FACTORS.len());
        format!("{}{constants}{factors}{}", self.enables, self.files.join("\n"))
    }
}

/// Index of the invocation.
pub const GRID: &str = include_str!("shaders/grid.wgsl");
const RANDOM: &str = include_str!("shaders/random.wgsl");
/// The layout of a ray.
pub const RAY: &str = include_str!("shaders/ray.wgsl");
const SPACE: &str = include_str!("shaders/space.wgsl");
const CAMERA: &str = include_str!("shaders/camera.wgsl");
const ALL_RAYS: &str = include_str!("shaders/rays.wgsl");
const RAYS: &[&str] =
    &[GRID, RANDOM, RAY, CAMERA, PROJECTIONS, include_str!("shaders/photographs_none.wgsl"), ALL_RAYS];
const EXPOSED_RAYS: &[&str] =
    &[GRID, RANDOM, RAY, CAMERA, PROJECTIONS, include_str!("shaders/photographs_kept.wgsl"), ALL_RAYS];
const BLOCKS: &str = include_str!("shaders/blocks.wgsl");
const WALK: &str = include_str!("shaders/walk.wgsl");
const MARCH: &[&str] = &[GRID, RANDOM, RAY, SPACE, BLOCKS, WALK, include_str!("shaders/march.wgsl")];
const CHOICE: &[&str] = &[GRID, RAY, SPACE, BLOCKS, WALK, include_str!("shaders/choose.wgsl")];
const SCAN: &[&str] = &[include_str!("shaders/scan.wgsl")];
/// 64-bit fixed point.
pub const FIXED: &str = include_str!("shaders/fixed.wgsl");
/// Gradients read from fixed point or f32.
pub const OWN_FIXED: &str = include_str!("shaders/own_fixed.wgsl");
pub const OWN_FLOAT: &str = include_str!("shaders/own_float.wgsl");
/// The three ways of adding to gradients.
pub const ADD_FIXED: &str = include_str!("shaders/add_fixed.wgsl");
pub const ADD_ATOMIC: &str = include_str!("shaders/add_atomic.wgsl");
pub const ADD_EXCHANGE: &str = include_str!("shaders/add_exchange.wgsl");
const WEIGHTS: &[&str] =
    &[GRID, include_str!("shaders/weight_float.wgsl"), include_str!("shaders/weights.wgsl")];
const HALF: &str = crate::products::HALF;
const WEIGHTS_HALF: &[&str] =
    &[GRID, HALF, include_str!("shaders/weight_half.wgsl"), include_str!("shaders/weights.wgsl")];
const ACTIVATION: &str = include_str!("shaders/activation.wgsl");
const FIELD_PARAMS: &str = include_str!("shaders/field_params.wgsl");
/// Spherical harmonics of a direction.
pub const HARMONICS: &str = include_str!("shaders/harmonics.wgsl");
const FIELD: &[&str] = &[GRID, RAY, FIELD_PARAMS, ACTIVATION, HARMONICS, include_str!("shaders/field.wgsl")];
const DENSITY_GRADIENTS: &[&str] =
    &[GRID, FIELD_PARAMS, ACTIVATION, include_str!("shaders/density_gradients.wgsl")];
const BIASES: &[&str] = &[GRID, include_str!("shaders/biases.wgsl")];
const PRUNING: &str = include_str!("shaders/pruning.wgsl");
const PRUNE: &[&str] = &[GRID, PRUNING, include_str!("shaders/prune.wgsl")];
const GATHER: &[&str] = &[GRID, include_str!("shaders/gather.wgsl")];
const COMPOSITING: &str = include_str!("shaders/compositing.wgsl");
const SHARE: &[&str] = &[GRID, PRUNING, COMPOSITING, include_str!("shaders/share.wgsl")];
const DIM: &[&str] = &[GRID, COMPOSITING, include_str!("shaders/dim.wgsl")];
const COMPOSITE: &[&str] = &[GRID, RAY, COMPOSITING, include_str!("shaders/composite.wgsl")];
const COMPOSITE_GRADIENT: &[&str] = &[GRID, COMPOSITING, include_str!("shaders/composite_gradient.wgsl")];
const DISTORTION: &[&str] = &[GRID, RAY, SPACE, COMPOSITING, include_str!("shaders/distortion.wgsl")];
const PHOTOMETRIC: &str = include_str!("shaders/loss.wgsl");
const LOSS: &[&str] = &[GRID, include_str!("shaders/exposure_none.wgsl"), PHOTOMETRIC];
const EXPOSED_LOSS: &[&str] = &[GRID, FIXED, include_str!("shaders/exposure_gain.wgsl"), PHOTOMETRIC];
const ADAMW: &[&str] = &[GRID, include_str!("shaders/adamw.wgsl")];
const OCCUPANCY: &[&str] = &[GRID, RANDOM, RAY, SPACE, BLOCKS, include_str!("shaders/occupancy.wgsl")];

/// Computes the arguments of an indirect dispatch.
pub static ARGUMENTS: Kernel =
    Kernel::new("size", &[include_str!("shaders/arguments.wgsl")], &[(0, Read), (1, Write), (2, Parameters)]);

/// Multiply-adds without memory accesses, to measure a device.
pub static PEAK: Kernel =
    Kernel::new("peak", &[include_str!("shaders/peak.wgsl")], &[(0, Write), (1, Parameters)]);

pub static CAMERA_RAYS: Kernel =
    Kernel::new("camera_rays", RAYS, &[(0, Read), (1, Write), (2, Parameters), (6, Write)]);
pub static TRAINING_RAYS: Kernel = Kernel::new(
    "training_rays",
    RAYS,
    &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Read), (5, Write), (6, Write)],
);
pub static TRAINING_RAYS_EXPOSED: Kernel = Kernel::new(
    "training_rays",
    EXPOSED_RAYS,
    &[
        (0, Read),
        (1, Write),
        (2, Parameters),
        (3, Read),
        (4, Read),
        (5, Write),
        (6, Write),
        (7, Write),
        (8, Read),
    ],
);
pub static MARCHING: Kernel =
    Kernel::new("march", MARCH, &[(0, Read), (1, Write), (2, Write), (3, Parameters), (4, Read)]);
pub static PLACING: Kernel = Kernel::new(
    "place",
    MARCH,
    &[(0, Read), (1, Write), (2, Write), (3, Parameters), (5, Write), (6, Write), (7, Write)],
);
pub static COUNT_CHOSEN: Kernel =
    Kernel::new("count", CHOICE, &[(0, Read), (1, Write), (2, Write), (3, Parameters), (4, Read), (8, Read)]);
pub static FILL_CHOSEN: Kernel = Kernel::new(
    "fill",
    CHOICE,
    &[
        (0, Read),
        (1, Write),
        (2, Write),
        (3, Parameters),
        (4, Read),
        (5, Write),
        (6, Write),
        (7, Write),
        (8, Read),
    ],
);
pub static SHARING: Kernel = Kernel::new(
    "share",
    SHARE,
    &[(0, Write), (1, Read), (2, Parameters), (3, Write), (4, Write), (5, Write), (6, Write), (7, Write)],
);
pub static SUM_BLOCKS: Kernel = Kernel::new("sum_blocks", SCAN, &[(0, Write), (1, Write), (2, Parameters)]);
pub static SUM_ALL: Kernel = Kernel::new("sum_all", SCAN, &[(1, Write), (2, Parameters), (3, Write)]);
pub static START_SEGMENTS: Kernel =
    Kernel::new("start_segments", SCAN, &[(0, Write), (1, Write), (2, Parameters)]);
pub static PACK: Kernel = Kernel::new("pack", WEIGHTS, &[(0, Read), (1, Write), (2, Parameters), (3, Write)]);
pub static PACK_HALF: Kernel =
    Kernel::new("pack", WEIGHTS_HALF, &[(0, Read), (1, Write), (2, Parameters), (3, Write)]).cooperative();
pub static REDUCE: Kernel = Kernel::new("reduce", WEIGHTS, &[(0, Read), (1, Write), (2, Parameters)]);
pub static SPREAD_BIASES: Kernel =
    Kernel::new("spread", BIASES, &[(0, Read), (2, Parameters), (3, Write), (5, Read)]);
pub static SUM_ROWS: Kernel =
    Kernel::new("sum_rows", BIASES, &[(0, Read), (2, Parameters), (3, Write), (5, Read)]);
pub static DENSITIES: Kernel =
    Kernel::new("densities", FIELD, &[(0, Read), (1, Write), (2, Parameters), (3, Read)]);
pub static COLOR_INPUTS: Kernel = Kernel::new(
    "color_inputs",
    FIELD,
    &[(0, Read), (2, Parameters), (3, Read), (4, Read), (5, Read), (6, Write)],
);
pub static COLORS: Kernel =
    Kernel::new("colors", FIELD, &[(0, Read), (1, Write), (2, Parameters), (3, Read)]);
pub static DIMMING: Kernel = Kernel::new("dim", DIM, &[(0, Read), (1, Write), (2, Parameters), (3, Read)]);
pub static COLOR_GRADIENTS: Kernel =
    Kernel::new("color_gradients", FIELD, &[(1, Write), (2, Parameters), (3, Read), (6, Write), (7, Read)]);
pub static DENSITY_GRADIENT: Kernel = Kernel::new(
    "density_gradients",
    DENSITY_GRADIENTS,
    &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Read), (5, Read)],
);
pub static SEE: Kernel =
    Kernel::new("see", PRUNE, &[(0, Write), (2, Parameters), (3, Read), (4, Read), (5, Write), (6, Write)]);
pub static LIST: Kernel =
    Kernel::new("list", PRUNE, &[(0, Write), (1, Write), (2, Parameters), (5, Write), (6, Write)]);
pub static GATHERING: Kernel =
    Kernel::new("gather", GATHER, &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Read)]);
pub static COMPOSITING_RAYS: Kernel = Kernel::new(
    "composite",
    COMPOSITE,
    &[
        (0, Read),
        (1, Write),
        (2, Parameters),
        (3, Read),
        (4, Read),
        (5, Read),
        (6, Read),
        (7, Read),
        (8, Write),
    ],
);
pub static COMPOSITING_GRADIENT: Kernel = Kernel::new(
    "composite_gradient",
    COMPOSITE_GRADIENT,
    &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Read), (5, Read), (6, Read), (7, Read)],
);
pub static EVALUATE: Kernel = Kernel::new(
    "evaluate",
    LOSS,
    &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Write), (7, Read), (8, Read)],
);
pub static EVALUATE_EXPOSED: Kernel = Kernel::new(
    "evaluate",
    EXPOSED_LOSS,
    &[
        (0, Read),
        (1, Write),
        (2, Parameters),
        (3, Read),
        (4, Write),
        (7, Read),
        (8, Read),
        (9, Read),
        (10, Write),
    ],
);
pub static ADD_UP: Kernel =
    Kernel::new("add_up", LOSS, &[(2, Parameters), (4, Write), (5, Write), (6, Read)]);
pub static DISTORT: Kernel = Kernel::new(
    "distort",
    DISTORTION,
    &[
        (0, Read),
        (1, Write),
        (2, Parameters),
        (3, Read),
        (4, Read),
        (5, Read),
        (6, Read),
        (7, Read),
        (8, Write),
    ],
);
pub static ADD_DISTORTION: Kernel =
    Kernel::new("add_distortion", DISTORTION, &[(2, Parameters), (8, Write), (9, Write)]);
pub static UPDATE: Kernel = Kernel::new(
    "update",
    ADAMW,
    &[(0, Write), (1, Read), (2, Parameters), (3, Write), (4, Write), (5, Read), (6, Write)],
);
pub static CHOOSE: Kernel =
    Kernel::new("choose", OCCUPANCY, &[(0, Write), (1, Write), (2, Parameters), (3, Write), (6, Write)]);
pub static PROBES: Kernel = Kernel::new(
    "probes",
    OCCUPANCY,
    &[(0, Write), (2, Parameters), (3, Write), (4, Write), (8, Write), (9, Write), (10, Write)],
);
pub static ABSORB: Kernel =
    Kernel::new("absorb", OCCUPANCY, &[(0, Write), (2, Parameters), (3, Write), (5, Read), (6, Write)]);
pub static SUM_DENSITIES: Kernel =
    Kernel::new("sum_densities", OCCUPANCY, &[(2, Parameters), (6, Write), (7, Write)]);
pub static SETTLE: Kernel = Kernel::new("settle", OCCUPANCY, &[(0, Write), (2, Parameters), (7, Write)]);
pub static SET_BITS: Kernel =
    Kernel::new("set_bits", OCCUPANCY, &[(0, Write), (1, Write), (2, Parameters), (6, Write), (7, Write)]);
pub static FILL_IF_EMPTY: Kernel =
    Kernel::new("fill_if_empty", OCCUPANCY, &[(0, Write), (1, Write), (2, Parameters), (6, Write)]);
pub static SET_OUTER_BITS: Kernel =
    Kernel::new("set_outer_bits", OCCUPANCY, &[(0, Write), (1, Write), (2, Parameters)]);

/// The way in which texel gradients are added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Addition {
    /// 64-bit fixed point: the same bits every time.
    Fixed,
    /// Atomic f32 additions, if the device has them: half the memory.
    Atomic,
    /// Compare-and-exchange of f32, which every device has: half the memory.
    Exchange,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::products::{Finish, GRADIENT_SCALE, Matrices, accumulate, multiply};

    /// Every kernel in every variant that a configuration can select, or a similar variant.
    fn all() -> Vec<Kernel> {
        let fixed = [
            &ARGUMENTS,
            &PEAK,
            &CAMERA_RAYS,
            &TRAINING_RAYS,
            &TRAINING_RAYS_EXPOSED,
            &MARCHING,
            &PLACING,
            &COUNT_CHOSEN,
            &FILL_CHOSEN,
            &SHARING,
            &SUM_BLOCKS,
            &SUM_ALL,
            &START_SEGMENTS,
            &PACK,
            &PACK_HALF,
            &REDUCE,
            &SPREAD_BIASES,
            &SUM_ROWS,
            &DENSITIES,
            &COLOR_INPUTS,
            &COLORS,
            &DIMMING,
            &COLOR_GRADIENTS,
            &DENSITY_GRADIENT,
            &SEE,
            &LIST,
            &GATHERING,
            &COMPOSITING_RAYS,
            &COMPOSITING_GRADIENT,
            &EVALUATE,
            &EVALUATE_EXPOSED,
            &ADD_UP,
            &DISTORT,
            &ADD_DISTORTION,
            &UPDATE,
            &CHOOSE,
            &PROBES,
            &ABSORB,
            &SUM_DENSITIES,
            &SETTLE,
            &SET_BITS,
            &FILL_IF_EMPTY,
            &SET_OUTER_BITS,
        ];
        let sizes = [(8, 16), (16, 4), (16, 1)];
        let matrices = sizes.map(|(side, subgroups)| Some(Matrices { side, subgroups }));
        let matrices = matrices.into_iter().chain([None]);
        let mut kernels: Vec<Kernel> = fixed.into_iter().cloned().collect();
        for hidden in [16, 32, 48, 80, 128, 144, 160, 512] {
            for (k, n) in [(48, hidden), (hidden, 16), (32, hidden), (hidden, hidden), (16, hidden)] {
                for matrices in matrices.clone() {
                    let finishes = [Finish::Store, Finish::Relu, Finish::Mask];
                    kernels.extend(finishes.map(|f| multiply(k, n, f, matrices, GRADIENT_SCALE)));
                    if matrices.is_none() {
                        let adding = [Finish::Add, Finish::AddRelu];
                        kernels.extend(adding.map(|f| multiply(k, n, f, None, GRADIENT_SCALE)));
                    }
                    kernels.push(accumulate(k, n, 64, matrices));
                }
            }
        }
        kernels.extend(crate::encoder::kernels());
        kernels
    }

    #[test]
    fn every_variant_is_valid_and_fits_everywhere() {
        for kernel in all() {
            let name = kernel.key();
            let module = naga::front::wgsl::parse_str(&kernel.source())
                .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(&kernel.source())));
            // Capabilities beyond the default are allowed only to kernels that run on adapters with them.
            use naga::valid::Capabilities;
            let capabilities = match &kernel {
                kernel if kernel.files.contains(&ADD_ATOMIC) => Capabilities::SHADER_FLOAT32_ATOMIC,
                kernel if kernel.enables.is_empty() => Capabilities::default(),
                _ => Capabilities::SHADER_FLOAT16 | Capabilities::COOPERATIVE_MATRIX | Capabilities::SUBGROUP,
            };
            let info = naga::valid::Validator::new(naga::valid::ValidationFlags::all(), capabilities)
                .validate(&module)
                .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(&kernel.source())));
            let place = module.entry_points.iter().position(|entry| entry.name == kernel.entry);
            let place = place.unwrap_or_else(|| panic!("{name}: no such entry point"));
            assert!(module.entry_points[place].workgroup_size[0] <= 256, "{name}");

            // The listed bindings are those that the entry point uses, with their declared access.
            let used = info.get_entry_point(place);
            let mut found: Vec<(u32, Access)> = Vec::new();
            let (mut storage, mut workgroup) = (0, 0);
            for (handle, variable) in module.global_variables.iter() {
                if used[handle].is_empty() {
                    continue;
                }
                let size = module.types[variable.ty].inner.size(module.to_ctx());
                let access = match variable.space {
                    naga::AddressSpace::Uniform => Parameters,
                    naga::AddressSpace::Storage { access } if access.contains(naga::StorageAccess::STORE) => {
                        Write
                    }
                    naga::AddressSpace::Storage { .. } => Read,
                    naga::AddressSpace::WorkGroup => {
                        workgroup += size;
                        continue;
                    }
                    _ => continue,
                };
                if access == Parameters {
                    assert!(size <= 256, "{name}: parameters of {size} bytes");
                } else {
                    storage += 1;
                }
                found.extend(variable.binding.as_ref().map(|at| (at.binding, access)));
            }
            found.sort_by_key(|(binding, _)| *binding);
            assert_eq!(found, kernel.bindings, "{name}");
            assert!(storage <= 8, "{name}: {storage} storage buffers");
            assert!(workgroup <= 20 << 10, "{name}: {workgroup} bytes of workgroup memory");
        }
    }
}
