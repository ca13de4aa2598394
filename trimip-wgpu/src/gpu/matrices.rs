//! Cooperative matrices of an adapter: the properties that the kernels of matrix products need.

/// Cooperative matrices of a device, with f16 factors and f32 sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Matrices {
    /// Number of rows and columns: 8 or 16.
    pub side: u32,
    /// Minimum number of subgroups in a workgroup of [`COOPERATING`] invocations.
    pub subgroups: u32,
}

/// Workgroup size of the kernels that use cooperative matrices.
pub const COOPERATING: u32 = 128;

/// The features that cooperative matrices need.
pub const COOPERATION: wgpu::Features = wgpu::Features::SHADER_F16
    .union(wgpu::Features::SUBGROUP)
    .union(wgpu::Features::EXPERIMENTAL_COOPERATIVE_MATRIX);

impl Matrices {
    /// Returns the largest matrices of an adapter that the kernels support: square matrices of side 8 or 16, with f16
    /// factors and f32 sums.
    pub fn of(adapter: &wgpu::Adapter) -> Option<Self> {
        use wgpu::CooperativeScalarType::{F16, F32};
        if !adapter.features().contains(COOPERATION) {
            return None;
        }
        let fits = |p: &wgpu::CooperativeMatrixProperties| {
            [p.n_size, p.k_size] == [p.m_size; 2]
                && matches!(p.m_size, 8 | 16)
                && (p.ab_type, p.cr_type) == (F16, F32)
        };
        let properties = adapter.cooperative_matrix_properties();
        let side = properties.iter().filter(|p| fits(p)).map(|p| p.m_size).max()?;
        let largest = adapter.get_info().subgroup_max_size.clamp(1, COOPERATING);
        Some(Self { side, subgroups: COOPERATING / largest })
    }
}
