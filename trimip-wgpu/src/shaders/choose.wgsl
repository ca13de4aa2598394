// Chooses samples with the proxy of the model (hybrid rendering). `count` walks each ray and counts its samples. After a
// prefix sum of the counts, `fill` walks each ray again and writes its samples. A ray that is too wide for the proxy gets
// the samples of volume rendering. Mirrors `trimip_core::engine::proxy::Chooser` and the CPU's hybrid renderer.

@group(0) @binding(0) var<storage, read> rays: array<Ray>;
// 1 for each ray whose samples the proxy chooses, 0 for each ray that is too wide.
@group(0) @binding(1) var<storage, read_write> sure: array<u32>;
@group(0) @binding(2) var<storage, read_write> segments: array<vec2<u32>>;
@group(0) @binding(3) var<uniform> params: Params;
@group(0) @binding(5) var<storage, read_write> owners: array<u32>;
@group(0) @binding(6) var<storage, read_write> intervals: array<vec2<f32>>;
@group(0) @binding(7) var<storage, read_write> spheres: array<vec4<f32>>;
// For each code, the optical depth and opacity of a step (floats); then one word per brick; then the cells' codes,
// eight per word.
@group(0) @binding(8) var<storage, read> proxy: array<u32>;

// A step that represents a group of steps: its midpoint, its predicted optical depth, and the optical depth of the
// group.
struct Chosen {
    t: f32,
    own: f32,
    depth: f32,
}

struct Walker {
    m: March,
    // Index of the next step.
    index: f32,
    transmittance: f32,
    // Weight of the steps that were left out since the last sample, and the step of largest optical depth among them.
    light: f32,
    lent: Chosen,
    // The last sample, which is returned when the next sample is found.
    held: Chosen,
    holds: bool,
    ended: bool,
    sure: bool,
    // The sample that was found.
    found: Chosen,
    // For the rule of layers: the number of layers so far, and the distance of the last step in a surface; then, of the
    // layer that is being filled, the distance of its next sample, the length of its samples, its end, and the number
    // of samples that are left.
    layers: u32,
    dense: f32,
    next: f32,
    length: f32,
    end: f32,
    left: u32,
}

fn walk(ray: Ray) -> Walker {
    let none = Chosen(0.0, 0.0, 0.0);
    let m = march_along(parameterisation_of(params.space, ray), params.step, 0.0);
    return Walker(m, 0.0, 1.0, 0.0, none, none, false, false, true, none, 0u, -FAR, 0.0, 0.0, -FAR, 0u);
}

// Returns the code of the proxy's cell at a position in the cube.
fn code_at(position: vec3<f32>) -> u32 {
    let scaled = max(position * vec3<f32>(params.cells), vec3<f32>(0.0));
    let cell = min(vec3<u32>(scaled), params.cells - 1u);
    let brick = cell / BRICK;
    let sides = params.cells / BRICK;
    let place = proxy[params.bricks + brick.x + sides.x * (brick.y + sides.y * brick.z)];
    if place == 0u {
        return 0u;
    }
    let within = cell % BRICK;
    let at = (place - 1u) * BRICK * BRICK * BRICK + within.x + BRICK * (within.y + BRICK * within.z);
    return (proxy[params.codes + at / 8u] >> (4u * (at % 8u))) & 0xfu;
}

// Finds the next sample of a ray. Returns false at the end of the ray, and where the ray is too wide for the proxy.
fn next_sample(ray: Ray, walker: ptr<function, Walker>) -> bool {
    var w = *walker;
    var found = false;
    while !found {
        if w.left > 0u {
            w.found = Chosen(w.next, 1.0, w.length / params.step);
            w.next += w.length;
            w.left -= 1u;
            found = true;
            break;
        }
        if w.ended {
            if w.holds {
                w.found = w.held;
                w.found.depth += w.lent.depth + select(0.0, params.behind, w.transmittance < params.opaque);
                found = true;
                w.holds = false;
            }
            break;
        }
        let index = next_occupied(ray, w.m, w.index, params.last);
        w.index = index + 1.0;
        if index >= params.last {
            w.ended = true;
            continue;
        }
        let t = middle(w.m, index);
        let sphere = sphere_at(params.space, ray, t);
        // The spheres of a wide cone may touch cells with density even where its axis misses them.
        if sphere.w > params.widest {
            w.sure = false;
            break;
        }
        let code = code_at(sphere.xyz);
        if code == 0u {
            continue;
        }
        let depth = bitcast<f32>(proxy[2u * code]);
        if params.layers > 0u {
            if depth >= params.surface {
                if t - w.dense > 1.5 * params.step {
                    let first = max(t - params.delta, w.end);
                    w.end = t + params.delta;
                    w.length = (w.end - first) / f32(params.samples);
                    w.next = first + 0.5 * w.length;
                    w.left = params.samples;
                    w.layers += 1u;
                }
                w.dense = t;
                w.ended = w.layers == params.layers;
            }
            continue;
        }
        let weight = w.transmittance * bitcast<f32>(proxy[2u * code + 1u]);
        w.transmittance -= weight;
        w.ended = w.transmittance < params.opaque;
        w.light += weight;
        var best = Chosen(t, depth, w.lent.depth + depth);
        if depth <= w.lent.own {
            best = Chosen(w.lent.t, w.lent.own, best.depth);
        }
        if w.light < params.least {
            w.lent = best;
            continue;
        }
        found = w.holds;
        w.found = w.held;
        w.held = best;
        w.holds = true;
        w.light = 0.0;
        w.lent = Chosen(0.0, 0.0, 0.0);
    }
    *walker = w;
    return found;
}

fn length_of(chosen: Chosen) -> f32 {
    return params.step * (chosen.depth / chosen.own);
}

fn volume_march(ray: Ray) -> March {
    let parameterisation = parameterisation_of(params.space, ray);
    return march_along(parameterisation, volume_step(ray, parameterisation), 0.0);
}

@compute @workgroup_size(GROUP)
fn count(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    let ray = rays[i];
    var walker = walk(ray);
    var count = 0u;
    while next_sample(ray, &walker) {
        count += 1u;
    }
    sure[i] = u32(walker.sure);
    if !walker.sure {
        count = 0u;
        let m = volume_march(ray);
        var index = next_occupied(ray, m, 0.0, params.last);
        while index < params.last {
            count += 1u;
            index = next_occupied(ray, m, index + 1.0, params.last);
        }
    }
    segments[i] = vec2<u32>(0u, count);
}

fn place(at: u32, ray: u32, t: f32, length: f32) {
    owners[at] = ray;
    intervals[at] = vec2<f32>(t, length);
    spheres[at] = sphere_at(params.space, rays[ray], t);
}

@compute @workgroup_size(GROUP)
fn fill(
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
    let end = segment.x + segment.y;
    var at = segment.x;
    if sure[i] == 1u {
        var walker = walk(ray);
        while at < end && next_sample(ray, &walker) {
            place(at, i, walker.found.t, length_of(walker.found));
            at += 1u;
        }
    } else {
        let m = volume_march(ray);
        var index = 0.0;
        while at < end {
            index = next_occupied(ray, m, index, params.last);
            place(at, i, middle(m, index), m.step);
            index += 1.0;
            at += 1u;
        }
    }
}
