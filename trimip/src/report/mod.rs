//! The report of a run: its content, its verdict, and its machine-readable and text forms: JSON, CSV, Markdown, LaTeX.
//! All are generated from the run folder and the event history, so they can be regenerated at any time.

mod content;
mod json;
pub mod text;
pub mod verdict;

pub use content::{Report, Status, scale_name};

use crate::run::{csv, folder::RunFolder};
use trimip_core::{Result, atomic::write_atomically};

impl Report<'_> {
    /// Writes the report's tables and JSON: `error_vs_time.csv`, `metrics.csv`, `report.md`, `report.tex`,
    /// `report.json`.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, folder: &RunFolder) -> Result<()> {
        csv::write(&folder.curve(), self.history)?;
        csv::write_steps(&folder.steps(), &folder.events())?;
        write_atomically(&folder.markdown(), text::markdown(self).as_bytes())?;
        write_atomically(&folder.latex(), text::latex(self).as_bytes())?;
        write_atomically(&folder.json(), json::text(self)?.as_bytes())
    }
}

/// Passes a report of two evaluations on a small curve to `test`. For tests of the writers.
#[cfg(test)]
fn example(test: impl FnOnce(&Report<'_>)) {
    use crate::machine::Machine;
    use crate::run::{fixtures::evaluation, history::History};
    use trimip_core::Config;
    use trimip_core::engine::events::{Event, Provenance};
    let settings = crate::settings::defaults();
    let config = Config::default();
    let history = History::of(&[
        Event::Warning { message: "a <dark> image".into() },
        evaluation(10, 25, false, 20.0),
        evaluation(100, 25, false, 25.0),
        evaluation(100, 1, true, 24.5),
        Event::SessionEnded {
            device: "two cores".into(),
            backend: "cpu".into(),
            wall_seconds: 20.0,
            peak_memory_bytes: None,
            provenance: Provenance {
                command: Some("trimip-cli --config a&b.toml".into()),
                version: Some("0.1.0 (abc)".into()),
                ended_unix: Some(0),
                test_views: Some(200),
            },
        },
    ]);
    test(&Report {
        status: Status::Finished,
        run: "first_run".into(),
        scene: "lego & co".into(),
        config: &config,
        settings: &settings,
        history: &history,
        machine: Machine::detect(),
        model_bytes: Some(1_000),
        views: Vec::new(),
    });
}
