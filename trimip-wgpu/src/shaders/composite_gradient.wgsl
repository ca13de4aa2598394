// Maps gradients of pixels to gradients of density and colour. The gradient of a density is what the sample adds to its
// pixel minus what it hides.

@group(0) @binding(0) var<storage, read> segments: array<vec2<u32>>;
@group(0) @binding(1) var<storage, read_write> gradients: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> radiance: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> intervals: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read> cones: array<f32>;
@group(0) @binding(6) var<storage, read> pixel_gradients: array<vec4<f32>>;
// First cone and number of cones of each pixel.
@group(0) @binding(7) var<storage, read> pixel_groups: array<vec2<u32>>;

fn cone_gradient(cone: u32, gradient: vec4<f32>) {
    let segment = segments[cone];
    // Contribution of everything behind the current sample, background included; initially of the whole cone.
    let at = PIXEL_FLOATS * cone;
    let whole = vec4<f32>(cones[at], cones[at + 1u], cones[at + 2u], cones[at + 3u]);
    var behind = dot(whole, gradient);
    var transmittance = 1.0;
    var depth_before = 0.0;
    let brightest = BRIGHTEST * dot(abs(gradient), vec4<f32>(1.0));
    for (var j = segment.x; j < segment.x + segment.y; j++) {
        let length = intervals[j].y;
        let depth = radiance[j].w * length;
        let shade = dot(vec4<f32>(radiance[j].rgb, 1.0), gradient);
        let weight = transmittance * alpha_of(depth);
        depth_before += depth;
        transmittance = exp(-depth_before);
        behind -= weight * shade;
        // The bound removes the rounding error that would remain where no light passes the sample.
        let most = transmittance * brightest;
        let hidden = clamp(behind, -most, most);
        gradients[j] = vec4<f32>(gradient.rgb * weight, (transmittance * shade - hidden) * length);
    }
}

@compute @workgroup_size(GROUP)
fn composite_gradient(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    let own = pixel_groups[i];
    // Opacity is a fourth channel: 1 for every sample, 0 for the background.
    let gradient = pixel_gradients[i] * (1.0 / f32(own.y));
    for (var cone = own.x; cone < own.x + own.y; cone++) {
        cone_gradient(cone, gradient);
    }
}
