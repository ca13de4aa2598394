//! Hybrid rendering: pictures rendered with the proxy of a model match those of volume rendering.

use crate::fixtures::{as_code, constant, small};
use glam::DVec3;
use trimip_core::{
    Backend, Camera, Config, Frame, Intrinsics, Layout, Query, Result, Session, Viewer,
    config::RendererKind,
    engine::{
        batch::{Radiance, Ray},
        loaded::LoadedModel,
        proxy::{Baking, bake},
        trainer::Trainer,
    },
    field::{
        model::Model,
        tensors::{Tensor, TensorFile},
    },
    measures::metrics::psnr,
};
use trimip_data::settings::DataConfig;

/// Number of training steps.
const STEPS: u64 = 200;

/// Trains a model of the built-in scene and adds its proxy.
///
/// # Panics
/// When training fails.
pub fn model<B: Backend>(backend: B) -> Model {
    let mut config: Config = as_code();
    let read = config.change(|data: &mut DataConfig| {
        data.format = "builtin".into();
        (data.builtin_size, data.builtin_train, data.builtin_test) = (48, 12, 1);
        (data.builtin_supersampling, data.scales) = (2, 2);
    });
    read.expect("settings of a small scene");
    (config.encoder.plane_size, config.encoder.levels) = (64, 5);
    config.field.hidden = 32;
    config.renderer.steps_per_diagonal = 256;
    (config.renderer.cones, config.renderer.cone_width) = (2, 0.04);
    (config.occupancy.resolution, config.occupancy.warmup) = (32, 64);
    (config.train.samples_per_step, config.train.steps) = (4096, STEPS);
    config.hybrid.resolution = 96;
    let scene = trimip_data::open(&config.section().expect("a small scene"))
        .expect("the built-in scene needs no file");
    let mut trainer = Trainer::new(backend, &config, scene.train).expect("a small configuration is accepted");
    for step in 0..STEPS {
        trainer.step(step as f64 / STEPS as f64).expect("a step succeeds");
    }
    let mut model = trainer.finish().expect("the model is read");
    add_proxy(&mut trainer, &mut model).expect("the proxy is computed");
    model
}

/// Adds the proxy of a model, which `viewer` evaluates.
///
/// # Errors
/// When the device fails.
pub fn add_proxy(viewer: &mut dyn Viewer, model: &mut Model) -> Result<()> {
    let proxy = bake(viewer, model, &Baking::of(&model.config), &mut |_| true)?;
    model.file.tensors.extend(proxy.expect("nobody stops it").to_assets()?);
    Ok(())
}

/// Renders a model with the given kind of renderer.
///
/// # Errors
/// When the backend refuses the model, or the device fails.
pub fn picture<B: Backend>(backend: B, model: &Model, kind: RendererKind, camera: &Camera) -> Result<Frame> {
    let mut model = model.clone();
    model.config.renderer.kind = kind;
    LoadedModel::new(backend, &model)?.render(camera)
}

/// Returns a camera that looks at the origin.
pub fn camera(size: u32, eye: DVec3) -> Camera {
    Camera::look_at(Intrinsics::from_angle(size, size, 0.69), eye, DVec3::ZERO, DVec3::Z)
}

/// Returns the bits of all colours.
pub fn bits(frame: &Frame) -> Vec<u32> {
    frame.pixels.iter().flat_map(|pixel| pixel.rgb.map(f32::to_bits)).collect()
}

/// Checks the hybrid pictures of a trained [`model`].
///
/// # Errors
/// When the backend refuses the model.
pub fn pictures<B: Backend>(make: impl Fn() -> B, model: &Model) -> Result<()> {
    use RendererKind::{Hybrid, Volume};
    let eye = DVec3::new(3.0, -2.0, 2.0);
    let far = camera(36, eye);
    let hybrid = picture(make(), model, Hybrid, &far)?;

    // The hybrid picture has a PSNR above 38 dB against the volume-rendered one. Against the photographs, training reaches
    // only about 25 dB.
    let volume = picture(make(), model, Volume, &far)?;
    let near = psnr(&hybrid.rgb(), &volume.rgb());
    assert!(near > 38.0, "{near:.1} dB");
    let apart = hybrid.pixels.iter().zip(&volume.pixels).map(|(a, b)| f64::from(a.opacity - b.opacity).abs());
    let apart = apart.sum::<f64>() / hybrid.pixels.len() as f64;
    assert!(volume.pixels.iter().filter(|pixel| pixel.opacity > 0.9).count() > 60, "something is seen");
    assert!(apart < 0.02, "opacities differ by {apart:.4} on average");

    // Rays that hit nothing show the background.
    let away = Camera::look_at(far.intrinsics, eye, 3.0 * eye, DVec3::Z);
    let background = model.config.data.background;
    let found = picture(make(), model, Hybrid, &away)?;
    assert!(found.pixels.iter().all(|pixel| pixel.rgb == background && pixel.opacity == 0.0));

    // A camera within the proxy.
    let inside = camera(16, DVec3::new(0.2, -0.1, 0.1));
    let (found, expected) =
        (picture(make(), model, Hybrid, &inside)?, picture(make(), model, Volume, &inside)?);
    assert!(found.pixels.iter().all(|pixel| pixel.rgb.iter().all(|c| (0.0..=1.0 + 1e-5).contains(c))));
    let near = psnr(&found.rgb(), &expected.rgb());
    assert!(near > 25.0, "within: {near:.1} dB");

    // Cones that are too wide for the proxy are volume-rendered, so the picture has the bits of volume rendering.
    let wide = camera(4, eye);
    let (found, expected) = (picture(make(), model, Hybrid, &wide)?, picture(make(), model, Volume, &wide)?);
    assert_eq!(bits(&found), bits(&expected));

    // If the proxy has no density anywhere, the hybrid picture is the volume-rendered one.
    let mut blind = model.clone();
    add_proxy(&mut Nothing, &mut blind)?;
    assert_eq!(bits(&picture(make(), &blind, Hybrid, &far)?), bits(&volume));
    Ok(())
}

/// In a box full of fog of one colour and any density, the opacity of a ray differs from the exact one by less than the larger of
/// `hybrid.least` and `hybrid.opaque`, plus the optical depth of one step. The ray has the fog's colour.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn fog<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let camera = camera(7, DVec3::new(3.1, -2.2, 1.7));
    for density in [0.02, 0.3, 3.0] {
        let mut config = small();
        config.hybrid.resolution = 64;
        config.renderer.kind = RendererKind::Hybrid;
        // No cone is too wide for the proxy.
        config.hybrid.widest = 1e3;
        let layout = Layout::new(&config);
        let rgb = [0.2, 0.5, 0.7];
        let mut file = TensorFile::default();
        layout.to_tensors(&constant(&config, &layout, density, rgb), "", &mut file);
        let cells = config.occupancy.resolution.pow(3) as usize;
        file.tensors.insert("occupancy".into(), Tensor::u8(&[cells / 8], vec![0xff; cells / 8]));
        let mut model = Model::new(config.clone(), file);
        let of_volume = Config { renderer: small().renderer, ..config.clone() };
        let mut viewer = LoadedModel::new(make(), &Model { config: of_volume, ..model.clone() })?;
        add_proxy(&mut viewer, &mut model)?;
        let frame = LoadedModel::new(make(), &model)?.render(&camera)?;
        let mut hits = 0;
        for (i, pixel) in frame.pixels.iter().enumerate() {
            let ray = Ray::from(camera.cone::<f32>(i as u32 % 7, i as u32 / 7));
            let (origin, direction) = (ray.origin.map(f64::from), ray.direction.map(f64::from));
            let (enter, leave) = crate::reference::tile(&config, origin, direction).unwrap_or((0.0, 0.0));
            hits += usize::from(leave > enter);
            let exact = 1.0 - (-density * (leave - enter)).exp();
            // Whole steps of 1.25 cells cover the path; an opaque ray ends early.
            let step = 3.0 * f64::from(config.hybrid.step) / f64::from(config.hybrid.resolution);
            let bound = f64::from(config.hybrid.least.max(config.hybrid.opaque)) + density * step;
            let opacity = f64::from(pixel.opacity);
            assert!((opacity - exact).abs() < bound, "density {density}: opacity {opacity}, not {exact}");
            for c in 0..3 {
                let expected = (1.0 - opacity) * f64::from(config.data.background[c]) + opacity * rgb[c];
                assert!((f64::from(pixel.rgb[c]) - expected).abs() < 1e-3, "{pixel:?}");
            }
        }
        assert!(hits > 10);
    }
    Ok(())
}

/// A viewer whose field has no density.
struct Nothing;

impl Viewer for Nothing {
    fn backend(&self) -> &str {
        "nothing"
    }
    fn device_name(&self) -> String {
        "nothing".into()
    }
    fn render(&mut self, _: &Camera) -> Result<Frame> {
        Err(trimip_core::Error::run("renders nothing"))
    }
    fn render_watched(&mut self, _: &Camera, _: &mut dyn FnMut(u32, u32) -> bool) -> Result<Option<Frame>> {
        Err(trimip_core::Error::run("renders nothing"))
    }
    fn query(&mut self, queries: &[Query]) -> Result<Vec<Radiance>> {
        Ok(vec![Radiance::default(); queries.len()])
    }
}
