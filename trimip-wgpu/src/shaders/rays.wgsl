// Where rays come from: random pixels of the training views, or all pixels of a camera. Twin of `Camera::cone` and of
// the CPU's sampler.

struct Ray {
    origin: vec3<f32>,
    slope: f32,
    direction: vec3<f32>,
    cosine: f32,
}

struct View {
    // Rows of the rotation (camera to world), each with a part of the origin.
    pose: array<vec4<f32>, 3>,
    // fx, fy, cx, cy.
    intrinsics: vec4<f32>,
    // Radius of the pixel's disc on the plane at distance 1.
    disc: f32,
    width: u32,
    // First pixel.
    offset: u32,
    padding: u32,
}

struct Params {
    draws: vec4<u32>,
    background_draws: vec4<u32>,
    background: vec3<f32>,
    // Share of the rays that have a random background.
    random_share: f32,
    // Rays of the step; first ray and number of rays of this span.
    total: u32,
    first: u32,
    count: u32,
    scales: u32,
    premultiplied: u32,
    // Pixels come in the order of this span's rays.
    streamed: u32,
    // Rays from this index of the step on belong to this scale or a coarser one.
    begins: array<vec4<u32>, 2>,
    // Loss weight of a ray of each scale.
    weights: array<vec4<f32>, 2>,
}

struct Scale {
    first_pixel: u32,
    pixels: u32,
    first_view: u32,
    views: u32,
}

@group(0) @binding(0) var<storage, read> views: array<View>;
@group(0) @binding(1) var<storage, read_write> rays: array<Ray>;
@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(3) var<storage, read> pixels: array<u32>;
@group(0) @binding(4) var<storage, read> scales: array<Scale>;
@group(0) @binding(5) var<storage, read_write> targets: array<f32>;

// Radius of the sphere inscribed in a cone per unit of distance along its axis (Eq. 3 with f = 1).
fn sphere_slope(disc: f32, tangent: f32, cosine: f32) -> f32 {
    let inner = tangent - disc;
    return disc * cosine / sqrt(inner * inner + 1.0);
}

fn cone(view: View, x: u32, y: u32) -> Ray {
    let u = (f32(x) + 0.5 - view.intrinsics.z) / view.intrinsics.x;
    let v = -(f32(y) + 0.5 - view.intrinsics.w) / view.intrinsics.y;
    let tangent = sqrt(u * u + v * v);
    let cosine = 1.0 / sqrt(1.0 + tangent * tangent);
    var ray: Ray;
    for (var i = 0u; i < 3u; i++) {
        let row = view.pose[i];
        ray.direction[i] = (row.x * u + row.y * v - row.z) * cosine;
        ray.origin[i] = row.w;
    }
    ray.slope = sphere_slope(view.disc, tangent, cosine);
    ray.cosine = cosine;
    return ray;
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
    rays[i] = cone(views[0], pixel % views[0].width, pixel / views[0].width);
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
    var s = 0u;
    for (var j = 1u; j < params.scales; j++) {
        if index >= params.begins[j / 4u][j % 4u] {
            s = j;
        }
    }
    let scale = scales[s];
    let pixel = scale.first_pixel + below(random_bits(params.draws, index).x, scale.pixels);
    // The last view that does not begin behind the pixel.
    var low = scale.first_view;
    var high = scale.first_view + scale.views;
    while high - low > 1u {
        let middle = (low + high) / 2u;
        if views[middle].offset <= pixel {
            low = middle;
        } else {
            high = middle;
        }
    }
    let view = views[low];
    let within = pixel - view.offset;
    rays[i] = cone(view, within % view.width, within / view.width);

    var background = params.background;
    if params.random_share > 0.0 {
        let bits = random_bits(params.background_draws, index);
        if unit(bits.w) < params.random_share {
            background = vec3<f32>(unit(bits.x), unit(bits.y), unit(bits.z));
        }
    }
    let word = pixels[select(pixel, i, params.streamed != 0u)];
    let rgba = vec4<f32>(vec4<u32>(word, word >> 8u, word >> 16u, word >> 24u) & vec4<u32>(0xffu)) / 255.0;
    let coverage = select(rgba.a, 1.0, params.premultiplied != 0u);
    let rgb = rgba.rgb * coverage + (1.0 - rgba.a) * background;
    // A target is eight floats: colour, weight, background, opacity.
    let at = i * 8u;
    targets[at] = rgb.r;
    targets[at + 1u] = rgb.g;
    targets[at + 2u] = rgb.b;
    targets[at + 3u] = params.weights[s / 4u][s % 4u];
    targets[at + 4u] = background.r;
    targets[at + 5u] = background.g;
    targets[at + 6u] = background.b;
    targets[at + 7u] = rgba.a;
}
