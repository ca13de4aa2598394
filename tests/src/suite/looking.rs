//! Tests of views other than colours: the number of samples of each pixel, and a clipped part of the box. In fog of one density
//! both follow from the lengths of the rays within the box.

use crate::fixtures::{constant, small};
use glam::DVec3;
use trimip_core::{
    Aabb, Backend, Camera, Config, Crop, Intrinsics, Layout, Result, Viewer,
    engine::loaded::LoadedModel,
    field::{
        model::Model,
        tensors::{Tensor, TensorFile},
    },
    scene::cones::Division,
};

/// Returns a model of fog that fills the box, configured so that rendering omits no sample.
fn fog(config: &mut Config, density: f64) -> Model {
    (config.renderer.min_transmittance, config.renderer.min_weight) = (0.0, 0.0);
    let layout = Layout::new(config);
    let mut file = TensorFile::default();
    layout.to_tensors(&constant(config, &layout, density, [0.2, 0.5, 0.7]), "", &mut file);
    let cells = config.occupancy.cells();
    file.tensors.insert("occupancy".into(), Tensor::u8(&[cells / 8], vec![0xff; cells / 8]));
    Model::new(config.clone(), file)
}

/// Returns the length of the part of a ray within the box.
fn chord(aabb: &Aabb<f64>, origin: [f64; 3], direction: [f64; 3]) -> f64 {
    let (mut near, mut far) = (0.0_f64, f64::INFINITY);
    for axis in 0..3 {
        let ends = [aabb.min[axis], aabb.max[axis]].map(|end| (end - origin[axis]) / direction[axis]);
        near = near.max(ends[0].min(ends[1]));
        far = far.min(ends[0].max(ends[1]));
    }
    (far - near).max(0.0)
}

/// The number of samples of a pixel is the number of steps of its cones within the box.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn samples<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for most in [1, 3] {
        let mut config = small();
        config.renderer.cones = most;
        // The box lies far from the origin, so the viewer shifts it.
        (config.scene.aabb_min, config.scene.aabb_max) = ([9.0, -1.5, -0.5], [12.0, 1.5, 0.75]);
        let model = fog(&mut config, 0.02);
        let mut viewer = LoadedModel::new(make(), &model)?;
        let middle = DVec3::new(10.5, 0.0, 0.1);
        let eye = middle + DVec3::new(3.1, -2.2, 1.7);
        let camera = Camera::look_at(Intrinsics::from_angle(9, 7, 1.1), eye, middle, DVec3::Z);
        let pattern = Division::new(&config).pattern(&camera);
        assert_eq!(pattern.count() > 1, most > 1, "the camera's pixels are wide");
        let aabb = Aabb::<f64>::new(&config.scene);
        let step = f64::from(config.step_length()) * config.renderer.step_scale.at(1.0);
        let found = viewer.samples(&camera, &mut |_, _| true)?.expect("nobody stops it");
        assert_eq!(found.len(), 9 * 7);
        let mut seen = 0;
        for (pixel, &found) in found.iter().enumerate() {
            let (x, y) = (pixel as u32 % 9, pixel as u32 / 9);
            let count = pattern.count();
            let steps = (0..count).map(|index| {
                let cone = camera.cone_in::<f64>(x, y, index, pattern);
                chord(&aabb, cone.origin, cone.direction) / step
            });
            let expected: f64 = steps.sum();
            let apart = (f64::from(found) - expected).abs();
            assert!(apart <= 1.01 * f64::from(count), "pixel {x},{y}: {found} samples, {expected:.2} steps");
            seen += u32::from(found > 0);
        }
        assert!(seen > 20 && seen < 63, "{seen} pixels see the box, others do not");
        assert_eq!(viewer.samples(&camera, &mut |_, _| true)?, Some(found), "the same again");
        assert_eq!(viewer.samples(&camera, &mut |_, _| false)?, None);
    }
    Ok(())
}

/// A clipped view shows only the cells within the given box. A new box replaces the last one; without a box, the picture has the
/// bits of the unclipped view.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn clips<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let (mut config, density) = (small(), 0.3);
    let model = fog(&mut config, density);
    let aabb = Aabb::<f64>::new(&config.scene);
    let step = f64::from(config.step_length()) * config.renderer.step_scale.at(1.0);
    // Every ray enters by the upper face and leaves by the lower one.
    let middle = DVec3::from_array(aabb.centre());
    let height = aabb.extent()[2];
    let intrinsics = Intrinsics::from_angle(6, 6, 0.15);
    let camera = Camera::look_at(intrinsics, middle + 2.0 * height * DVec3::Z, middle, DVec3::Y);
    let part = |low: f64, high: f64| {
        let mut part = aabb;
        part.min[2] = aabb.min[2] + low * height;
        part.max[2] = aabb.min[2] + high * height;
        part
    };
    let mut viewer = LoadedModel::new(make(), &model)?;
    let whole = viewer.render(&camera)?;
    for (low, high) in [(0.0, 1.0), (0.0, 0.5), (0.25, 1.0), (0.25, 0.5), (0.0, 0.0)] {
        viewer.clip(&[Crop::from(part(low, high))])?;
        let frame = viewer.render(&camera)?;
        for (pixel, found) in frame.pixels.iter().enumerate() {
            let cone = camera.cone::<f64>(pixel as u32 % 6, pixel as u32 / 6);
            let chord = (high - low) * height / -cone.direction[2];
            // A sample is kept or left out as a whole.
            let bounds = [chord - step, chord + step].map(|length| 1.0 - (-density * length.max(0.0)).exp());
            let opacity = f64::from(found.opacity);
            let none = high == low && found.opacity == 0.0;
            assert!(
                none || (bounds[0]..=bounds[1]).contains(&opacity),
                "{low}-{high}: {opacity}, not {bounds:?}"
            );
        }
        let fresh = {
            let mut fresh = LoadedModel::new(make(), &model)?;
            fresh.clip(&[Crop::from(part(low, high))])?;
            fresh.render(&camera)?
        };
        assert!(frame == fresh, "{low}-{high}: the box before it shows through");
    }
    viewer.clip(&[])?;
    assert!(viewer.render(&camera)? == whole);
    viewer.clip(&[])?;
    assert!(viewer.render(&camera)? == whole);
    Ok(())
}
