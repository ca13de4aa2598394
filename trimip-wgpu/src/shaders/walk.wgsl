// Walking rays in steps through the occupied cells of the grid. Needs `space.wgsl`, `blocks.wgsl`, and parameters with
// `space`, `step_length` and `step_per_radius`.

// One bit per cell in blocks of 4x4x4 cells (two words per block), then one bit per block in blocks of blocks.
@group(0) @binding(4) var<storage, read> grid: array<u32>;

// March parameters of a ray: distance of the start of the first step, distance at which the ray leaves the box,
// length of a step.
struct March {
    first: f32,
    leave: f32,
    step: f32,
}

// The march of a ray that meets the box between the distances `hit`. `offset` moves its start, in steps.
fn march_along(hit: vec2<f32>, step: f32, offset: f32) -> March {
    let first = hit.x + offset * step;
    let hits = hit.y > first && hit.y < FAR;
    return March(first, select(-FAR, hit.y, hits), step);
}

// Length of the steps of volume rendering.
fn volume_step(ray: Ray, hit: vec2<f32>) -> f32 {
    let by_radius = params.step_per_radius * ray.slope * 0.5 * (hit.x + hit.y);
    return select(params.step_length, by_radius, by_radius > params.step_length);
}

// Distance of the middle of a step.
fn middle(m: March, index: f32) -> f32 {
    return m.first + (index + 0.5) * m.step;
}

fn is_empty(word: u32) -> bool {
    return (grid[word] | grid[word + 1u]) == 0u;
}

// Side, in cells, of the largest empty cube of the hierarchy that contains a cell; 0 if the cell is occupied.
fn empty_around(cell: vec3<u32>) -> u32 {
    let blocks = params.space.resolution / SIDE;
    let outer = bit_of(cell / SIDE, (blocks + SIDE - 1u) / SIDE);
    if is_empty((2u * blocks * blocks * blocks + outer.word) & ~1u) {
        return SIDE * SIDE;
    }
    let own = bit_of(cell, blocks);
    if is_empty(own.word & ~1u) {
        return SIDE;
    }
    return select(1u, 0u, ((grid[own.word] >> own.bit) & 1u) == 1u);
}

// Index of the first step, from `start` on, whose middle lies in an occupied cell; `last` if there is none before it.
fn next_occupied(ray: Ray, m: March, start: f32, last: f32) -> f32 {
    var index = start;
    loop {
        let t = middle(m, index);
        if !(t < m.leave) || index >= last {
            return last;
        }
        let cell = cell_of(params.space, sphere_at(params.space, ray, t).xyz);
        let size = empty_around(cell);
        if size == 0u {
            return index;
        }
        let leave = cells_exit(params.space, ray, t, cell, size);
        // The first step whose middle is not before the exit. A step that rounding may move is tested, not skipped.
        let steps = (leave - m.first) / m.step - 0.5;
        let next = ceil(steps * (1.0 - 1e-6) - 0.01);
        index = select(index + 1.0, max(next, index + 1.0), leave < FAR);
    }
    return last;
}
