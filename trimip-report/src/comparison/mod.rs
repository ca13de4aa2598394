//! Comparison of systems on several scenes: the runs, their figures, and their means as in tables of papers. Also their JSON,
//! Markdown and LaTeX; [`crate::paper`] makes their page.

mod content;
mod figures;
#[cfg(test)]
mod fixtures;
mod json;
mod means;
mod runs;
mod text;

pub use content::Comparison;
pub use figures::Figures;
pub use json::json;
pub use means::{Cell, TableRow, mean_curve, scene_row, whole_row};
pub use runs::{Run, Scales, Status};
pub use text::{Column, columns, latex, markdown, published_caption, published_cells, published_columns};
