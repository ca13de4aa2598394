//! Unit vectors perpendicular to a direction.

use crate::math::scalar::Real;

/// Returns two unit vectors that are orthogonal to a unit vector and to each other (Duff et al. 2017).
#[inline(always)]
pub fn across<R: Real>([x, y, z]: [R; 3]) -> [[R; 3]; 2] {
    let sign = if z < R::zero() { -R::one() } else { R::one() };
    let a = -(sign + z).recip();
    let b = x * y * a;
    [[R::one() + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y]]
}
