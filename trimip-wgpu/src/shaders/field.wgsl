// What lies between the layers of the two networks: densities, the colour network's input, colours, and the gradients
// there and back. Density outputs are [samples, 16]: one logit and 15 geometry features.

struct Ray {
    origin: vec3<f32>,
    slope: f32,
    direction: vec3<f32>,
    cosine: f32,
}

struct Params {
    counter: u32,
    // Width of the colour network's input: 16 harmonics, where it sees directions, 15 geometry features, zero.
    width: u32,
}

@group(0) @binding(0) var<storage, read> outputs: array<f32>;
@group(0) @binding(1) var<storage, read_write> radiance: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> counts: array<u32>;
@group(0) @binding(4) var<storage, read> rays: array<Ray>;
@group(0) @binding(5) var<storage, read> owners: array<u32>;
@group(0) @binding(6) var<storage, read_write> rows: array<f32>;
@group(0) @binding(7) var<storage, read> gradients: array<vec4<f32>>;

// Real spherical harmonics up to degree 4 of a unit direction; twin of `trimip_core::sh`.
fn spherical_harmonics(d: vec3<f32>) -> array<f32, 16> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    return array<f32, 16>(
        0.28209479177387814,
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.94617469575756 * zz - 0.31539156525252,
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        0.5900435899266435 * y * (yy - 3.0 * xx),
        2.890611442640554 * x * y * z,
        0.4570457994644657 * y * (1.0 - 5.0 * zz),
        0.3731763325901154 * z * (5.0 * zz - 3.0),
        0.4570457994644657 * x * (1.0 - 5.0 * zz),
        1.445305721320277 * z * (xx - yy),
        0.5900435899266435 * x * (3.0 * yy - xx),
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
        radiance[i] = vec4<f32>(0.0, 0.0, 0.0, density_of(outputs[16u * i]));
    }
}

// Rows of `width`.
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
    let geometry = start + params.width - 16u;
    if params.width > 16u {
        var harmonics = spherical_harmonics(rays[owners[i]].direction);
        for (var j = 0u; j < 16u; j++) {
            rows[start + j] = harmonics[j];
        }
    }
    for (var j = 1u; j < 16u; j++) {
        rows[geometry + j - 1u] = outputs[16u * i + j];
    }
    rows[geometry + 15u] = 0.0;
}

// Colours of the colour network's outputs, [samples, 16] of which three count.
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
