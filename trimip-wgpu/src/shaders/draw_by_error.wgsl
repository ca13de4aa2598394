// Draws pixels with the error map; mirrors `ErrorMap::draw`. Needs `cell_of` and `views`.

// Divides a side of `pixels` pixels into `parts` parts, and returns the first pixel and the end of part `part`.
fn part_of(pixels: u32, part: u32, parts: u32) -> vec2<u32> {
    return (vec2<u32>(part, part + 1u) * pixels + parts - 1u) / parts;
}

fn drawn(index: u32) -> Drawn {
    let s = scale_of(index);
    let bits = random_bits(params.draws, index);
    let cell = cell_of(bits.x);
    // Finds the last view of the scale whose cells start at or before `cell`.
    var low = params.first_views[s / 4u][s % 4u];
    var high = low + params.views[s / 4u][s % 4u];
    while high - low > 1u {
        let middle = (low + high) / 2u;
        if views[middle].cells.x <= cell {
            low = middle;
        } else {
            high = middle;
        }
    }
    let view = views[low];
    let size = view.cells.yz;
    let within = cell - view.cells.x;
    let columns = part_of(view.width, within % size.x, size.x);
    let rows = part_of(view.cells.w, within / size.x, size.y);
    let x = columns.x + below(bits.y, columns.y - columns.x);
    let y = rows.x + below(bits.z, rows.y - rows.x);
    // The last cell ends at 2^32, which is 0 in a u32.
    var end = 0u;
    if cell + 1u < params.cells.x {
        end = starts[cell + 1u];
    }
    let width = select(f32(end - starts[cell]), 4294967296.0, end == starts[cell]);
    let area = f32((columns.y - columns.x) * (rows.y - rows.x));
    return Drawn(s, view.offset + y * view.width + x, area / width * params.per_pixel[s / 4u][s % 4u]);
}
