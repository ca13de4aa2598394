//! The distance field of an occupancy grid: it bounds how far ray marching may skip.

/// Replaces each value of a grid of `side`³ cells, x fastest, by its Chebyshev distance to the nearest cell of value 0, in
/// cells, at most 255. All other cells must hold 255 on entry. The result is exact: two passes over the 26 neighbours
/// (Borgefors 1986).
pub(crate) fn distances(cells: &mut [u8], side: usize) {
    let mut least = vec![0; side];
    for z in 0..side {
        for y in 0..side {
            least.fill(255);
            // Adjacent rows that this pass has already visited: one in the same layer, three in the previous layer.
            let before = (y > 0).then(|| (z, y - 1)).into_iter();
            let layer = (z > 0).then(|| (y.saturating_sub(1)..(y + 2).min(side)).map(move |y| (z - 1, y)));
            for (z, y) in before.chain(layer.into_iter().flatten()) {
                minimum(&mut least, &cells[(z * side + y) * side..][..side]);
            }
            let row = &mut cells[(z * side + y) * side..][..side];
            relax(row, &least);
            (1..side).for_each(|x| row[x] = row[x].min(row[x - 1].saturating_add(1)));
        }
    }
    for z in (0..side).rev() {
        for y in (0..side).rev() {
            least.fill(255);
            let before = (y + 1 < side).then_some((z, y + 1)).into_iter();
            let layer =
                (z + 1 < side).then(|| (y.saturating_sub(1)..(y + 2).min(side)).map(move |y| (z + 1, y)));
            for (z, y) in before.chain(layer.into_iter().flatten()) {
                minimum(&mut least, &cells[(z * side + y) * side..][..side]);
            }
            let row = &mut cells[(z * side + y) * side..][..side];
            relax(row, &least);
            (1..side).rev().for_each(|x| row[x - 1] = row[x - 1].min(row[x].saturating_add(1)));
        }
    }
}

/// Lowers each `least[x]` to the minimum of the three values of `row` around x.
fn minimum(least: &mut [u8], row: &[u8]) {
    let side = row.len();
    least.iter_mut().zip(row).for_each(|(least, &value)| *least = (*least).min(value));
    least[1..].iter_mut().zip(row).for_each(|(least, &value)| *least = (*least).min(value));
    least[..side - 1].iter_mut().zip(&row[1..]).for_each(|(least, &value)| *least = (*least).min(value));
}

/// Limits each value to `least` + 1, where `least` holds the minima over neighbouring rows.
fn relax(row: &mut [u8], least: &[u8]) {
    row.iter_mut().zip(least).for_each(|(value, &least)| *value = (*value).min(least.saturating_add(1)));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_those_of_the_nearest_occupied_cell() {
        let side = 11;
        let place = |i: usize| [i % side, i / side % side, i / side / side];
        for occupied in [vec![0], vec![700, 1330], vec![5, 6, 400, 900, 901], vec![]] {
            let mut cells = vec![255; side * side * side];
            occupied.iter().for_each(|&i: &usize| cells[i] = 0);
            distances(&mut cells, side);
            for (i, &found) in cells.iter().enumerate() {
                let apart = |&other: &usize| {
                    let (a, b) = (place(i), place(other));
                    (0..3).map(|axis| a[axis].abs_diff(b[axis])).max().unwrap_or(0)
                };
                let expected = occupied.iter().map(apart).min().unwrap_or(255);
                assert_eq!(usize::from(found), expected, "{:?}", place(i));
            }
        }
    }
}
