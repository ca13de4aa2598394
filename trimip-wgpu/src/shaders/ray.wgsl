// The axis of a cone; twin of `trimip_core::batch::Ray`.
struct Ray {
    origin: vec3<f32>,
    // Sphere radius per unit of distance.
    slope: f32,
    // Unit direction.
    direction: vec3<f32>,
    // Cosine to the optical axis.
    cosine: f32,
}
