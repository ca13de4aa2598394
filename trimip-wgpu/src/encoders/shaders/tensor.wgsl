// Mirrors `trimip_core::field::encoders::tensor`, four components at a time.

@group(0) @binding(2) var<uniform> params: Params;
@group(0) @binding(9) var<storage, read> factors: array<vec4<f32>>;

// Four neighbouring features.
struct Feature {
    // 0: density, 1: colour.
    kind: u32,
    plane: u32,
    component: u32,
    // Number of components of the tensor, in units of four.
    width: u32,
}

// Returns the factors of the group of four features with index `at`.
fn feature(at: u32) -> Feature {
    let copies = max(params.planes, 1u);
    let density = params.components.x * copies;
    if at < density {
        return Feature(0u, at / params.components.x, at % params.components.x, params.components.x);
    }
    let rest = at - density;
    return Feature(1u, rest / params.components.y, rest % params.components.y, params.components.y);
}

// Returns the two axes of a plane, and the axis of the line perpendicular to the plane.
fn axes(plane: u32) -> vec3<u32> {
    return select(select(vec3<u32>(1u, 2u, 0u), vec3<u32>(0u, 2u, 1u), plane == 1u), vec3<u32>(0u, 1u, 2u), plane == 0u);
}

struct Along {
    lower: u32,
    upper: f32,
}

fn along(axis: u32, position: vec3<f32>) -> Along {
    let last = f32(params.sides[axis] - 1u);
    let at = clamp(position[axis] * last, 0.0, last);
    let lower = min(floor(at), last - 1.0);
    return Along(u32(lower), at - lower);
}

// Returns the index of the feature's component at grid point `lower` of a line; the next grid point follows `f.width`
// later.
fn line_index(f: Feature, line: u32, lower: u32) -> u32 {
    var first = params.starts[2u * f.kind + 1u];
    for (var l = 0u; l < line; l++) {
        first += params.sides[axes(l).z] * f.width;
    }
    return first + lower * f.width + f.component;
}

fn line_value(f: Feature, line: u32, position: vec3<f32>) -> vec4<f32> {
    let place = along(axes(line).z, position);
    let at = line_index(f, line, place.lower);
    return (1.0 - place.upper) * factors[at] + place.upper * factors[at + f.width];
}

// The cell of a plane that contains a position: the index of a component at the cell's first corner, the distance to
// the next row, and the position's fractions along the two axes.
struct Cell {
    at: u32,
    columns: u32,
    right: f32,
    up: f32,
}

fn cell(f: Feature, position: vec3<f32>) -> Cell {
    var first = 0u;
    for (var p = 0u; p < f.plane; p++) {
        let own = axes(p);
        first += params.sides[own.x] * params.sides[own.y];
    }
    let own = axes(f.plane);
    let a = along(own.x, position);
    let b = along(own.y, position);
    let columns = params.sides[own.x];
    let at = params.starts[2u * f.kind] + (first + b.lower * columns + a.lower) * f.width + f.component;
    return Cell(at, columns * f.width, a.upper, b.upper);
}

fn plane_value(f: Feature, own: Cell) -> vec4<f32> {
    let below = (1.0 - own.right) * factors[own.at] + own.right * factors[own.at + f.width];
    let above = (1.0 - own.right) * factors[own.at + own.columns] + own.right * factors[own.at + own.columns + f.width];
    return (1.0 - own.up) * below + own.up * above;
}
