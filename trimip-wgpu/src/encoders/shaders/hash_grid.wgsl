// Mirrors `trimip_core::field::encoders::hash_grid`.

@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(9) var<storage, read> levels: array<Level>;

// The cell that contains a position: its lower corner, and the position within it.
struct Cell {
    lower: vec3<u32>,
    fraction: vec3<f32>,
}

fn cell_around(scale: f32, position: vec3<f32>) -> Cell {
    let place = position * scale + 0.5;
    let lower = floor(place);
    return Cell(vec3<u32>(lower), place - lower);
}

fn is_upper(corner: u32) -> vec3<bool> {
    return vec3<bool>((corner & 1u) != 0u, (corner & 2u) != 0u, (corner & 4u) != 0u);
}

fn corner_weight(cell: Cell, corner: u32) -> f32 {
    let along = select(1.0 - cell.fraction, cell.fraction, is_upper(corner));
    return along.x * along.y * along.z;
}

// Returns the index of a corner's entry among the entries of all levels.
fn corner_entry(level: Level, cell: Cell, corner: u32) -> u32 {
    let at = cell.lower + select(vec3<u32>(0u), vec3<u32>(1u), is_upper(corner));
    if level.side == 0u {
        return level.first + ((at.x ^ (at.y * PRIME_Y) ^ (at.z * PRIME_Z)) & (level.entries - 1u));
    }
    return level.first + (at.x + level.side * (at.y + level.side * at.z)) % level.entries;
}

// Returns the weight of a level's features at a point with the standard deviation `deviation`, divided by the number of
// points.
fn downweight(scale: f32, deviation: f32) -> f32 {
    var level_weight = 1.0;
    if WEIGHTED == 1u {
        let cells = deviation * (scale + 1.0);
        if cells > 1e-3 {
            // The error function (Abramowitz and Stegun, 7.1.28).
            let x = min(0.35355339 / cells, 4.0);
            let sum = (((((4.30638e-5 * x + 2.765672e-4) * x + 1.520143e-4) * x + 9.2705272e-3) * x + 4.22820123e-2) * x
                + 7.05230784e-2) * x;
            let by_2 = (1.0 + sum) * (1.0 + sum);
            let by_4 = by_2 * by_2;
            let by_8 = by_4 * by_4;
            level_weight = 1.0 - 1.0 / (by_8 * by_8);
        }
    }
    return level_weight / f32(POINTS);
}
