// Walks rays in steps through the occupied cells of the occupancy grid. Needs parameters with `space`, `step_length`
// and `step_per_radius`.

// One bit per cell in blocks of 4x4x4 cells (two words per block), then one bit per block in blocks of blocks.
@group(0) @binding(4) var<storage, read> grid: array<u32>;

// The march of a ray: ray parameter at the start of the first step, ray parameter at which the ray leaves the space,
// step length as a difference of ray parameters, and the ray's parameterisation.
struct March {
    first: f32,
    leave: f32,
    step: f32,
    parameterisation: RayParameter,
}

// Returns the march of a ray. Its start is moved by `offset` steps.
fn march_along(parameterisation: RayParameter, step: f32, offset: f32) -> March {
    let first = parameterisation.enter + offset * step;
    let hits = parameterisation.leave > first && parameterisation.leave < FAR;
    return March(first, select(-FAR, parameterisation.leave, hits), step, parameterisation);
}

// Returns the length of the steps of volume rendering.
fn volume_step(ray: Ray, parameterisation: RayParameter) -> f32 {
    let radius = params.step_per_radius * ray.radius;
    let by_radius = radius + params.step_per_radius * ray.slope * 0.5 * (parameterisation.enter + parameterisation.leave);
    return select(params.step_length, by_radius, by_radius > params.step_length);
}

// Returns the distance of a step's midpoint.
fn middle(m: March, index: f32) -> f32 {
    return distance_at(m.parameterisation, m.first + (index + 0.5) * m.step);
}

fn is_empty(word: u32) -> bool {
    return (grid[word] | grid[word + 1u]) == 0u;
}

// Returns the side, in cells, of the largest empty cube of the hierarchy that contains a cell; 0 if the cell is
// occupied.
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

// Returns the index of the first step, from `start` on, whose midpoint lies in an occupied cell; `last` if no step
// before `last` does.
fn next_occupied(ray: Ray, m: March, start: f32, last: f32) -> f32 {
    var index = start;
    loop {
        let s = m.first + (index + 0.5) * m.step;
        if !(s < m.leave) || index >= last {
            return last;
        }
        let position = to_cube(params.space, ray.origin + distance_at(m.parameterisation, s) * ray.direction);
        let cell = cell_of(params.space, position);
        let size = empty_around(cell);
        if size == 0u {
            return index;
        }
        var leave = 0.0;
        if m.parameterisation.speed == 0.0 {
            leave = cells_exit(params.space, ray, cell, size);
        } else {
            leave = cells_clear(params.space, s, position, cell, size);
        }
        // Continues with the first step whose midpoint is not before the exit. A step so close to the exit that
        // rounding may move it is tested, not skipped.
        let steps = (leave - m.first) / m.step - 0.5;
        let next = ceil(steps * (1.0 - 1e-6) - 0.01);
        index = select(index + 1.0, max(next, index + 1.0), leave < FAR);
    }
    return last;
}
