//! `export`: writes a model in a form that other programs read.

mod cameras;
mod mesh;
mod web;

use crate::args::{ExportArguments, ExportWhat};
use trimip_core::Result;

/// Writes the form that the arguments select.
pub fn run(arguments: &ExportArguments) -> Result<u8> {
    match &arguments.what {
        ExportWhat::Mesh(arguments) => mesh::export(arguments),
        ExportWhat::Web(arguments) => web::export(arguments),
        ExportWhat::Cameras(arguments) => cameras::export(arguments),
    }
}
