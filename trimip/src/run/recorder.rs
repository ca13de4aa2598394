//! Distributes the events of a run: to its history, to `metrics.jsonl`, and to the program's listener.

use super::{csv, folder::RunFolder, history::History};
use std::fs::File;
use std::io::{Result as IoResult, Write};
use trimip_core::{
    Error, Result,
    engine::events::{Event, EventSink},
};

/// The run's event sink.
pub struct Recorder<'a> {
    /// The history accumulated from the events.
    pub history: History,
    listener: &'a mut dyn EventSink,
    metrics: Backlog<File>,
    folder: RunFolder,
    failure: Option<Error>,
}

impl<'a> Recorder<'a> {
    /// Starts recording. `kept` are the events in the folder that a resumed run keeps.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn new(folder: &RunFolder, kept: &[Event], listener: &'a mut dyn EventSink) -> Result<Self> {
        Ok(Self {
            history: History::of(kept),
            listener,
            metrics: Backlog { file: folder.restart_events(kept)?, unwritten: Vec::new() },
            folder: folder.clone(),
            failure: None,
        })
    }

    /// Returns the history, and the reason if the last events could not be written.
    pub fn into_parts(self) -> (History, Option<Error>) {
        (self.history, self.failure)
    }

    fn write(&mut self, event: &Event) -> Result<()> {
        let mut line = serde_json::to_string(event).map_err(Error::run)?;
        line.push('\n');
        let place = self.folder.metrics();
        let evaluation = matches!(event, Event::Evaluation { .. });
        // Evaluations reach the disk before the checkpoint that follows them, so a power failure leaves no gap in the curve.
        let synced = |file: &File| if evaluation { file.sync_data() } else { Ok(()) };
        self.metrics.write(line.as_bytes()).and_then(|()| synced(&self.metrics.file)).map_err(|error| {
            Error::input(place.display(), format!("cannot write: {error}"), "free some disk space")
        })?;
        if evaluation {
            csv::write(&self.folder.curve(), &self.history)?;
        }
        Ok(())
    }
}

impl EventSink for Recorder<'_> {
    fn emit(&mut self, event: &Event) {
        self.history.take(event);
        // A full disk must not end hours of training before the last checkpoint is attempted. The failure is cleared
        // once everything is written. The progress of an evaluation is not stored: it is useless once the evaluation is
        // over.
        if !matches!(event, Event::EvaluationProgress { .. }) {
            self.failure = self.write(event).err();
        }
        self.listener.emit(event);
    }
}

/// A writer that keeps the bytes that it could not write, and writes them first the next time.
struct Backlog<W> {
    file: W,
    unwritten: Vec<u8>,
}

impl<W: Write> Backlog<W> {
    fn write(&mut self, bytes: &[u8]) -> IoResult<()> {
        self.unwritten.extend_from_slice(bytes);
        while !self.unwritten.is_empty() {
            match self.file.write(&self.unwritten) {
                Ok(0) => return Err(std::io::ErrorKind::WriteZero.into()),
                Ok(written) => drop(self.unwritten.drain(..written)),
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disk with room for some bytes.
    struct Disk {
        held: Vec<u8>,
        room: usize,
    }

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> IoResult<usize> {
            let written = bytes.len().min(self.room);
            self.room -= written;
            self.held.extend_from_slice(&bytes[..written]);
            if written == 0 { Err(std::io::ErrorKind::StorageFull.into()) } else { Ok(written) }
        }

        fn flush(&mut self) -> IoResult<()> {
            Ok(())
        }
    }

    #[test]
    fn what_a_full_disk_did_not_take_is_written_when_it_has_room() {
        let mut log = Backlog { file: Disk { held: Vec::new(), room: 8 }, unwritten: Vec::new() };
        log.write(b"first\n").unwrap();
        assert!(log.write(b"second\n").is_err() && log.write(b"third\n").is_err());
        log.file.room = 100;
        log.write(b"fourth\n").unwrap();
        assert_eq!(log.file.held, b"first\nsecond\nthird\nfourth\n");
    }
}
