//! Property tests: the laws of `trimip-cli check` on random cases.

use glam::DVec3;
use proptest::prelude::*;
use trimip_core::config::{EncoderConfig, PlaneShape};
use trimip_core::field::encoders::tri_mip::{CHANNELS, PLANE_AXES, Pyramid, grow, taps};
use trimip_core::math::compositing::{composite, composite_gradient};
use trimip_core::scene::silhouettes;
use trimip_core::scene_plan::radii;
use trimip_core::{Aabb, Alpha, Camera, Config, Intrinsics, Scale, View, ViewSet};

/// Generates the samples of a ray: optical depths from 1e-12 to 1e12, colours and distances.
fn ray() -> impl Strategy<Value = Vec<(f64, [f64; 3], f64)>> {
    let sample = (-12.0..12.0_f64, prop::array::uniform3(0.0..1.0_f64), 0.1..10.0_f64);
    prop::collection::vec(sample.prop_map(|(depth, rgb, t)| (10_f64.powf(depth), rgb, t)), 0..60)
}

/// Generates a box at a random position, with side ratios up to 1 : 1000.
fn aabb() -> impl Strategy<Value = Aabb<f64>> {
    let sides = prop::array::uniform3((-3.0..0.0_f64).prop_map(|log| 10_f64.powf(log)));
    (sides, prop::array::uniform3(-5.0..5.0_f64))
        .prop_map(|(sides, min)| Aabb { min, max: std::array::from_fn(|i| min[i] + sides[i]) })
}

fn direction() -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-1.0..1.0_f64)
        .prop_map(DVec3::from_array)
        .prop_filter("a direction", |v| v.length() > 1e-3)
        .prop_map(DVec3::normalize)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    /// A pixel is a mean of the samples along its ray and the background, in f32 and in f64.
    #[test]
    fn a_pixel_lies_between_its_samples_and_its_background(samples in ray(), background in 0.0..1.0_f64) {
        let wide = composite(samples.iter().copied(), [background; 3]);
        let narrow = samples.iter().map(|&(depth, rgb, t)| (depth as f32, rgb.map(|c| c as f32), t as f32));
        let narrow = composite(narrow, [background as f32; 3]);
        prop_assert!((0.0..=1.0).contains(&wide.opacity) && (0.0..=1.0).contains(&narrow.opacity));
        for c in 0..3 {
            let all = samples.iter().map(|(_, rgb, _)| rgb[c]).chain([background]);
            let (low, high) = all.fold((1.0, 0.0), |(low, high): (f64, f64), x| (low.min(x), high.max(x)));
            prop_assert!(wide.rgb[c] >= low - 1e-12 && wide.rgb[c] <= high + 1e-12);
            prop_assert!((f64::from(narrow.rgb[c]) - wide.rgb[c]).abs() < 1e-5);
        }
    }

    /// The gradient of a pixel is finite for any media, and matches central differences where these are accurate
    /// enough.
    #[test]
    fn gradients_are_finite_and_true(
        depths in prop::collection::vec(1e-3..2.0_f64, 1..12),
        extreme in ray(),
        upstream in prop::array::uniform4(-1.0..1.0_f64),
    ) {
        let color = |i: usize| [0.2, 0.9, 0.4].map(|c| (c + 0.37 * i as f64).fract());
        let samples: Vec<_> = depths.iter().enumerate().map(|(i, &x)| (x, color(i), i as f64)).collect();
        let background = [0.3, 0.6, 0.1];
        let value = |samples: &[(f64, [f64; 3], f64)]| {
            let pixel = composite(samples.iter().copied(), background);
            upstream.iter().zip(pixel.channels()).map(|(g, value)| g * value).sum::<f64>()
        };
        let mut found = vec![(0.0, [0.0; 3]); samples.len()];
        gradient(&samples, background, upstream, &mut found);
        for i in 0..samples.len() {
            let moved = |by: f64| {
                let mut other = samples.clone();
                other[i].0 += by;
                value(&other)
            };
            let expected = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            prop_assert!((found[i].0 - expected).abs() < 1e-7, "sample {i}: {} for {expected}", found[i].0);
        }
        let mut found = vec![(0.0, [0.0; 3]); extreme.len()];
        gradient(&extreme, background, upstream, &mut found);
        prop_assert!(found.iter().all(|(x, rgb)| x.is_finite() && rgb.iter().all(|c| c.is_finite())));
    }

    /// A ray is inside the box between entering and leaving it, and outside before and after.
    #[test]
    fn a_ray_is_in_the_box_from_entering_to_leaving(
        aabb in aabb(), from in direction(), at in prop::array::uniform3(-0.2..1.2_f64), distance in 0.0..20.0_f64,
    ) {
        let target = DVec3::from_array(std::array::from_fn(|i| aabb.min[i] + at[i] * aabb.extent()[i]));
        let origin = target + distance * from;
        let (enter, leave) = aabb.intersect(origin.to_array(), (-from).to_array());
        let inside = |t: f64, slack: f64| {
            let p = origin - t * from;
            (0..3).all(|i| p[i] >= aabb.min[i] - slack && p[i] <= aabb.max[i] + slack)
        };
        if enter < leave {
            for fraction in [0.0, 0.25, 0.5, 0.75, 1.0] {
                prop_assert!(inside(enter + fraction * (leave - enter), 1e-9));
            }
            prop_assert!(!inside(leave + 1e-3, 0.0));
            prop_assert!(enter < 1e-3 || !inside(enter - 1e-3, 0.0));
        } else {
            let missed = (0..400).all(|i| !inside(f64::from(i) * 0.075, -1e-9));
            prop_assert!(missed);
        }
    }

    /// The planes of any box have nearly square texels, levels that halve evenly, and interpolation weights that sum to
    /// one.
    #[test]
    fn planes_fit_their_box(
        aabb in aabb(), levels in 1..7_u32, units in 1..20_u32, a in 0.0..1.0_f64, b in 0.0..1.0_f64,
    ) {
        let config = EncoderConfig {
            plane_size: (units << (levels - 1)).max(4).next_multiple_of(1 << (levels - 1)),
            levels,
            shape: PlaneShape::Box,
            ..Config::default().encoder
        };
        let fitted = Pyramid::new(&config, &aabb);
        let texel = aabb.longest() / f64::from(config.plane_size);
        for axis in 0..3 {
            prop_assert!(fitted.sides[axis].is_multiple_of(1 << (levels - 1)));
            // Texels are not coarser than requested, and a side has less than one unit of texels too many.
            let own = aabb.extent()[axis] / fitted.sides[axis] as f64;
            prop_assert!(own <= texel * 1.02, "{own} for {texel}");
            let unit = f64::from(1 << (levels - 1));
            prop_assert!((fitted.sides[axis] as f64) < aabb.extent()[axis] / texel + unit + 0.02);
        }
        for level in 0..fitted.levels {
            for plane in 0..3 {
                let shape = fitted.shape(level, plane);
                let [along, across] = PLANE_AXES[plane].map(|axis| fitted.sides[axis]);
                prop_assert_eq!([shape.columns << level, shape.rows << level], [along, across]);
                let read = taps(shape, a, b);
                prop_assert!(read.columns.iter().all(|&i| i < shape.columns));
                prop_assert!(read.rows.iter().all(|&i| i < shape.rows));
                let sum: f64 = read.weights.iter().flatten().sum();
                prop_assert!((sum - 1.0).abs() < 1e-12);
            }
        }
        // Growing preserves the mean of the texels.
        if levels > 1 && fitted.base_len() < 200_000 {
            let half = fitted.halved(1);
            let mut values: Vec<f64> = (0..fitted.base_len()).map(|i| (i as f64 * 0.7).sin()).collect();
            let before: f64 = values[..half.base_len()].iter().sum();
            grow(&mut values, &fitted, 1, 0);
            let after: f64 = values.iter().sum();
            prop_assert!((after - 4.0 * before).abs() < 1e-6 * values.len() as f64);
            prop_assert_eq!(values.len() % CHANNELS, 0);
        }
    }
}

/// Computes the gradients with respect to optical depths and colours.
fn gradient(
    samples: &[(f64, [f64; 3], f64)],
    background: [f64; 3],
    upstream: [f64; 4],
    out: &mut [(f64, [f64; 3])],
) {
    let pixel = composite(samples.iter().copied(), background);
    let sample = |i: usize| (samples[i].0, samples[i].1);
    composite_gradient(samples.len(), sample, pixel.channels(), upstream, |i, x, rgb| out[i] = (x, rgb));
}

/// Returns silhouettes of a box, seen from cameras all around it.
fn photographs(object: &Aabb<f64>, origins: &[DVec3]) -> ViewSet {
    let k = Intrinsics::from_angle(64, 64, 0.8);
    let mut set = ViewSet {
        views: vec![],
        pixels: Default::default(),
        alpha: Alpha::Straight,
        scales: vec![],
        depths: Vec::new(),
    };
    for (i, &origin) in origins.iter().enumerate() {
        let camera = Camera::look_at(k, origin, DVec3::ZERO, DVec3::new(0.1, 0.2, 0.97));
        set.views.push(View { name: i.to_string(), camera, offset: set.pixels.len() });
        for (y, x) in (0..64).flat_map(|y| (0..64).map(move |x| (y, x))) {
            let cone = camera.cone::<f64>(x, y);
            let (enter, leave) = object.intersect(cone.origin, cone.direction);
            set.pixels.push([255, 255, 255, if enter < leave { 255 } else { 0 }]);
        }
    }
    let (views, pixels) = (0..set.views.len(), 0..set.pixels.len());
    set.scales.push(Scale { factor: 1, weight: 1.0, views, pixels });
    set
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    /// The fitted box contains everything in the photographs, and every sphere's radius is within the predicted range.
    #[test]
    fn a_fitted_box_holds_the_object(
        centre in prop::array::uniform3(-0.5..0.5_f64),
        half in prop::array::uniform3(0.08..0.5_f64),
        directions in prop::collection::vec(direction(), 4..12),
    ) {
        let object = Aabb {
            min: std::array::from_fn(|i| centre[i] - half[i]),
            max: std::array::from_fn(|i| centre[i] + half[i]),
        };
        let origins: Vec<DVec3> = directions.iter().map(|d| 4.0 * *d).collect();
        let views = photographs(&object, &origins);
        let whole = Aabb { min: [-1.5; 3], max: [1.5; 3] };
        let fitted = silhouettes::bounds(&views, &whole, 0.0).expect("silhouettes");
        for axis in 0..3 {
            prop_assert!(fitted.min[axis] <= object.min[axis] + 1e-9, "{fitted:?} for {object:?}");
            prop_assert!(fitted.max[axis] >= object.max[axis] - 1e-9, "{fitted:?} for {object:?}");
        }
        let cameras = views.views.iter().map(|view| &view.camera);
        let [least, most] = radii::range(cameras, &fitted).expect("cameras");
        for view in &views.views {
            for (x, y) in [(0, 0), (31, 32), (63, 5), (20, 63)] {
                let cone = view.camera.cone::<f64>(x, y);
                let (enter, leave) = fitted.intersect(cone.origin, cone.direction);
                prop_assert!(enter >= leave || (cone.slope * enter >= least && cone.slope * leave <= most));
            }
        }
    }
}
