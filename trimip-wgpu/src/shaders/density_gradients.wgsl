// Gradients of the density network's outputs, [samples, 16]: the logit's from the density, the geometry features' from
// the colour network's input [samples, width].

struct Params {
    counter: u32,
    width: u32,
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
    rows[16u * i] = gradients[i].w * density_derivative(outputs[16u * i]);
    let geometry = params.width * (i + 1u) - 16u;
    for (var j = 1u; j < 16u; j++) {
        rows[16u * i + j] = inputs[geometry + j - 1u];
    }
}
