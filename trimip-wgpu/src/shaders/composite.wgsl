// Volume rendering along each ray, and its gradient.

struct Params {
    background: vec3<f32>,
    count: u32,
    // Rays have targets with backgrounds of their own.
    targets: u32,
}

@group(0) @binding(0) var<storage, read> segments: array<vec2<u32>>;
// Five floats a ray: colour, opacity, depth.
@group(0) @binding(1) var<storage, read_write> pixels: array<f32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> radiance: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> intervals: array<vec2<f32>>;
// Eight floats a ray, of which the last is the cosine.
@group(0) @binding(5) var<storage, read> rays: array<f32>;
// Eight floats a ray: colour, weight, background, opacity.
@group(0) @binding(6) var<storage, read> targets: array<f32>;

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
    let segment = segments[i];
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
    var background = params.background;
    if params.targets != 0u {
        background = vec3<f32>(targets[8u * i + 4u], targets[8u * i + 5u], targets[8u * i + 6u]);
    }
    rgb += transmittance * background;
    pixels[5u * i] = rgb.r;
    pixels[5u * i + 1u] = rgb.g;
    pixels[5u * i + 2u] = rgb.b;
    pixels[5u * i + 3u] = min(opacity, 1.0);
    pixels[5u * i + 4u] = distance * rays[8u * i + 7u];
}
