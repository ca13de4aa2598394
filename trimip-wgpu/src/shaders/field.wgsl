// Operations between the layers of the two networks: densities, the colour network's input, colours, and their
// gradients.

@group(0) @binding(0) var<storage, read> outputs: array<f32>;
@group(0) @binding(1) var<storage, read_write> radiance: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> counts: array<u32>;
@group(0) @binding(4) var<storage, read> rays: array<Ray>;
@group(0) @binding(5) var<storage, read> owners: array<u32>;
@group(0) @binding(6) var<storage, read_write> rows: array<f32>;
@group(0) @binding(7) var<storage, read> gradients: array<vec4<f32>>;

// Real spherical harmonics up to degree 4 of a unit direction; twin of `trimip_core::sh`, whose factors are `SH`.
fn spherical_harmonics(d: vec3<f32>) -> array<f32, 16> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    return array<f32, 16>(
        SH[0],
        -SH[1] * y,
        SH[1] * z,
        -SH[1] * x,
        SH[2] * x * y,
        -SH[2] * y * z,
        SH[3] * zz - SH[4],
        -SH[2] * x * z,
        SH[5] * (xx - yy),
        SH[6] * y * (yy - 3.0 * xx),
        SH[7] * x * y * z,
        SH[8] * y * (1.0 - 5.0 * zz),
        SH[9] * z * (5.0 * zz - 3.0),
        SH[8] * x * (1.0 - 5.0 * zz),
        SH[10] * z * (xx - yy),
        SH[6] * x * (3.0 * yy - xx),
    );
}

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

// One row of `width` floats per sample.
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
    let direction = rays[owners[i]].direction;
    if params.view > 0u && params.frequencies_of_view == 0u {
        var harmonics = spherical_harmonics(direction);
        for (var j = 0u; j < params.view; j++) {
            rows[start + j] = harmonics[j];
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

// Colours from the colour network's outputs, [samples, 16], of which the first three are used.
@compute @workgroup_size(GROUP)
fn colors(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i < counts[params.counter] {
        let logits = vec3<f32>(outputs[16u * i], outputs[16u * i + 1u], outputs[16u * i + 2u]);
        let rgb = vec3<f32>(sigmoid(logits.x), sigmoid(logits.y), sigmoid(logits.z));
        radiance[i] = vec4<f32>(rgb, radiance[i].w);
    }
}

// Gradients of the colour logits, [samples, 16].
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
        rows[16u * i + c] = gradients[i][c] * sigmoid_derivative(radiance[i][c]);
    }
    for (var c = 3u; c < 16u; c++) {
        rows[16u * i + c] = 0.0;
    }
}
