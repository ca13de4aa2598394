//! Pages as self-contained HTML files: the report of a run, an inspected capture, and comparisons of runs and of
//! systems. Also the parts that these pages share with those of other programs.

#![forbid(unsafe_code)]

pub mod beside;
pub mod comparison;
mod difference;
mod escape;
mod html;
pub mod inspect;
pub mod page;
pub mod paper;
mod pictures;
mod settings;
pub mod svg;
mod turntable;

use std::path::Path;
use trimip::{Error, Result, report::Status, run::Recorded};
use trimip_core::atomic::write_atomically;

/// Writes all files of a run's report, the page last. For a finished run, first draws the strip of views.
///
/// # Errors
/// When the strip cannot be rendered, or a file cannot be written.
pub fn write(run: &Recorded) -> Result<()> {
    let drawn = match run.status {
        Status::Finished => turntable::draw(run),
        _ => Ok(()),
    };
    let (report, folder) = (run.report(), &run.folder);
    report.write(folder)?;
    write_atomically(&folder.html(), html::page(&report, &folder.images())?.as_bytes())?;
    drawn
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
