// Evaluates a ray term over each pixel's cones, and its gradient with respect to densities. The term's function `ray_term(cone, at,
// fraction)` adds `fraction` times the gradient of a cone and returns `fraction` times the value of the term. The sums over a workgroup's
// pixels are written to `partial`; `add_rays` adds them to the step's loss in order.

@group(0) @binding(0) var<storage, read> segments: array<vec2<u32>>;
// Gradients with respect to the colour and density of each sample. They already include the terms that were evaluated
// before.
@group(0) @binding(1) var<storage, read_write> gradients: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> radiance: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> intervals: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read> rays: array<Ray>;
@group(0) @binding(6) var<storage, read> targets: array<f32>;
// First cone and number of cones of each pixel.
@group(0) @binding(7) var<storage, read> pixel_groups: array<vec2<u32>>;
@group(0) @binding(8) var<storage, read_write> partial: array<f32>;
// The step's sums: the first word holds the bits of the loss.
@group(0) @binding(9) var<storage, read_write> sums: array<u32>;

// Returns the ray parameter and the width of sample `j`, see `along`.
fn at_sample(parameterisation: RayParameter, ray: Ray, j: u32) -> vec2<f32> {
    return along(params.space, parameterisation, ray, intervals[j].x, intervals[j].y);
}

@compute @workgroup_size(GROUP)
fn evaluate_rays(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    var own = 0.0;
    if i < params.count {
        let cones = pixel_groups[i];
        let at = TARGET_FLOATS * i;
        let fraction = params.term.x * targets[at + TARGET_WEIGHT] / f32(cones.y);
        for (var cone = cones.x; cone < cones.x + cones.y; cone++) {
            own += ray_term(cone, at, fraction);
        }
    }
    let sum = workgroup_sum(local, own);
    let block = group.y * groups.x + group.x;
    if local == 0u && block < params.blocks {
        partial[block] = sum;
    }
}

@compute @workgroup_size(GROUP)
fn add_rays(@builtin(local_invocation_index) local: u32) {
    var own = 0.0;
    for (var i = local; i < params.blocks; i += GROUP) {
        own += partial[i];
    }
    let sum = workgroup_sum(local, own);
    if local == 0u {
        sums[0] = bitcast<u32>(bitcast<f32>(sums[0]) + sum);
    }
}
