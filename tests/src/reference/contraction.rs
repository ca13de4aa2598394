//! Contracted space written from its equations (mip-NeRF 360, Eq. 10), in f64. u is a point relative to the ball's centre, in
//! units of the ball's radius; n = |u|.

use super::sample::{Sample, apex, radius as radius_at, step_length};
use trimip_core::{Config, engine::batch::Ray};

/// Distance at which rays end, in units of the radius.
const FARTHEST: f64 = 1000.0;

/// Returns the centre and the radius of the ball: the middle of the cube, and a quarter of its side.
fn ball(config: &Config) -> ([f64; 3], f64) {
    let [low, high] = [config.scene.aabb_min, config.scene.aabb_max].map(|corner| corner.map(f64::from));
    ([0, 1, 2].map(|i| 0.5 * (low[i] + high[i])), 0.25 * (high[0] - low[0]))
}

fn norm(u: [f64; 3]) -> f64 {
    u.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Returns the contracted point in the unit cube: contract(u) = u for n ≤ 1, (2 − 1/n)·u/n otherwise. The contracted cube spans
/// −2 to 2.
fn position(u: [f64; 3]) -> [f64; 3] {
    let n = norm(u);
    let contracted = if n <= 1.0 { u } else { u.map(|x| (2.0 - 1.0 / n) * (x / n)) };
    contracted.map(|x| (x + 2.0) / 4.0)
}

/// A ray relative to the ball, and its parameter s as a function of the distance t.
struct RayParameter {
    origin: [f64; 3],
    direction: [f64; 3],
    /// Distance along the ray of its point nearest to the ball's centre, in radii.
    middle: f64,
    /// Distance of that point from the centre, in radii.
    nearest: f64,
    reach: f64,
    speed: f64,
}

impl RayParameter {
    fn new(config: &Config, ray: &Ray) -> Self {
        let (centre, radius) = ball(config);
        let direction = ray.direction.map(f64::from);
        let origin = [0, 1, 2].map(|i| (f64::from(ray.origin[i]) - centre[i]) / radius);
        let middle = -(0..3).map(|i| origin[i] * direction[i]).sum::<f64>();
        let nearest = norm([0, 1, 2].map(|i| origin[i] + middle * direction[i]));
        let reach = nearest.max(1.0);
        Self { origin, direction, middle, nearest, reach, speed: (2.0 * reach - 1.0) / (reach * reach) }
    }

    /// Returns dt/ds at distance t, by a central difference.
    fn slowness(&self, t: f64) -> f64 {
        let h = 1e-6 * t.max(1e-3);
        2.0 * h / (self.parameter(t + h) - self.parameter(t - h))
    }

    fn at(&self, t: f64) -> [f64; 3] {
        [0, 1, 2].map(|i| self.origin[i] + t * self.direction[i])
    }

    /// Returns s at distance t in radii: speed·reach·c(m) with c(m) = m for |m| ≤ 1, sign(m)·(2 − 1/|m|) otherwise.
    fn parameter(&self, t: f64) -> f64 {
        let m = (t - self.middle) / self.reach;
        let c = if m.abs() <= 1.0 { m } else { m.signum() * (2.0 - 1.0 / m.abs()) };
        self.speed * self.reach * c
    }

    /// Returns the distance t of a parameter s, by bisection.
    fn distance(&self, s: f64) -> f64 {
        let (mut low, mut high) = (-1e-9, 3.0 * FARTHEST);
        for _ in 0..200 {
            let t = 0.5 * (low + high);
            if self.parameter(t) < s { low = t } else { high = t }
        }
        0.5 * (low + high)
    }
}

/// A step of a ray through contracted space.
pub struct Step {
    /// The sample at the middle of the step. Its length is scaled by the radial derivative of the contraction: ds·(dt/ds)/n².
    pub sample: Sample,
    /// Length in world units, ds·(dt/ds).
    pub length: f64,
    /// Parameter at the end of the ray minus the parameter at the middle of the step, in world units.
    pub left: f64,
}

/// Returns all steps of a ray through contracted space.
pub fn march(config: &Config, ray: &Ray) -> Vec<Step> {
    let (_, radius) = ball(config);
    let parameterisation = RayParameter::new(config, ray);
    let RayParameter { direction, middle, nearest, .. } = parameterisation;
    let end = parameterisation.parameter(middle + (FARTHEST * FARTHEST - nearest * nearest).max(0.0).sqrt());
    let step = step_length(config) / radius;
    let mut steps = Vec::new();
    for i in 0.. {
        let s = parameterisation.parameter(0.0) + (f64::from(i) + 0.5) * step;
        if s >= end {
            break;
        }
        let t = parameterisation.distance(s);
        let slowness = parameterisation.slowness(t);
        let u = parameterisation.at(t);
        let n = norm(u).max(1.0);
        let place = position(u);
        let length = radius * step * slowness;
        let sample = Sample {
            t: radius * t,
            apex: apex(ray, radius * t),
            length: length / (n * n),
            position: place,
            radius: radius_at(ray, radius * t) * (2.0 * n - 1.0) / (n * n),
            direction,
        };
        steps.push(Step { sample, length, left: radius * (end - s) });
    }
    steps
}

/// Returns the midpoint and the width of a sample as parameters of its ray, in units of the cube's side: s/4 and
/// (ds/dt)·n²·length/4.
pub fn along(config: &Config, ray: &Ray, sample: &Sample) -> [f64; 2] {
    let (_, radius) = ball(config);
    let parameterisation = RayParameter::new(config, ray);
    let t = sample.t / radius;
    let n = norm(parameterisation.at(t)).max(1.0);
    [parameterisation.parameter(t) / 4.0, sample.length / radius * n * n / parameterisation.slowness(t) / 4.0]
}
