// Twin of `trimip_core::activation`.

// Density per world unit from a density logit.
fn density_of(logit: f32) -> f32 {
    return exp(logit - 1.0);
}

fn density_derivative(logit: f32) -> f32 {
    return exp(clamp(logit - 1.0, -15.0, 15.0));
}

// Logistic function, in a form that never overflows.
fn sigmoid(logit: f32) -> f32 {
    let e = exp(-abs(logit));
    let positive = 1.0 / (1.0 + e);
    return select(e * positive, positive, logit >= 0.0);
}

fn sigmoid_derivative(value: f32) -> f32 {
    return value * (1.0 - value);
}
