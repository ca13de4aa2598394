//! The contraction of mip-NeRF 360 (Barron et al. 2022, Eq. 10): a ball of space stays uncontracted, and all of space beyond
//! it is contracted into a shell around the ball, up to twice the ball's radius. Ray marching takes steps that are about
//! equally long in contracted space. Letters: u = position relative to the ball's centre, n = |u|, b = least n along a ray,
//! all in radii.

use crate::math::scalar::Real;

/// Distance from the ball's centre, in radii, at which rays end. In contracted space this is a thousandth of the radius
/// from infinity.
pub const FARTHEST: f64 = 1000.0;

/// Upper bound of the length of a ray in contracted space, per unit of the ray's parameter. The supremum is √5, which a ray
/// that grazes the ball approaches far away.
pub const STRETCH: f64 = 2.2361;

/// The ball of space that stays uncontracted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball<R> {
    /// Centre, world units.
    pub centre: [R; 3],
    /// Radius, world units.
    pub radius: R,
}

impl<R: Real> Ball<R> {
    /// Maps a point of the world to contracted space, both in world units. A point within the ball stays unchanged; others
    /// become centre + radius · (2 − 1/n) · u/n.
    #[inline(always)]
    pub fn contract(&self, point: [R; 3]) -> [R; 3] {
        let u = self.relative(point);
        let n = length(u);
        let factor = if n > R::one() { (two::<R>() - n.recip()) / n } else { R::one() };
        std::array::from_fn(|i| self.centre[i] + self.radius * factor * u[i])
    }

    /// Returns the point of the world that [`contract`](Self::contract) maps to `place`. A place to which no point within
    /// [`FARTHEST`] is mapped is first moved towards the centre.
    #[inline]
    pub fn expand(&self, place: [R; 3]) -> [R; 3] {
        let v = self.relative(place);
        let m = length(v);
        if !(m > R::one()) {
            return place;
        }
        let n = (two::<R>() - m).max(R::from_f64(1.0 / FARTHEST)).recip();
        std::array::from_fn(|i| self.centre[i] + self.radius * n / m * v[i])
    }

    /// Returns the factor by which the contraction shortens lengths perpendicular to the line to the centre: (2n − 1)/n², or
    /// 1 within the ball. It is the largest singular value of the map's Jacobian.
    #[inline(always)]
    pub fn lateral(&self, point: [R; 3]) -> R {
        let n = length(self.relative(point)).max(R::one());
        (two::<R>() * n - R::one()) / (n * n)
    }

    /// Returns the factor by which the contraction shortens lengths along the line to the centre: 1/n², or 1 within the
    /// ball.
    #[inline(always)]
    pub fn radial(&self, point: [R; 3]) -> R {
        let n = length(self.relative(point)).max(R::one());
        (n * n).recip()
    }

    /// Returns the map between the distance along a ray and the parameter in which its marching steps are uniform.
    #[inline]
    pub fn parameterisation(&self, origin: [R; 3], direction: [R; 3]) -> Curve<R> {
        let u = self.relative(origin);
        let middle = -(u[0] * direction[0] + u[1] * direction[1] + u[2] * direction[2]);
        let b = length(std::array::from_fn(|i| u[i] + middle * direction[i]));
        let reach = b.max(R::one());
        let farthest = R::from_f64(FARTHEST);
        let half = (farthest * farthest - b * b).max(R::zero()).sqrt();
        Curve {
            middle: self.radius * middle,
            reach: self.radius * reach,
            speed: (two::<R>() * reach - R::one()) / (reach * reach),
            leave: self.radius * (middle + half),
        }
    }

    #[inline(always)]
    fn relative(&self, point: [R; 3]) -> [R; 3] {
        let inverse = self.radius.recip();
        std::array::from_fn(|i| (point[i] - self.centre[i]) * inverse)
    }
}

/// A ray in contracted space. Near the ball its parameter s is proportional to the distance t, and far away s converges: s
/// = speed · reach · c((t − middle)/reach), with the contraction c(m) = m for |m| ≤ 1 and ±2 − 1/m otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curve<R> {
    /// Distance t at which the ray is nearest to the ball's centre.
    middle: R,
    /// Distance from `middle` up to which s is proportional to t: the ball's radius, or b radii for a ray that misses the
    /// ball.
    reach: R,
    /// ds/dt within `reach`: the lateral factor at the ray's point nearest to the ball's centre.
    speed: R,
    /// Distance t at which the ray ends.
    leave: R,
}

impl<R: Real> Curve<R> {
    /// Returns the parameters between which the ray can have samples; enter ≥ leave if it can have none.
    #[inline]
    pub fn range(&self) -> (R, R) {
        (self.parameter(R::zero()), self.parameter(self.leave))
    }

    /// Returns s at distance t.
    #[inline(always)]
    pub fn parameter(&self, t: R) -> R {
        let m = (t - self.middle) / self.reach;
        let size = m.abs();
        let contracted = if size > R::one() { (two::<R>() - size.recip()).copysign(m) } else { m };
        self.speed * self.reach * contracted
    }

    /// Returns the distance t at parameter s.
    #[inline(always)]
    pub fn distance(&self, s: R) -> R {
        let c = s / (self.speed * self.reach);
        let size = c.abs();
        let m = if size > R::one() { (two::<R>() - size).recip().copysign(c) } else { c };
        self.middle + self.reach * m
    }

    /// Returns dt/ds at distance t.
    #[inline(always)]
    pub fn slowness(&self, t: R) -> R {
        let m = ((t - self.middle) / self.reach).abs().max(R::one());
        m * m / self.speed
    }
}

#[inline(always)]
fn length<R: Real>([x, y, z]: [R; 3]) -> R {
    (x * x + y * y + z * z).sqrt()
}

#[inline(always)]
fn two<R: Real>() -> R {
    R::one() + R::one()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat3, DVec3};

    const BALL: Ball<f64> = Ball { centre: [0.3, -0.2, 0.1], radius: 2.5 };

    /// Returns points in all directions, from the centre to far away.
    fn points() -> impl Iterator<Item = DVec3> {
        (0..4000).map(|i| {
            let turn = 2.399_963 * f64::from(i);
            let height = 1.0 - 2.0 * (f64::from(i) + 0.5) / 4000.0;
            let flat = (1.0 - height * height).sqrt();
            let n = 10_f64.powf(f64::from(i * 37 % 1000) / 200.0 - 2.0);
            DVec3::from_array(BALL.centre)
                + BALL.radius * n * DVec3::new(flat * turn.cos(), flat * turn.sin(), height)
        })
    }

    fn relative(point: DVec3) -> DVec3 {
        (point - DVec3::from_array(BALL.centre)) / BALL.radius
    }

    #[test]
    fn the_paper_s_equation_and_its_inverse() {
        for point in points() {
            let u = relative(point);
            let literal = if u.length() <= 1.0 { u } else { (2.0 - 1.0 / u.length()) * (u / u.length()) };
            let place = DVec3::from_array(BALL.contract(point.to_array()));
            assert!((relative(place) - literal).length() < 1e-14);
            assert!(relative(place).length() < 2.0);
            let back = DVec3::from_array(BALL.expand(place.to_array()));
            assert!((back - point).length() < 1e-9 * u.length().max(1.0) * u.length().max(1.0), "{point}");
        }
        // The corners of the cube, which no point maps to, stay finite.
        let corner = BALL.centre.map(|x| x + 2.0 * BALL.radius);
        let far = relative(DVec3::from_array(BALL.expand(corner))).length();
        assert!((far - FARTHEST).abs() < 1e-6, "{far}");
    }

    /// Checks that the lateral factor is the largest singular value of the Jacobian (central differences), and the radial
    /// factor the smallest.
    #[test]
    fn factors_are_those_of_the_jacobian() {
        for point in points().filter(|point| relative(*point).length() < 50.0) {
            let h = 1e-5 * relative(point).length().max(1.0);
            let column = |axis: DVec3| {
                let at = |by: f64| DVec3::from_array(BALL.contract((point + by * axis).to_array()));
                (at(h) - at(-h)) / (2.0 * h)
            };
            let out = relative(point).normalize();
            let across = out.any_orthonormal_vector();
            let near = |found: f64, expected: f64| (found - expected).abs() < 2e-5;
            if (relative(point).length() - 1.0).abs() > 1e-3 {
                assert!(near(column(out).length(), BALL.radial(point.to_array())), "{point}");
                assert!(near(column(across).length(), BALL.lateral(point.to_array())), "{point}");
            }
            let jacobian = DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z));
            let most = [out, across, out.cross(across), (out + across).normalize()]
                .map(|direction| (jacobian * direction).length())
                .into_iter()
                .fold(0.0, f64::max);
            assert!(most <= BALL.lateral(point.to_array()) + 2e-5);
        }
    }

    fn rays() -> impl Iterator<Item = (DVec3, DVec3)> {
        let directions: Vec<DVec3> = points().map(|point| relative(point).normalize()).collect();
        points()
            .enumerate()
            .filter(|(_, point)| relative(*point).length() < 30.0)
            .map(move |(i, origin)| (origin, directions[(i * 1409 + 3) % directions.len()]))
    }

    #[test]
    fn parameters_and_distances_are_inverse_and_rays_end_far_away() {
        for (origin, direction) in rays() {
            let curve = BALL.parameterisation(origin.to_array(), direction.to_array());
            let (enter, leave) = curve.range();
            assert!(enter < leave);
            assert!(curve.distance(enter).abs() < 1e-9 * (1.0 + relative(origin).length().powi(2)));
            let end = relative(origin + curve.distance(leave) * direction).length();
            assert!((end - FARTHEST).abs() < 1e-3, "{end}");
            let steps = 200;
            for i in 0..steps {
                let s = enter + (leave - enter) * (f64::from(i) + 0.5) / f64::from(steps);
                let t = curve.distance(s);
                assert!((curve.parameter(t) - s).abs() < 1e-9);
                let h = 1e-6 * (leave - enter);
                let slowness = (curve.distance(s + h) - curve.distance(s - h)) / (2.0 * h);
                assert!((slowness / curve.slowness(t) - 1.0).abs() < 1e-2, "{s}: {slowness}");
            }
        }
    }

    /// Checks that between two parameters a ray moves at most [`STRETCH`] times their difference in contracted space, and
    /// that this bound is nearly reached.
    #[test]
    fn a_ray_moves_no_faster_than_the_bound() {
        let mut most = 0.0_f64;
        for (origin, direction) in rays() {
            let curve = BALL.parameterisation(origin.to_array(), direction.to_array());
            let (enter, leave) = curve.range();
            let place = |s: f64| {
                DVec3::from_array(BALL.contract((origin + curve.distance(s) * direction).to_array()))
            };
            let step = (leave - enter) / 400.0;
            for i in 0..400 {
                let s = enter + f64::from(i) * step;
                most = most.max((place(s + step) - place(s)).length() / step);
            }
        }
        assert!(most <= STRETCH && most > 0.9 * STRETCH, "{most}");
    }
}
