//! Alignment of test views, for a run that refines poses. Each view is aligned with the finished model on the left half
//! of its picture and measured on the right half. Alignment is necessary because a model trained with refined poses
//! lies in the coordinate frame that training found, and because the given poses of test views are as rough as those of
//! the training views were. An aligned view has the refined intrinsics of its camera.

use super::evaluate::{TestFrames, compared};
use crate::{
    Camera, Intrinsics, Result, Scale, Session, View, ViewSet,
    engine::{
        intrinsics::{Change, changed},
        poses::Aligned,
    },
    measures::{metrics::psnr, quality::capped},
};

/// Largest number of test views that are aligned; they are spread evenly over the test set.
const VIEWS: usize = 8;

/// Largest number of pixels of an aligned view, if the test frame has such a coarse scale.
const PIXELS: u64 = 1 << 18;

/// Aligns test views with the model of `session` and measures them; `None` without test views. `refined` has the given
/// intrinsics of each training camera at its finest scale, and their change.
///
/// # Errors
/// When a photograph cannot be read, or the device fails.
pub fn measure(
    session: &mut dyn Session,
    test: TestFrames<'_>,
    refined: &[(Intrinsics, Change)],
) -> Result<Option<Aligned>> {
    let count = test.frames.len();
    let stride = count.div_ceil(VIEWS).max(1);
    let frames: Vec<ViewSet> =
        (0..count).step_by(stride).map(|index| test.frames.load(index)).collect::<Result<_>>()?;
    if frames.is_empty() {
        return Ok(None);
    }
    let [mut left, right] = [Half::Left, Half::Right].map(|half| halves(&frames, half));
    let changes: Vec<Change> = frames.iter().map(|frame| change_of(frame, refined)).collect();
    for (view, change) in left.views.iter_mut().zip(&changes) {
        view.camera.intrinsics = changed(&view.camera.intrinsics, change);
    }
    let cameras = session.align(left)?;
    let mut sums = [0.0; 2];
    for (view, (frame, aligned)) in frames.iter().zip(&cameras).enumerate() {
        let given = right.views[view].camera;
        let exponent = test.data.edge_exponent(frame.scales[shown(frame)].factor);
        let target = compared(&right, view, right.composited(view, test.data.background));
        let aligned = Camera { intrinsics: changed(&given.intrinsics, &changes[view]), ..*aligned };
        for (sum, camera) in sums.iter_mut().zip([given, aligned]) {
            let rendered = session.render(&camera)?.shown(test.data.background, exponent).rgb();
            *sum += capped(psnr(&compared(&right, view, rendered), &target));
        }
    }
    let [given, aligned] = sums.map(|sum| sum / frames.len() as f64);
    Ok(Some(Aligned { views: frames.len(), given, aligned }))
}

/// Returns the change of the intrinsics of the camera that took a frame; zero if this camera took no training
/// photograph.
fn change_of(frame: &ViewSet, refined: &[(Intrinsics, Change)]) -> Change {
    let finest = frame.views.first().map(|view| view.camera.intrinsics);
    let camera = refined.iter().find(|(given, _)| Some(*given) == finest);
    camera.map_or_else(Change::default, |(_, change)| *change)
}

/// Returns the scale at which a frame is aligned: the finest scale with at most [`PIXELS`] pixels, or the coarsest
/// scale if none is that small.
fn shown(frame: &ViewSet) -> usize {
    let few = |scale: &Scale| scale.pixels.len() as u64 <= PIXELS;
    frame.scales.iter().position(few).unwrap_or(frame.scales.len() - 1)
}

#[derive(Clone, Copy, PartialEq)]
enum Half {
    Left,
    Right,
}

/// Returns the left or right halves of one view of each frame, as photographs of their own.
fn halves(frames: &[ViewSet], half: Half) -> ViewSet {
    let alpha = frames[0].alpha;
    let mut set =
        ViewSet { views: vec![], pixels: Default::default(), alpha, scales: vec![], depths: vec![] };
    for (i, frame) in frames.iter().enumerate() {
        let view = frame.scales[shown(frame)].views.start;
        let camera = frame.views[view].camera;
        let k = camera.intrinsics;
        let middle = k.width.div_ceil(2);
        let columns = if half == Half::Left { 0..middle } else { middle..k.width };
        let intrinsics = Intrinsics { width: columns.len() as u32, cx: k.cx - f64::from(columns.start), ..k };
        let camera = Camera { intrinsics, ..camera };
        set.views.push(View { name: format!("test view {i}"), camera, offset: set.pixels.len() });
        for row in frame.pixels_of(view).chunks_exact(k.width as usize) {
            let own = &row[columns.start as usize..columns.end as usize];
            own.iter().for_each(|pixel| set.pixels.push(*pixel));
        }
    }
    let (views, pixels) = (0..set.views.len(), 0..set.pixels.len());
    set.scales.push(Scale { factor: 1, weight: 1.0, views, pixels });
    set
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Config, Frame, Pixel, Query, StepReport, Viewer,
        engine::{batch::Radiance, checkpoint::Checkpoint},
        field::model::Model,
    };
    use glam::DVec3;

    /// Returns a picture whose colours show the direction of each ray.
    fn picture(camera: &Camera) -> Vec<[f32; 3]> {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let colour = |i: u32| camera.cone::<f32>(i % width, i / width).direction.map(|x| 0.5 + 0.5 * x);
        (0..width * height).map(colour).collect()
    }

    /// A session that aligns every view to the given camera of the photographs.
    struct Knowing(Camera);

    impl Viewer for Knowing {
        fn backend(&self) -> &str {
            "test"
        }
        fn device_name(&self) -> String {
            String::new()
        }
        fn render(&mut self, camera: &Camera) -> Result<Frame> {
            let pixels = picture(camera).into_iter();
            let pixels = pixels.map(|rgb| Pixel { rgb, opacity: 1.0, ..Pixel::default() }).collect();
            Ok(Frame { width: camera.intrinsics.width, height: camera.intrinsics.height, pixels })
        }
        fn render_watched(
            &mut self,
            camera: &Camera,
            _: &mut dyn FnMut(u32, u32) -> bool,
        ) -> Result<Option<Frame>> {
            self.render(camera).map(Some)
        }
        fn query(&mut self, _: &[Query]) -> Result<Vec<Radiance>> {
            Ok(Vec::new())
        }
    }

    impl Session for Knowing {
        fn step(&mut self, _: f64) -> Result<StepReport> {
            unreachable!("nothing is trained")
        }
        fn model(&mut self) -> Result<Model> {
            unreachable!("nothing is trained")
        }
        fn finish(&mut self) -> Result<Model> {
            unreachable!("nothing is trained")
        }
        fn checkpoint(&mut self) -> Result<Checkpoint> {
            unreachable!("nothing is trained")
        }
        fn restore(&mut self, _: &Checkpoint) -> Result<()> {
            unreachable!("nothing is trained")
        }
        fn align(&mut self, views: ViewSet) -> Result<Vec<Camera>> {
            // The views are the left halves of the pictures.
            for (i, view) in views.views.iter().enumerate() {
                let true_camera = Camera { intrinsics: view.camera.intrinsics, ..self.0 };
                let expected = picture(&true_camera);
                for (found, expected) in views.composited(i, [0.0; 3]).iter().zip(&expected) {
                    assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 0.003), "{found:?} {expected:?}");
                }
            }
            Ok(views
                .views
                .iter()
                .map(|view| Camera { intrinsics: view.camera.intrinsics, ..self.0 })
                .collect())
        }
    }

    struct One(ViewSet);

    impl crate::Frames for One {
        fn len(&self) -> usize {
            1
        }
        fn names(&self) -> Vec<String> {
            self.0.views.iter().take(1).map(|view| view.name.clone()).collect()
        }
        fn cameras(&self) -> Vec<Camera> {
            self.0.views.iter().map(|view| view.camera).collect()
        }
        fn load(&self, _: usize) -> Result<ViewSet> {
            Ok(self.0.clone())
        }
    }

    #[test]
    fn a_view_is_aligned_on_its_left_half_and_measured_on_the_right() {
        let intrinsics = Intrinsics::from_angle(15, 10, 0.9);
        let camera = |x| Camera::look_at(intrinsics, DVec3::new(x, -3.0, 0.5), DVec3::ZERO, DVec3::Z);
        let (taken, given) = (camera(0.2), camera(0.0));
        let byte = |rgb: [f32; 3]| rgb.map(|c| (255.0 * c).round() as u8);
        let pixels: Vec<[u8; 4]> =
            picture(&taken).into_iter().map(byte).map(|[r, g, b]| [r, g, b, 255]).collect();
        let set = ViewSet {
            depths: Vec::new(),
            views: vec![View { name: "a".into(), camera: given, offset: 0 }],
            pixels: pixels.into(),
            alpha: crate::Alpha::Straight,
            scales: vec![Scale { factor: 1, weight: 1.0, views: 0..1, pixels: 0..150 }],
        };
        let (frames, config) = (One(set), Config::default());
        let test = TestFrames { frames: &frames, data: &config.data, finest: 1 };
        let found = measure(&mut Knowing(taken), test, &[]).unwrap().unwrap();
        assert!(found.views == 1 && found.given < 40.0 && found.aligned > 50.0, "{found:?}");
    }
}
