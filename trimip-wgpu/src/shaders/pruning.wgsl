// Whether a sample of the optical depth `own`, behind the optical depth `before`, is kept. The same as
// `compositing::Pruning`.
fn is_seen(before: f32, own: f32, max_depth: f32, min_weight: f32) -> bool {
    if before > max_depth {
        return false;
    }
    // The comparison is false for NaN: the sample is kept, and the training step reports it.
    return !(min_weight > 0.0 && exp(-before) * (1.0 - exp(-own)) < min_weight);
}
