// Draws samples with probabilities proportional to the norms of the gradients of their logits, but at most 1. The draw is
// systematic along each ray: a sample is drawn wherever the sum of the probabilities reaches a whole number. The gradients of
// drawn samples are divided by their probabilities. One invocation per ray.

@group(0) @binding(0) var<storage, read> outputs: array<f32>;
@group(0) @binding(1) var<storage, read> radiance: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> segments: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read_write> gradients: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> marks: array<u32>;

// Returns the norm of the gradient with respect to a sample's logits.
fn norm_of(j: u32) -> f32 {
    let gradient = gradients[j];
    let slope = params.scale * density_derivative(params.density, outputs[params.outputs * j] - params.shift);
    var sum = (gradient.w * slope) * (gradient.w * slope);
    for (var c = 0u; c < 3u; c++) {
        let value = radiance[j][c];
        let by_logit = gradient[c] * select(sigmoid_derivative(value), select(0.0, 1.0, value > 0.0), params.direct == 1u);
        sum += by_logit * by_logit;
    }
    return sqrt(sum);
}

@compute @workgroup_size(GROUP)
fn draw(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    let segment = segments[i];
    var sum = unit(random_bits(params.draws, params.first + i).x);
    for (var j = segment.x; j < segment.x + segment.y; j++) {
        let norm = norm_of(j);
        var probability = 1.0;
        if norm < params.threshold {
            probability = norm / params.threshold;
        }
        sum += probability;
        if sum >= 1.0 {
            sum -= 1.0;
            marks[j] = 1u;
            gradients[j] = gradients[j] * (1.0 / probability);
        } else {
            marks[j] = 0u;
        }
    }
}
