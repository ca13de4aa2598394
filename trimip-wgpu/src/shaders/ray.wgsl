// Functions of a cone's axis.

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
