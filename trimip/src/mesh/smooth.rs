//! Smoothing of meshes: vertices move towards, and away from, the means of their neighbours.

use super::surface::Mesh;
use glam::Vec3;
use std::collections::HashMap;

/// Part of the way to the mean of its neighbours that a vertex moves, and moves back afterwards (Taubin 1995). Together the steps keep the
/// size of the mesh and remove detail of about the length of an edge.
const THERE_AND_BACK: [f32; 2] = [0.5, -0.53];

/// Moves the vertices of a mesh there and back, `rounds` times. Vertices on the border of an open mesh stay. Normals are not changed.
pub fn smooth(mesh: &mut Mesh, rounds: u32) {
    if rounds == 0 {
        return;
    }
    let fixed = on_border(mesh);
    let before: Vec<Vec3> = mesh.positions.iter().map(|&position| position.into()).collect();
    let mut positions = before.clone();
    for _ in 0..rounds {
        for part in THERE_AND_BACK {
            step(mesh, &mut positions, part);
            let border = fixed.iter().zip(&before).zip(&mut positions).filter(|((fixed, _), _)| **fixed);
            border.for_each(|((_, &before), position)| *position = before);
        }
    }
    mesh.positions = positions.iter().map(Vec3::to_array).collect();
}

/// Returns the positions of the vertices after `rounds` rounds, in each of which a vertex moves half of the way to the mean of its
/// neighbours. The mesh shrinks.
pub fn shrunk(mesh: &Mesh, rounds: u32) -> Vec<[f32; 3]> {
    let mut positions: Vec<Vec3> = mesh.positions.iter().map(|&position| position.into()).collect();
    (0..rounds).for_each(|_| step(mesh, &mut positions, 0.5));
    positions.iter().map(Vec3::to_array).collect()
}

/// Moves every vertex by `part` of the way to the mean of its neighbours; a neighbour counts once for each triangle that has both.
fn step(mesh: &Mesh, positions: &mut [Vec3], part: f32) {
    let mut sums = vec![(Vec3::ZERO, 0.0_f32); positions.len()];
    for triangle in &mesh.triangles {
        for [a, b] in [[0, 1], [1, 2], [2, 0]].map(|edge| edge.map(|corner| triangle[corner] as usize)) {
            sums[a] = (sums[a].0 + positions[b], sums[a].1 + 1.0);
            sums[b] = (sums[b].0 + positions[a], sums[b].1 + 1.0);
        }
    }
    for (position, (sum, count)) in positions.iter_mut().zip(sums) {
        if count > 0.0 {
            *position += part * (sum / count - *position);
        }
    }
}

/// Returns true for each vertex on an edge that belongs to one triangle only.
fn on_border(mesh: &Mesh) -> Vec<bool> {
    let mut triangles: HashMap<[u32; 2], u32> = HashMap::new();
    for &[a, b, c] in &mesh.triangles {
        for [from, to] in [[a, b], [b, c], [c, a]] {
            *triangles.entry([from.min(to), from.max(to)]).or_default() += 1;
        }
    }
    let mut border = vec![false; mesh.positions.len()];
    for (edge, count) in triangles {
        if count == 1 {
            edge.into_iter().for_each(|vertex| border[vertex as usize] = true);
        }
    }
    border
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{Grid, march};
    use glam::DVec3;

    /// Returns a number from -0.5 to 0.5 (SplitMix64).
    fn white(index: u64) -> f64 {
        let mut bits = index.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        bits = (bits ^ bits >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        bits = (bits ^ bits >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        (bits ^ bits >> 31) as f64 / u64::MAX as f64 - 0.5
    }

    /// Returns a ball of radius 0.5 whose surface has noise of the size of half a cell.
    fn noisy_ball() -> (Mesh, f64) {
        let spacing = 1.0 / 32.0;
        let grid = Grid { origin: [-0.75; 3], spacing, points: [49; 3] };
        let mesh = march(&grid, 1.0, |z, layer| {
            for (i, value) in layer.iter_mut().enumerate() {
                let point = DVec3::from(grid.point([i % 49, i / 49, z]));
                let noise = white((z * 49 * 49 + i) as u64);
                *value = (20.0 * (0.5 - point.length() + spacing * noise)).exp() as f32;
            }
            Ok(())
        });
        (mesh.unwrap(), spacing)
    }

    /// Returns the mean and the standard deviation of the distances of the vertices from the origin.
    fn radii(mesh: &Mesh) -> [f64; 2] {
        let radii = mesh.positions.iter().map(|p| DVec3::from(p.map(f64::from)).length());
        let count = mesh.positions.len() as f64;
        let mean = radii.clone().sum::<f64>() / count;
        [mean, (radii.map(|radius| (radius - mean).powi(2)).sum::<f64>() / count).sqrt()]
    }

    #[test]
    fn noise_goes_and_the_size_stays() {
        let (mut mesh, spacing) = noisy_ball();
        let before = radii(&mesh);
        let defects = mesh.defects();
        smooth(&mut mesh, 0);
        assert_eq!(radii(&mesh), before);
        let small = Mesh { positions: shrunk(&mesh, 20), ..mesh.clone() };
        smooth(&mut mesh, 10);
        let after = radii(&mesh);
        let mut longer = mesh.clone();
        smooth(&mut longer, 40);
        let noise = [before, after, radii(&longer)].map(|[_, deviation]| deviation);
        // Ten rounds keep 0.59 of a wave whose neighbours' mean is half of it, (0.75 · 1.265)¹⁰, and more of a longer one.
        assert!(
            noise[0] > 0.15 * spacing && noise[1] < 0.8 * noise[0] && noise[2] < 0.8 * noise[1],
            "{noise:?}"
        );
        assert!((after[0] / before[0] - 1.0).abs() < 0.01, "{before:?} -> {after:?}");
        assert!(radii(&small)[0] < 0.995 * before[0], "without the steps back the ball shrinks");
        assert_eq!(mesh.defects(), defects);
    }

    #[test]
    fn the_border_of_an_open_mesh_stays() {
        let (mut mesh, _) = noisy_ball();
        let upper: Vec<bool> = (mesh.triangles.iter())
            .map(|triangle| triangle.iter().all(|&vertex| mesh.positions[vertex as usize][2] > 0.1))
            .collect();
        mesh.retain(|i| upper[i]);
        let (border, before) = (on_border(&mesh), mesh.positions.clone());
        assert!(border.iter().filter(|border| **border).count() > 50);
        smooth(&mut mesh, 5);
        for ((border, before), after) in border.iter().zip(&before).zip(&mesh.positions) {
            assert!(!border || before == after);
        }
        assert_ne!(before, mesh.positions);
    }
}
