//! The program's pages: the report of a run, one self-contained HTML file, the page of an inspected capture, and the parts
//! they share with the pages of `bench`, `compare` and `paper`.

pub mod beside;
mod difference;
mod escape;
mod html;
pub mod inspect;
pub mod page;
pub mod paper;
mod pictures;
mod settings;
pub mod svg;

use std::path::Path;
use trimip::{Error, Result, RunFolder, report::Report};
use trimip_core::atomic::write_atomically;

/// Writes all files of the report, the page last.
///
/// # Errors
/// When a file cannot be written.
pub fn write(report: &Report<'_>, folder: &RunFolder) -> Result<()> {
    report.write(folder)?;
    write_atomically(&folder.html(), html::page(report, &folder.images())?.as_bytes())
}

/// Writes a file, and creates its folder if missing.
///
/// # Errors
/// Of kind `Input`, when it cannot be written.
pub fn save(path: &Path, text: &str) -> Result<()> {
    let refused = |error: &dyn std::fmt::Display| {
        Error::input(path.display(), error, "name a file in a folder that can be written")
    };
    if let Some(parent) = path.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        std::fs::create_dir_all(parent).map_err(|error| refused(&format!("cannot write: {error}")))?;
    }
    if path.is_dir() {
        return Err(refused(&"this is a folder"));
    }
    write_atomically(path, text.as_bytes())
}
