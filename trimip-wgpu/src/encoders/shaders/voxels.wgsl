// Mirrors `trimip_core::field::encoders::voxels`.

@group(0) @binding(2) var<uniform> params: Params;

// The cell that contains a position: its first grid point, and the position within it.
struct Cell {
    point: u32,
    upper: vec3<f32>,
}

fn cell_around(position: vec3<f32>) -> Cell {
    let last = vec3<f32>(params.sides - 1u);
    let at = clamp(position * last, vec3<f32>(0.0), last);
    let lower = min(floor(at), last - 1.0);
    let cell = vec3<u32>(lower);
    return Cell((cell.z * params.sides.y + cell.y) * params.sides.x + cell.x, at - lower);
}

fn is_upper(corner: u32) -> vec3<bool> {
    return vec3<bool>((corner & 1u) != 0u, (corner & 2u) != 0u, (corner & 4u) != 0u);
}

fn corner_weight(cell: Cell, corner: u32) -> f32 {
    let along = select(1.0 - cell.upper, cell.upper, is_upper(corner));
    return along.x * along.y * along.z;
}

fn corner_point(cell: Cell, corner: u32) -> u32 {
    let upper = select(vec3<u32>(0u), vec3<u32>(1u), is_upper(corner));
    return cell.point + (upper.z * params.sides.y + upper.y) * params.sides.x + upper.x;
}

// Returns the index of the first coefficient of a channel at a grid point.
fn color_at(point: u32, channel: u32) -> u32 {
    return params.colors + (3u * point + channel) * params.harmonics;
}
