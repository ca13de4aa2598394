// Planes with ripmaps; mirrors `trimip_core::field::encoders::rip_map::Plane`.

@group(0) @binding(9) var<storage, read> planes: array<Plane>;

// Returns the first column (axis 0) or row (axis 1) of a level in a plane's ripmap. If `level` is the number of levels,
// this is the ripmap's width or height.
fn level_first(plane: u32, axis: u32, level: u32) -> u32 {
    let whole = 2u * planes[plane].sides[axis];
    return whole - (whole >> level);
}

// Returns the index of a texel in the array of all ripmaps, given its row and column in the plane's ripmap.
fn map_texel(plane: u32, levels: u32, row: u32, column: u32) -> u32 {
    return planes[plane].start + row * level_first(plane, 0u, levels) + column;
}
