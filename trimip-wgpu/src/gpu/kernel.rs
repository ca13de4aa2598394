//! Kernels: a kernel has an entry point in WGSL, the parts of its source, and the bindings that it uses. A stage declares
//! its kernels in its own file with `kernels!`.

use super::shared::Layout;
use super::source::Source;

/// Workgroup size of the kernels with one invocation per item; every kernel has it as the constant `GROUP`.
pub const GROUP: u32 = 64;

/// Shader source: computes the index of an invocation.
pub const GRID: Source = Source::Text(include_str!("shaders/grid.wgsl"));

/// Access of a kernel to a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Reads values.
    Read,
    /// Reads and writes values.
    Write,
    /// The dispatch's own parameters.
    Parameters,
}

/// A compute kernel.
#[derive(Clone, Debug, PartialEq)]
pub struct Kernel {
    /// Name of the entry point.
    pub entry: &'static str,
    /// Parts of the WGSL source, in order.
    sources: Vec<Source>,
    /// True for kernels with f16 and cooperative matrices.
    cooperative: bool,
    /// Constants of this variant.
    constants: Vec<(&'static str, u32)>,
    /// Binding numbers and their access, in order.
    bindings: Vec<(u32, Access)>,
}

impl Kernel {
    /// Creates the kernel with the entry point `entry`.
    pub fn new(entry: &'static str, sources: &[Source], bindings: &[(u32, Access)]) -> Self {
        let mut kernel = Self {
            entry,
            sources: Vec::new(),
            cooperative: false,
            constants: Vec::new(),
            bindings: bindings.to_vec(),
        };
        sources.iter().for_each(|source| source.flatten(&mut kernel.sources));
        kernel
    }

    /// Enables f16 and cooperative matrices.
    pub fn cooperative(mut self) -> Self {
        self.cooperative = true;
        self
    }

    /// Adds constants.
    pub fn with(mut self, constants: &[(&'static str, u32)]) -> Self {
        self.constants.extend_from_slice(constants);
        self
    }

    /// Adds parts and bindings.
    pub fn and(mut self, sources: &[Source], bindings: &[(u32, Access)]) -> Self {
        sources.iter().for_each(|source| source.flatten(&mut self.sources));
        self.bindings.extend_from_slice(bindings);
        self.bindings.sort_by_key(|(binding, _)| *binding);
        self
    }

    /// Returns the binding numbers and their access, in order.
    pub fn bindings(&self) -> &[(u32, Access)] {
        &self.bindings
    }

    /// Iterates over the structs that the kernel shares with Rust.
    pub fn layouts(&self) -> impl Iterator<Item = &'static Layout> {
        self.sources.iter().filter_map(|source| match source {
            Source::Struct(layout) => Some(*layout),
            _ => None,
        })
    }

    /// Returns the complete WGSL source.
    pub fn source(&self) -> String {
        let enables = if self.cooperative { "enable f16;\nenable wgpu_cooperative_matrix;\n" } else { "" };
        let constants = self.constants.iter().copied().chain([("GROUP", GROUP)]);
        let constants = constants.map(|(name, value)| Source::whole(name, value));
        let parts = constants.chain(self.sources.iter().copied()).map(|source| source.text() + "\n");
        enables.to_string() + &parts.collect::<String>()
    }
}

#[cfg(test)]
impl Kernel {
    /// Returns true for kernels with f16 and cooperative matrices.
    pub fn is_cooperative(&self) -> bool {
        self.cooperative
    }

    /// Returns true if `source` is among the parts.
    pub fn has(&self, source: Source) -> bool {
        self.sources.contains(&source)
    }

    /// Returns the entry point and the constants.
    pub fn name(&self) -> String {
        format!("{} {:?}", self.entry, self.constants)
    }
}
