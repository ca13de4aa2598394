// Operations before and after the two networks: densities, the colour network's input, colours, and their gradients.

@group(0) @binding(0) var<storage, read> outputs: array<f32>;
@group(0) @binding(1) var<storage, read_write> radiance: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> counts: array<u32>;
@group(0) @binding(4) var<storage, read> rays: array<Ray>;
@group(0) @binding(5) var<storage, read> owners: array<u32>;
@group(0) @binding(6) var<storage, read_write> rows: array<f32>;
@group(0) @binding(7) var<storage, read> gradients: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn densities(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i < counts[params.counter] {
        radiance[i] = vec4<f32>(0.0, 0.0, 0.0, params.scale * density_of(params.density, outputs[params.outputs * i] - params.shift));
    }
}

// Writes one row of `width` floats per sample, or per ray with deferred shading.
@compute @workgroup_size(GROUP)
fn color_inputs(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= counts[params.counter] {
        return;
    }
    let start = params.width * i;
    var ray = i;
    if params.deferred == 0u {
        ray = owners[i];
    }
    let direction = rays[ray].direction;
    if params.view > 0u && params.encoding == HARMONICS {
        var harmonics = spherical_harmonics(direction);
        for (var j = 0u; j < params.view; j++) {
            rows[start + j] = harmonics[j];
        }
    } else if params.view > 0u && params.encoding == VORONOI {
        var weights = soft_voronoi(direction, params.sharpness);
        for (var j = 0u; j < params.view; j++) {
            rows[start + j] = weights[j];
        }
    } else if params.view > 0u {
        for (var j = 0u; j < 3u; j++) {
            rows[start + j] = direction[j];
            append_frequencies(start, 3u, j, direction[j], params.view_frequencies);
        }
    }
    let first = start + params.view;
    for (var j = 0u; j < params.geometry; j++) {
        let value = outputs[params.outputs * i + 1u + j];
        rows[first + j] = value;
        append_frequencies(first, params.geometry, j, value, params.geometry_frequencies);
    }
    let used = params.view + params.geometry * (1u + 2u * params.geometry_frequencies);
    for (var j = used; j < params.width; j++) {
        rows[start + j] = 0.0;
    }
}

// Writes the sines and cosines of value number `j` of `count` values of the row that begins at `first`.
fn append_frequencies(first: u32, count: u32, j: u32, value: f32, frequencies: u32) {
    var factor = 1.0;
    for (var k = 0u; k < frequencies; k++) {
        let at = first + count * (1u + 2u * k) + j;
        rows[at] = sin(factor * value);
        rows[at + count] = cos(factor * value);
        factor *= 2.0;
    }
}

// Computes colours from the first three outputs of the colour network, [samples, DIRECT]; without networks, from the three
// values after the density logit.
@compute @workgroup_size(GROUP)
fn colors(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i < counts[params.counter] {
        let red = DIRECT * i + params.direct;
        let logits = vec3<f32>(outputs[red], outputs[red + 1u], outputs[red + 2u]);
        var rgb = vec3<f32>(sigmoid(logits.x), sigmoid(logits.y), sigmoid(logits.z));
        if params.direct == 1u {
            rgb = max(logits + 0.5, vec3<f32>(0.0));
        }
        radiance[i] = vec4<f32>(rgb, radiance[i].w);
    }
}

// Computes the gradients of the colour logits, [samples, DIRECT].
@compute @workgroup_size(GROUP)
fn color_gradients(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= counts[params.counter] {
        return;
    }
    for (var c = 0u; c < 3u; c++) {
        let value = radiance[i][c];
        let slope = select(sigmoid_derivative(value), select(0.0, 1.0, value > 0.0), params.direct == 1u);
        rows[DIRECT * i + c] = gradients[i][c] * slope;
    }
    for (var c = 3u; c < DIRECT; c++) {
        rows[DIRECT * i + c] = 0.0;
    }
}
