// Computes the gradients of the density network's outputs, [samples, outputs]. The gradient of the logit comes from the
// density. The gradients of the geometry features come from the gradients of the colour network's input, [samples,
// width].

@group(0) @binding(0) var<storage, read> outputs: array<f32>;
@group(0) @binding(1) var<storage, read_write> rows: array<f32>;
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
    let slope = params.scale * density_derivative(params.density, outputs[start] - params.shift);
    rows[start] = gradients[i].w * slope;
    let first = params.width * i + params.view;
    for (var j = 0u; j < params.outputs - 1u; j++) {
        var value = 0.0;
        if j < params.geometry {
            value = inputs[first + j];
            let x = outputs[start + 1u + j];
            var factor = 1.0;
            for (var k = 0u; k < params.geometry_frequencies; k++) {
                let at = first + params.geometry * (1u + 2u * k) + j;
                value += factor * (inputs[at] * cos(factor * x) - inputs[at + params.geometry] * sin(factor * x));
                factor *= 2.0;
            }
        }
        rows[start + 1u + j] = value;
    }
}
