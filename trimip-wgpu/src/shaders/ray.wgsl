// Functions of a cone's axis.

// Returns the distance from the cone's apex to the point at distance `t` along the ray.
fn apex_distance(ray: Ray, t: f32) -> f32 {
    if ray.radius == 0.0 {
        return t;
    }
    if ray.radius >= (FARTHEST_APEX - 1.0) * ray.slope * t {
        return FARTHEST_APEX * t;
    }
    return t + ray.radius / ray.slope;
}
