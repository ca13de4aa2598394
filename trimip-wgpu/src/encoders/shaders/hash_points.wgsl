// Computes the points at which samples read the grid, one per invocation; mirrors
// `trimip_core::field::encoders::hash_grid::Points`.

@group(0) @binding(0) var<storage, read> rays: array<Ray>;
@group(0) @binding(1) var<storage, read> owners: array<u32>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> intervals: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read_write> points: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read> counts: array<u32>;
@group(0) @binding(6) var<storage, read> spheres: array<vec4<f32>>;

@compute @workgroup_size(GROUP)
fn hash_points(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    let sample = i / params.points;
    if sample >= counts[params.counter] {
        return;
    }
    let sphere = spheres[sample];
    let ray = rays[owners[sample]];
    let t = apex_distance(ray, intervals[sample].x);
    if params.points == 1u || !(t > 0.0) {
        points[i] = vec4<f32>(sphere.xyz, 0.35355339 * sphere.w / params.longest);
        return;
    }
    let j = i % params.points;
    let d = ray.direction;
    let h = min(0.5 * intervals[sample].y, t);
    let hh = h * h;
    let tt = t * t;
    let spread = 1.1338934 * (0.4 * f32(j) - 1.0) * sqrt((hh - tt) * (hh - tt) + 4.0 * tt * tt);
    let end = t + h;
    let at = (t - h) + h / (hh + 3.0 * tt) * (end * end + 2.0 * tt + spread);
    // The cone's radius at the point.
    let radius = sphere.w / t * at;
    var turns = TURNS;
    let angle = turns[j] * 1.04719755;
    let basis = across(d);
    let offset = (at - t) * d + 0.70710678 * radius * (cos(angle) * basis[0] + sin(angle) * basis[1]);
    let place = clamp(sphere.xyz + offset / params.extent, vec3<f32>(0.0), vec3<f32>(1.0));
    points[i] = vec4<f32>(place, 0.35355339 * radius / params.longest);
}
