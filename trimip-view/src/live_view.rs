//! The live view of a training run. Pages show the current model and the curve of its error, and can pause, resume or stop the run.

use crate::protocol::Command;
use crate::scene::Scene;
use crate::server::{Callbacks, Listener, Server};
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread;
use std::time::{Duration, Instant};
use trimip_core::Result;
use trimip_core::engine::events::{Event, Totals};
use trimip_core::field::model::Model;
use trimip_core::run::Observer;

/// Minimum time between two states of the model that pages show.
const RENEWED: Duration = Duration::from_secs(2);

/// Minimum time between two states of the model that pages show, in multiples of the time to load one: a GPU compiles its kernels each
/// time.
const LOADS: u32 = 10;

/// Interval at which a paused run checks for the resume command.
const LOOK: Duration = Duration::from_millis(50);

/// The pages that watch one run. Clones share their state: one clone receives the events, another observes the run.
#[derive(Clone)]
pub struct LiveView {
    shared: Arc<Shared>,
}

struct Shared {
    /// Address to open in a browser; it contains the token.
    address: String,
    name: String,
    paused: Arc<AtomicBool>,
    stop: Arc<AtomicBool>,
    state: Mutex<State>,
}

struct State {
    /// `None` once the server is open.
    listener: Option<Listener>,
    server: Option<Server>,
    /// Time at which pages last received a new state of the model.
    shown: Option<Instant>,
    /// True if the pages show the state at which the run was paused.
    still: bool,
    /// Status of the run that pages receive, without the points of the curve.
    status: Value,
    /// Seconds of training and PSNR of each evaluation.
    curve: Vec<[f64; 2]>,
}

impl LiveView {
    /// Binds the address at which pages will watch the run `name`. Pages wait until the first step is done. Setting `stop` ends the run.
    ///
    /// # Errors
    /// When the address is taken or cannot be bound.
    pub fn bind(at: SocketAddr, name: String, stop: Arc<AtomicBool>) -> Result<Self> {
        let listener = Listener::bind(at)?;
        let state = State {
            server: None,
            shown: None,
            still: false,
            status: json!({ "state": "running" }),
            curve: Vec::new(),
            listener: None,
        };
        let (address, paused) = (listener.address.clone(), Arc::new(AtomicBool::new(false)));
        let state = Mutex::new(State { listener: Some(listener), ..state });
        Ok(Self { shared: Arc::new(Shared { address, name, paused, stop, state }) })
    }

    /// Returns the address to open in a browser; it contains the token.
    pub fn address(&self) -> &str {
        &self.shared.address
    }

    /// Updates the status from an event and sends it to the pages.
    pub fn handle(&self, event: &Event) {
        let mut state = self.shared.state();
        match event {
            Event::Step { totals, progress, batch_psnr, samples_per_second, seconds_left, .. } => {
                state.status["step"] = totals.step.into();
                state.status["seconds"] = totals.seconds.into();
                state.status["progress"] = (*progress).into();
                state.status["batch_psnr"] = (*batch_psnr).into();
                state.status["samples_per_second"] = (*samples_per_second).into();
                state.status["seconds_left"] = (*seconds_left).into();
            }
            Event::Evaluation { totals, psnr, .. } if psnr.is_finite() => {
                state.curve.push([totals.seconds, *psnr]);
            }
            Event::Stopped { .. } => state.status["state"] = "stopped".into(),
            // The final evaluation follows.
            Event::Finished { .. } => state.status["state"] = "measuring".into(),
            Event::SessionEnded { .. } if state.status["state"] == "measuring" => {
                state.status["state"] = "finished".into();
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

    /// Opens the server with the first model.
    fn open(&self, state: &mut State, model: Model) -> Result<()> {
        let Some(listener) = state.listener.take() else { return Ok(()) };
        let (paused, stop) = (Arc::clone(&self.paused), Arc::clone(&self.stop));
        let control = move |command| match command {
            Command::Pause => paused.store(true, Ordering::Relaxed),
            Command::Resume => paused.store(false, Ordering::Relaxed),
            Command::Stop => stop.store(true, Ordering::Relaxed),
        };
        let (scene, renderers) = Scene::of(self.name.clone(), model)?;
        let callbacks = Callbacks { control: Some(Box::new(control)), ..Callbacks::default() };
        state.server = Some(Server::open(listener, scene, renderers, callbacks)?);
        Ok(())
    }
}

impl State {
    fn tell(&self) {
        if let Some(server) = &self.server {
            let mut status = self.status.clone();
            status["curve"] = json!(self.curve);
            server.tell(&json!({ "training": status }).to_string());
        }
    }
}

impl Observer for LiveView {
    fn between(&mut self, _: &Totals) -> bool {
        let Shared { paused, stop, .. } = &*self.shared;
        let wants = |state: &State| match &state.server {
            None => state.listener.is_some(),
            Some(server) => server.render_thread().load_time().is_some_and(|load| {
                let pause = RENEWED.max(LOADS * load);
                state.shown.is_none_or(|shown| shown.elapsed() >= pause)
                    && server.render_thread().watchers() > 0
            }),
        };
        let mut state = self.shared.state();
        if paused.load(Ordering::Relaxed) {
            if !state.still {
                state.still = true;
                state.status["state"] = "paused".into();
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
            state.status["state"] = "running".into();
            state.tell();
        }
        wants(&state)
    }

    fn model(&mut self, model: Model) {
        let mut state = self.shared.state();
        state.shown = Some(Instant::now());
        if let Some(server) = &state.server {
            return server.render_thread().show(model);
        }
        // A failure does not stop the run, which continues without a live view.
        if let Err(error) = self.shared.open(&mut state, model) {
            eprintln!("warning: the run cannot be watched: {error}");
        }
        state.tell();
    }
}
