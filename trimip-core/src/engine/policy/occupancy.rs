//! The policy of the occupancy grid: its space and step length, the choice of cells for a refresh, and the query of
//! each cell.

use crate::{
    Config, Space,
    config::OccupancyConfig,
    geometry::{
        elements::{Interval, Ray, Sphere},
        occupancy::{Choice, direction_of, point_in},
    },
    math::rng::{Random, Sequence},
};

/// Settings, space and random numbers of an occupancy grid.
#[derive(Clone, Debug)]
pub struct OccupancyPolicy {
    /// The settings.
    pub settings: OccupancyConfig,
    /// The space that the cells divide.
    pub space: Space<f32>,
    /// Generator of random cells, points and directions.
    pub random: Random,
    /// Radius of a sphere whose great circle has the area of a cell's face, in world units.
    pub radius: f32,
    /// World length of one marching step at scale 1.
    pub step_length: f32,
}

impl OccupancyPolicy {
    /// Creates the policy of a configuration.
    pub fn new(config: &Config) -> Self {
        let space = Space::new(&config.scene);
        Self {
            settings: config.occupancy.clone(),
            space,
            random: Random::new(config.seed),
            radius: space.cell(config.occupancy.resolution) / std::f32::consts::PI.sqrt(),
            step_length: config.step_length(),
        }
    }

    /// Returns the number of cells along a side.
    #[inline]
    pub fn resolution(&self) -> u32 {
        self.settings.resolution
    }

    /// Returns the number of cells.
    pub fn cells(&self) -> u32 {
        self.settings.resolution.pow(3)
    }

    /// Returns the fraction of the cells that the refresh at `step` queries. Warm-up steps use
    /// `occupancy.warmup_fraction`.
    pub fn fraction(&self, step: u64) -> f32 {
        let warm = step < u64::from(self.settings.warmup);
        if warm { self.settings.warmup_fraction } else { self.settings.fraction }
    }

    /// Returns the cells that the refresh at `step` queries, if `occupied` cells are occupied.
    pub fn choice(&self, step: u64, occupied: usize) -> Choice {
        let draws = self.random.at(Sequence::Cell, step);
        Choice::new(draws, self.fraction(step), occupied, self.settings.cells())
    }

    /// Returns the query of a refresh for one cell: a sample at a random point of the cell, one marching step long, on
    /// a ray with a random direction. The sphere at the sample has the policy's `radius`. The ray starts in front of
    /// the point, at a distance equal to the longest side of the space.
    #[inline]
    pub fn probe(&self, cell: u32, step: u64) -> (Ray, Interval, Sphere) {
        let Self { space, random, radius, step_length: length, .. } = *self;
        let position = point_in(cell, self.resolution(), &random, step);
        let direction = direction_of(random.bits(Sequence::Point, step, cell)[3]);
        let (point, t) = (space.to_world(position), space.aabb().longest());
        let origin = std::array::from_fn(|axis| point[axis] - t * direction[axis]);
        let ray = Ray { origin, slope: radius / t, direction, cosine: 1.0, ..Ray::default() };
        (ray, Interval { t, length }, Sphere { position, radius })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refresh_asks_the_stated_shares() {
        let mut config = Config::default();
        config.occupancy = OccupancyConfig {
            resolution: 60,
            warmup: 256,
            warmup_fraction: 1.0,
            fraction: 0.25,
            ..config.occupancy
        };
        let policy = OccupancyPolicy::new(&config);
        let cells = policy.cells();
        let fraction = |choice: &Choice, occupied: bool| {
            (0..cells).filter(|&cell| choice.includes(cell, occupied)).count() as f64 / f64::from(cells)
        };
        assert_eq!([255, 256].map(|step| policy.fraction(step)), [1.0, 0.25]);
        assert_eq!(fraction(&policy.choice(16, 0), false), 1.0);
        // Half the cells are occupied. An occupied cell is drawn uniformly (probability 1/4) or from the occupied cells
        // (1/2).
        let later = policy.choice(512, cells as usize / 2);
        assert!((fraction(&later, false) - 0.25).abs() < 0.005);
        assert!((fraction(&later, true) - (1.0 - 0.75 * 0.5)).abs() < 0.005);
        // If few cells are occupied, all of them are drawn.
        assert_eq!(fraction(&policy.choice(512, 100), true), 1.0);
    }

    #[test]
    fn a_query_lies_in_its_cell_and_on_its_ray() {
        let policy = OccupancyPolicy::new(&Config::default());
        for cell in (0..policy.cells()).step_by(9973) {
            let (ray, interval, sphere) = policy.probe(cell, 7);
            assert_eq!(crate::geometry::occupancy::cell_of(sphere.position, policy.resolution()), cell);
            assert_eq!((sphere.radius, interval.length), (policy.radius, policy.step_length));
            assert!((ray.slope * interval.t - policy.radius).abs() < 1e-6 * policy.radius);
            let world = policy.space.to_world(sphere.position);
            for axis in 0..3 {
                let point = ray.origin[axis] + interval.t * ray.direction[axis];
                assert!((point - world[axis]).abs() < 1e-5 * interval.t, "{cell}");
            }
        }
    }
}
