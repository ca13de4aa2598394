// Passes over all ripmaps, along the rows (axis 0) or across them (axis 1). One invocation computes four channels of
// one texel of a level.

@group(0) @binding(0) var<storage, read_write> maps: array<vec4<f32>>;
@group(0) @binding(2) var<uniform> pass_: Pass;

// A texel of level `pass_.level` along an axis: its plane, and its row and column in the level. A level along the rows
// has all rows of the ripmap; a level across the rows has the columns of level 0.
struct Texel {
    // Index of the plane; the number of planes if there is no such texel.
    plane: u32,
    row: u32,
    column: u32,
}

// Returns the numbers of columns and rows of level `pass_.level` along `axis` in a plane's ripmap.
fn part_sides(plane: u32, axis: u32) -> vec2<u32> {
    let sides = planes[plane].sides;
    if axis == 0u {
        return vec2<u32>(sides.x >> pass_.level, level_first(plane, 1u, pass_.levels));
    }
    return vec2<u32>(sides.x, sides.y >> pass_.level);
}

fn part_texel(index: u32, axis: u32) -> Texel {
    var rest = index;
    for (var plane = 0u; plane < pass_.planes; plane++) {
        let sides = part_sides(plane, axis);
        if rest < sides.x * sides.y {
            return Texel(plane, rest / sides.x, rest % sides.x);
        }
        rest -= sides.x * sides.y;
    }
    return Texel(pass_.planes, 0u, 0u);
}

// Returns the index, in the array of all ripmaps, of a texel of `level` along `axis`.
fn part_index(plane: u32, axis: u32, level: u32, row: u32, column: u32) -> u32 {
    let first = level_first(plane, axis, level);
    return map_texel(plane, pass_.levels, row + select(0u, first, axis == 1u), column + select(first, 0u, axis == 1u));
}

// Returns the index of one of the two texels on the next finer level that `texel` covers.
fn finer_index(texel: Texel, axis: u32, which: u32) -> u32 {
    let row = select(texel.row, 2u * texel.row + which, axis == 1u);
    let column = select(2u * texel.column + which, texel.column, axis == 1u);
    return part_index(texel.plane, axis, pass_.level - 1u, row, column);
}
