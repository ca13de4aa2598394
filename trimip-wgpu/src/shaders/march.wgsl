// Marching: `march` decides once, as one bit per step, which steps lie in occupied cells, and counts them; after the
// counts are summed `place` turns bits into samples. Twin of the CPU's renderer.

struct Ray {
    origin: vec3<f32>,
    slope: f32,
    direction: vec3<f32>,
    cosine: f32,
}

struct Params {
    aabb_min: vec3<f32>,
    step_length: f32,
    aabb_max: vec3<f32>,
    step_per_radius: f32,
    // Quotients are made where they are exact to half an ulp: a device's own division may be off by more.
    inverse_extent: vec3<f32>,
    padding: f32,
    cell_extent: vec3<f32>,
    more_padding: f32,
    draws: vec4<u32>,
    jitter: u32,
    // Index of the span's first ray within the step.
    first: u32,
    count: u32,
    resolution: u32,
    // Words of bits of a ray.
    words: u32,
    // Samples that there is room for.
    capacity: u32,
}

@group(0) @binding(0) var<storage, read> rays: array<Ray>;
@group(0) @binding(1) var<storage, read_write> bits: array<u32>;
@group(0) @binding(2) var<storage, read_write> segments: array<vec2<u32>>;
@group(0) @binding(3) var<uniform> params: Params;
// One bit per cell in blocks of 4x4x4 cells (two words), then one per block in blocks of blocks.
@group(0) @binding(4) var<storage, read> grid: array<u32>;
@group(0) @binding(5) var<storage, read_write> owners: array<u32>;
@group(0) @binding(6) var<storage, read_write> intervals: array<vec2<f32>>;
@group(0) @binding(7) var<storage, read_write> spheres: array<vec4<f32>>;

const FAR: f32 = 3.0e38;

// How a ray is marched: distance of the first step's beginning, where the ray leaves the box, length of a step.
struct March {
    first: f32,
    leave: f32,
    step: f32,
}

// Distances at which a ray enters (not before 0) and leaves the box; enter >= leave when it misses.
fn intersect(ray: Ray) -> vec2<f32> {
    var enter = 0.0;
    var leave = FAR;
    for (var i = 0u; i < 3u; i++) {
        let below = params.aabb_min[i] - ray.origin[i];
        let above = params.aabb_max[i] - ray.origin[i];
        if ray.direction[i] == 0.0 {
            if below > 0.0 || above < 0.0 {
                return vec2<f32>(0.0);
            }
        } else {
            let inverse = 1.0 / ray.direction[i];
            enter = max(enter, min(below * inverse, above * inverse));
            leave = min(leave, max(below * inverse, above * inverse));
        }
    }
    return vec2<f32>(enter, leave);
}

fn start(ray: Ray, index: u32) -> March {
    let hit = intersect(ray);
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

// Side, in cells, of the largest empty cube of the hierarchy that holds a cell; 0 when the cell is occupied.
fn empty_around(cell: vec3<u32>) -> u32 {
    let blocks = params.resolution / 4u;
    let supers = (blocks + 3u) / 4u;
    let block = cell / 4u;
    let outer = block / 4u;
    let words = 2u * blocks * blocks * blocks;
    let at = words + 2u * (outer.x + supers * (outer.y + supers * outer.z));
    if (grid[at] | grid[at + 1u]) == 0u {
        return 16u;
    }
    let word = 2u * (block.x + blocks * (block.y + blocks * block.z));
    if (grid[word] | grid[word + 1u]) == 0u {
        return 4u;
    }
    let within = cell % 4u;
    let bit = within.x + 4u * (within.y + 4u * within.z);
    return select(1u, 0u, ((grid[word + bit / 32u] >> (bit % 32u)) & 1u) == 1u);
}

fn position_at(ray: Ray, t: f32) -> vec3<f32> {
    return (ray.origin + t * ray.direction - params.aabb_min) * params.inverse_extent;
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
        let scaled = position_at(ray, t) * f32(params.resolution);
        let cell = min(vec3<u32>(max(scaled, vec3<f32>(0.0))), vec3<u32>(params.resolution - 1u));
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
        var leave = FAR;
        for (var axis = 0u; axis < 3u; axis++) {
            if ray.direction[axis] == 0.0 {
                continue;
            }
            let lower = cell[axis] / size * size;
            let edge = f32(select(lower, lower + size, ray.direction[axis] > 0.0));
            let place = edge * params.cell_extent[axis] + params.aabb_min[axis];
            let distance = (place - ray.origin[axis]) / ray.direction[axis];
            if distance > t && distance < leave {
                leave = distance;
            }
        }
        // The first step whose middle is not before the exit; what rounding may move is asked rather than skipped.
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
    // What there is no room for is dropped from the end of the batch; the sums of the step count it.
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
            spheres[at] = vec4<f32>(position_at(ray, t), ray.slope * t);
            at += 1u;
        }
    }
}
