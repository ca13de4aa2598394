// Gradients of the density network's outputs, [samples, outputs]. The logit's gradient comes from the density, those
// of the geometry features from the colour network's input, [samples, width].

struct Params {
    counter: u32,
    // Width of the colour network's input: harmonics (if it uses directions), geometry features, zeros.
    width: u32,
    harmonics: u32,
    geometry: u32,
    // Width of the density network's output: a logit, geometry features, zeros.
    outputs: u32,
}

@group(0) @binding(0) var<storage, read> outputs: array<f32>;
@group(0) @binding(1) var<storage, read_write> rows: array<f32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> counts: array<u32>;
@group(0) @binding(4) var<storage, read> inputs: array<f32>;
@group(0) @binding(5) var<storage, read> gradients: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn density_gradients(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= counts[params.counter] {
        return;
    }
    let start = params.outputs * i;
    rows[start] = gradients[i].w * density_derivative(outputs[start]);
    for (var j = 0u; j < params.outputs - 1u; j++) {
        var value = 0.0;
        if j < params.geometry {
            value = inputs[params.width * i + params.harmonics + j];
        }
        rows[start + 1u + j] = value;
    }
}
