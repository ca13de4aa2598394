//! Kernels: an entry point in WGSL files with constants put in front, and the bindings it uses. Every constant comes from
//! Rust; none is typed twice.

use crate::device::GROUP;

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
    /// Entry point.
    pub entry: &'static str,
    /// WGSL texts, in order.
    files: &'static [&'static str],
    /// What stands before everything: extensions of the language.
    enables: &'static str,
    /// Constants of this variant.
    constants: Vec<(&'static str, u32)>,
    /// Binding numbers and their use.
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

    /// The kernel with f16 and cooperative matrices.
    const fn cooperative(mut self) -> Self {
        self.enables = "enable f16;\nenable wgpu_cooperative_matrix;\n";
        self
    }

    /// The kernel with constants of its own.
    fn with(mut self, constants: &[(&'static str, u32)]) -> Self {
        self.constants = constants.to_vec();
        self
    }

    /// What tells variants apart.
    pub fn key(&self) -> String {
        format!("{} {:p} {:?}", self.entry, self.files, self.constants)
    }

    /// The whole WGSL text.
    pub fn source(&self) -> String {
        let constants = self.constants.iter().copied().chain([("GROUP", GROUP)]);
        let constants: String =
            constants.map(|(name, value)| format!("const {name}: u32 = {value}u;\n")).collect();
        format!("{}{constants}{}", self.enables, self.files.join("\n"))
    }
}

const GRID: &str = include_str!("shaders/grid.wgsl");
const RANDOM: &str = include_str!("shaders/random.wgsl");
const RAYS: &[&str] = &[GRID, RANDOM, include_str!("shaders/rays.wgsl")];
const MARCH: &[&str] = &[GRID, RANDOM, include_str!("shaders/march.wgsl")];
const SCAN: &[&str] = &[include_str!("shaders/scan.wgsl")];
const PLANES: &str = include_str!("shaders/planes.wgsl");
const TRI_MIP: &str = include_str!("shaders/tri_mip.wgsl");
const ENCODE: &[&str] = &[GRID, PLANES, TRI_MIP, include_str!("shaders/encode.wgsl")];
const FIXED: &str = include_str!("shaders/fixed.wgsl");
const SCATTER: &str = include_str!("shaders/scatter.wgsl");
const SCATTER_FIXED: &[&str] =
    &[GRID, PLANES, TRI_MIP, FIXED, include_str!("shaders/add_fixed.wgsl"), SCATTER];
const SCATTER_ATOMIC: &[&str] = &[GRID, PLANES, TRI_MIP, include_str!("shaders/add_atomic.wgsl"), SCATTER];
const SCATTER_EXCHANGE: &[&str] =
    &[GRID, PLANES, TRI_MIP, include_str!("shaders/add_exchange.wgsl"), SCATTER];
const AVERAGING: &[&str] = &[GRID, PLANES, include_str!("shaders/average.wgsl")];
const PULL: &str = include_str!("shaders/pull.wgsl");
const PULL_FIXED: &[&str] = &[GRID, PLANES, FIXED, include_str!("shaders/own_fixed.wgsl"), PULL];
const PULL_FLOAT: &[&str] = &[GRID, PLANES, include_str!("shaders/own_float.wgsl"), PULL];
const PRODUCT: &str = include_str!("shaders/multiply.wgsl");
const STORE: &str = include_str!("shaders/finish_store.wgsl");
const RELU: &str = include_str!("shaders/finish_relu.wgsl");
const MASK: &str = include_str!("shaders/finish_mask.wgsl");
const MULTIPLY: [&[&str]; 3] = [&[STORE, PRODUCT], &[RELU, PRODUCT], &[MASK, PRODUCT]];
const ACCUMULATE: &[&str] = &[include_str!("shaders/accumulate.wgsl")];
const HALF: &str = include_str!("shaders/half.wgsl");
const EIGHT: &str = include_str!("shaders/cooperative_8.wgsl");
const SIXTEEN: &str = include_str!("shaders/cooperative_16.wgsl");
const PRODUCT_HALF: &str = include_str!("shaders/multiply_cooperative.wgsl");
/// By the side of the matrices, then by [`Finish`].
const MULTIPLY_COOPERATIVE: [[&[&str]; 3]; 2] = [
    [
        &[HALF, EIGHT, STORE, PRODUCT_HALF],
        &[HALF, EIGHT, RELU, PRODUCT_HALF],
        &[HALF, EIGHT, MASK, PRODUCT_HALF],
    ],
    [
        &[HALF, SIXTEEN, STORE, PRODUCT_HALF],
        &[HALF, SIXTEEN, RELU, PRODUCT_HALF],
        &[HALF, SIXTEEN, MASK, PRODUCT_HALF],
    ],
];
const ACCUMULATE_HALF: &str = include_str!("shaders/accumulate_cooperative.wgsl");
const ACCUMULATE_COOPERATIVE: [&[&str]; 2] =
    [&[HALF, EIGHT, ACCUMULATE_HALF], &[HALF, SIXTEEN, ACCUMULATE_HALF]];
const WEIGHTS: &[&str] =
    &[GRID, include_str!("shaders/weight_float.wgsl"), include_str!("shaders/weights.wgsl")];
const WEIGHTS_HALF: &[&str] =
    &[GRID, HALF, include_str!("shaders/weight_half.wgsl"), include_str!("shaders/weights.wgsl")];
const ACTIVATION: &str = include_str!("shaders/activation.wgsl");
const FIELD: &[&str] = &[GRID, ACTIVATION, include_str!("shaders/field.wgsl")];
const DENSITY_GRADIENTS: &[&str] = &[GRID, ACTIVATION, include_str!("shaders/density_gradients.wgsl")];
const PRUNE: &[&str] = &[GRID, include_str!("shaders/prune.wgsl")];
const GATHER: &[&str] = &[GRID, include_str!("shaders/gather.wgsl")];
const COMPOSITING: &str = include_str!("shaders/compositing.wgsl");
const COMPOSITE: &[&str] = &[GRID, COMPOSITING, include_str!("shaders/composite.wgsl")];
const COMPOSITE_GRADIENT: &[&str] = &[GRID, COMPOSITING, include_str!("shaders/composite_gradient.wgsl")];
const LOSS: &[&str] = &[GRID, include_str!("shaders/loss.wgsl")];
const ADAMW: &[&str] = &[GRID, include_str!("shaders/adamw.wgsl")];
const OCCUPANCY: &[&str] = &[GRID, RANDOM, include_str!("shaders/occupancy.wgsl")];

/// Sizes of an indirect dispatch.
pub static ARGUMENTS: Kernel =
    Kernel::new("size", &[include_str!("shaders/arguments.wgsl")], &[(0, Read), (1, Write), (2, Parameters)]);

/// Multiply-adds without memory, to measure a device.
pub static PEAK: Kernel =
    Kernel::new("peak", &[include_str!("shaders/peak.wgsl")], &[(0, Write), (1, Parameters)]);

pub static CAMERA_RAYS: Kernel = Kernel::new("camera_rays", RAYS, &[(0, Read), (1, Write), (2, Parameters)]);
pub static TRAINING_RAYS: Kernel = Kernel::new(
    "training_rays",
    RAYS,
    &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Read), (5, Write)],
);
pub static MARCHING: Kernel =
    Kernel::new("march", MARCH, &[(0, Read), (1, Write), (2, Write), (3, Parameters), (4, Read)]);
pub static PLACING: Kernel = Kernel::new(
    "place",
    MARCH,
    &[(0, Read), (1, Write), (2, Write), (3, Parameters), (5, Write), (6, Write), (7, Write)],
);
pub static SUM_BLOCKS: Kernel = Kernel::new("sum_blocks", SCAN, &[(0, Write), (1, Write), (2, Parameters)]);
pub static SUM_ALL: Kernel = Kernel::new("sum_all", SCAN, &[(1, Write), (2, Parameters), (3, Write)]);
pub static START_SEGMENTS: Kernel =
    Kernel::new("start_segments", SCAN, &[(0, Write), (1, Write), (2, Parameters)]);
pub static ENCODING: Kernel =
    Kernel::new("encode", ENCODE, &[(0, Read), (1, Read), (2, Parameters), (3, Read), (4, Write), (5, Read)]);
pub static AVERAGE: Kernel = Kernel::new("average", AVERAGING, &[(0, Write), (1, Write), (2, Parameters)]);
pub static PACK: Kernel = Kernel::new("pack", WEIGHTS, &[(0, Read), (1, Write), (2, Parameters), (3, Write)]);
pub static PACK_HALF: Kernel =
    Kernel::new("pack", WEIGHTS_HALF, &[(0, Read), (1, Write), (2, Parameters), (3, Write)]).cooperative();
pub static REDUCE: Kernel = Kernel::new("reduce", WEIGHTS, &[(0, Read), (1, Write), (2, Parameters)]);
pub static DENSITIES: Kernel =
    Kernel::new("densities", FIELD, &[(0, Read), (1, Write), (2, Parameters), (3, Read)]);
pub static COLOR_INPUTS: Kernel = Kernel::new(
    "color_inputs",
    FIELD,
    &[(0, Read), (2, Parameters), (3, Read), (4, Read), (5, Read), (6, Write)],
);
pub static COLORS: Kernel =
    Kernel::new("colors", FIELD, &[(0, Read), (1, Write), (2, Parameters), (3, Read)]);
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
    &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Read), (5, Read), (6, Read)],
);
pub static COMPOSITING_GRADIENT: Kernel = Kernel::new(
    "composite_gradient",
    COMPOSITE_GRADIENT,
    &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Read), (5, Read), (6, Read)],
);
pub static EVALUATE: Kernel = Kernel::new(
    "evaluate",
    LOSS,
    &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Write), (7, Read)],
);
pub static ADD_UP: Kernel =
    Kernel::new("add_up", LOSS, &[(2, Parameters), (4, Write), (5, Write), (6, Read)]);
pub static UPDATE: Kernel = Kernel::new(
    "update",
    ADAMW,
    &[(0, Write), (1, Read), (2, Parameters), (3, Write), (4, Write), (5, Read), (6, Write)],
);
pub static CHOOSE: Kernel =
    Kernel::new("choose", OCCUPANCY, &[(0, Write), (1, Write), (2, Parameters), (3, Write)]);
pub static PROBES: Kernel =
    Kernel::new("probes", OCCUPANCY, &[(0, Write), (2, Parameters), (3, Write), (4, Write)]);
pub static ABSORB: Kernel =
    Kernel::new("absorb", OCCUPANCY, &[(0, Write), (2, Parameters), (3, Write), (5, Read), (6, Write)]);
pub static SUM_DENSITIES: Kernel =
    Kernel::new("sum_densities", OCCUPANCY, &[(2, Parameters), (6, Write), (7, Write)]);
pub static SETTLE: Kernel = Kernel::new("settle", OCCUPANCY, &[(0, Write), (2, Parameters), (7, Write)]);
pub static SET_BITS: Kernel =
    Kernel::new("set_bits", OCCUPANCY, &[(0, Write), (1, Write), (2, Parameters), (6, Write), (7, Write)]);
pub static FILL_IF_EMPTY: Kernel =
    Kernel::new("fill_if_empty", OCCUPANCY, &[(0, Write), (1, Write), (2, Parameters)]);
pub static SET_OUTER_BITS: Kernel =
    Kernel::new("set_outer_bits", OCCUPANCY, &[(0, Write), (1, Write), (2, Parameters)]);

/// What becomes of a product before it is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    /// Nothing.
    Store,
    /// Values below zero become zero.
    Relu,
    /// Zero where the mask is not above zero.
    Mask,
}

/// Columns of a tile in units of 16 for matrices of `n` columns.
pub fn tile(n: usize) -> u32 {
    (1..=4).rev().find(|t| n.is_multiple_of(16 * t)).unwrap_or(1) as u32
}

/// Cooperative matrices of a device: f16 factors, f32 sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Matrices {
    /// Rows and columns: 8 or 16.
    pub side: u32,
    /// Subgroups that a workgroup of [`COOPERATING`] invocations has at least.
    pub subgroups: u32,
}

/// Invocations of a workgroup that works on cooperative matrices.
pub const COOPERATING: u32 = 128;

/// Factor that keeps small gradients within f16; the largest that it leaves room for is 255.
pub const GRADIENT_SCALE: u32 = 256;

/// Floats of a block of rows in workgroup memory: 16 KiB of f16.
const BLOCK: usize = 8192;

impl Matrices {
    fn index(self) -> usize {
        usize::from(self.side == 16)
    }

    /// Matrices side by side for which a subgroup sums at once.
    fn across(self, n: usize) -> u32 {
        (1..=4).rev().find(|t| n.is_multiple_of((self.side * t) as usize)).unwrap_or(1)
    }

    /// Rows of a block of `k` columns: they divide the rows that arrays end with ([`crate::rows::BLOCK`]), so that no block
    /// reaches beyond its array.
    pub fn rows(self, k: usize) -> u32 {
        match BLOCK / k {
            64.. => 64,
            32.. => 32,
            _ => 16,
        }
    }

    /// Workgroups for each chunk of a weight gradient [k, n].
    pub fn tiles(self, k: usize, n: usize) -> u32 {
        (k as u32).div_ceil(self.side * self.subgroups) * (n as u32 / (self.side * self.across(n)))
    }
}

const PLAIN: &[(u32, Access)] = &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read)];
const MASKED: &[(u32, Access)] = &[(0, Read), (1, Read), (2, Parameters), (3, Write), (4, Read), (5, Read)];
const SUMMED: &[(u32, Access)] = &[(0, Read), (1, Read), (2, Parameters), (3, Write), (4, Read)];
// The same, and where overflows are counted.
const PLAIN_HALF: &[(u32, Access)] =
    &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read), (6, Write)];
const MASKED_HALF: &[(u32, Access)] =
    &[(0, Read), (1, Read), (2, Parameters), (3, Write), (4, Read), (5, Read), (6, Write)];
const SUMMED_HALF: &[(u32, Access)] =
    &[(0, Read), (1, Read), (2, Parameters), (3, Write), (4, Read), (6, Write)];

/// Product of [rows, k] and [k, n], in f32 or by cooperative `matrices`; these take the left factor times `scale` and have
/// one more binding, the count of overflows.
pub fn multiply(k: usize, n: usize, finish: Finish, matrices: Option<Matrices>, scale: u32) -> Kernel {
    let bindings = match (finish == Finish::Mask, matrices.is_some()) {
        (false, false) => PLAIN,
        (true, false) => MASKED,
        (false, true) => PLAIN_HALF,
        (true, true) => MASKED_HALF,
    };
    let mut constants = vec![("K", k as u32), ("N", n as u32)];
    match matrices {
        None => {
            constants.push(("TN", tile(n)));
            Kernel::new("multiply", MULTIPLY[finish as usize], bindings).with(&constants)
        }
        Some(matrices) => {
            constants.extend([("TN", matrices.across(n)), ("ROWS", matrices.rows(k)), ("SCALE", scale)]);
            let files = MULTIPLY_COOPERATIVE[matrices.index()][finish as usize];
            Kernel::new("multiply", files, bindings).cooperative().with(&constants)
        }
    }
}

/// Weight gradient [k, n] in `chunks` parts, in f32 or by cooperative `matrices`; these leave it times [`GRADIENT_SCALE`]
/// and have one more binding, the count of overflows.
pub fn accumulate(k: usize, n: usize, chunks: u32, matrices: Option<Matrices>) -> Kernel {
    let mut constants = vec![("K", k as u32), ("N", n as u32), ("CHUNKS", chunks)];
    match matrices {
        None => {
            constants.extend([("TK", tile(k)), ("TN", tile(n))]);
            Kernel::new("accumulate", ACCUMULATE, SUMMED).with(&constants)
        }
        Some(matrices) => {
            let (across, subgroups) = (matrices.across(n), matrices.subgroups);
            constants.extend([("TN", across), ("SUBGROUPS", subgroups), ("SCALE", GRADIENT_SCALE)]);
            let files = ACCUMULATE_COOPERATIVE[matrices.index()];
            Kernel::new("accumulate", files, SUMMED_HALF).cooperative().with(&constants)
        }
    }
}

/// How texel gradients are added up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Addition {
    /// Fixed point of 64 bits: the same bits every time.
    Fixed,
    /// Atomic additions of f32, where the device has them: half the memory.
    Atomic,
    /// Compare and exchange of f32, which every device has: half the memory.
    Exchange,
}

const SCATTER_FLOATS: &[(u32, Access)] =
    &[(0, Read), (1, Read), (2, Parameters), (3, Write), (4, Write), (5, Read)];

/// Texel gradients of feature gradients.
pub fn scatter(addition: Addition) -> Kernel {
    match addition {
        Addition::Fixed => Kernel::new(
            "scatter",
            SCATTER_FIXED,
            &[
                (0, Read),
                (1, Read),
                (2, Parameters),
                (3, Write),
                (4, Write),
                (5, Read),
                (6, Write),
                (7, Write),
                (8, Write),
            ],
        ),
        Addition::Atomic => Kernel::new("scatter", SCATTER_ATOMIC, SCATTER_FLOATS),
        Addition::Exchange => Kernel::new("scatter", SCATTER_EXCHANGE, SCATTER_FLOATS),
    }
}

/// Gradients from a coarse level to a fine one.
pub fn pull(addition: Addition) -> Kernel {
    match addition {
        Addition::Fixed => {
            Kernel::new("pull", PULL_FIXED, &[(0, Write), (1, Write), (2, Parameters), (3, Write)])
        }
        Addition::Atomic | Addition::Exchange => {
            Kernel::new("pull", PULL_FLOAT, &[(0, Write), (1, Write), (2, Parameters)])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every kernel in every variant that a configuration can ask for, or one like it.
    fn all() -> Vec<Kernel> {
        let fixed = [
            &ARGUMENTS,
            &PEAK,
            &CAMERA_RAYS,
            &TRAINING_RAYS,
            &MARCHING,
            &PLACING,
            &SUM_BLOCKS,
            &SUM_ALL,
            &START_SEGMENTS,
            &ENCODING,
            &AVERAGE,
            &PACK,
            &PACK_HALF,
            &REDUCE,
            &DENSITIES,
            &COLOR_INPUTS,
            &COLORS,
            &COLOR_GRADIENTS,
            &DENSITY_GRADIENT,
            &SEE,
            &LIST,
            &GATHERING,
            &COMPOSITING_RAYS,
            &COMPOSITING_GRADIENT,
            &EVALUATE,
            &ADD_UP,
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
                    kernels.push(accumulate(k, n, 64, matrices));
                }
            }
        }
        let additions = [Addition::Fixed, Addition::Atomic, Addition::Exchange];
        kernels.extend(additions.into_iter().flat_map(|a| [scatter(a), pull(a)]));
        kernels
    }

    /// Cooperative stores write whole blocks of rows: arrays have to end with one.
    #[test]
    fn arrays_end_with_whole_blocks() {
        let matrices = Matrices { side: 16, subgroups: 4 };
        for k in (16..=512).step_by(16) {
            let rows = matrices.rows(k) as usize;
            assert!(crate::rows::BLOCK.is_multiple_of(rows) && rows.is_multiple_of(16), "{k}");
            assert!(rows * k <= BLOCK, "{k}: workgroup memory");
        }
    }

    #[test]
    fn every_variant_is_valid_and_fits_everywhere() {
        for kernel in all() {
            let name = kernel.key();
            let module = naga::front::wgsl::parse_str(&kernel.source())
                .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(&kernel.source())));
            // Asked for where the adapter has it, and then alone.
            use naga::valid::Capabilities;
            let capabilities = match &kernel {
                kernel if *kernel == scatter(Addition::Atomic) => Capabilities::SHADER_FLOAT32_ATOMIC,
                kernel if kernel.enables.is_empty() => Capabilities::default(),
                _ => Capabilities::SHADER_FLOAT16 | Capabilities::COOPERATIVE_MATRIX | Capabilities::SUBGROUP,
            };
            let info = naga::valid::Validator::new(naga::valid::ValidationFlags::all(), capabilities)
                .validate(&module)
                .unwrap_or_else(|error| panic!("{name}: {}", error.emit_to_string(&kernel.source())));
            let place = module.entry_points.iter().position(|entry| entry.name == kernel.entry);
            let place = place.unwrap_or_else(|| panic!("{name}: no such entry point"));
            assert!(module.entry_points[place].workgroup_size[0] <= 256, "{name}");

            // The bindings listed are those the entry point uses, with the access that they are declared with.
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

    #[test]
    fn tiles_divide_their_matrices() {
        for n in (16..=512).step_by(16) {
            assert_eq!(n % (16 * tile(n) as usize), 0, "{n}");
        }
    }
}
