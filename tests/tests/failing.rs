//! A run with non-finite values stops, reports the value and the step, and keeps the last good checkpoint. A run whose
//! results cannot be stored continues as far as it can. A run in which no camera sees the box fails.

use std::sync::atomic::AtomicBool;
use trimip_core::{
    Camera, Config, ErrorKind, Frames, Result, Session, ViewSet,
    engine::{
        checkpoint::Checkpoint,
        events::{Event, Totals},
        trainer::Trainer,
    },
    field::model::Model,
    run::{Run, Store, evaluate::ViewResult},
};
use trimip_cpu::{CpuBackend, simd::Simd};
use trimip_tests::{binary, fixtures, suite};

/// A store that records the steps of the checkpoints.
#[derive(Default)]
struct Shelf(Vec<u64>);

impl Store for Shelf {
    fn checkpoint(&mut self, checkpoint: &Checkpoint) -> Result<u64> {
        assert_eq!(checkpoint.not_finite(), None, "what is kept can be gone on from");
        self.0.push(checkpoint.state.totals.step);
        Ok(0)
    }

    fn model(&mut self, _: &Model) -> Result<u64> {
        Ok(0)
    }

    fn view(&mut self, _: &ViewResult<'_>) -> Result<()> {
        Ok(())
    }

    fn evaluated(&mut self) -> Result<()> {
        Ok(())
    }
}

/// The given number of test frames, all of them unreadable.
struct Unreadable(usize);

impl Frames for Unreadable {
    fn len(&self) -> usize {
        self.0
    }

    fn names(&self) -> Vec<String> {
        (0..self.0).map(|index| format!("r_{index}")).collect()
    }

    fn cameras(&self) -> Vec<Camera> {
        Vec::new()
    }

    fn load(&self, _: usize) -> Result<ViewSet> {
        Err(trimip_core::Error::input("r_0.png", "is torn", "copy it again"))
    }
}

fn run(trainer: &mut dyn Session, config: &Config, totals: Totals, shelf: &mut Shelf) -> trimip_core::Error {
    let stop = AtomicBool::new(false);
    Run {
        config,
        session: trainer,
        frames: &Unreadable(0),
        perception: &mut (),
        observer: &mut (),
        store: shelf,
        events: &mut |_: &Event| {},
        stop: &stop,
        evaluated: Totals::default(),
    }
    .train(totals)
    .expect_err("the run fails")
}

#[test]
fn a_test_view_that_cannot_be_read_costs_no_step() {
    let mut config = suite::training::configuration();
    (config.train.checkpoint_seconds, config.eval.points) = (0.0, 4);
    let backend = CpuBackend::new(1, Simd::detect()).expect("a thread");
    let mut trainer = Trainer::new(backend, &config, fixtures::noise(3, 16, 2, 2)).expect("views that fit");
    let (stop, mut shelf) = (AtomicBool::new(false), Shelf::default());
    let events = &mut |_: &Event| {};
    let error = Run {
        config: &config,
        session: &mut trainer,
        frames: &Unreadable(1),
        perception: &mut (),
        observer: &mut (),
        store: &mut shelf,
        events,
        stop: &stop,
        evaluated: Totals::default(),
    }
    .train(Totals::default())
    .expect_err("the frame cannot be read");
    assert!(error.message().contains("r_0.png"), "{error}");
    assert_eq!(shelf.0, [trainer.checkpoint().expect("a checkpoint").state.totals.step]);
}

/// Continues a run after step 6 with one NaN parameter. Returns the run's error and the steps of its checkpoints.
fn broken(slot: &str, checkpoint_seconds: f64) -> (trimip_core::Error, Vec<u64>) {
    let mut config = suite::training::configuration();
    config.train.checkpoint_seconds = checkpoint_seconds;
    let backend = CpuBackend::new(1, Simd::detect()).expect("a thread");
    let mut trainer = Trainer::new(backend, &config, fixtures::noise(3, 16, 2, 2)).expect("views that fit");
    suite::training::steps(&mut trainer, &config, 6).expect("finite steps");
    let totals = trainer.checkpoint().expect("a checkpoint").state.totals;
    let mut values = trainer.parameters();
    let slot = trainer.layout().slots.iter().find(|other| other.name == slot).expect("a layer");
    let place = slot.range.start + 5;
    values[place] = f32::NAN;
    trainer.set_parameters(&values);
    let mut shelf = Shelf::default();
    let error = run(&mut trainer, &config, totals, &mut shelf);
    assert_eq!(error.kind(), ErrorKind::Run, "{error}");
    (error, shelf.0)
}

#[test]
fn a_loss_out_of_range_stops_the_run_and_names_the_number() {
    let (error, written) = broken("color.2.weight", 0.0);
    for part in
        ["step 6", "pixels are not finite", "color.2.weight[5] is NaN", "checkpoint of step 6 is kept"]
    {
        assert!(error.message().contains(part), "`{part}` in {error}");
    }
    assert_eq!(written, [0_u64; 0], "nothing is written over the last good checkpoint");
}

#[test]
fn a_number_that_a_relu_hides_from_the_loss_is_found_when_it_would_be_saved() {
    let (error, written) = broken("color.0.weight", 1e-9);
    for part in ["step 7", "color.0.weight[5] is NaN", "checkpoint of step 6 is kept"] {
        assert!(error.message().contains(part), "`{part}` in {error}");
    }
    assert_eq!(written, [0_u64; 0], "nothing is written over the last good checkpoint");
}

/// A store that has room for the checkpoint of a step only if `room` returns true, and for views only if `views` is
/// true.
struct Full {
    room: fn(u64) -> bool,
    views: bool,
    checkpoints: Vec<u64>,
    models: usize,
}

impl Store for Full {
    fn checkpoint(&mut self, checkpoint: &Checkpoint) -> Result<u64> {
        let step = checkpoint.state.totals.step;
        if !(self.room)(step) {
            return Err(trimip_core::Error::input("checkpoint", "no space left", "free some"));
        }
        self.checkpoints.push(step);
        Ok(0)
    }

    fn model(&mut self, _: &Model) -> Result<u64> {
        self.models += 1;
        Ok(0)
    }

    fn view(&mut self, _: &ViewResult<'_>) -> Result<()> {
        Ok(())
    }

    fn evaluated(&mut self) -> Result<()> {
        if self.views {
            Ok(())
        } else {
            Err(trimip_core::Error::input("views", "no space left", "free some"))
        }
    }
}

/// Runs six steps with a checkpoint after each and one test view. Returns the error, the store and the events.
fn with_little_room(room: fn(u64) -> bool, views: bool) -> (Option<trimip_core::Error>, Full, Vec<Event>) {
    let mut config = suite::training::configuration();
    (config.train.steps, config.train.checkpoint_seconds) = (6, 1e-9);
    (config.eval.points, config.eval.time_fraction, config.eval.min_gain) = (0, 0.0, 0.0);
    config.data.scales = 2;
    let backend = CpuBackend::new(1, Simd::detect()).expect("a thread");
    let mut trainer = Trainer::new(backend, &config, fixtures::noise(3, 16, 2, 2)).expect("views that fit");
    let mut store = Full { room, views, checkpoints: Vec::new(), models: 0 };
    let mut events = Vec::new();
    let outcome = Run {
        config: &config,
        session: &mut trainer,
        frames: &Noise,
        perception: &mut (),
        observer: &mut (),
        store: &mut store,
        events: &mut |event: &Event| events.push(event.clone()),
        stop: &AtomicBool::new(false),
        evaluated: Totals::default(),
    }
    .train(Totals::default());
    (outcome.err(), store, events)
}

/// One test frame of noise.
struct Noise;

impl Frames for Noise {
    fn len(&self) -> usize {
        1
    }

    fn names(&self) -> Vec<String> {
        vec!["view 0".into()]
    }

    fn cameras(&self) -> Vec<Camera> {
        self.load(0).expect("noise").views.iter().map(|view| view.camera).collect()
    }

    fn load(&self, _: usize) -> Result<ViewSet> {
        Ok(fixtures::noise(1, 16, 2, 5))
    }
}

fn is_measured(events: &[Event]) -> bool {
    events.iter().any(|event| matches!(event, Event::Evaluation { last: true, .. }))
}

#[test]
fn a_checkpoint_on_the_way_that_has_no_room_is_a_warning_and_is_tried_again() {
    let (error, store, events) = with_little_room(|step| step != 2 && step != 3, true);
    assert!(error.is_none(), "{error:?}");
    assert_eq!(store.checkpoints, [1, 4, 5, 6]);
    let warned: Vec<&String> = events
        .iter()
        .filter_map(|event| if let Event::Warning { message } = event { Some(message) } else { None })
        .collect();
    assert_eq!(warned.len(), 2);
    for (step, message) in [2, 3].iter().zip(warned) {
        assert!(message.contains(&format!("step {step}")) && message.contains("no space left"), "{message}");
    }
    assert!(is_measured(&events));
}

#[test]
fn a_run_without_room_for_its_last_checkpoint_keeps_its_model_and_its_measures_and_fails() {
    let (error, store, events) = with_little_room(|step| step < 6, true);
    let error = error.expect("the last checkpoint is missing");
    assert!(error.kind() == ErrorKind::Input && error.message().contains("no space left"), "{error}");
    assert_eq!((store.checkpoints.last(), store.models), (Some(&5), 1));
    assert!(is_measured(&events));
}

#[test]
fn a_measure_is_told_when_its_views_are_stored() {
    let (error, store, events) = with_little_room(|_| true, false);
    assert!(error.is_some_and(|error| error.message().contains("views")), "the views are not stored");
    assert!(store.models == 1 && !is_measured(&events));
}

#[test]
fn a_run_of_which_no_camera_sees_the_box_fails_and_says_so() {
    let folder = tempfile::tempdir().expect("a folder");
    // One run has fewer steps than the limit for runs without samples, the other more.
    for steps in ["train.steps=20", "train.steps=100"] {
        let away = ["--out", "run", "--fresh", "--set", "scene.aabb_min=[50,50,50]", "--set"];
        let away = [&away[..], &["scene.aabb_max=[51,51,51]", "--set", steps]].concat();
        let answer = binary::run(folder.path(), &binary::tiny_and(&away));
        assert!(answer.code == Some(1) && answer.err.contains("kept no sample"), "{answer:?}");
        let report = std::fs::read(folder.path().join("run/report.json")).expect("a report");
        let report: serde_json::Value = serde_json::from_slice(&report).expect("JSON");
        assert_eq!(report["status"], "failed", "{steps}");
    }
}
