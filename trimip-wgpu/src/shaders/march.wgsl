// Ray marching. `march` finds the steps that lie in occupied cells, sets one bit for each of them, and counts them.
// After a prefix sum of the counts, `place` turns the bits into samples. Mirrors the CPU's renderer.

@group(0) @binding(0) var<storage, read> rays: array<Ray>;
@group(0) @binding(1) var<storage, read_write> bits: array<u32>;
@group(0) @binding(2) var<storage, read_write> segments: array<vec2<u32>>;
@group(0) @binding(3) var<uniform> params: Params;
@group(0) @binding(5) var<storage, read_write> owners: array<u32>;
@group(0) @binding(6) var<storage, read_write> intervals: array<vec2<f32>>;
@group(0) @binding(7) var<storage, read_write> spheres: array<vec4<f32>>;

// Returns the march of ray `index` of the training step.
fn start(ray: Ray, index: u32) -> March {
    let parameterisation = parameterisation_of(params.space, ray);
    var offset = 0.0;
    if params.jitter != 0u {
        offset = unit(random_bits(params.draws, index).x);
    }
    return march_along(parameterisation, volume_step(ray, parameterisation), offset);
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
    let last = f32(32u * params.words);
    var index = next_occupied(ray, m, 0.0, last);
    var count = 0u;
    while index < last {
        let step = u32(index);
        while word < step / 32u {
            bits[base + word] = word_bits;
            word_bits = 0u;
            word += 1u;
        }
        word_bits |= 1u << (step % 32u);
        count += 1u;
        index = next_occupied(ray, m, index + 1.0, last);
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
    let segment = fitting(segments[i], params.capacity);
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
            let t = middle(m, f32(32u * word + bit));
            owners[at] = i;
            intervals[at] = vec2<f32>(t, length_at(params.space, m.parameterisation, ray, t, m.step));
            spheres[at] = sphere_at(params.space, ray, t);
            at += 1u;
        }
    }
}
