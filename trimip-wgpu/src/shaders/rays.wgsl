// Generates the rays of random pixels of the training views, or of all pixels of a camera. Mirrors the CPU's sampler.
// Needs `views` and `drawn`.

@group(0) @binding(1) var<storage, read_write> rays: array<Ray>;
@group(0) @binding(3) var<storage, read> pixels: array<u32>;
@group(0) @binding(5) var<storage, read_write> targets: array<f32>;
// First cone and number of cones of each pixel.
@group(0) @binding(6) var<storage, read_write> pixel_groups: array<vec2<u32>>;

// Generates the cones of pixel number `i` of the tile; the first of these cones has number `start`. Returns false if
// the camera has no ray for one of the cones.
fn cones_of(i: u32, start: u32, side: u32, view: View, x: u32, y: u32) -> bool {
    let count = cones_in(side);
    pixel_groups[i] = vec2<u32>(start, count);
    var all = true;
    for (var index = 0u; index < count; index++) {
        let ray = cone_in(view, x, y, index, side);
        all = all && ray.slope + ray.radius > 0.0;
        rays[start + index] = ray;
    }
    return all;
}

// Returns the number of cones of all pixels of the step before pixel `index`; mirrors `RayAllocation::cones_before`.
fn cones_before(index: u32) -> u32 {
    var cones = 0u;
    for (var j = 0u; j < params.scales; j++) {
        let begin = params.begins[j / 4u][j % 4u];
        var end = params.total;
        if j + 1u < params.scales {
            end = params.begins[(j + 1u) / 4u][(j + 1u) % 4u];
        }
        let side = params.sides[j / 4u][j % 4u];
        cones += (clamp(index, begin, end) - begin) * cones_in(side);
    }
    return cones;
}

@compute @workgroup_size(GROUP)
fn camera_rays(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    let pixel = params.first + i;
    let side = params.sides[0].x;
    cones_of(i, i * cones_in(side), side, views[0], pixel % views[0].width, pixel / views[0].width);
}

@compute @workgroup_size(GROUP)
fn training_rays(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = index_of(group, groups, local);
    if i >= params.count {
        return;
    }
    let index = params.first + i;
    let own = drawn(index);
    let s = own.scale;
    let pixel = own.pixel;
    // Finds the last view whose pixels start at or before `pixel`.
    var low = params.first_views[s / 4u][s % 4u];
    var high = low + params.views[s / 4u][s % 4u];
    while high - low > 1u {
        let middle = (low + high) / 2u;
        if views[middle].offset <= pixel {
            low = middle;
        } else {
            high = middle;
        }
    }
    let view = views[low];
    keep_photograph(i, low);
    let within = pixel - view.offset;
    let start = cones_before(index) - params.first_cone;
    let seen = cones_of(i, start, params.sides[s / 4u][s % 4u], view, within % view.width, within / view.width);

    var background = params.background;
    if params.random_background > 0.0 {
        let bits = random_bits(params.background_draws, index);
        if unit(bits.w) < params.random_background {
            background = vec3<f32>(unit(bits.x), unit(bits.y), unit(bits.z));
        }
    }
    let word = pixels[select(pixel, i, params.streamed != 0u)];
    let rgba = vec4<f32>(vec4<u32>(word, word >> 8u, word >> 16u, word >> 24u) & vec4<u32>(0xffu)) / 255.0;
    let kept = params.alpha == 2u;
    let opacity = select(rgba.a, 1.0, kept);
    let fraction = select(1.0, rgba.a, kept);
    let coverage = select(rgba.a, 1.0, params.alpha != 0u);
    let rgb = rgba.rgb * coverage + (1.0 - opacity) * background;
    let at = TARGET_FLOATS * i;
    targets[at] = rgb.r;
    targets[at + 1u] = rgb.g;
    targets[at + 2u] = rgb.b;
    // Pixels for which the lens has no ray get no weight.
    targets[at + TARGET_WEIGHT] = select(0.0, fraction * params.weights[s / 4u][s % 4u] * own.importance, seen);
    targets[at + TARGET_BACKGROUND] = background.r;
    targets[at + TARGET_BACKGROUND + 1u] = background.g;
    targets[at + TARGET_BACKGROUND + 2u] = background.b;
    targets[at + TARGET_OPACITY] = opacity;
    targets[at + TARGET_EXPONENT] = params.exponents[s / 4u][s % 4u];
    // The kernel `known_depths` overwrites both for pixels of known depth.
    targets[at + TARGET_DISTANCE] = 0.0;
    targets[at + TARGET_DEVIATION] = 0.0;
    targets[at + TARGET_IMPORTANCE] = own.importance;
}
