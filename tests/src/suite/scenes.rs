//! Tests of scenes whose pictures are known analytically: a homogeneous medium (Beer and Lambert) and a box of one
//! opaque colour. σ is the density, L the length of a ray in the box, δ the marching step.

use crate::{fixtures, reference};
use glam::DVec3;
use trimip_core::{
    Backend, Camera, Config, Frame, Intrinsics, Layout, Result, Viewer,
    engine::{batch::Ray, loaded::LoadedModel},
    field::{
        model::Model,
        tensors::{Tensor, TensorFile},
    },
};

/// Rounding error of several hundred f32 additions.
const ROUNDING: f64 = 2e-5;

/// Renders a model with the given parameters and occupancy.
fn render<B: Backend>(
    backend: B,
    config: &Config,
    parameters: &[f32],
    bits: Vec<u8>,
    camera: &Camera,
) -> Result<Frame> {
    let mut file = TensorFile::default();
    Layout::new(config).to_tensors(parameters, "", &mut file);
    file.tensors.insert("occupancy".into(), Tensor::u8(&[bits.len()], bits));
    LoadedModel::new(backend, &Model::new(config.clone(), file))?.render(camera)
}

/// If all logits are zero, the density is e⁻¹ and the colour grey 1/2 everywhere, and every pixel has the analytic
/// opacity, colour and depth.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn homogeneous<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for steps in [64, 1000] {
        let mut config = fixtures::small();
        config.renderer.steps_per_diagonal = steps;
        let layout = Layout::new(&config);
        let cells = config.occupancy.resolution.pow(3) as usize;
        let intrinsics = Intrinsics::from_angle(9, 7, 0.9);
        let camera = Camera::look_at(intrinsics, DVec3::new(3.1, -2.2, 1.7), DVec3::ZERO, DVec3::Z);
        // Planes of zeros give density logits of 0 for any density network. The colour network is zero too; otherwise
        // the spherical harmonics would be visible.
        let mut parameters = fixtures::lively(&layout, 5);
        parameters[layout.slots[0].range.clone()].fill(0.0);
        for slot in layout.network("color") {
            parameters[slot.range.clone()].fill(0.0);
        }
        let frame = render(make(), &config, &parameters, vec![0xff; cells / 8], &camera)?;
        let (sigma, step) = ((-1.0_f64).exp(), reference::step_length(&config));
        let mut misses = 0;
        for (i, pixel) in frame.pixels.iter().enumerate() {
            let ray = Ray::from(camera.cone::<f32>(i as u32 % 9, i as u32 / 9));
            let (origin, direction) = (ray.origin.map(f64::from), ray.direction.map(f64::from));
            let (enter, leave) = reference::tile(&config, origin, direction).unwrap_or((0.0, 0.0));
            misses += usize::from(enter == leave);
            // Number of steps whose middle lies in the box: L/δ rounded, so the quadrature covers L to within half a
            // step.
            let count = ((leave - enter) / step).round();
            let covered = 1.0 - (-sigma * count * step).exp();
            let exact = 1.0 - (-sigma * (leave - enter)).exp();
            assert!((covered - exact).abs() <= sigma * 0.5 * step);
            let edge = (((leave - enter) / step).fract() - 0.5).abs() < 1e-4;
            let tolerance = ROUNDING + if edge { sigma * step } else { 0.0 };
            let opacity = f64::from(pixel.opacity);
            assert!((opacity - covered).abs() < tolerance, "pixel {i}: opacity {opacity}, not {covered}");
            for c in 0..3 {
                let background = f64::from(config.data.background[c]);
                let expected = (1.0 - covered) * background + covered * 0.5;
                assert!((f64::from(pixel.rgb[c]) - expected).abs() < tolerance, "pixel {i}: {pixel:?}");
            }
            // ∫ σ·exp(−σ(t − t₀))·t dt over the box. The midpoint rule is off by up to half a step at the end of the
            // box, times the weight there.
            let depth = f64::from(ray.cosine)
                * ((enter + sigma.recip()) - (leave + sigma.recip()) * (-sigma * (leave - enter)).exp());
            let bound = 0.5 * step * sigma * (leave + step) + 8.0 * ROUNDING;
            assert!(
                (f64::from(pixel.depth) - depth).abs() <= bound,
                "pixel {i}: depth {}, not {depth}",
                pixel.depth
            );
        }
        assert!(misses > 0 && misses < 63, "some rays miss the box");
    }
    Ok(())
}

/// Some cells are filled with one opaque colour. Pixels whose ray crosses them for more than two steps have that colour
/// and the depth of the first occupied face; pixels whose ray misses them show the background.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn silhouette<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let mut config = fixtures::small();
    config.renderer.steps_per_diagonal = 600;
    config.occupancy.resolution = 12;
    let rgb = [0.1, 0.7, 0.4];
    let parameters = fixtures::constant(&config, &Layout::new(&config), 3000.0, rgb);
    // Cells 4..7 × 5..8 × 3..10 of 12: a box that is not aligned with blocks of four.
    let (low, high) = ([4_u32, 5, 3], [7_u32, 8, 10]);
    let mut bits = vec![0_u8; 12 * 12 * 12 / 8];
    for cell in 0..12_u32.pow(3) {
        let place = [cell % 12, cell / 12 % 12, cell / 144];
        let inside = (0..3).all(|axis| (low[axis]..high[axis]).contains(&place[axis]));
        bits[cell as usize / 8] |= u8::from(inside) << (cell % 8);
    }
    let mut inner = config.clone();
    inner.scene.aabb_min = low.map(|c| c as f32 * 0.25 - 1.5);
    inner.scene.aabb_max = high.map(|c| c as f32 * 0.25 - 1.5);
    let intrinsics = Intrinsics::from_angle(33, 31, 0.5);
    let step = reference::step_length(&config);
    for origin in [DVec3::new(4.0, 0.3, 0.2), DVec3::new(-2.0, 3.0, 2.5), DVec3::new(0.1, 0.2, -4.0)] {
        let up = if origin.x.abs() < 1.0 { DVec3::Y } else { DVec3::Z };
        let camera = Camera::look_at(intrinsics, origin, DVec3::ZERO, up);
        let frame = render(make(), &config, &parameters, bits.clone(), &camera)?;
        let [mut hits, mut misses, mut edges] = [0, 0, 0];
        for (i, pixel) in frame.pixels.iter().enumerate() {
            let ray = Ray::from(camera.cone::<f32>(i as u32 % 33, i as u32 / 33));
            let (origin, direction) = (ray.origin.map(f64::from), ray.direction.map(f64::from));
            let (expected, opacity) = match reference::tile(&inner, origin, direction) {
                None => (config.data.background.map(f64::from), 0.0),
                Some((enter, leave)) if leave - enter > 2.0 * step => {
                    let depth = f64::from(pixel.depth) / f64::from(ray.cosine);
                    // The first midpoint lies within a step of the face; later samples have weights below 1e-10.
                    assert!(
                        (depth - enter - 0.5 * step).abs() <= 0.6 * step,
                        "pixel {i}: {depth}, face at {enter}"
                    );
                    (rgb, 1.0)
                }
                Some(_) => {
                    edges += 1;
                    continue;
                }
            };
            *(if opacity == 0.0 { &mut misses } else { &mut hits }) += 1;
            assert!((f64::from(pixel.opacity) - opacity).abs() < 1e-6, "pixel {i}: {pixel:?}");
            for c in 0..3 {
                assert!((f64::from(pixel.rgb[c]) - expected[c]).abs() < 1e-5, "pixel {i}: {pixel:?}");
            }
        }
        assert!(
            hits > 50 && misses > 300 && edges * 20 < hits + misses,
            "{hits} hit, {misses} miss, {edges} graze"
        );
    }
    Ok(())
}
