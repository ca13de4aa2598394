// Evaluates the terms of each pixel, weighted by area, and their gradient with respect to the pixel. The sums over a workgroup's pixels are
// written to `partial`; `loss_sums.wgsl` adds them up. Needs the functions `exposed` and `unexposed`. `penalty` (the photometric term),
// `PixelTerms` and `pixel_terms` are generated from the registered terms.

@group(0) @binding(0) var<storage, read> pixels: array<f32>;
@group(0) @binding(1) var<storage, read_write> gradients: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> targets: array<f32>;
// Loss, weight, squared error, number of non-finite pixels.
@group(0) @binding(4) var<storage, read_write> partial: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read> segments: array<vec2<u32>>;
// First cone and number of cones of each pixel.
@group(0) @binding(8) var<storage, read> pixel_groups: array<vec2<u32>>;

// Mirrors `trimip_core::scene::edge_exponents`: a photograph shows the pixel P + (1 - A) * background as P * A^exponent + (1 - A) *
// background.
fn shown(pixel: vec4<f32>, background: vec3<f32>, exponent: f32) -> vec3<f32> {
    if exponent == 0.0 {
        return pixel.rgb;
    }
    let behind = (1.0 - pixel.a) * background;
    return (pixel.rgb - behind) * pow(max(pixel.a, LEAST_OPACITY), exponent) + behind;
}

// Returns the gradient with respect to the pixel's colour and opacity, given the gradient `by` with respect to the
// colour that is shown.
fn shown_gradient(pixel: vec4<f32>, background: vec3<f32>, exponent: f32, by: vec3<f32>) -> vec4<f32> {
    if exponent == 0.0 {
        return vec4<f32>(by, 0.0);
    }
    let base = max(pixel.a, LEAST_OPACITY);
    let factor = pow(base, exponent);
    let slope = select(0.0, exponent * factor / base, pixel.a > LEAST_OPACITY);
    let own = pixel.rgb - (1.0 - pixel.a) * background;
    return vec4<f32>(by * factor, dot(by, own * slope - background * (1.0 - factor)));
}

fn has_samples(own: vec2<u32>) -> bool {
    var samples = 0u;
    for (var cone = own.x; cone < own.x + own.y; cone++) {
        samples += segments[cone].y;
    }
    return samples > 0u;
}

@compute @workgroup_size(GROUP)
fn evaluate(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    var own = vec4<f32>(0.0);
    if i < params.count {
        let first = PIXEL_FLOATS * i;
        let pixel = vec4<f32>(pixels[first], pixels[first + 1u], pixels[first + 2u], pixels[first + 3u]);
        let at = TARGET_FLOATS * i;
        let weight = targets[at + TARGET_WEIGHT];
        let place = at + TARGET_BACKGROUND;
        let background = vec3<f32>(targets[place], targets[place + 1u], targets[place + 2u]);
        let exponent = targets[at + TARGET_EXPONENT];
        let behind = (1.0 - targets[at + TARGET_OPACITY]) * background;
        let seen = exposed(i, shown(pixel, background, exponent), behind);
        let counted = params.live == 0u || has_samples(pixel_groups[i]);
        var loss = 0.0;
        var squared = 0.0;
        var finite = true;
        var by_colour = vec3<f32>(0.0);
        for (var c = 0u; c < 3u; c++) {
            let difference = seen[c] - targets[at + c];
            finite = finite && is_finite(difference);
            let value = penalty(difference);
            loss += value.x / 3.0;
            squared += select(0.0, targets[at + TARGET_IMPORTANCE] * difference * difference, weight > 0.0);
            by_colour[c] = select(0.0, weight * value.y / 3.0, counted);
        }
        if finite {
            by_colour = unexposed(i, by_colour, seen - behind);
        }
        var gradient = shown_gradient(pixel, background, exponent, by_colour);
        loss = pixel_terms(loss, pixel, at, select(0.0, weight, counted), &gradient);
        gradients[i] = gradient;
        own = vec4<f32>(select(0.0, weight * loss, counted), select(0.0, weight, counted), squared, 0.0);
        if !finite {
            own = vec4<f32>(0.0, 0.0, 0.0, 1.0);
            gradients[i] = vec4<f32>(0.0);
        }
    }
    let sum = workgroup_sum(local, own);
    let block = group.y * groups.x + group.x;
    if local == 0u && block < params.blocks {
        partial[block] = sum;
    }
}
