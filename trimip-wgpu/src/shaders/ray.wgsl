// The axis of a cone; twin of `trimip_core::batch::Ray`.
struct Ray {
    origin: vec3<f32>,
    // Growth of the sphere's radius per unit of distance.
    slope: f32,
    // Unit direction.
    direction: vec3<f32>,
    // Cosine to the optical axis.
    cosine: f32,
    // Radius of the sphere at `origin`.
    radius: f32,
}

// Largest distance to the apex over the distance to the origin.
const FARTHEST_APEX: f32 = 32.0;

// Distance of a point at distance `t` from the cone's apex.
fn apex_distance(ray: Ray, t: f32) -> f32 {
    if ray.radius == 0.0 {
        return t;
    }
    if ray.radius >= (FARTHEST_APEX - 1.0) * ray.slope * t {
        return FARTHEST_APEX * t;
    }
    return t + ray.radius / ray.slope;
}
