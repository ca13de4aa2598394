//! Distributes the events of a run: to its history, to `metrics.jsonl`, and to the program's listener.

use super::{csv, folder::RunFolder, history::History};
use std::fs::File;
use std::io::Write;
use trimip_core::{
    Error, Result,
    events::{Event, EventSink},
};

/// The run's event sink.
pub struct Recorder<'a> {
    /// The history accumulated from the events.
    pub history: History,
    listener: &'a mut dyn EventSink,
    metrics: File,
    folder: RunFolder,
    failure: Option<Error>,
}

impl<'a> Recorder<'a> {
    /// Starts recording. `kept` are the events of the folder that the resumed run keeps.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn new(folder: &RunFolder, kept: &[Event], listener: &'a mut dyn EventSink) -> Result<Self> {
        Ok(Self {
            history: History::of(kept),
            listener,
            metrics: folder.restart_events(kept)?,
            folder: folder.clone(),
            failure: None,
        })
    }

    /// Returns the history and the first failure to write events.
    pub fn into_parts(self) -> (History, Option<Error>) {
        (self.history, self.failure)
    }

    fn write(&mut self, event: &Event) -> Result<()> {
        let mut line = serde_json::to_string(event).map_err(Error::run)?;
        line.push('\n');
        let place = self.folder.metrics();
        self.metrics.write_all(line.as_bytes()).map_err(|error| {
            Error::input(place.display(), format!("cannot write: {error}"), "free some disk space")
        })?;
        if matches!(event, Event::Evaluation { .. }) {
            csv::write(&self.folder.curve(), &self.history)?;
        }
        Ok(())
    }
}

impl EventSink for Recorder<'_> {
    fn emit(&mut self, event: &Event) {
        self.history.take(event);
        // A full disk must not end hours of training before the last checkpoint is attempted.
        // The progress of an evaluation is of no use once it is over.
        if !matches!(event, Event::EvaluationProgress { .. })
            && let Err(error) = self.write(event)
        {
            self.failure.get_or_insert(error);
        }
        self.listener.emit(event);
    }
}
