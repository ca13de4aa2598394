// The same as `trimip_core::field::encoders::hash_grid`.

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

// Index of a corner's entry within all levels.
fn corner_entry(level: Level, cell: Cell, corner: u32) -> u32 {
    let at = cell.lower + select(vec3<u32>(0u), vec3<u32>(1u), is_upper(corner));
    if level.side == 0u {
        return level.first + ((at.x ^ (at.y * PRIME_Y) ^ (at.z * PRIME_Z)) & (level.entries - 1u));
    }
    return level.first + (at.x + level.side * (at.y + level.side * at.z)) % level.entries;
}

// Weight of a level's features at a point with the standard deviation `deviation`, among all points.
fn downweight(scale: f32, deviation: f32) -> f32 {
    var level_weight = 1.0;
    if WEIGHTED == 1u {
        let cells = deviation * (scale + 1.0);
        if cells > 1e-3 {
            // The error function (Abramowitz and Stegun, 7.1.26).
            let x = 0.35355339 / cells;
            let t = 1.0 / (1.0 + 0.3275911 * x);
            let sum = ((((1.061405429 * t - 1.453152027) * t + 1.421413741) * t - 0.284496736) * t + 0.254829592) * t;
            level_weight = 1.0 - sum * exp(-x * x);
        }
    }
    return level_weight / f32(POINTS);
}
