//! A run with non-finite values stops, reports which and when, and keeps the last good checkpoint.

use std::sync::atomic::AtomicBool;
use trimip_core::{
    Camera, Config, ErrorKind, Frames, Result, Session, ViewSet,
    checkpoint::Checkpoint,
    evaluate::ViewResult,
    events::{Event, Totals},
    model::Model,
    run::{Run, Store},
    trainer::Trainer,
};
use trimip_cpu::{CpuBackend, simd::Simd};
use trimip_tests::{fixtures, suite};

/// Records the steps of the checkpoints.
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

/// The given number of test frames, none of which can be read.
struct Unreadable(usize);

impl Frames for Unreadable {
    fn len(&self) -> usize {
        self.0
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
        store: &mut shelf,
        events,
        stop: &stop,
        evaluated: Totals::default(),
    }
    .train(Totals::default())
    .expect_err("the frame cannot be read");
    assert!(error.message.contains("r_0.png"), "{error}");
    assert_eq!(shelf.0, [trainer.checkpoint().expect("a checkpoint").state.totals.step]);
}

/// The error of a run that continues after step 6 with one NaN parameter, and the steps of its checkpoints.
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
    assert_eq!((error.kind, error.exit_code()), (ErrorKind::Run, 1), "{error}");
    (error, shelf.0)
}

#[test]
fn a_loss_out_of_range_stops_the_run_and_names_the_number() {
    let (error, written) = broken("color.2.weight", 0.0);
    for part in
        ["step 6", "pixels are not finite", "color.2.weight[5] is NaN", "checkpoint of step 6 is kept"]
    {
        assert!(error.message.contains(part), "`{part}` in {error}");
    }
    assert_eq!(written, [0_u64; 0], "nothing is written over the last good checkpoint");
}

#[test]
fn a_number_that_a_relu_hides_from_the_loss_is_found_when_it_would_be_saved() {
    let (error, written) = broken("color.0.weight", 1e-9);
    for part in ["step 7", "color.0.weight[5] is NaN", "checkpoint of step 6 is kept"] {
        assert!(error.message.contains(part), "`{part}` in {error}");
    }
    assert_eq!(written, [0_u64; 0], "nothing is written over the last good checkpoint");
}
