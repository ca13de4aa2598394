// Mirrors `trimip_core::field::activation`. The density functions take the logit minus the configured shift.

fn density_of(kind: u32, x: f32) -> f32 {
    if kind == EXP {
        return exp(min(x, LARGEST_ARGUMENT));
    }
    if kind == SOFTPLUS {
        let e = exp(-abs(x));
        // Computes ln(1 + e) from its series where 1 + e would lose the digits of e.
        let series = e * (1.0 - e * (1.0 / 2.0 - e * (1.0 / 3.0 - 0.25 * e)));
        return max(x, 0.0) + select(log(1.0 + e), series, e < 0.03);
    }
    return max(x, 0.0);
}

fn density_derivative(kind: u32, x: f32) -> f32 {
    if kind == EXP {
        return exp(clamp(x, -15.0, 15.0));
    }
    if kind == SOFTPLUS {
        return sigmoid(x);
    }
    return select(0.0, 1.0, x > 0.0);
}

// Returns the logistic function, in a form that never overflows.
fn sigmoid(logit: f32) -> f32 {
    let e = exp(-abs(logit));
    let positive = 1.0 / (1.0 + e);
    return select(e * positive, positive, logit >= 0.0);
}

fn sigmoid_derivative(value: f32) -> f32 {
    return value * (1.0 - value);
}
