//! The objects and lights of the built-in scene: patterns finer than a pixel of a coarse scale, lines of text, pins
//! that are down to half a pixel wide, and a mirroring ball. Colours are image values in [0, 1].

use super::{Shape, paint::Paint};
use crate::settings::Finish;
use glam::DVec3;
use std::{f64::consts::TAU, sync::LazyLock};

/// Directions to the lights, and the strengths of the lights; only the first light casts shadows.
static LIGHTS: LazyLock<[(DVec3, f64); 2]> = LazyLock::new(|| {
    let light = |toward: [f64; 3], strength| (DVec3::from(toward).normalize(), strength);
    [light([0.55, -0.4, 0.85], 0.58), light([-0.7, 0.35, 0.4], 0.20)]
});
/// Ambient light from below, and the additional ambient light from above.
const AMBIENT: (f64, f64) = (0.32, 0.14);

const GROUND_TOP: f64 = -0.44;
/// Reflectance from which a surface reflects the other objects in addition to the environment.
const MIRROR: f64 = 0.5;

struct Object {
    shape: Shape,
    paint: Paint,
    /// Reflectance at normal incidence.
    mirror: f64,
    /// Strength and exponent of the specular highlight (Phong).
    highlight: (f64, i32),
}

static OBJECTS: LazyLock<Vec<Object>> = LazyLock::new(|| {
    let rgb = DVec3::new;
    let ball = |x, y, radius: f64| Shape::Ellipsoid {
        center: rgb(x, y, GROUND_TOP + radius),
        radii: DVec3::splat(radius),
    };
    let matt = |shape, paint| Object { shape, paint, mirror: 0.0, highlight: (0.0, 1) };
    let mut objects = vec![
        matt(
            Shape::Drum { center: rgb(0.0, 0.0, GROUND_TOP - 0.04), radius: 1.05, half_height: 0.04 },
            Paint::Checker(rgb(0.92, 0.90, 0.84), rgb(0.16, 0.20, 0.32), 0.075),
        ),
        Object {
            shape: ball(-0.42, -0.42, 0.32),
            paint: Paint::Rings(rgb(0.86, 0.20, 0.14), rgb(0.97, 0.95, 0.90), 0.08),
            mirror: 0.0,
            highlight: (0.25, 30),
        },
        matt(
            Shape::Drum { center: rgb(0.50, -0.42, GROUND_TOP + 0.42), radius: 0.26, half_height: 0.42 },
            Paint::Letters {
                ink: rgb(0.08, 0.24, 0.46),
                paper: rgb(1.0, 0.86, 0.40),
                radius: 0.26,
                top: GROUND_TOP + 0.84,
            },
        ),
        Object {
            shape: ball(0.42, 0.44, 0.36),
            paint: Paint::Plain(rgb(0.14, 0.14, 0.18)),
            mirror: MIRROR,
            highlight: (0.8, 60),
        },
        Object {
            shape: Shape::Ellipsoid {
                center: rgb(-0.48, 0.42, GROUND_TOP + 0.24),
                radii: rgb(0.36, 0.22, 0.24),
            },
            paint: Paint::Plain(rgb(0.20, 0.58, 0.28)),
            mirror: 0.08,
            highlight: (0.35, 18),
        },
    ];
    // A row of ever thinner pins: at 192 pixels the thinnest is half a pixel wide.
    let heads = [rgb(0.90, 0.22, 0.16), rgb(0.98, 0.76, 0.18), rgb(0.10, 0.58, 0.62)];
    for (i, head) in (0..9).zip(heads.into_iter().cycle()) {
        let turn = TAU * f64::from(i) / 9.0;
        // The golden ratio spreads the heights: pins of equal height would share a row of a feature plane.
        let height = 0.62 + 0.22 * (0.618_034 * f64::from(i)).fract();
        let tip = rgb(0.46 * (turn + 1.1).cos(), 0.46 * (turn + 1.1).sin(), height);
        objects.push(matt(
            Shape::Capsule {
                start: rgb(0.10 * turn.cos(), 0.10 * turn.sin(), GROUND_TOP),
                end: tip,
                radius: 0.024 * 0.8_f64.powi(i),
            },
            match i % 3 {
                0 => Paint::Helix(rgb(0.92, 0.92, 0.94), rgb(0.20, 0.45, 0.78), 1.0, 0.12),
                1 => Paint::Plain(rgb(0.62, 0.28, 0.60)),
                _ => Paint::Helix(rgb(0.12, 0.12, 0.12), rgb(0.95, 0.75, 0.30), 0.0, 0.1),
            },
        ));
        let head_shape = Shape::Ellipsoid { center: tip, radii: DVec3::splat(0.045 - 0.002 * f64::from(i)) };
        objects.push(Object {
            shape: head_shape,
            paint: Paint::Plain(head),
            mirror: 0.0,
            highlight: (0.35, 30),
        });
    }
    objects
});

/// Returns the solids of the scene.
pub fn shapes() -> impl Iterator<Item = Shape> {
    OBJECTS.iter().map(|object| object.shape)
}

/// Returns the colour seen along a ray, or `None` if the ray hits nothing; `origin` must lie outside every solid.
pub fn radiance(origin: DVec3, direction: DVec3) -> Option<[f64; 3]> {
    radiance_of(u32::MAX, origin, direction.try_normalize()?, Finish::Mixed).map(|color| color.to_array())
}

/// Returns a set of bits: bit i is set if object i may be hit by a ray whose angle to this ray has a tangent of at most `spread`.
pub(super) fn near_line(origin: DVec3, direction: DVec3, spread: f64) -> u32 {
    OBJECTS
        .iter()
        .enumerate()
        .fold(0, |near, (i, object)| near | u32::from(object.shape.near_line(origin, direction, spread)) << i)
}

/// Returns the objects whose bits are set.
fn members(mut bits: u32) -> impl Iterator<Item = &'static Object> {
    let objects = &*OBJECTS;
    std::iter::from_fn(move || {
        let index = bits.trailing_zeros() as usize;
        // Clears the lowest bit; none is left at index 32.
        bits &= bits.wrapping_sub(1);
        objects.get(index)
    })
}

/// Returns the [`radiance`] of only the objects in `near`; shadows are cast by all objects.
pub(super) fn radiance_of(near: u32, origin: DVec3, direction: DVec3, finish: Finish) -> Option<DVec3> {
    let mut first: Option<(f64, &Object)> = None;
    for object in members(near) {
        if let Some(t) = object.shape.hit(origin, direction)
            && first.is_none_or(|(nearest, _)| t < nearest)
        {
            first = Some((t, object));
        }
    }
    let (t, object) = first?;
    Some(object.shade(origin + t * direction, direction, finish))
}

impl Object {
    fn shade(&self, point: DVec3, direction: DVec3, finish: Finish) -> DVec3 {
        let (mirror, (shine, exponent)) = match finish {
            Finish::Mixed => (self.mirror, self.highlight),
            Finish::Matt => (0.0, (0.0, 1)),
            Finish::Lacquered => {
                (self.mirror.max(0.25), if self.highlight.0 > 0.0 { self.highlight } else { (0.35, 30) })
            }
        };
        let normal = self.shape.normal(point);
        let reflected = direction - 2.0 * direction.dot(normal) * normal;
        let mut diffuse = AMBIENT.0 + AMBIENT.1 * (0.5 + 0.5 * normal.z);
        let mut highlight = 0.0;
        for (index, &(toward, strength)) in LIGHTS.iter().enumerate() {
            let facing = normal.dot(toward);
            // The offset is larger than the rounding error of a hit.
            if facing <= 0.0 || (index == 0 && SHADOWS.covers(point + 1e-6 * normal)) {
                continue;
            }
            diffuse += strength * facing;
            if shine > 0.0 {
                highlight += strength * reflected.dot(toward).max(0.0).powi(exponent);
            }
        }
        let mut color = self.paint.color(point, normal) * diffuse;
        if mirror > 0.0 {
            // Schlick's approximation of Fresnel's reflectance.
            let fraction = mirror + (1.0 - mirror) * (1.0 + direction.dot(normal)).clamp(0.0, 1.0).powi(5);
            // The ball is convex: a reflected ray never hits it again.
            let others =
                (mirror >= MIRROR).then(|| radiance_of(u32::MAX, point + 1e-6 * normal, reflected, finish));
            color = color.lerp(others.flatten().unwrap_or_else(|| surroundings(reflected)), fraction);
        }
        (color + shine * highlight).clamp(DVec3::ZERO, DVec3::ONE)
    }
}

/// Shadow map of the first light: the objects that can lie between a point and the light.
static SHADOWS: LazyLock<ShadowMap> = LazyLock::new(ShadowMap::new);

struct ShadowMap {
    /// `right` and `up` are unit vectors perpendicular to `toward`, the direction to the light.
    right: DVec3,
    up: DVec3,
    toward: DVec3,
    /// Bits of the objects that may shade each cell of [-REACH, REACH]², row by row.
    cells: Vec<u32>,
}

impl ShadowMap {
    const SIDE: usize = 128;
    const REACH: f64 = 1.25;

    fn new() -> Self {
        let toward = LIGHTS[0].0;
        let (right, up) = toward.any_orthonormal_pair();
        let size = 2.0 * Self::REACH / Self::SIDE as f64;
        let cells = (0..Self::SIDE * Self::SIDE)
            .map(|cell| {
                let middle = |index: usize| (index as f64 + 0.5) * size - Self::REACH;
                let origin = middle(cell % Self::SIDE) * right + middle(cell / Self::SIDE) * up;
                // Half the diagonal of a cell.
                let margin = 0.7072 * size;
                OBJECTS.iter().enumerate().fold(0, |bits, (i, object)| {
                    bits | u32::from(object.shape.line_distance(origin, toward) <= margin) << i
                })
            })
            .collect();
        Self { right, up, toward, cells }
    }

    /// Returns true if a point is in shadow.
    fn covers(&self, point: DVec3) -> bool {
        let index = |along: DVec3| {
            let fraction = (point.dot(along) / Self::REACH + 1.0) * 0.5;
            ((fraction * Self::SIDE as f64) as usize).min(Self::SIDE - 1)
        };
        let bits = self.cells[index(self.up) * Self::SIDE + index(self.right)];
        members(bits).any(|object| object.shape.hit(point, self.toward).is_some())
    }
}

/// Returns the environment for reflections: a sky that brightens upwards, a warm floor, two soft windows.
fn surroundings(direction: DVec3) -> DVec3 {
    let sky = DVec3::new(0.45, 0.62, 0.88).lerp(DVec3::new(0.92, 0.95, 1.0), direction.z.max(0.0));
    let floor = DVec3::new(0.42, 0.36, 0.30);
    let horizon = (0.5 + 4.0 * direction.z).clamp(0.0, 1.0);
    let window = |toward: DVec3, sharpness: i32| direction.dot(toward.normalize()).max(0.0).powi(sharpness);
    floor.lerp(sky, horizon)
        + DVec3::new(1.0, 0.9, 0.6) * window(DVec3::new(-0.3, -0.9, 0.5), 20)
        + DVec3::new(0.9, 0.3, 0.3) * window(DVec3::new(0.9, 0.5, 0.3), 12)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scene_lies_well_inside_its_box() {
        // Rays that pass the origin at a distance of 1.2 hit nothing.
        for i in 0..400 {
            let turn = 0.1 * f64::from(i);
            let side = DVec3::new(turn.cos(), turn.sin(), (0.37 * turn).sin()).normalize();
            let along = side.any_orthonormal_vector();
            assert_eq!(radiance(1.2 * side - 3.0 * along, along), None);
        }
    }

    #[test]
    fn the_ball_shines_differently_to_another_eye() {
        let center = DVec3::new(0.42, 0.44, GROUND_TOP + 0.36);
        // Two positions that see the same point of the ball.
        let point = center + 0.36 * DVec3::new(0.4, 0.6, 0.7).normalize();
        let seen = |from: DVec3| DVec3::from(radiance(from, point - from).expect("the ball is there"));
        let (a, b) = (seen(DVec3::new(2.0, 3.0, 2.0)), seen(DVec3::new(1.0, 3.0, 3.0)));
        assert!((a - b).length() > 0.03, "{a} {b}");
        // A matt point has one colour from all directions; a lacquered point of the ground has several.
        let eyes = [DVec3::new(2.0, 3.0, 2.0), DVec3::new(1.0, 3.0, 3.0)];
        let change = |point: DVec3, finish| {
            let seen = |from: DVec3| radiance_of(u32::MAX, from, (point - from).normalize(), finish);
            let [a, b] = eyes.map(|from| seen(from).expect("it is there"));
            (a - b).length()
        };
        let ground = DVec3::new(-0.7, 0.5, GROUND_TOP);
        assert!(change(point, Finish::Matt) < 1e-9 && change(ground, Finish::Mixed) < 1e-9);
        // 0.01 is more than two steps of 1/255.
        assert!(change(ground, Finish::Lacquered) > 0.01, "{}", change(ground, Finish::Lacquered));
    }

    #[test]
    fn colours_are_within_range_and_repeat() {
        for i in 0..500 {
            let turn = 0.7 * f64::from(i);
            let origin = 4.0 * DVec3::new(turn.cos(), turn.sin(), 0.5 + 0.4 * (1.3 * turn).sin()).normalize();
            let target = DVec3::new((2.1 * turn).sin(), (3.3 * turn).cos(), (0.9 * turn).sin()) * 0.5;
            let color = radiance(origin, target - origin);
            assert_eq!(color, radiance(origin, target - origin));
            assert!(color.is_none_or(|color| color.iter().all(|c| (0.0..=1.0).contains(c))));
        }
        assert!(OBJECTS.len() <= 32, "objects are numbered by the bits of a u32");
    }

    #[test]
    fn the_shadow_map_forgets_no_object() {
        let toward = LIGHTS[0].0;
        for i in 0..4000 {
            let i = f64::from(i);
            let point = DVec3::new((0.7 * i).sin(), (1.1 * i).cos(), 0.6 * (0.3 * i).sin());
            // Skips points inside an object: the map is never queried there.
            if shapes().any(|shape| shape.implicit(point) < 1e-6) || point.length() > 1.2 {
                continue;
            }
            let expected = shapes().any(|shape| shape.hit(point, toward).is_some());
            assert_eq!(SHADOWS.covers(point), expected, "{point}");
        }
    }
}
