// Layout of the planes YZ, XZ and XY of one level. `sides` are the level's texels along x, y and z.

// Number of columns and rows of a plane.
fn plane_shape(sides: vec3<u32>, plane: u32) -> vec2<u32> {
    switch plane {
        case 0u: { return sides.yz; }
        case 1u: { return sides.xz; }
        default: { return sides.xy; }
    }
}

// Index of a plane's first texel. Returns the end of the level for plane 3.
fn plane_start(sides: vec3<u32>, plane: u32) -> u32 {
    var start = 0u;
    for (var before = 0u; before < plane; before++) {
        let shape = plane_shape(sides, before);
        start += shape.x * shape.y;
    }
    return start;
}

struct Place {
    plane: u32,
    row: u32,
    column: u32,
}

// Plane, row and column of a texel, given its index in the level.
fn place_of(sides: vec3<u32>, texel: u32) -> Place {
    var plane = 0u;
    while plane < 2u && texel >= plane_start(sides, plane + 1u) {
        plane++;
    }
    let at = texel - plane_start(sides, plane);
    let columns = plane_shape(sides, plane).x;
    return Place(plane, at / columns, at % columns);
}

// Index of the texel at `place` in the level with these `sides`.
fn texel_at(sides: vec3<u32>, place: Place) -> u32 {
    return plane_start(sides, place.plane) + place.row * plane_shape(sides, place.plane).x + place.column;
}
