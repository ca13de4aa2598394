// The depth term: a logarithmic loss of the probability that a cone ends at the known point of its pixel, and its gradient with
// respect to the densities of the cone's samples; mirrors `trimip_core::field::losses::depth`. `at` is the first word of the
// pixel's target.

// Returns the weight at sample `j` of the Gaussian around the point.
fn near_point(j: u32, at: u32) -> f32 {
    let off = intervals[j].x - targets[at + TARGET_DISTANCE];
    let deviation = targets[at + TARGET_DEVIATION];
    let length = intervals[j].y;
    return exp(-0.5 * off * off / (deviation * deviation + length * length));
}

// Returns the loss of a cone, times `fraction`.
fn depth(cone: u32, at: u32, fraction: f32) -> f32 {
    let segment = segments[cone];
    if segment.y == 0u || targets[at + TARGET_DEVIATION] == 0.0 {
        return 0.0;
    }
    let odds = params.term.y;
    let end = segment.x + segment.y;
    var total = 0.0;
    var x = 0.0;
    for (var j = segment.x; j < end; j++) {
        let own = radiance[j].w * intervals[j].y;
        total += exp(-x) * alpha_of(own) * near_point(j, at);
        x += own;
    }
    let slope = -fraction / (odds + total);
    var hidden = total;
    x = 0.0;
    for (var j = segment.x; j < end; j++) {
        let own = radiance[j].w * intervals[j].y;
        let near = near_point(j, at);
        hidden -= exp(-x) * alpha_of(own) * near;
        x += own;
        gradients[j].w += slope * (exp(-x) * near - clamp(hidden, 0.0, exp(-x))) * intervals[j].y;
    }
    return -fraction * log((odds + total) / (1.0 + odds));
}
