// Deferred shading: the mean of the samples' geometry features along each ray, the ray's colour, and their gradients. Mirrors
// `trimip_core::math::deferred`. One invocation per ray.

// Outputs of the density network, [samples, outputs]; in `ray_colors` those of the colour network, [rays, DIRECT].
@group(0) @binding(0) var<storage, read> outputs: array<f32>;
@group(0) @binding(1) var<storage, read_write> radiance: array<vec4<f32>>;
@group(0) @binding(3) var<storage, read> segments: array<vec2<u32>>;
@group(0) @binding(4) var<storage, read> intervals: array<vec2<f32>>;
// Fraction of each sample in the mean of its ray.
@group(0) @binding(5) var<storage, read_write> fractions: array<f32>;
// Opacity of each ray, or 0 if the ray has no colour, then the mean of its geometry features: [rays, outputs].
@group(0) @binding(6) var<storage, read_write> means: array<f32>;
// Number of rays.
@group(0) @binding(7) var<storage, read_write> counts: array<u32>;
// Gradients of density and colour.
@group(0) @binding(8) var<storage, read> gradients: array<vec4<f32>>;
// Gradients of the colour logits, [rays, DIRECT]; in `spread_gradients` those of the density network's outputs.
@group(0) @binding(9) var<storage, read_write> rows: array<f32>;
// Gradients of the colour network's input, [rays, width].
@group(0) @binding(10) var<storage, read_write> by_inputs: array<f32>;

@compute @workgroup_size(GROUP)
fn mean_outputs(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.rays {
        return;
    }
    if i == 0u {
        counts[0] = params.rays;
    }
    let segment = segments[i];
    let end = segment.x + segment.y;
    var opacity = 0.0;
    var before = 0.0;
    var transmittance = 1.0;
    for (var j = segment.x; j < end; j++) {
        let depth = radiance[j].w * intervals[j].y;
        let weight = transmittance * alpha_of(depth);
        fractions[j] = weight;
        opacity += weight;
        before += depth;
        transmittance = exp(-before);
    }
    let mean = params.outputs * i;
    for (var k = 0u; k < params.outputs; k++) {
        means[mean + k] = 0.0;
    }
    if segment.y == 0u || opacity < LEAST_OPACITY {
        for (var j = segment.x; j < end; j++) {
            fractions[j] = 0.0;
        }
        return;
    }
    for (var j = segment.x; j < end; j++) {
        let fraction = fractions[j] / opacity;
        fractions[j] = fraction;
        for (var k = 1u; k <= params.geometry; k++) {
            means[mean + k] += fraction * outputs[params.outputs * j + k];
        }
    }
    means[mean] = select(opacity, 0.0, opacity < params.least);
}

@compute @workgroup_size(GROUP)
fn ray_colors(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.rays {
        return;
    }
    let segment = segments[i];
    var rgb = vec3<f32>(0.0);
    // The comparison is true for NaN: such a ray has a colour, and the step reports it.
    if !(means[params.outputs * i] == 0.0) {
        let red = DIRECT * i;
        rgb = vec3<f32>(sigmoid(outputs[red]), sigmoid(outputs[red + 1u]), sigmoid(outputs[red + 2u]));
    }
    for (var j = segment.x; j < segment.x + segment.y; j++) {
        radiance[j] = vec4<f32>(rgb, radiance[j].w);
    }
}

// A black ray has no gradient, because the derivative of a colour of 0 with respect to its logit is 0.
@compute @workgroup_size(GROUP)
fn ray_color_gradients(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.rays {
        return;
    }
    let segment = segments[i];
    var by_color = vec3<f32>(0.0);
    for (var j = segment.x; j < segment.x + segment.y; j++) {
        by_color += gradients[j].rgb;
    }
    for (var c = 0u; c < DIRECT; c++) {
        var by_logit = 0.0;
        if c < 3u && segment.y > 0u {
            by_logit = by_color[c] * sigmoid_derivative(radiance[segment.x][c]);
        }
        rows[DIRECT * i + c] = by_logit;
    }
}

// Returns the slope of sample `j`: the gradient of its ray's mean times the sample's features. `by_mean` is the index of the
// gradient.
fn slope_of(j: u32, by_mean: u32) -> f32 {
    var slope = 0.0;
    for (var k = 0u; k < params.geometry; k++) {
        slope += by_inputs[by_mean + k] * outputs[params.outputs * j + 1u + k];
    }
    return slope;
}

@compute @workgroup_size(GROUP)
fn spread_gradients(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.rays {
        return;
    }
    let segment = segments[i];
    let end = segment.x + segment.y;
    let opacity = means[params.outputs * i];
    let by_mean = params.width * i + params.view;
    let is_lit = !(opacity == 0.0);
    // The gradients of the sines and cosines are added to those of the values.
    for (var k = 0u; k < params.geometry; k++) {
        var value = by_inputs[by_mean + k];
        let x = means[params.outputs * i + 1u + k];
        var factor = 1.0;
        for (var f = 0u; f < params.geometry_frequencies; f++) {
            let at = by_mean + params.geometry * (1u + 2u * f) + k;
            value += factor * (by_inputs[at] * cos(factor * x) - by_inputs[at + params.geometry] * sin(factor * x));
            factor *= 2.0;
        }
        by_inputs[by_mean + k] = value;
    }
    var mean = 0.0;
    for (var j = segment.x; j < end; j++) {
        let slope = slope_of(j, by_mean);
        rows[params.outputs * j] = slope;
        mean += fractions[j] * slope;
    }
    var largest = 0.0;
    for (var j = segment.x; j < end; j++) {
        largest = max(largest, abs(rows[params.outputs * j] - mean));
    }
    var passed = 0.0;
    var before = 0.0;
    for (var j = segment.x; j < end; j++) {
        let start = params.outputs * j;
        let logit = outputs[start] - params.shift;
        let length = intervals[j].y;
        let difference = rows[start] - mean;
        before += params.scale * density_of(params.density, logit) * length;
        var by_depth = 0.0;
        if is_lit {
            let light = exp(-before) / opacity;
            let most = light * largest;
            passed += fractions[j] * difference;
            by_depth = light * difference + clamp(passed, -most, most);
        }
        let by_density = gradients[j].w + by_depth * length;
        rows[start] = by_density * params.scale * density_derivative(params.density, logit);
        for (var k = 0u; k + 1u < params.outputs; k++) {
            var by_output = 0.0;
            if k < params.geometry && is_lit {
                by_output = fractions[j] * by_inputs[by_mean + k];
            }
            rows[start + 1u + k] = by_output;
        }
    }
}
