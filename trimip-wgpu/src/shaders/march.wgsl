// Marching. `march` decides once, with one bit per step, which steps lie in occupied cells, and counts them. After
// the counts are summed, `place` turns the bits into samples. Twin of the CPU's renderer.

struct Params {
    space: Space,
    draws: vec4<u32>,
    step_length: f32,
    step_per_radius: f32,
    jitter: u32,
    // Index of the span's first ray within the step.
    first: u32,
    count: u32,
    // Words of bits per ray.
    words: u32,
    // Maximum number of samples.
    capacity: u32,
}

@group(0) @binding(0) var<storage, read> rays: array<Ray>;
@group(0) @binding(1) var<storage, read_write> bits: array<u32>;
@group(0) @binding(2) var<storage, read_write> segments: array<vec2<u32>>;
@group(0) @binding(3) var<uniform> params: Params;
// One bit per cell in blocks of 4x4x4 cells (two words per block), then one bit per block in blocks of blocks.
@group(0) @binding(4) var<storage, read> grid: array<u32>;
@group(0) @binding(5) var<storage, read_write> owners: array<u32>;
@group(0) @binding(6) var<storage, read_write> intervals: array<vec2<f32>>;
@group(0) @binding(7) var<storage, read_write> spheres: array<vec4<f32>>;

// March parameters of a ray: distance of the start of the first step, distance at which the ray leaves the box,
// length of a step.
struct March {
    first: f32,
    leave: f32,
    step: f32,
}

fn start(ray: Ray, index: u32) -> March {
    let hit = intersect(params.space, ray);
    var offset = 0.0;
    if params.jitter != 0u {
        offset = unit(random_bits(params.draws, index).x);
    }
    let by_radius = params.step_per_radius * ray.slope * 0.5 * (hit.x + hit.y);
    let step = select(params.step_length, by_radius, by_radius > params.step_length);
    let first = hit.x + offset * step;
    let hits = hit.y > first && hit.y < FAR;
    return March(first, select(-FAR, hit.y, hits), step);
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

@compute @workgroup_size(GROUP)
fn march(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    let ray = rays[i];
    let m = start(ray, params.first + i);
    let base = i * params.words;
    var word = 0u;
    var word_bits = 0u;
    var index = 0.0;
    var count = 0u;
    loop {
        let t = m.first + (index + 0.5) * m.step;
        let step = u32(index);
        if !(t < m.leave) || step >= 32u * params.words {
            break;
        }
        let cell = cell_of(params.space, sphere_at(params.space, ray, t).xyz);
        let size = empty_around(cell);
        if size == 0u {
            while word < step / 32u {
                bits[base + word] = word_bits;
                word_bits = 0u;
                word += 1u;
            }
            word_bits |= 1u << (step % 32u);
            count += 1u;
            index += 1.0;
            continue;
        }
        let leave = cells_exit(params.space, ray, t, cell, size);
        // The first step whose midpoint is not before the exit. A step that rounding may move is tested, not skipped.
        let steps = (leave - m.first) / m.step - 0.5;
        let next = ceil(steps * (1.0 - 1e-6) - 0.01);
        index = select(index + 1.0, max(next, index + 1.0), leave < FAR);
    }
    while word < params.words {
        bits[base + word] = word_bits;
        word_bits = 0u;
        word += 1u;
    }
    segments[i] = vec2<u32>(0u, count);
}

@compute @workgroup_size(GROUP)
fn place(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    var segment = segments[i];
    // A batch larger than its buffer is truncated; the step's sums count the dropped samples.
    segment.x = min(segment.x, params.capacity);
    segment.y = min(segment.y, params.capacity - segment.x);
    segments[i] = segment;
    let ray = rays[i];
    let m = start(ray, params.first + i);
    var at = segment.x;
    let end = segment.x + segment.y;
    for (var word = 0u; word < params.words && at < end; word++) {
        var rest = bits[i * params.words + word];
        while rest != 0u && at < end {
            let bit = firstTrailingBit(rest);
            rest &= rest - 1u;
            let t = m.first + (f32(32u * word + bit) + 0.5) * m.step;
            owners[at] = i;
            intervals[at] = vec2<f32>(t, m.step);
            spheres[at] = sphere_at(params.space, ray, t);
            at += 1u;
        }
    }
}
