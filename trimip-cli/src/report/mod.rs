//! The program's pages: the report of a run, one self-contained HTML file, and the parts it shares with the pages of
//! `bench` and `compare`.

pub mod beside;
mod difference;
#[cfg(test)]
mod example;
mod html;
pub mod page;
mod pictures;
mod settings;
pub mod svg;

use trimip::{Result, RunFolder, report::Report};
use trimip_core::tensors::write_atomically;

/// Writes all files of the report, the page last.
///
/// # Errors
/// When a file cannot be written.
pub fn write(report: &Report<'_>, folder: &RunFolder) -> Result<()> {
    report.write(folder)?;
    write_atomically(&folder.html(), html::page(report, &folder.images())?.as_bytes())
}
