//! Tests of the readers on scenes on disk, as one program: a program for each file would take a minute more to link.

mod common;

mod archives;
mod as_found;
mod broken;
mod captures;
mod checks;
mod depths;
mod exports;
mod fuzz;
mod layouts;
mod llff;
mod masks;
mod orientation;
mod phones;
mod pictures;
mod projections;
mod realign;
mod realitycapture;
mod reports;
mod shared;
