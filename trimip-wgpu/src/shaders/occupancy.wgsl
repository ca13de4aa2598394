// The occupancy grid: selection of cells, their densities, and the occupied bits. Mirrors `trimip_core::geometry::occupancy`
// and the CPU's grid. `state` holds the numbers of selected cells, of occupied cells, and of cells that this tile queries.

@group(0) @binding(0) var<storage, read_write> state: array<atomic<u32>>;
@group(0) @binding(1) var<storage, read_write> grid: array<u32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read_write> chosen: array<u32>;
@group(0) @binding(4) var<storage, read_write> spheres: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> radiance: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> densities: array<f32>;
@group(0) @binding(7) var<storage, read_write> partial: array<f32>;
@group(0) @binding(8) var<storage, read_write> rays: array<Ray>;
@group(0) @binding(9) var<storage, read_write> owners: array<u32>;
@group(0) @binding(10) var<storage, read_write> intervals: array<vec2<f32>>;

fn is_occupied(cell: vec3<u32>) -> bool {
    let own = bit_of(cell, params.space.resolution / SIDE);
    return ((grid[own.word] >> own.bit) & 1u) == 1u;
}

fn coordinates(cell: u32, side: u32) -> vec3<u32> {
    return vec3<u32>(cell % side, cell / side % side, cell / (side * side));
}

// Returns a unit direction from 32 random bits: the upper half gives the height, the lower half the angle.
fn direction_of(bits: u32) -> vec3<f32> {
    let part = (vec2<f32>(f32(bits >> 16u), f32(bits & 0xffffu)) + 0.5) / 65536.0;
    let height = 2.0 * part.x - 1.0;
    let angle = 6.283185307179586 * part.y;
    let radius = sqrt(1.0 - height * height);
    return vec3<f32>(radius * cos(angle), radius * sin(angle), height);
}

// Lists the selected cells. Their order does not matter, because each cell is evaluated on its own.
@compute @workgroup_size(GROUP)
fn choose(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let cell = index_of(group, groups, local);
    if cell >= params.cells || densities[cell] < 0.0 {
        return;
    }
    var asked = params.fraction >= 1.0;
    if !asked {
        let bits = random_bits(params.cell_draws, cell);
        let probability = params.fraction * f32(params.cells) / f32(max(atomicLoad(&state[OCCUPIED]), 1u));
        asked = unit(bits.x) < params.fraction
            || (is_occupied(coordinates(cell, params.space.resolution)) && unit(bits.y) < probability);
    }
    if asked {
        chosen[atomicAdd(&state[CHOSEN], 1u)] = cell;
    }
}

@compute @workgroup_size(GROUP)
fn probes(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    let all = atomicLoad(&state[CHOSEN]);
    let count = min(all - min(all, params.first), params.capacity);
    if i == 0u {
        atomicStore(&state[ASKED], count);
    }
    if i >= count {
        return;
    }
    let cell = chosen[params.first + i];
    let bits = random_bits(params.point_draws, cell);
    let offset = vec3<f32>(unit(bits.x), unit(bits.y), unit(bits.z));
    let corner = vec3<f32>(coordinates(cell, params.space.resolution));
    let position = (corner + offset) / f32(params.space.resolution);
    let direction = direction_of(bits.w);
    let t = params.space.longest;
    rays[i] = Ray(to_world(params.space, position) - t * direction, params.radius / t, direction, 1.0, 0.0);
    owners[i] = i;
    intervals[i] = vec2<f32>(t, params.step_length);
    spheres[i] = vec4<f32>(position, params.radius);
}

@compute @workgroup_size(GROUP)
fn absorb(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= atomicLoad(&state[CHOSEN]) {
        return;
    }
    let cell = chosen[i];
    densities[cell] = max(params.decay * densities[cell], radiance[i].w * params.step_length);
}

@compute @workgroup_size(GROUP)
fn sum_densities(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    var own = 0.0;
    if i < params.cells {
        own = max(densities[i], 0.0);
    }
    let sum = workgroup_sum(local, own);
    let block = group.y * groups.x + group.x;
    if local == 0u && block < params.blocks {
        partial[block] = sum;
    }
}

// Writes the threshold of this refresh to `partial[0]` and sets the count of occupied cells to zero.
@compute @workgroup_size(GROUP)
fn find_threshold(@builtin(local_invocation_index) local: u32) {
    var own = 0.0;
    for (var i = local; i < params.blocks; i += GROUP) {
        own += partial[i];
    }
    let sum = workgroup_sum(local, own);
    if local == 0u {
        partial[0] = min(sum / f32(params.inside), params.threshold);
        atomicStore(&state[OCCUPIED], 0u);
    }
}

// Returns the bits of a block's cells; a bit is set if its cell is denser than `limit`.
fn denser(block: u32, limit: f32) -> vec2<u32> {
    let corner = coordinates(block, params.space.resolution / SIDE) * SIDE;
    var words = vec2<u32>(0u);
    for (var bit = 0u; bit < SIDE * SIDE * SIDE; bit++) {
        let cell = corner + coordinates(bit, SIDE);
        let index = cell.x + params.space.resolution * (cell.y + params.space.resolution * cell.z);
        if densities[index] > limit {
            words[bit / 32u] |= 1u << (bit % 32u);
        }
    }
    return words;
}

// One invocation per block of 64 cells.
@compute @workgroup_size(GROUP)
fn set_bits(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let block = index_of(group, groups, local);
    let side = params.space.resolution / SIDE;
    if block >= side * side * side {
        return;
    }
    let words = denser(block, partial[0]);
    grid[2u * block] = words.x;
    grid[2u * block + 1u] = words.y;
    atomicAdd(&state[OCCUPIED], countOneBits(words.x) + countOneBits(words.y));
}

// If all densities are equal, none is above their mean. Without this rule, such a grid would stay empty.
@compute @workgroup_size(GROUP)
fn fill_if_empty(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let block = index_of(group, groups, local);
    let side = params.space.resolution / SIDE;
    if block < side * side * side && atomicLoad(&state[OCCUPIED]) == 0u {
        let words = denser(block, -0.5);
        grid[2u * block] = words.x;
        grid[2u * block + 1u] = words.y;
    }
}

// One invocation per block of blocks.
@compute @workgroup_size(GROUP)
fn set_outer_bits(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let outer = index_of(group, groups, local);
    let side = params.space.resolution / SIDE;
    let outer_side = (side + SIDE - 1u) / SIDE;
    if outer >= outer_side * outer_side * outer_side {
        return;
    }
    let corner = coordinates(outer, outer_side) * SIDE;
    var words = vec2<u32>(0u);
    for (var bit = 0u; bit < SIDE * SIDE * SIDE; bit++) {
        let block = corner + coordinates(bit, SIDE);
        if any(block >= vec3<u32>(side)) {
            continue;
        }
        let word = 2u * (block.x + side * (block.y + side * block.z));
        if (grid[word] | grid[word + 1u]) != 0u {
            words[bit / 32u] |= 1u << (bit % 32u);
        }
    }
    let at = 2u * (side * side * side + outer);
    grid[at] = words.x;
    grid[at + 1u] = words.y;
    // If `fill_if_empty` filled the grid, all cells of the hull count as occupied.
    if outer == 0u && atomicLoad(&state[OCCUPIED]) == 0u {
        atomicStore(&state[OCCUPIED], params.inside);
    }
}
