// AdamW; mirrors `trimip_core::field::adamw::Rule`, four parameters per invocation. If the loss weights of a step sum
// to 0, nothing changes.

@group(0) @binding(0) var<storage, read_write> parameters: array<vec4<f32>>;
@group(0) @binding(1) var<storage, read> gradients: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read_write> first_moments: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> second_moments: array<vec4<f32>>;
// The second value is the sum of the loss weights.
@group(0) @binding(5) var<storage, read> sums: array<f32>;
@group(0) @binding(6) var<storage, read_write> skipped: array<atomic<u32>>;

@compute @workgroup_size(GROUP)
fn update(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count || !(sums[1] > 0.0) {
        return;
    }
    let at = params.start + i;
    let raw = gradients[at];
    var moves = vec4<bool>(true);
    if params.group >= 4u && all(raw == vec4<f32>(0.0)) {
        let fours = params.group / 4u;
        let first = params.start + i / fours * fours;
        var none = true;
        for (var j = 0u; j < fours; j++) {
            none = none && all(gradients[first + j] == vec4<f32>(0.0));
        }
        if none {
            return;
        }
    } else if params.group == 2u {
        let pairs = vec2<bool>(any(raw.xy != vec2<f32>(0.0)), any(raw.zw != vec2<f32>(0.0)));
        moves = pairs.xxyy;
    } else if params.group == 1u {
        moves = raw != vec4<f32>(0.0);
    }
    let gradient = raw / sums[1];
    var parameter = parameters[at];
    var m = first_moments[at];
    var v = second_moments[at];
    for (var c = 0u; c < 4u; c++) {
        if !moves[c] {
            continue;
        }
        let raw_gradient = gradient[c];
        // Skips a gradient whose square overflows f32 or is NaN.
        if (bitcast<u32>(raw_gradient * raw_gradient) & 0x7f800000u) == 0x7f800000u {
            atomicAdd(&skipped[0], 1u);
            continue;
        }
        let g = raw_gradient + select(params.sparsity, -params.sparsity, parameter[c] < 0.0);
        m[c] = params.beta1 * m[c] + params.share1 * g;
        v[c] = params.beta2 * v[c] + params.share2 * g * g;
        parameter[c] = parameter[c] * params.shrink
            - params.rate * m[c] / (sqrt(v[c]) * params.root_correction + params.epsilon);
    }
    parameters[at] = parameter;
    first_moments[at] = m;
    second_moments[at] = v;
}
