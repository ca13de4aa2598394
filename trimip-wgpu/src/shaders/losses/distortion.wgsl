// The distortion of the weights of a cone's samples, and its gradient with respect to the densities of the samples;
// mirrors `trimip_core::field::losses::distortion`.

// A sample, and sums over the samples in front of it.
struct Walk {
    weight: f32,
    // Transmittance behind the sample, and optical depth up to its far end.
    transmittance: f32,
    depth: f32,
    place: f32,
    width: f32,
    // Distance to the previous sample, and distance to the first sample.
    gap: f32,
    from_first: f32,
    // Sum of the weights of the samples in front, and sum of these weights times the distances of their samples.
    before: f32,
    in_front: f32,
}

// Begins a walk at the position of the first sample.
fn begin(place: f32) -> Walk {
    return Walk(0.0, 1.0, 0.0, place, 0.0, 0.0, 0.0, 0.0, 0.0);
}

// Moves on to the next sample, which has the optical depth `depth`.
fn advance(walk: Walk, depth: f32, at: vec2<f32>) -> Walk {
    var next = walk;
    next.gap = at.x - walk.place;
    next.place = at.x;
    next.width = at.y;
    next.before += walk.weight;
    next.from_first += next.gap;
    next.in_front += next.before * next.gap;
    next.weight = walk.transmittance * alpha_of(depth);
    next.depth += depth;
    next.transmittance = exp(-next.depth);
    return next;
}

// Returns the loss of a cone, times `fraction`.
fn distortion(cone: u32, at: u32, fraction: f32) -> f32 {
    let segment = segments[cone];
    if segment.y == 0u {
        return 0.0;
    }
    let ray = rays[cone];
    let parameterisation = parameterisation_of(params.space, ray);
    let first = at_sample(parameterisation, ray, segment.x).x;
    let end = segment.x + segment.y;
    var value = 0.0;
    var behind = 0.0;
    var total = 0.0;
    var widest = 0.0;
    var walk = begin(first);
    for (var j = segment.x; j < end; j++) {
        walk = advance(walk, radiance[j].w * intervals[j].y, at_sample(parameterisation, ray, j));
        value += walk.weight * (2.0 * walk.in_front + walk.weight * walk.width / 3.0);
        behind += walk.weight * walk.from_first;
        total += walk.weight;
        widest = max(widest, walk.width);
    }
    let most_by_weight = 2.0 * (walk.from_first + widest);
    var hidden = 2.0 * value;
    walk = begin(first);
    for (var j = segment.x; j < end; j++) {
        walk = advance(walk, radiance[j].w * intervals[j].y, at_sample(parameterisation, ray, j));
        behind -= (total - walk.before) * walk.gap;
        let by_weight = 2.0 * (walk.in_front + behind + walk.weight * walk.width / 3.0);
        hidden -= walk.weight * by_weight;
        let bounded = clamp(hidden, 0.0, walk.transmittance * most_by_weight);
        gradients[j].w += fraction * (walk.transmittance * by_weight - bounded) * intervals[j].y;
    }
    return fraction * value;
}
