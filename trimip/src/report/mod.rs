//! The report of a run: its content, its verdict, and its machine-readable and text forms: JSON, CSV, Markdown, LaTeX, TensorBoard. All
//! forms are made from the run folder and the event history, so they can be made again at any time.

mod content;
mod correlation;
mod json;
pub mod latex;
pub mod tensorboard;
pub mod text;
pub mod verdict;

pub use content::{PsnrByDistance, Report, Status, scale_name};

use crate::run::{csv, folder::RunFolder};
use trimip_core::{Result, atomic::write_atomically};

impl Report<'_> {
    /// Writes the report's tables, scalars and JSON: `error_vs_time.csv`, `metrics.csv`, `events.out.tfevents.run`, `report.md`,
    /// `report.tex`, `report.json`.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, folder: &RunFolder) -> Result<()> {
        csv::write(&folder.curve(), self.history)?;
        let events = folder.events();
        csv::write_steps(&folder.steps(), &events)?;
        write_atomically(&folder.tensorboard(), &tensorboard::file(self.history, &events))?;
        write_atomically(&folder.markdown(), text::markdown(self).as_bytes())?;
        write_atomically(&folder.latex(), text::latex(self).as_bytes())?;
        write_atomically(&folder.json(), json::text(self)?.as_bytes())
    }
}
