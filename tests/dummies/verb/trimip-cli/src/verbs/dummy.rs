//! `dummy`: prints a line.

use crate::terminal;
use trimip::Result;

/// Runs the verb.
pub fn run() -> Result<u8> {
    terminal::line("a line");
    Ok(0)
}
