// Layout of the planes YZ, XZ and XY of one level. `sides` are the numbers of texels of the level along x, y and z.

// Returns the number of columns and rows of a plane.
fn plane_shape(sides: vec3<u32>, plane: u32) -> vec2<u32> {
    switch plane {
        case 0u: { return sides.yz; }
        case 1u: { return sides.xz; }
        default: { return sides.xy; }
    }
}

// Returns the index of a plane's first texel; for plane 3, the end of the level.
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

// Returns the plane, row and column of the texel with index `texel` in the level.
fn place_of(sides: vec3<u32>, texel: u32) -> Place {
    var plane = 0u;
    while plane < 2u && texel >= plane_start(sides, plane + 1u) {
        plane++;
    }
    let at = texel - plane_start(sides, plane);
    let columns = plane_shape(sides, plane).x;
    return Place(plane, at / columns, at % columns);
}

// Returns the index of the texel at `place` in the level with these `sides`.
fn texel_at(sides: vec3<u32>, place: Place) -> u32 {
    return plane_start(sides, place.plane) + place.row * plane_shape(sides, place.plane).x + place.column;
}
