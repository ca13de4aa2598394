// The distortion loss of each pixel's cones and its gradient with respect to densities; twin of `trimip_core::distortion`. The
// sums over a workgroup's pixels go to `partial`; `add_distortion` adds them to the step's loss in order.

@group(0) @binding(0) var<storage, read> segments: array<vec2<u32>>;
// Colour and density of each sample; the gradients of the other losses are there already.
@group(0) @binding(1) var<storage, read_write> gradients: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> radiance: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> intervals: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read> rays: array<Ray>;
// Nine floats per pixel; the fourth is its weight.
@group(0) @binding(6) var<storage, read> targets: array<f32>;
// First cone and number of cones of each pixel.
@group(0) @binding(7) var<storage, read> pixel_groups: array<vec2<u32>>;
@group(0) @binding(8) var<storage, read_write> partial: array<f32>;
// Eight words: the first is the bits of the loss.
@group(0) @binding(9) var<storage, read_write> sums: array<u32>;

// A sample, and sums over the samples in front of it.
struct Walk {
    weight: f32,
    // Transmittance behind the sample, and optical depth up to there.
    transmittance: f32,
    depth: f32,
    place: f32,
    width: f32,
    // Distance to the sample before, and to the first one.
    gap: f32,
    from_first: f32,
    // Sum of the weights in front, and of the weights times their distances.
    before: f32,
    in_front: f32,
}

// Begins at the place of the first sample.
fn begin(place: f32) -> Walk {
    return Walk(0.0, 1.0, 0.0, place, 0.0, 0.0, 0.0, 0.0, 0.0);
}

// Moves on to a sample of optical depth `depth`.
fn advance(walk: Walk, depth: f32, at: vec2<f32>) -> Walk {
    var next = walk;
    next.gap = at.x - walk.place;
    next.place = at.x;
    next.width = at.y;
    next.before += walk.weight;
    next.from_first += next.gap;
    next.in_front += next.before * next.gap;
    next.weight = walk.transmittance * alpha_of(depth);
    next.depth += depth;
    next.transmittance = exp(-next.depth);
    return next;
}

// Place and width of sample `j`.
fn at_sample(course: Course, ray: Ray, j: u32) -> vec2<f32> {
    return along(params.space, course, ray, intervals[j].x, intervals[j].y);
}

// The loss of a cone, times `share`.
fn distort_cone(cone: u32, share: f32) -> f32 {
    let segment = segments[cone];
    if segment.y == 0u {
        return 0.0;
    }
    let ray = rays[cone];
    let course = course_of(params.space, ray);
    let first = at_sample(course, ray, segment.x).x;
    let end = segment.x + segment.y;
    var value = 0.0;
    var behind = 0.0;
    var total = 0.0;
    var walk = begin(first);
    for (var j = segment.x; j < end; j++) {
        walk = advance(walk, radiance[j].w * intervals[j].y, at_sample(course, ray, j));
        value += walk.weight * (2.0 * walk.in_front + walk.weight * walk.width / 3.0);
        behind += walk.weight * walk.from_first;
        total += walk.weight;
    }
    var hidden = 2.0 * value;
    walk = begin(first);
    for (var j = segment.x; j < end; j++) {
        walk = advance(walk, radiance[j].w * intervals[j].y, at_sample(course, ray, j));
        behind -= (total - walk.before) * walk.gap;
        let by_weight = 2.0 * (walk.in_front + behind + walk.weight * walk.width / 3.0);
        hidden -= walk.weight * by_weight;
        gradients[j].w += share * (walk.transmittance * by_weight - hidden) * intervals[j].y;
    }
    return share * value;
}

@compute @workgroup_size(GROUP)
fn distort(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    var own = 0.0;
    if i < params.count {
        let cones = pixel_groups[i];
        let share = params.distortion * targets[9u * i + 3u] / f32(cones.y);
        for (var cone = cones.x; cone < cones.x + cones.y; cone++) {
            own += distort_cone(cone, share);
        }
    }
    let sum = workgroup_sum(local, own);
    let block = group.y * groups.x + group.x;
    if local == 0u && block < params.blocks {
        partial[block] = sum;
    }
}

@compute @workgroup_size(GROUP)
fn add_distortion(@builtin(local_invocation_index) local: u32) {
    var own = 0.0;
    for (var i = local; i < params.blocks; i += GROUP) {
        own += partial[i];
    }
    let sum = workgroup_sum(local, own);
    if local == 0u {
        sums[0] = bitcast<u32>(bitcast<f32>(sums[0]) + sum);
    }
}
