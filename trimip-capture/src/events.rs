//! Events of a capture.

use serde::Serialize;
use std::cell::Cell;

/// An event of a capture.
#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Event<'a> {
    /// Something the user should know.
    Note {
        /// A sentence.
        text: &'a str,
    },
    /// A stage begins.
    Begun {
        /// Name of the stage.
        stage: &'a str,
        /// What it does first.
        doing: &'a str,
    },
    /// Part of a stage is done.
    Progress {
        /// Name of the stage.
        stage: &'a str,
        /// What it does.
        doing: &'a str,
        /// Things that are done.
        done: u64,
        /// Things that there are.
        total: u64,
    },
    /// A stage is done.
    Done {
        /// Name of the stage.
        stage: &'a str,
        /// Time that it took.
        seconds: f64,
        /// True if an earlier call did it.
        earlier: bool,
    },
}

/// Tells the events of one capture.
pub(crate) struct Teller<'a> {
    events: &'a dyn Fn(&Event<'_>),
    stage: Cell<&'static str>,
}

impl<'a> Teller<'a> {
    pub fn new(events: &'a dyn Fn(&Event<'_>)) -> Self {
        Self { events, stage: Cell::new("") }
    }

    /// Tells the user something.
    pub fn note(&self, text: &str) {
        (self.events)(&Event::Note { text });
    }

    /// A stage begins.
    pub fn begin(&self, stage: &'static str, doing: &str) {
        self.stage.set(stage);
        (self.events)(&Event::Begun { stage, doing });
    }

    /// Part of the stage is done.
    pub fn progress(&self, doing: &str, done: u64, total: u64) {
        (self.events)(&Event::Progress { stage: self.stage.get(), doing, done, total });
    }

    /// A stage is done, or was by an earlier call.
    pub fn done(&self, stage: &'static str, seconds: f64, earlier: bool) {
        (self.events)(&Event::Done { stage, seconds, earlier });
    }
}
