//! Progress of a capture for the user: a bar with lines above it on a terminal, or one JSON object per event.

use crate::{args::ProgressStyle, progress, terminal};
use indicatif::ProgressBar;
use std::{
    cell::Cell,
    time::{Duration, Instant},
};
use trimip_capture::Event;

/// Template of the bar, whose length is [`STEPS`].
const BAR: &str = "{bar:12} {percent:>3} %  {wide_msg}";
const STEPS: u64 = 1000;

/// Minimum time between two progress events.
const PAUSE: Duration = Duration::from_millis(500);

/// Shows the progress of a capture.
pub struct Display {
    /// The bar; if it is `None`, events are printed as JSON.
    bar: Option<ProgressBar>,
    told: Cell<Option<Instant>>,
}

impl Display {
    /// Creates the display for a style; `Auto` selects the bar if both outputs are terminals.
    pub fn new(style: ProgressStyle) -> Self {
        let is_json = match style {
            ProgressStyle::Json => true,
            ProgressStyle::Auto => !terminal::watched(),
            ProgressStyle::Bar => false,
        };
        Self { bar: (!is_json).then(|| progress::bar(BAR, STEPS)), told: Cell::new(None) }
    }

    /// Shows one event.
    pub fn show(&self, event: &Event<'_>) {
        match &self.bar {
            Some(bar) => show_on(bar, event),
            None => self.print(event),
        }
    }

    /// Removes the bar at the end of the capture.
    pub fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }

    /// Prints an event as a line of JSON; progress events that follow too quickly are dropped.
    fn print(&self, event: &Event<'_>) {
        match event {
            Event::Begun { .. } => self.told.set(None),
            Event::Progress { .. } if self.told.get().is_some_and(|told| told.elapsed() < PAUSE) => return,
            Event::Progress { .. } => self.told.set(Some(Instant::now())),
            Event::Note { .. } | Event::Done { .. } => {}
        }
        if let Ok(text) = serde_json::to_string(event) {
            terminal::line(text);
        }
    }
}

fn show_on(bar: &ProgressBar, event: &Event<'_>) {
    match *event {
        Event::Note { text } => bar.suspend(|| terminal::prose(text)),
        Event::Begun { doing, .. } => {
            bar.reset();
            bar.set_message(doing.to_string());
            bar.enable_steady_tick(Duration::from_millis(200));
        }
        Event::Progress { doing, done, total, .. } => {
            let part = done as f64 / total.max(1) as f64;
            let seconds = bar.elapsed().as_secs_f64() * (1.0 / part - 1.0);
            let left = match part > 0.02 && part < 1.0 {
                true => format!(", {} left", terminal::duration(seconds)),
                false => String::new(),
            };
            bar.set_position(STEPS * done.min(total) / total.max(1));
            bar.set_message(format!("{doing}, {done} of {total}{left}"));
        }
        Event::Done { stage, seconds, earlier } => {
            let when = if earlier { "already done" } else { "done" };
            bar.suspend(|| terminal::prose(format!("{stage}: {when}, {}", terminal::duration(seconds))));
        }
    }
}
