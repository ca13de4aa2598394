//! Pages that watch a run: they see the model as it is learned and the curve of its error, and pause, resume or stop it.

use crate::door::{Door, Threshold};
use crate::protocol::Command;
use crate::scene::Scene;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread;
use std::time::{Duration, Instant};
use trimip_core::Result;
use trimip_core::events::{Event, Totals};
use trimip_core::model::Model;
use trimip_core::run::Onlooker;

/// Shortest time between two states of the model that are shown.
const RENEWED: Duration = Duration::from_secs(2);

/// The same, in times of loading one: a GPU compiles its kernels again.
const LOADS: u32 = 10;

/// How often a paused run looks whether it goes on.
const LOOK: Duration = Duration::from_millis(50);

/// Who watches a run. Clones are the same audience: one receives the events, the other looks on.
#[derive(Clone)]
pub struct Audience {
    shared: Arc<Shared>,
}

struct Shared {
    /// The address to open, with its token.
    address: String,
    name: String,
    paused: Arc<AtomicBool>,
    stop: Arc<AtomicBool>,
    state: Mutex<State>,
}

struct State {
    /// `None` once the door is open.
    threshold: Option<Threshold>,
    door: Option<Door>,
    /// When a state of the model was shown last.
    shown: Option<Instant>,
    /// True if the state at which the run was paused is shown.
    still: bool,
    /// What the pages are told, but for the points of the curve.
    news: Value,
    /// Seconds of training and PSNR of each evaluation.
    curve: Vec<[f64; 2]>,
}

impl Audience {
    /// Binds the address at which pages will watch the run `name`; they wait until its first step is done. `stop` ends the run.
    ///
    /// # Errors
    /// When the address is taken or cannot be bound.
    pub fn await_at(at: SocketAddr, name: String, stop: Arc<AtomicBool>) -> Result<Self> {
        let threshold = Threshold::bind(at)?;
        let state = State {
            door: None,
            shown: None,
            still: false,
            news: json!({ "state": "running" }),
            curve: Vec::new(),
            threshold: None,
        };
        let (address, paused) = (threshold.address.clone(), Arc::new(AtomicBool::new(false)));
        let state = Mutex::new(State { threshold: Some(threshold), ..state });
        Ok(Self { shared: Arc::new(Shared { address, name, paused, stop, state }) })
    }

    /// The address to open.
    pub fn address(&self) -> &str {
        &self.shared.address
    }

    /// Tells the pages what happened.
    pub fn hear(&self, event: &Event) {
        let mut state = self.shared.state();
        match event {
            Event::Step { totals, progress, batch_psnr, samples_per_second, seconds_left, .. } => {
                state.news["step"] = totals.step.into();
                state.news["seconds"] = totals.seconds.into();
                state.news["progress"] = (*progress).into();
                state.news["batch_psnr"] = (*batch_psnr).into();
                state.news["samples_per_second"] = (*samples_per_second).into();
                state.news["seconds_left"] = (*seconds_left).into();
            }
            Event::Evaluation { totals, psnr, .. } if psnr.is_finite() => {
                state.curve.push([totals.seconds, *psnr]);
            }
            Event::Stopped { .. } => state.news["state"] = "stopped".into(),
            // The final evaluation follows.
            Event::Finished { .. } => state.news["state"] = "measuring".into(),
            Event::SessionEnded { .. } if state.news["state"] == "measuring" => {
                state.news["state"] = "finished".into();
            }
            _ => return,
        }
        state.tell();
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }

    /// Opens the door, once there is a model.
    fn open(&self, state: &mut State, model: Model) -> Result<()> {
        let Some(threshold) = state.threshold.take() else { return Ok(()) };
        let (paused, stop) = (Arc::clone(&self.paused), Arc::clone(&self.stop));
        let steer = move |command| match command {
            Command::Pause => paused.store(true, Ordering::Relaxed),
            Command::Resume => paused.store(false, Ordering::Relaxed),
            Command::Stop => stop.store(true, Ordering::Relaxed),
        };
        let (scene, renderers) = Scene::of(self.name.clone(), model)?;
        state.door = Some(Door::open(threshold, scene, renderers, Some(Box::new(steer)))?);
        Ok(())
    }
}

impl State {
    fn tell(&self) {
        if let Some(door) = &self.door {
            let mut news = self.news.clone();
            news["curve"] = json!(self.curve);
            door.tell(&json!({ "training": news }).to_string());
        }
    }
}

impl Onlooker for Audience {
    fn between(&mut self, _: &Totals) -> bool {
        let Shared { paused, stop, .. } = &*self.shared;
        let wants = |state: &State| match &state.door {
            None => state.threshold.is_some(),
            Some(door) => door.studio().load_time().is_some_and(|load| {
                let pause = RENEWED.max(LOADS * load);
                state.shown.is_none_or(|shown| shown.elapsed() >= pause) && door.studio().watchers() > 0
            }),
        };
        let mut state = self.shared.state();
        if paused.load(Ordering::Relaxed) {
            if !state.still {
                state.still = true;
                state.news["state"] = "paused".into();
                state.tell();
                return true;
            }
            drop(state);
            while paused.load(Ordering::Relaxed) && !stop.load(Ordering::Relaxed) {
                thread::sleep(LOOK);
            }
            state = self.shared.state();
        }
        if state.still {
            state.still = false;
            state.news["state"] = "running".into();
            state.tell();
        }
        wants(&state)
    }

    fn model(&mut self, model: Model) {
        let mut state = self.shared.state();
        state.shown = Some(Instant::now());
        if let Some(door) = &state.door {
            return door.studio().show(model);
        }
        // The run goes on without its audience.
        if let Err(error) = self.shared.open(&mut state, model) {
            eprintln!("warning: the run cannot be watched: {error}");
        }
        state.tell();
    }
}
