// Volume rendering along each cone, and the mean of the cones of each pixel.

@group(0) @binding(0) var<storage, read> segments: array<vec2<u32>>;
// Colour, opacity and depth of each pixel.
@group(0) @binding(1) var<storage, read_write> pixels: array<f32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> radiance: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> intervals: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read> rays: array<Ray>;
@group(0) @binding(6) var<storage, read> targets: array<f32>;
// First cone and number of cones of each pixel.
@group(0) @binding(7) var<storage, read> pixel_groups: array<vec2<u32>>;
// Colour, opacity and depth of each cone.
@group(0) @binding(8) var<storage, read_write> cones: array<f32>;

// Returns the colour of a cone on the background, its opacity and its depth.
fn composite_cone(cone: u32, background: vec3<f32>) -> array<f32, PIXEL_FLOATS> {
    let segment = segments[cone];
    var rgb = vec3<f32>(0.0);
    var opacity = 0.0;
    var distance = 0.0;
    var depth_before = 0.0;
    var transmittance = 1.0;
    for (var j = segment.x; j < segment.x + segment.y; j++) {
        let depth = radiance[j].w * intervals[j].y;
        let weight = transmittance * alpha_of(depth);
        rgb += weight * radiance[j].rgb;
        opacity += weight;
        distance += weight * intervals[j].x;
        depth_before += depth;
        transmittance = exp(-depth_before);
    }
    rgb += transmittance * background;
    return array<f32, PIXEL_FLOATS>(rgb.r, rgb.g, rgb.b, min(opacity, 1.0), distance * rays[cone].cosine);
}

@compute @workgroup_size(GROUP)
fn composite(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    var background = params.background;
    if params.targets != 0u {
        let at = TARGET_FLOATS * i + TARGET_BACKGROUND;
        background = vec3<f32>(targets[at], targets[at + 1u], targets[at + 2u]);
    }
    let own = pixel_groups[i];
    var sum: array<f32, PIXEL_FLOATS>;
    for (var cone = own.x; cone < own.x + own.y; cone++) {
        let values = composite_cone(cone, background);
        for (var c = 0u; c < PIXEL_FLOATS; c++) {
            cones[PIXEL_FLOATS * cone + c] = values[c];
            sum[c] += values[c];
        }
    }
    let fraction = 1.0 / f32(own.y);
    for (var c = 0u; c < PIXEL_FLOATS; c++) {
        pixels[PIXEL_FLOATS * i + c] = sum[c] * fraction;
    }
}
