//! Colours of a surface: the field seen against the normals.

use glam::{DVec3, Vec3};
use trimip_core::{Query, Result, Viewer, math::compositing::composite};

/// Number of samples that are composited for a colour.
const SAMPLES: usize = 8;

/// Number of queries that are evaluated at once.
const QUERIES_AT_ONCE: usize = 1 << 18;

/// A line of sight through a point of the surface.
#[derive(Clone, Copy, Debug)]
pub struct Sight {
    /// Length of the line in front of the point and behind it, world units.
    pub reach: f64,
    /// Radius of the spheres in which the field is evaluated, world units.
    pub radius: f64,
}

/// Rounds a colour to 8 bits.
pub fn eight_bits(color: [f32; 3]) -> [u8; 3] {
    color.map(|c| (255.0 * c.clamp(0.0, 1.0)).round() as u8)
}

/// Returns the colour of each point, as seen against its normal, by volume rendering along a line of sight. A point is a
/// position and a unit normal.
pub fn colors(viewer: &mut dyn Viewer, points: &[[[f32; 3]; 2]], sight: Sight) -> Result<Vec<[f32; 3]>> {
    let length = 2.0 * sight.reach / SAMPLES as f64;
    let mut colors = Vec::with_capacity(points.len());
    for points in points.chunks(QUERIES_AT_ONCE / SAMPLES) {
        let queries: Vec<Query> = points
            .iter()
            .flat_map(|&[position, normal]| {
                let direction = (-Vec3::from_array(normal)).to_array();
                (0..SAMPLES).map(move |i| {
                    let offset = length * (i as f64 + 0.5) - sight.reach;
                    let point = Vec3::from_array(position).as_dvec3()
                        + offset * DVec3::from(direction.map(f64::from));
                    Query { point: point.to_array(), radius: sight.radius as f32, direction }
                })
            })
            .collect();
        for samples in viewer.query(&queries)?.chunks_exact(SAMPLES) {
            let seen = samples.iter().map(|own| (own.density * length as f32, own.rgb, 0.0));
            let pixel = composite(seen, [0.0; 3]);
            // Where the line of sight is not opaque, divide the colour by the opacity.
            let fraction = pixel.opacity.max(1e-6).recip();
            colors.push(pixel.rgb.map(|c| (c * fraction).clamp(0.0, 1.0)));
        }
    }
    Ok(colors)
}
