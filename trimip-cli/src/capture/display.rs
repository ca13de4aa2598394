//! Progress of a capture for the user: a bar with lines above it on a terminal, or one JSON object per event.

use crate::{args::ProgressStyle, progress, terminal};
use indicatif::ProgressBar;
use serde::Serialize;
use std::{
    cell::Cell,
    time::{Duration, Instant},
};

/// Template of the bar, in thousandths.
const BAR: &str = "{bar:12} {percent:>3} %  {wide_msg}";
const STEPS: u64 = 1000;

/// Shortest time between two events of progress.
const PAUSE: Duration = Duration::from_millis(500);

/// An event, a line of JSON.
#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum Event<'a> {
    /// Something the user should know.
    Note { text: &'a str },
    /// A stage begins.
    Begun { stage: &'a str },
    /// Part of a stage is done.
    Progress { stage: &'a str, doing: &'a str, done: u64, total: u64 },
    /// A stage is done, now or by an earlier command.
    Done { stage: &'a str, seconds: f64, earlier: bool },
}

/// Shows a capture.
pub struct Display {
    /// `None` shows JSON.
    bar: Option<ProgressBar>,
    stage: Cell<&'static str>,
    told: Cell<Option<Instant>>,
}

impl Display {
    /// Creates the display for a style; `Auto` selects the bar if a person watches.
    pub fn new(style: ProgressStyle) -> Self {
        let is_json = match style {
            ProgressStyle::Json => true,
            ProgressStyle::Auto => !terminal::watched(),
            ProgressStyle::Bar => false,
        };
        let bar = (!is_json).then(|| progress::bar(BAR, STEPS));
        Self { bar, stage: Cell::new(""), told: Cell::new(None) }
    }

    /// Tells the user something.
    pub fn note(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.suspend(|| terminal::prose(text)),
            None => json(&Event::Note { text }),
        }
    }

    /// A stage begins.
    pub fn begin(&self, stage: &'static str, doing: &str) {
        self.stage.set(stage);
        self.told.set(None);
        match &self.bar {
            Some(bar) => {
                bar.reset();
                bar.set_message(doing.to_string());
                bar.enable_steady_tick(Duration::from_millis(200));
            }
            None => json(&Event::Begun { stage }),
        }
    }

    /// Part of the stage is done.
    pub fn progress(&self, doing: &str, done: u64, total: u64) {
        let stage = self.stage.get();
        let left = |bar: &ProgressBar| {
            let part = done as f64 / total.max(1) as f64;
            let seconds = bar.elapsed().as_secs_f64() * (1.0 / part - 1.0);
            if part > 0.02 && part < 1.0 {
                format!(", {} left", terminal::duration(seconds))
            } else {
                String::new()
            }
        };
        match &self.bar {
            Some(bar) => {
                bar.set_position(STEPS * done.min(total) / total.max(1));
                bar.set_message(format!("{doing}, {done} of {total}{}", left(bar)));
            }
            None if self.told.get().is_none_or(|told| told.elapsed() >= PAUSE) => {
                self.told.set(Some(Instant::now()));
                json(&Event::Progress { stage, doing, done, total });
            }
            None => {}
        }
    }

    /// The stage is done, or was by an earlier command.
    pub fn done(&self, stage: &'static str, seconds: f64, earlier: bool) {
        match &self.bar {
            Some(bar) => {
                let when = if earlier { "done before" } else { "done" };
                bar.suspend(|| terminal::prose(format!("{stage}: {when}, {}", terminal::duration(seconds))));
            }
            None => json(&Event::Done { stage, seconds, earlier }),
        }
    }

    /// Nothing more comes.
    pub fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

fn json(event: &Event<'_>) {
    if let Ok(text) = serde_json::to_string(event) {
        terminal::line(text);
    }
}
