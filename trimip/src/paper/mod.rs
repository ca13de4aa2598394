//! Systems beside each other on several scenes: the runs, their figures, and the means that tables of papers state. JSON and
//! Markdown are made here; the page is the program's.

mod comparison;
mod figures;
#[cfg(test)]
mod fixtures;
mod json;
mod means;
mod runs;
mod text;

pub use comparison::Comparison;
pub use figures::Figures;
pub use json::json;
pub use means::{Cell, TableRow, mean_curve, scene_row, whole_row};
pub use runs::{Run, Scales, Status};
pub use text::{Column, columns, latex, markdown, published_caption, published_cells, published_columns};
