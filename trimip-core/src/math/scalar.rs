//! The scalar type of the mathematics: f32 in production, f64 in references.

use num_traits::Float;

/// f32 or f64.
pub trait Real: Float + std::fmt::Debug + std::ops::AddAssign + Send + Sync + 'static {
    /// Rounds an f64.
    fn from_f64(value: f64) -> Self;
    /// Converts a count or an index; exact below 2^24.
    fn from_u32(value: u32) -> Self;
    /// Converts to f64.
    fn to_f64(self) -> f64;
}

impl Real for f32 {
    #[inline]
    fn from_f64(value: f64) -> Self {
        value as Self
    }
    #[inline]
    fn from_u32(value: u32) -> Self {
        value as Self
    }
    #[inline]
    fn to_f64(self) -> f64 {
        self.into()
    }
}

impl Real for f64 {
    #[inline]
    fn from_f64(value: f64) -> Self {
        value
    }
    #[inline]
    fn from_u32(value: u32) -> Self {
        value.into()
    }
    #[inline]
    fn to_f64(self) -> f64 {
        self
    }
}
