//! Events of a capture.

use serde::Serialize;
use std::cell::Cell;

/// An event of a capture.
#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Event<'a> {
    /// A message for the user.
    Note {
        /// The text.
        text: &'a str,
    },
    /// A stage begins.
    Begun {
        /// Name of the stage.
        stage: &'a str,
        /// The first action of the stage.
        doing: &'a str,
    },
    /// Part of a stage is done.
    Progress {
        /// Name of the stage.
        stage: &'a str,
        /// The current action of the stage.
        doing: &'a str,
        /// Number of items done.
        done: u64,
        /// Number of all items.
        total: u64,
    },
    /// A stage is done.
    Done {
        /// Name of the stage.
        stage: &'a str,
        /// Duration of the stage, seconds.
        seconds: f64,
        /// True if an earlier call did the stage.
        earlier: bool,
    },
}

/// Sends the events of one capture.
pub(crate) struct Teller<'a> {
    events: &'a dyn Fn(&Event<'_>),
    stage: Cell<&'static str>,
}

impl<'a> Teller<'a> {
    pub fn new(events: &'a dyn Fn(&Event<'_>)) -> Self {
        Self { events, stage: Cell::new("") }
    }

    /// Sends a message for the user.
    pub fn note(&self, text: &str) {
        (self.events)(&Event::Note { text });
    }

    /// Announces that a stage begins.
    pub fn begin(&self, stage: &'static str, doing: &str) {
        self.stage.set(stage);
        (self.events)(&Event::Begun { stage, doing });
    }

    /// Reports that part of the stage is done.
    pub fn progress(&self, doing: &str, done: u64, total: u64) {
        (self.events)(&Event::Progress { stage: self.stage.get(), doing, done, total });
    }

    /// Announces that a stage is done, by this call or an earlier one.
    pub fn done(&self, stage: &'static str, seconds: f64, earlier: bool) {
        (self.events)(&Event::Done { stage, seconds, earlier });
    }
}
