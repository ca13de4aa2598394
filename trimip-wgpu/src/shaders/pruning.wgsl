// The rule that keeps the samples of a ray; mirrors `compositing::Pruning`.

// The optical depths that a ray has passed: that of the kept samples, merged ones included, and that of the faint samples since
// the last kept one.
struct Passed {
    depth: f32,
    faint: f32,
}

// Factor that extends the length of a sample of optical depth `own` by the samples merged with it; 0 if the
// sample is dropped.
fn stands_for(passed: ptr<function, Passed>, own: f32, max_depth: f32, min_weight: f32) -> f32 {
    let before = *passed;
    if before.depth > max_depth {
        return 0.0;
    }
    let all = before.faint + own;
    // The comparison is false for NaN: the sample is kept, and the training step reports it.
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
