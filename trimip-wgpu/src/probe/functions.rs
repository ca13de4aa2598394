//! Checks functions of one value: activations, losses, harmonics, levels, fixed point and random numbers.

use super::{compare, directions, files, gpu, numbers, run, singles};
use crate::encoders::tri_mip::TRI_MIP;
use crate::gpu::Source::Text;
use crate::losses::{FINITE, PENALTIES};
use crate::shaders::{ACTIVATION, COMPOSITING, FIXED, HARMONICS, RANDOM};
use trimip_core::config::{DensityFunction, Photometric};
use trimip_core::field::encoders::tri_mip::{Pyramid, Shape, level_input, taps};
use trimip_core::field::losses::smooth_l1::smooth_l1;
use trimip_core::{
    Config,
    field::activation,
    math::{compositing, rng, sh},
};

#[test]
fn activations() {
    // The exp of drivers is accurate to about 17 ulp (2e-6) at 0 and less accurate for larger arguments.
    compare(
        files!(ACTIVATION; "return vec4<f32>(density_of(EXP, x.x), density_derivative(EXP, x.x), sigmoid(x.x), sigmoid_derivative(x.x));"),
        &singles(|x| x.abs() < 80.0),
        |[x, ..]| {
            let density = activation::Density { kind: DensityFunction::Exp, shift: 0.0, scale: 1.0 };
            [
                density.value(x),
                density.derivative(x),
                activation::sigmoid(x),
                activation::sigmoid_derivative(x),
            ]
        },
        (1e-37, 2e-5),
    );
    compare(
        files!(ACTIVATION; "return vec4<f32>(density_of(SOFTPLUS, x.x), density_derivative(SOFTPLUS, x.x), density_of(2u, x.x), density_derivative(2u, x.x));"),
        &singles(|x| x.abs() < 80.0),
        |[x, ..]| {
            let of = |kind| activation::Density { kind, shift: 0.0, scale: 1.0 };
            let [softplus, relu] = [DensityFunction::Softplus, DensityFunction::Relu].map(of);
            [softplus.value(x), softplus.derivative(x), relu.value(x), relu.derivative(x)]
        },
        (1e-37, 2e-5),
    );
}

#[test]
fn thin_samples_keep_their_relative_accuracy() {
    compare(
        files!(COMPOSITING; "return vec4<f32>(alpha_of(x.x), 0.0, 0.0, 0.0);"),
        &singles(|x| x >= 0.0),
        |[x, ..]| [compositing::weight(1.0, x).0, 0.0, 0.0, 0.0],
        (0.0, 3e-6),
    );
}

#[test]
fn penalties_of_the_loss() {
    compare(
        files!(Text(PENALTIES); "return vec4<f32>(smooth_l1(x.x, vec3<f32>(1.0, 0.0, 0.0)), smooth_l1(x.x, vec3<f32>(0.05, 0.0, 0.0)));"),
        &singles(|_| true),
        |[x, ..]| {
            let ((a, b), (c, d)) = (smooth_l1(x, 1.0), smooth_l1(x, f64::from(0.05_f32)));
            [a, b, c, d]
        },
        (0.0, 1e-6),
    );
}

#[test]
fn photometric_terms() {
    for term in Photometric::ALL.iter().map(|kind| kind.term()) {
        let mut config = Config::default();
        term.example(&mut config);
        let [a, b, c] = term.numbers(&config.loss);
        let call = format!("{}(x.x, vec3<f32>({a:?}, {b:?}, {c:?}))", term.name());
        let body = format!("fn probe(x: vec4<f32>) -> vec4<f32> {{ return vec4<f32>({call}, 0.0, 0.0); }}\n");
        // The text is leaked, because `Text` holds a `&'static str`.
        compare(
            &[Text(PENALTIES), Text(body.leak())],
            &singles(|_| true),
            |[x, ..]| {
                let slope = term.evaluate(&config.loss, x as f32).1;
                [term.reference(&config.loss, x), slope.into(), 0.0, 0.0]
            },
            (0.0, 4e-6),
        );
    }
}

#[test]
fn what_is_finite() {
    let Some(gpu) = gpu() else { return };
    let inputs = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, f32::MAX, -1e-45].map(|x| [x; 4]);
    let files = files!(FINITE; "return vec4<f32>(select(0.0, 1.0, is_finite(x.x)), 0.0, 0.0, 0.0);");
    let found = run(&gpu, files, &inputs);
    assert_eq!(found.iter().map(|row| row[0]).collect::<Vec<_>>(), [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
}

#[test]
fn harmonics() {
    let directions = directions();
    let expected = |first: usize| {
        move |[x, y, z, _]: [f64; 4]| {
            let all = sh::spherical_harmonics([x, y, z]);
            [0, 1, 2, 3].map(|i| all[first + i])
        }
    };
    let bound = (5e-7, 1e-6);
    compare(
        files!(HARMONICS; "let h = spherical_harmonics(x.xyz); return vec4<f32>(h[0], h[1], h[2], h[3]);"),
        &directions,
        expected(0),
        bound,
    );
    compare(
        files!(HARMONICS; "let h = spherical_harmonics(x.xyz); return vec4<f32>(h[4], h[5], h[6], h[7]);"),
        &directions,
        expected(4),
        bound,
    );
    compare(
        files!(HARMONICS; "let h = spherical_harmonics(x.xyz); return vec4<f32>(h[8], h[9], h[10], h[11]);"),
        &directions,
        expected(8),
        bound,
    );
    compare(
        files!(HARMONICS; "let h = spherical_harmonics(x.xyz); return vec4<f32>(h[12], h[13], h[14], h[15]);"),
        &directions,
        expected(12),
        bound,
    );
}

#[test]
fn levels_and_texels() {
    let pyramid = Pyramid { sides: [64, 32, 96], levels: 5, log2_base_radius: [-7.0, -6.5, -5.25] };
    let radii: Vec<[f32; 4]> =
        (-80..40).flat_map(|i| [0.0, 1.0, 2.0].map(|p| [i as f32 / 4.0, p, 0.0, 0.0])).collect();
    compare(
        files!(TRI_MIP; "let pyramid = Pyramid(vec3<f32>(-7.0, -6.5, -5.25), 5u, vec3<u32>(64u, 32u, 96u), 0u, -6.25, 1u, 64u); let b = blend_levels(pyramid, u32(x.y), x.x); return vec4<f32>(f32(b.lower), b.fraction, f32(level_start(pyramid, b.lower, u32(x.y))), level_feature(x.x, pyramid.reference));"),
        &radii,
        |[radius, plane, ..]| {
            let plane = plane as usize;
            let blend = pyramid.blend(plane, radius);
            let start = pyramid.offset(blend.lower, plane) / trimip_core::field::encoders::tri_mip::CHANNELS;
            let level = level_input(radius, pyramid.reference());
            [blend.lower as f64, blend.fraction, start as f64, level]
        },
        (1e-6, 0.0),
    );
    // Positions at the border, between texels, and beyond the outermost texel centres.
    let places: Vec<[f32; 4]> = [0.0, 0.003, 0.01, 0.3, 0.5, 0.77, 0.998, 1.0]
        .into_iter()
        .flat_map(|a| [0.0_f32, 0.12, 0.999, 1.0].map(|b| [a, b, 0.0, 0.0]))
        .collect();
    compare(
        files!(TRI_MIP; "let t = texel_taps(vec2<u32>(32u, 48u), x.xy); return vec4<f32>(f32(t.columns.x), f32(t.columns.y), f32(t.rows.x), f32(t.rows.y));"),
        &places,
        |[a, b, ..]| {
            let taps = taps(Shape { rows: 48, columns: 32 }, a, b);
            [taps.columns[0], taps.columns[1], taps.rows[0], taps.rows[1]].map(|x| x as f64)
        },
        (0.0, 0.0),
    );
    compare(
        files!(TRI_MIP; "let t = texel_taps(vec2<u32>(32u, 48u), x.xy); return vec4<f32>(tap_weight(t, 0u, 0u), tap_weight(t, 0u, 1u), tap_weight(t, 1u, 0u), tap_weight(t, 1u, 1u));"),
        &places,
        |[a, b, ..]| {
            let [below, above] = taps(Shape { rows: 48, columns: 32 }, a, b).weights;
            [below[0], below[1], above[0], above[1]]
        },
        (4e-6, 0.0),
    );
}

#[test]
fn fixed_point_there_and_back() {
    // Fixed point has 30 fractional bits. Sums of two values of either sign must be right whether the low words carry
    // or not.
    compare(
        files!(FIXED; "let a = to_fixed(x.x); let b = to_fixed(x.y); let low = a.x + b.x; let high = a.y + b.y + select(0u, 1u, low < a.x); return vec4<f32>(from_fixed(a), from_fixed(negated(a)), from_fixed(vec2<u32>(low, high)), 0.0);"),
        &numbers()
            .into_iter()
            .flat_map(|x| [0.0_f32, 1.5, -1.5, 7e-4, -1e6].map(|y| [x, y, 0.0, 0.0]))
            .collect::<Vec<_>>(),
        |[x, y, ..]| [x, -x, x + y, 0.0],
        (2.0 / f64::from(1 << 30), 3e-7),
    );
}

#[test]
fn random_numbers_are_the_same_integers() {
    let Some(gpu) = gpu() else { return };
    let draws = rng::Random::new(9).at(rng::Sequence::Pixel, 77);
    let counts = [1, 2, 1000, 65_536, 4_000_000_000_u32];
    let inputs: Vec<[f32; 4]> = (0..200_u32)
        .map(|i| {
            let bits = draws.bits(i);
            // Index, random bits and count are passed as the bits of floats.
            [i, bits[0], counts[i as usize % counts.len()], 0].map(f32::from_bits)
        })
        .collect();
    let found = run(
        &gpu,
        files!(RANDOM; "let i = bitcast<vec4<u32>>(x); return vec4<f32>(f32(below(i.y, i.z) >> 16u), f32(below(i.y, i.z) & 0xffffu), unit(i.y), 0.0);"),
        &inputs,
    );
    for (input, found) in inputs.iter().zip(&found) {
        let [_, bits, count, _] = input.map(f32::to_bits);
        let expected = rng::below(bits, count);
        assert_eq!(found[0] as u32 * 65_536 + found[1] as u32, expected, "below({bits}, {count})");
        assert_eq!(found[2], rng::unit(bits));
    }
    // Checks the hash itself, on words that are passed in the same way. The upper 24 bits of its four numbers are
    // compared, because floats represent them exactly.
    let words: Vec<[u32; 4]> =
        (0..50).map(|step| rng::Random::new(step).at(rng::Sequence::Cell, step).words()).collect();
    let inputs: Vec<[f32; 4]> = words.iter().map(|words| words.map(f32::from_bits)).collect();
    let found = run(
        &gpu,
        files!(RANDOM; "return vec4<f32>(random_bits(bitcast<vec4<u32>>(x), 12345u) >> vec4<u32>(8u));"),
        &inputs,
    );
    for (step, found) in (0..50).zip(&found) {
        let expected = rng::Random::new(step).at(rng::Sequence::Cell, step).bits(12_345);
        assert_eq!(found.map(|x| x as u32), expected.map(|bits| bits >> 8));
    }
}
