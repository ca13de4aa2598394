// The rule that determines which samples of a ray are kept; mirrors `compositing::Pruning`.

// Optical depths that a ray has passed: `depth` is that of the kept samples and of the samples merged with them, `faint` that
// of the faint samples since the last kept sample.
struct Passed {
    depth: f32,
    faint: f32,
}

// Returns the factor by which the samples merged with a sample lengthen it; 0 if the sample is dropped. `own` is the
// sample's optical depth.
fn stands_for(passed: ptr<function, Passed>, own: f32, max_depth: f32, min_weight: f32) -> f32 {
    let before = *passed;
    if before.depth > max_depth {
        return 0.0;
    }
    let all = before.faint + own;
    // The comparison is false for NaN, so the sample is kept, and the training step reports it.
    if min_weight > 0.0 && exp(-before.depth) * alpha_of(all) < min_weight {
        (*passed).faint = all;
        return 0.0;
    }
    *passed = Passed(before.depth + all, 0.0);
    if before.faint > 0.0 {
        return all / own;
    }
    return 1.0;
}
