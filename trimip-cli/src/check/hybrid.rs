//! Hybrid rendering, compared with volume rendering of the same model: a ball of constant density σ = 1/e. Small boxes
//! make the ball thin fog, large boxes make it solid.

use super::finding::{Finding, Make, Tell, apart, worst};
use super::rig::small;
use glam::DVec3;
use trimip_core::config::RendererKind;
use trimip_core::engine::loaded::LoadedModel;
use trimip_core::engine::proxy::{Baking, bake};
use trimip_core::field::model::Model;
use trimip_core::field::tensors::{Tensor, TensorFile};
use trimip_core::{Backend, Camera, Config, Frame, Intrinsics, Layout, Result, Viewer, math::bits};

/// Density of a field whose planes are all zero.
const DENSITY: f64 = 0.367_879_441_171_442_33;

/// Radius of the ball in boxes of half-width 1.
const RADIUS: f64 = 0.7;

/// Returns a ball in a box of half-width `half`: cells whose centre lies in the ball are occupied.
fn ball(half: f32) -> Model {
    let mut config = small();
    (config.scene.aabb_min, config.scene.aabb_max) = ([-half; 3], [half; 3]);
    config.occupancy.resolution = 32;
    config.renderer.steps_per_diagonal = 1024;
    (config.renderer.cone_width, config.renderer.cones) = (half / 16.0, 1);
    config.hybrid.resolution = 256;
    let layout = Layout::new(&config);
    let mut parameters = layout.initial(&config);
    parameters[layout.slots[0].range.clone()].fill(0.0);
    let cells = config.occupancy.resolution;
    let mut bits = vec![0_u8; (cells as usize).pow(3) / 8];
    for cell in 0..cells.pow(3) {
        let at = [cell % cells, cell / cells % cells, cell / cells / cells];
        let at = at.map(|c| 2.0 * (f64::from(c) + 0.5) / f64::from(cells) - 1.0);
        if DVec3::from(at).length() < RADIUS {
            bits::set(&mut bits, cell as usize);
        }
    }
    let mut file = TensorFile::default();
    layout.to_tensors(&parameters, "", &mut file);
    file.tensors.insert("occupancy".into(), Tensor::u8(&[bits.len()], bits));
    Model::new(config, file)
}

fn picture<B: Backend>(
    make: Make<'_, B>,
    model: &Model,
    kind: RendererKind,
    camera: &Camera,
) -> Result<Frame> {
    let mut model = model.clone();
    model.config.renderer.kind = kind;
    LoadedModel::new(make()?, &model)?.render(camera)
}

/// Returns the largest difference in opacity.
fn difference(a: &Frame, b: &Frame) -> f64 {
    worst(a.pixels.iter().zip(&b.pixels).map(|(a, b)| apart(a.opacity, b.opacity.into())))
}

/// Returns the number of pixels whose colour differs in any bit.
fn changed(a: &Frame, b: &Frame) -> f64 {
    let differ = |(a, b): &(&trimip_core::Pixel, &trimip_core::Pixel)| {
        a.rgb.map(f32::to_bits) != b.rgb.map(f32::to_bits)
    };
    a.pixels.iter().zip(&b.pixels).filter(differ).count() as f64
}

/// Returns the largest difference in opacity that the rule of hybrid rendering and the step lengths of both renderers allow.
fn bound(config: &Config) -> f64 {
    let hybrid = 2.0 * f64::from(config.scene.aabb_max[0]) / f64::from(config.hybrid.resolution);
    let steps = f64::from(config.hybrid.step) * hybrid + f64::from(config.step_length());
    f64::from(config.hybrid.least.max(config.hybrid.opaque)) + DENSITY * steps
}

/// Runs the cases of this part.
pub fn cases<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    use RendererKind::{Hybrid, Volume};
    let found =
        |case: &str, law, worst, bound| Finding { part: "hybrid", case: case.into(), law, worst, bound };
    let look = |size: u32, angle: f64, eye: DVec3, at: DVec3| {
        Camera::look_at(Intrinsics::from_angle(size, size, angle), eye, at, DVec3::Z)
    };
    for (half, name) in [(0.1_f32, "thin fog"), (1.0, "a cloud"), (20.0, "a solid ball")] {
        let mut model = ball(half);
        let without = picture(make, &model, Hybrid, &look(4, 0.7, DVec3::X * 4.0, DVec3::ZERO));
        let refused = without.is_err_and(|error| error.kind() == trimip_core::ErrorKind::Input);
        let config = model.config.clone();
        let mut viewer = LoadedModel::new(make()?, &model)?;
        let proxy = bake(&mut viewer, &model, &Baking::of(&config), &mut |_| true)?;
        model.file.tensors.extend(proxy.map(|proxy| proxy.to_assets()).transpose()?.unwrap_or_default());
        let scale = f64::from(half);
        let eye = scale * DVec3::new(3.0, -2.0, 1.5);
        let far = look(24, 0.5, eye, DVec3::ZERO);
        let volume = picture(make, &model, Volume, &far)?;
        let hybrid = picture(make, &model, Hybrid, &far)?;
        tell(found(name, "opacity as in volume rendering", difference(&hybrid, &volume), bound(&config)));
        // The mean over all pixels, because the errors at the silhouette have both signs.
        let mean = |frame: &Frame| {
            frame.pixels.iter().map(|p| f64::from(p.opacity)).sum::<f64>() / frame.pixels.len() as f64
        };
        tell(found(
            &format!("{name}, with its silhouette"),
            "mean opacity as in volume rendering",
            apart(mean(&hybrid), mean(&volume)),
            f64::from(config.hybrid.least),
        ));
        let inside = look(8, 0.9, 0.2 * eye, DVec3::ZERO);
        let (a, b) = (picture(make, &model, Hybrid, &inside)?, picture(make, &model, Volume, &inside)?);
        tell(found(
            &format!("{name}, from within"),
            "opacity as in volume rendering",
            difference(&a, &b),
            bound(&config),
        ));
        let away = picture(make, &model, Hybrid, &look(8, 0.3, eye, 3.0 * eye))?;
        let lit = away.pixels.iter().filter(|p| p.rgb != config.data.background || p.opacity != 0.0).count();
        tell(found(&format!("{name}, looking away"), "pixels that are not the background", lit as f64, 0.0));
        // A picture of one pixel, which is wider than the ball.
        let wide = look(1, 0.9, eye, DVec3::ZERO);
        let (a, b) = (picture(make, &model, Hybrid, &wide)?, picture(make, &model, Volume, &wide)?);
        tell(found(
            &format!("{name}, a cone wider than it"),
            "pixels whose bits differ from volume rendering",
            changed(&a, &b),
            0.0,
        ));
        let mut blind = model.clone();
        blind.file.tensors.insert("occupancy".into(), Tensor::u8(&[32 * 32 * 4], vec![0; 32 * 32 * 4]));
        let empty = bake(&mut viewer, &blind, &Baking::of(&config), &mut |_| true)?;
        let mut blind = model.clone();
        blind.file.tensors.extend(empty.map(|proxy| proxy.to_assets()).transpose()?.unwrap_or_default());
        tell(found(
            &format!("{name}, an empty proxy"),
            "pixels whose bits differ from volume rendering",
            changed(&picture(make, &blind, Hybrid, &far)?, &volume),
            0.0,
        ));
        let mut broken = model.clone();
        broken.file.tensors.insert("asset.proxy.codes".into(), Tensor::u8(&[3], vec![1, 2, 3]));
        let torn = picture(make, &broken, Hybrid, &far)
            .is_err_and(|error| error.kind() == trimip_core::ErrorKind::Input);
        tell(found(
            &format!("{name}, no proxy and a broken one"),
            "pictures that are not refused",
            f64::from(u8::from(!refused) + u8::from(!torn)),
            0.0,
        ));
    }
    Ok(())
}
