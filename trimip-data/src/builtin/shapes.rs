//! Solids with exact ray intersections: an ellipsoid, a capped upright cylinder and a capsule. Lengths are in world units.

use glam::DVec3;

/// Least distance of a hit: closer hits are on the surface that the ray starts from.
const SELF_HIT: f64 = 1e-9;

/// A solid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// Points whose offset from `center`, divided by `radii`, is shorter than 1.
    Ellipsoid {
        /// Its centre.
        center: DVec3,
        /// Half axes along x, y, z.
        radii: DVec3,
    },
    /// An upright cylinder with flat ends.
    Drum {
        /// Its centre.
        center: DVec3,
        /// Radius of its circle.
        radius: f64,
        /// Half its extent along z.
        half_height: f64,
    },
    /// Points nearer than `radius` to the segment from `start` to `end`.
    Capsule {
        /// One end of the segment.
        start: DVec3,
        /// The other end.
        end: DVec3,
        /// Its radius.
        radius: f64,
    },
}

impl Shape {
    /// Returns the distance along the unit vector `direction` at which a ray from outside enters the solid.
    pub fn hit(&self, origin: DVec3, direction: DVec3) -> Option<f64> {
        match *self {
            Self::Ellipsoid { center, radii } => {
                let (o, d) = ((origin - center) / radii, direction / radii);
                entry(d.length_squared(), o.dot(d), o.length_squared() - 1.0)
            }
            Self::Drum { center, radius, half_height } => {
                let o = origin - center;
                let side = entry(
                    direction.truncate().length_squared(),
                    o.truncate().dot(direction.truncate()),
                    o.truncate().length_squared() - radius * radius,
                )
                .filter(|t| (o.z + t * direction.z).abs() <= half_height);
                // Only the end that faces the ray can be hit; a horizontal ray hits neither end (t is not finite).
                let t = (-half_height.copysign(direction.z) - o.z) / direction.z;
                let end = Some(t).filter(|&t| {
                    t > SELF_HIT && (o + t * direction).truncate().length_squared() <= radius * radius
                });
                nearest(side, end)
            }
            Self::Capsule { start, end, radius } => {
                let (axis, o) = (end - start, origin - start);
                let (length, along) = (axis.length_squared(), axis.dot(direction));
                // The quadratic for the infinite cylinder: the components along the axis are removed, and all terms are
                // multiplied by |axis|².
                let a = length - along * along;
                let b = length * o.dot(direction) - axis.dot(o) * along;
                let c = length * (o.length_squared() - radius * radius) - axis.dot(o).powi(2);
                // The balls at the ends lie within the infinite cylinder, so a ray that misses the cylinder misses the
                // capsule. This test is impossible for a ray along the axis, where a = 0.
                if a > 1e-9 * length && b * b < a * c {
                    return None;
                }
                let side = entry(a, b, c).filter(|t| (0.0..=length).contains(&(axis.dot(o) + t * along)));
                let ball = |center: DVec3| {
                    let o = origin - center;
                    entry(1.0, o.dot(direction), o.length_squared() - radius * radius)
                };
                nearest(side, nearest(ball(start), ball(end)))
            }
        }
    }

    /// Returns the unit outward normal at a point of the surface.
    pub fn normal(&self, point: DVec3) -> DVec3 {
        match *self {
            Self::Ellipsoid { center, radii } => ((point - center) / (radii * radii)).normalize_or_zero(),
            Self::Drum { center, radius, half_height } => {
                let p = point - center;
                // The smaller distance decides between wall and end; both are 0 where they meet.
                if (p.truncate().length() - radius).abs() < (p.z.abs() - half_height).abs() {
                    p.truncate().normalize_or_zero().extend(0.0)
                } else {
                    DVec3::Z * p.z.signum()
                }
            }
            Self::Capsule { start, end, .. } => (point - on_segment(start, end, point)).normalize_or_zero(),
        }
    }

    /// Returns a value that is negative inside, positive outside and zero on the surface; it is not a distance.
    pub fn implicit(&self, point: DVec3) -> f64 {
        match *self {
            Self::Ellipsoid { center, radii } => ((point - center) / radii).length() - 1.0,
            Self::Drum { center, radius, half_height } => {
                let p = point - center;
                (p.truncate().length() - radius).max(p.z.abs() - half_height)
            }
            Self::Capsule { start, end, radius } => point.distance(on_segment(start, end, point)) - radius,
        }
    }

    /// Returns false only if the shape is missed by every ray from `origin` whose angle to `direction` has a tangent of at most
    /// `spread`.
    pub fn near_line(&self, origin: DVec3, direction: DVec3, spread: f64) -> bool {
        let (start, end, radius) = self.bound();
        let farthest = start.distance(origin).max(end.distance(origin)) + radius;
        self.line_distance(origin, direction) <= 1.001 * spread * farthest
    }

    /// Returns a lower bound of the distance between the surface and a line; negative if the line may hit the shape.
    pub fn line_distance(&self, origin: DVec3, direction: DVec3) -> f64 {
        let (start, end, radius) = self.bound();
        // Projects the segment onto the plane perpendicular to the line, and finds its point nearest to the line.
        let across = |v: DVec3| v - direction * v.dot(direction);
        let (from, axis) = (across(start - origin), across(end - start));
        let fraction = (-from.dot(axis) / axis.length_squared().max(1e-300)).clamp(0.0, 1.0);
        (from + fraction * axis).length() - radius
    }

    /// Returns the ends and the radius of a capsule that contains the shape.
    fn bound(&self) -> (DVec3, DVec3, f64) {
        match *self {
            Self::Ellipsoid { center, radii } => (center, center, radii.max_element()),
            Self::Drum { center, radius, half_height } => {
                (center - half_height * DVec3::Z, center + half_height * DVec3::Z, radius)
            }
            Self::Capsule { start, end, radius } => (start, end, radius),
        }
    }
}

/// Returns the smaller root of a·t² + 2·b·t + c = 0, for a > 0, if it is above [`SELF_HIT`].
fn entry(a: f64, b: f64, c: f64) -> Option<f64> {
    let discriminant = b * b - a * c;
    // A NaN fails both comparisons.
    if discriminant >= 0.0 {
        let t = (-b - discriminant.sqrt()) / a;
        (t > SELF_HIT).then_some(t)
    } else {
        None
    }
}

fn nearest(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    match (a, b) {
        (Some(a), Some(b)) => Some(a.min(b)),
        (a, b) => a.or(b),
    }
}

/// Returns the point of a segment nearest to `point`.
fn on_segment(start: DVec3, end: DVec3, point: DVec3) -> DVec3 {
    let axis = end - start;
    start + axis * ((point - start).dot(axis) / axis.length_squared()).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector(range: f64) -> impl Strategy<Value = DVec3> {
        prop::array::uniform3(-range..range).prop_map(DVec3::from_array)
    }

    fn shape() -> impl Strategy<Value = Shape> {
        prop_oneof![
            (vector(0.5), prop::array::uniform3(0.05..0.8))
                .prop_map(|(center, radii)| Shape::Ellipsoid { center, radii: radii.into() }),
            (vector(0.5), 0.05..0.8, 0.02..0.6).prop_map(|(center, radius, half_height)| Shape::Drum {
                center,
                radius,
                half_height
            }),
            (vector(0.8), vector(0.8), 0.01..0.3)
                .prop_filter("a segment", |(start, end, _)| start.distance(*end) > 0.05)
                .prop_map(|(start, end, radius)| Shape::Capsule { start, end, radius }),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        /// Checks hits against brute force: the first change of sign of the implicit function along the ray.
        #[test]
        fn hits_are_where_the_implicit_function_changes_sign(
            shape in shape(), toward in vector(0.8), from in vector(1.0),
        ) {
            prop_assume!(from.length() > 0.1);
            let origin = from.normalize() * 4.0;
            let direction = (toward - origin).normalize();
            const STEP: f64 = 1e-3;
            let sampled = (0..7000).map(|i| f64::from(i) * STEP).find(|t| {
                shape.implicit(origin + *t * direction) < 0.0
            });
            let hit = shape.hit(origin, direction);
            match (hit, sampled) {
                (Some(hit), Some(sampled)) => {
                    // The solids are convex, so the ray enters less than a step before the first sample inside.
                    prop_assert!(hit <= sampled + 1e-9 && hit >= sampled - STEP - 1e-9, "{hit} {sampled}");
                }
                (None, Some(sampled)) => prop_assert!(false, "missed at {sampled}"),
                // The chord is too short to be sampled; only the checks below apply to the hit.
                (Some(_) | None, None) => {}
            }
            if let Some(hit) = hit {
                let point = origin + hit * direction;
                prop_assert!(shape.implicit(point).abs() < 1e-9);
                let normal = shape.normal(point);
                prop_assert!((normal.length() - 1.0).abs() < 1e-9 && normal.dot(direction) < 1e-6);
                prop_assert!(shape.implicit(point + 1e-4 * normal) > 0.0);
                prop_assert!(shape.near_line(origin, direction, 0.0));
            }
        }

        #[test]
        fn no_shape_is_left_out_that_a_ray_of_the_pixel_hits(
            shape in shape(), toward in vector(0.8), from in vector(1.0), aside in vector(0.02),
        ) {
            prop_assume!(from.length() > 0.1);
            let origin = from.normalize() * 3.0;
            let center = (toward - origin).normalize();
            let ray = (center + aside).normalize();
            let spread = ray.cross(center).length() / ray.dot(center);
            prop_assert!(shape.hit(origin, ray).is_none() || shape.near_line(origin, center, spread));
        }
    }

    #[test]
    fn rays_along_an_axis_have_no_division_to_fear() {
        let capsule = Shape::Capsule { start: DVec3::ZERO, end: DVec3::Z, radius: 0.25 };
        assert_eq!(capsule.hit(DVec3::new(0.0, 0.0, 3.0), -DVec3::Z), Some(1.75));
        assert_eq!(capsule.hit(DVec3::new(1.0, 0.0, 3.0), -DVec3::Z), None);
        let drum = Shape::Drum { center: DVec3::ZERO, radius: 0.5, half_height: 0.25 };
        assert_eq!(drum.hit(DVec3::new(0.0, 0.1, 3.0), -DVec3::Z), Some(2.75));
        assert_eq!(drum.hit(DVec3::new(2.0, 0.0, 0.0), -DVec3::X), Some(1.5));
        assert_eq!(drum.hit(DVec3::new(2.0, 0.0, 0.3), -DVec3::X), None);
    }
}
