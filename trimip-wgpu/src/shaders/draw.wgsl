// The pixels of a training step.

@group(0) @binding(2) var<uniform> params: Params;

// A drawn pixel; mirrors `trimip_core::engine::error_map::Drawn`.
struct Drawn {
    scale: u32,
    // Index among all pixels of the views.
    pixel: u32,
    importance: f32,
}

// Returns the scale of pixel `index` of the step.
fn scale_of(index: u32) -> u32 {
    var s = 0u;
    for (var j = 1u; j < params.scales; j++) {
        if index >= params.begins[j / 4u][j % 4u] {
            s = j;
        }
    }
    return s;
}
