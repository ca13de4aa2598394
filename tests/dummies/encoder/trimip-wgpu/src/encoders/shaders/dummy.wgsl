// The encoder of `trimip_core::field::encoders::dummy`: one invocation writes the features of one sample.

@group(0) @binding(0) var<storage, read> spheres: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read_write> features: array<f32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> counts: array<u32>;

@compute @workgroup_size(GROUP)
fn dummy(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= counts[params.counter] {
        return;
    }
    let place = spheres[i].xyz;
    for (var j = 0u; j < params.stride; j++) {
        var value = 0.0;
        if j < params.width {
            value = params.lower + (params.upper - params.lower) * place[j];
        }
        features[params.stride * i + j] = value;
    }
}
