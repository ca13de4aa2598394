//! Removes specks and cavities of a mesh: connected parts that are small, and parts that bound a void.

use super::surface::{Mesh, signed_volume};

/// Number of parts removed from a mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Removed {
    /// Connected parts smaller than the limit.
    pub specks: usize,
    /// Connected parts that face inward: walls of voids that are not visible from outside.
    pub cavities: usize,
}

/// Removes the connected parts whose box has a diagonal below `least`, and those that bound a void. A closed part with
/// a negative volume bounds a void.
pub fn clean(mesh: &mut Mesh, least: f64) -> Removed {
    let parts = parts(mesh);
    let count = parts.iter().map(|&part| part as usize + 1).max().unwrap_or(0);
    let mut boxes = vec![EMPTY; count];
    let mut volumes = vec![0.0; count];
    for (&triangle, &part) in mesh.triangles.iter().zip(&parts) {
        let corners = mesh.corners(triangle);
        volumes[part as usize] += signed_volume(corners);
        extend(&mut boxes[part as usize], &corners);
    }
    let speck: Vec<bool> = boxes.iter().map(|own| diagonal(own) < least).collect();
    let cavity: Vec<bool> = volumes.iter().map(|&volume| volume < 0.0).collect();
    mesh.retain(|i| !speck[parts[i] as usize] && !cavity[parts[i] as usize]);
    let specks = speck.iter().filter(|&&own| own).count();
    Removed { specks, cavities: cavity.iter().zip(&speck).filter(|&(&own, &small)| own && !small).count() }
}

/// Removes the connected parts of a mesh, closed or not, whose box has a diagonal below `least`; returns their number.
pub fn remove_specks(mesh: &mut Mesh, least: f64) -> usize {
    let parts = parts(mesh);
    let count = parts.iter().map(|&part| part as usize + 1).max().unwrap_or(0);
    let mut boxes = vec![EMPTY; count];
    for (&triangle, &part) in mesh.triangles.iter().zip(&parts) {
        extend(&mut boxes[part as usize], &mesh.corners(triangle));
    }
    let speck: Vec<bool> = boxes.iter().map(|own| diagonal(own) < least).collect();
    mesh.retain(|i| !speck[parts[i] as usize]);
    speck.iter().filter(|&&own| own).count()
}

/// Corners of a box.
type Corners = [[f64; 3]; 2];

/// The empty box.
const EMPTY: Corners = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];

/// Extends a box to contain the corners of a triangle.
fn extend([low, high]: &mut Corners, corners: &[[f64; 3]; 3]) {
    for (axis, value) in corners.iter().flat_map(|corner| corner.iter().enumerate()) {
        low[axis] = low[axis].min(*value);
        high[axis] = high[axis].max(*value);
    }
}

fn diagonal([low, high]: &Corners) -> f64 {
    low.iter().zip(high).map(|(l, h)| (h - l).powi(2)).sum::<f64>().sqrt()
}

/// Returns the index of the connected part that each triangle belongs to.
fn parts(mesh: &Mesh) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    for &[a, b, c] in &mesh.triangles {
        for other in [b, c] {
            let (a, b) = (root(&mut parent, a), root(&mut parent, other));
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    let mut numbers = vec![u32::MAX; mesh.positions.len()];
    let mut count = 0;
    mesh.triangles
        .iter()
        .map(|triangle| {
            let number = &mut numbers[root(&mut parent, triangle[0]) as usize];
            if *number == u32::MAX {
                *number = count;
                count += 1;
            }
            *number
        })
        .collect()
}

/// Returns the representative of a vertex's part (union-find), and halves the path to it.
fn root(parent: &mut [u32], mut vertex: u32) -> u32 {
    while parent[vertex as usize] != vertex {
        parent[vertex as usize] = parent[parent[vertex as usize] as usize];
        vertex = parent[vertex as usize];
    }
    vertex
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::fixtures::cube;

    /// Returns a cube with a side of `side` and its least corner at `corner`, turned inside out if `void`.
    fn part(corner: f32, side: f32, void: bool) -> Mesh {
        let mut mesh = cube();
        mesh.positions.iter_mut().for_each(|p| *p = p.map(|x| corner + side * x));
        if void {
            mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        }
        mesh
    }

    #[test]
    fn specks_and_cavities_go_and_the_rest_stays() {
        let mut all = Mesh::default();
        for own in [part(0.0, 4.0, false), part(1.0, 1.0, true), part(9.0, 0.1, false), part(6.0, 0.5, false)]
        {
            let first = all.positions.len() as u32;
            all.positions.extend(own.positions);
            all.triangles.extend(own.triangles.into_iter().map(|t| t.map(|v| v + first)));
        }
        let removed = clean(&mut all, 0.5);
        assert_eq!(removed, Removed { specks: 1, cavities: 1 });
        assert_eq!((all.positions.len(), all.triangles.len()), (16, 24));
        assert!((all.volume() - 64.125).abs() < 1e-4);
        assert_eq!(clean(&mut Mesh::default(), 1.0), Removed::default());
    }
}
