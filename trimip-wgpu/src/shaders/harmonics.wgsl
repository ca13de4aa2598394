// Returns the real spherical harmonics of degrees 0 to 3 of a unit direction; mirrors `trimip_core::math::sh`, whose
// factors are `SH`.
fn spherical_harmonics(d: vec3<f32>) -> array<f32, 16> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    return array<f32, 16>(
        SH[0],
        -SH[1] * y,
        SH[1] * z,
        -SH[1] * x,
        SH[2] * x * y,
        -SH[2] * y * z,
        SH[3] * zz - SH[4],
        -SH[2] * x * z,
        SH[5] * (xx - yy),
        SH[6] * y * (yy - 3.0 * xx),
        SH[7] * x * y * z,
        SH[8] * y * (1.0 - 5.0 * zz),
        SH[9] * z * (5.0 * zz - 3.0),
        SH[8] * x * (1.0 - 5.0 * zz),
        SH[10] * z * (xx - yy),
        SH[6] * x * (3.0 * yy - xx),
    );
}
