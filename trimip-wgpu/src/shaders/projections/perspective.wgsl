// Perspective images: the pinhole and perspective lenses; mirrors `trimip_core::geometry::projections::perspective` and
// `trimip_core::geometry::lens`.

// Undistorted coordinates, and the factor by which the distortion scales a small area around them; 0 if there is no
// ray.
struct Unbent {
    at: vec2<f32>,
    area: f32,
}

// Returns the undistorted coordinates of the distorted coordinates `image`; mirrors `Lens::unbend`.
fn unbend(view: View, image: vec2<f32>) -> Unbent {
    let k = view.radial;
    let d = view.denominator.xyz;
    let p = view.shift.xy;
    let s = view.shift.zw;
    let domain = view.denominator.w;
    let enough = 8.0 * EPSILON * (1.0 + abs(image.x) + abs(image.y));
    let radius = length(image);
    var at = image * select(1.0, domain / radius, radius > domain);
    for (var round = 0u; round < MOST_ROUNDS; round++) {
        let x = at.x;
        let y = at.y;
        let r2 = x * x + y * y;
        let above = 1.0 + r2 * (k.x + r2 * (k.y + r2 * (k.z + r2 * k.w)));
        let below = 1.0 + r2 * (d.x + r2 * (d.y + r2 * d.z));
        let above_slope = k.x + r2 * (2.0 * k.y + r2 * (3.0 * k.z + r2 * 4.0 * k.w));
        let below_slope = d.x + r2 * (2.0 * d.y + r2 * 3.0 * d.z);
        let f = above / below;
        let slope = (above_slope * below - above * below_slope) / (below * below);
        let found = vec2<f32>(
            x * f + 2.0 * p.x * x * y + p.y * (r2 + 2.0 * x * x) + s.x * r2,
            y * f + p.x * (r2 + 2.0 * y * y) + 2.0 * p.y * x * y + s.y * r2,
        );
        let mixed = 2.0 * (x * y * slope + p.x * x + p.y * y);
        let xx = f + 2.0 * x * x * slope + 2.0 * p.x * y + 6.0 * p.y * x + 2.0 * s.x * x;
        let xy = mixed + 2.0 * s.x * y;
        let yx = mixed + 2.0 * s.y * x;
        let yy = f + 2.0 * y * y * slope + 6.0 * p.x * y + 2.0 * p.y * x + 2.0 * s.y * y;
        let error = found - image;
        let area = xx * yy - xy * yx;
        if max(abs(error.x), abs(error.y)) <= enough {
            let inside = length(at) < domain && area > 0.0;
            return Unbent(at, select(0.0, area, inside));
        }
        let step = vec2<f32>(yy * error.x - xy * error.y, xx * error.y - yx * error.x) / area;
        let size = length(step);
        let most = 0.5 * domain;
        at -= step * select(1.0, most / size, size > most);
    }
    return Unbent(at, 0.0);
}

// Returns the radius of the sphere inscribed in a cone, per unit of distance along the cone's axis (Eq. 3 with f = 1).
fn sphere_slope(disc: f32, tangent: f32, cosine: f32) -> f32 {
    let inner = tangent - disc;
    return disc * cosine / sqrt(inner * inner + 1.0);
}

// Returns the cone through a disc around (x, y) on the plane at distance 1.
fn cone_through(at: vec2<f32>, disc: f32) -> LocalCone {
    let v = -at.y;
    let tangent = sqrt(at.x * at.x + v * v);
    let cosine = 1.0 / sqrt(1.0 + tangent * tangent);
    return central_cone(vec3<f32>(at.x, v, -1.0), cosine, sphere_slope(disc, tangent, cosine), cosine);
}

// Returns the cone of a perspective lens's pixel.
fn cone_perspective(view: View, at: vec2<f32>, side: f32) -> LocalCone {
    let unbent = unbend(view, (at - view.intrinsics.zw) / view.intrinsics.xy);
    if !(unbent.area > 0.0) {
        return no_cone();
    }
    return cone_through(unbent.at, side * view.disc / sqrt(unbent.area));
}
