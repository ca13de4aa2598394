// Photographs of different exposures: the part of a pixel's colour that is not background is multiplied by the
// photograph's gain. The derivatives with respect to the logarithms of the gains are summed in 64-bit fixed point, so
// their sums are bit-identical in any order.

@group(0) @binding(9) var<storage, read> photographs: array<u32>;
// The three gains of every photograph; then, for every channel of every photograph, the low and the high word of a sum.
@group(0) @binding(10) var<storage, read_write> exposures: array<atomic<u32>>;

fn gain_of(photograph: u32) -> vec3<f32> {
    var gain = vec3<f32>(0.0);
    for (var c = 0u; c < 3u; c++) {
        gain[c] = bitcast<f32>(atomicLoad(&exposures[GAIN_WORDS * photograph + c]));
    }
    return gain;
}

// Returns the colour that is compared with the photograph; mirrors `trimip_core::field::losses::exposure`.
fn exposed(i: u32, shown: vec3<f32>, behind: vec3<f32>) -> vec3<f32> {
    return gain_of(photographs[i]) * (shown - behind) + behind;
}

// Converts the gradient with respect to the compared colour to the gradient with respect to the shown colour. `own` is
// the compared colour without its background. Adds the derivatives with respect to the logarithms of the photograph's
// gains. Gains and slopes are bounded, so every number fits.
fn unexposed(i: u32, by_seen: vec3<f32>, own: vec3<f32>) -> vec3<f32> {
    let photograph = photographs[i];
    for (var c = 0u; c < 3u; c++) {
        let value = by_seen[c] * own[c];
        if value != 0.0 && fits(value) {
            let at = GAIN_WORDS * params.photographs + SUM_WORDS * photograph + 2u * c;
            let words = to_fixed(value);
            let before = atomicAdd(&exposures[at], words.x);
            let high = words.y + select(0u, 1u, before + words.x < before);
            if high != 0u {
                atomicAdd(&exposures[at + 1u], high);
            }
        }
    }
    return by_seen * gain_of(photograph);
}
