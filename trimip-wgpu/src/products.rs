//! Kernels of matrix products, in f32 or with cooperative f16 matrices, and the sizes of their tiles and blocks of
//! rows.

use crate::gpu::Access::{self, Parameters, Read, Write};
use crate::gpu::Source::{self, Parts, Text};
use crate::gpu::{COOPERATING, Kernel, Matrices, Rows, Size};
use crate::shaders::HALF;

shared! {
    /// Parameters of a product.
    pub struct Counter as Params {
        /// Index of the counter that holds the number of rows: counts[counter].
        pub counter: u32,
    }
}

/// Number of invocations of a workgroup in products in f32.
const THREADS: u32 = 256;

const PLAIN: Source = Parts(&[
    Source::of::<Counter>(),
    Source::whole("THREADS", THREADS),
    Source::whole("ROWS", TILE_ROWS),
    Text(include_str!("shaders/multiply.wgsl")),
]);
const ACCUMULATE: Source = Parts(&[
    Source::of::<Counter>(),
    Source::whole("THREADS", THREADS),
    Text(include_str!("shaders/accumulate.wgsl")),
]);
const COOPERATIVE: Source =
    Parts(&[HALF, Source::of::<Counter>(), Source::whole("COOPERATING", COOPERATING)]);
const MULTIPLY_COOPERATIVE: Source =
    Parts(&[COOPERATIVE, Text(include_str!("shaders/multiply_cooperative.wgsl"))]);
const ACCUMULATE_COOPERATIVE: Source =
    Parts(&[COOPERATIVE, Text(include_str!("shaders/accumulate_cooperative.wgsl"))]);

/// Operation on a product before it is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    /// No operation.
    Store,
    /// ReLU: values below zero become zero.
    Relu,
    /// Derivative of a ReLU: values become zero where the mask is not above zero.
    Mask,
    /// Adds the product to the stored value; f32 only.
    Add,
    /// Adds the product to the stored value, then applies a ReLU; f32 only.
    AddRelu,
}

impl Finish {
    fn source(self) -> Source {
        Text(match self {
            Self::Store => include_str!("shaders/finish_store.wgsl"),
            Self::Relu => include_str!("shaders/finish_relu.wgsl"),
            Self::Mask => include_str!("shaders/finish_mask.wgsl"),
            Self::Add => include_str!("shaders/finish_add.wgsl"),
            Self::AddRelu => include_str!("shaders/finish_add_relu.wgsl"),
        })
    }

    /// Returns the bindings of this operation, in addition to those of a product.
    fn bindings(self) -> &'static [(u32, Access)] {
        if self == Self::Mask { &[(4, Read)] } else { &[] }
    }
}

/// Number of rows per tile of a product in f32.
const TILE_ROWS: u32 = 64;

/// Returns the padded width of a matrix on the device.
pub fn padded(width: usize) -> usize {
    width.next_multiple_of(16)
}

/// Returns the number of columns of a tile, in units of 16, for a matrix of `n` columns.
pub fn tile(n: usize) -> u32 {
    (1..=4).rev().find(|t| n.is_multiple_of(16 * t)).unwrap_or(1) as u32
}

/// Factor that keeps small gradients within the range of f16; it leaves room for gradients up to 255.
pub const GRADIENT_SCALE: u32 = 256;

/// Number of values of a block of rows in workgroup memory: 16 KiB of f16.
const BLOCK: usize = 8192;

impl Matrices {
    /// Returns the WGSL of the matrix types.
    fn source(self) -> Source {
        Text(match self.side {
            16 => include_str!("shaders/cooperative_16.wgsl"),
            _ => include_str!("shaders/cooperative_8.wgsl"),
        })
    }

    /// Returns the number of adjacent matrices that a subgroup sums at once.
    fn across(self, n: usize) -> u32 {
        (1..=4).rev().find(|t| n.is_multiple_of((self.side * t) as usize)).unwrap_or(1)
    }

    /// Returns the number of rows of a block of `k` columns. It divides [`crate::gpu::BLOCK`], to which arrays are
    /// padded, so that no block exceeds its array.
    pub fn rows(self, k: usize) -> u32 {
        match BLOCK / k {
            64.. => 64,
            32.. => 32,
            _ => 16,
        }
    }

    /// Returns the number of workgroups per chunk of a weight gradient [k, n].
    pub fn tiles(self, k: usize, n: usize) -> u32 {
        (k as u32).div_ceil(self.side * self.subgroups) * (n as u32 / (self.side * self.across(n)))
    }
}

/// The binding of the counter of overflows.
const OVERFLOWS: &[(u32, Access)] = &[(6, Write)];

/// Returns the kernel of the product of [rows, k] and [k, n], in f32 or with cooperative `matrices`. A kernel with
/// `matrices` multiplies the left factor by `scale` and has one more binding, the counter of overflows.
pub fn multiply(k: usize, n: usize, finish: Finish, matrices: Option<Matrices>, scale: u32) -> Kernel {
    let bindings = &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read)];
    let shape = [("K", k as u32), ("N", n as u32)];
    let kernel = match matrices {
        None => Kernel::new("multiply", &[PLAIN], bindings).with(&shape).with(&[("TN", tile(n))]),
        Some(matrices) => Kernel::new("multiply", &[MULTIPLY_COOPERATIVE, matrices.source()], bindings)
            .and(&[], OVERFLOWS)
            .cooperative()
            .with(&shape)
            .with(&[("TN", matrices.across(n)), ("ROWS", matrices.rows(k)), ("SCALE", scale)]),
    };
    kernel.and(&[finish.source()], finish.bindings())
}

/// Returns the size of a dispatch of the product of [rows, k] and [k, n].
pub fn multiplying(rows: &Rows, k: usize, n: usize, matrices: Option<Matrices>) -> Size<'_> {
    match matrices {
        None => rows.tiles(TILE_ROWS, n as u32 / (16 * tile(n))),
        Some(matrices) => rows.tiles(matrices.rows(k), 1),
    }
}

/// Returns the kernel of the weight gradient [k, n] in `chunks` parts, in f32 or with cooperative `matrices`. The
/// result of a kernel with `matrices` is multiplied by [`GRADIENT_SCALE`], and the kernel has one more binding, the
/// counter of overflows.
pub fn accumulate(k: usize, n: usize, chunks: u32, matrices: Option<Matrices>) -> Kernel {
    let bindings = &[(0, Read), (1, Read), (2, Parameters), (3, Write), (4, Read)];
    let shape = [("K", k as u32), ("N", n as u32), ("CHUNKS", chunks)];
    match matrices {
        None => {
            let tiles = [("TK", tile(k)), ("TN", tile(n))];
            Kernel::new("accumulate", &[ACCUMULATE], bindings).with(&shape).with(&tiles)
        }
        Some(matrices) => {
            let (across, subgroups) = (matrices.across(n), matrices.subgroups);
            Kernel::new("accumulate", &[ACCUMULATE_COOPERATIVE, matrices.source()], bindings)
                .and(&[], OVERFLOWS)
                .cooperative()
                .with(&shape)
                .with(&[("TN", across), ("SUBGROUPS", subgroups), ("SCALE", GRADIENT_SCALE)])
        }
    }
}

/// Returns all products and weight gradients that a configuration can select, or similar ones, for validation.
#[cfg(test)]
pub fn all() -> Vec<Kernel> {
    let sizes = [(8, 16), (16, 4), (16, 1)];
    let matrices = sizes.map(|(side, subgroups)| Some(Matrices { side, subgroups }));
    let mut kernels = Vec::new();
    for hidden in [16, 32, 48, 80, 128, 144, 160, 512] {
        for (k, n) in [(48, hidden), (hidden, 16), (32, hidden), (hidden, hidden), (16, hidden)] {
            for matrices in matrices.into_iter().chain([None]) {
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
    kernels
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that arrays end with a whole block of rows, because cooperative stores write whole blocks.
    #[test]
    fn arrays_end_with_whole_blocks() {
        let matrices = Matrices { side: 16, subgroups: 4 };
        for k in (16..=512).step_by(16) {
            let rows = matrices.rows(k) as usize;
            assert!(crate::gpu::BLOCK.is_multiple_of(rows) && rows.is_multiple_of(16), "{k}");
            assert!(rows * k <= BLOCK, "{k}: workgroup memory");
        }
    }

    #[test]
    fn tiles_divide_their_matrices() {
        for n in (16..=512).step_by(16) {
            assert_eq!(n % (16 * tile(n) as usize), 0, "{n}");
        }
    }
}
