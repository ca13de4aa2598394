// Which samples of a ray are kept. The same as `compositing::Pruning`.

// The optical depths that a ray has passed: of the kept samples with what they stand for, and of the dropped ones that the next
// kept one stands for.
struct Passed {
    depth: f32,
    faint: f32,
}

// How many times its own length a sample of the optical depth `own` stands for; 0 if it is dropped.
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
