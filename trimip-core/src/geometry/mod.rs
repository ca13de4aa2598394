//! Rays and the space that they cross: cameras and their cones ([`camera`], [`lens`], the registry of [`projections`]), the box of
//! a scene ([`aabb`]) and the `crop` around its subject, the map from the world to the unit cube ([`space`]), the cells of the
//! occupancy grid ([`occupancy`]), and the elements of batches as every device stores them.

pub mod aabb;
pub mod camera;
pub(crate) mod cone_pattern;
mod crop;
pub(crate) mod elements;
pub mod lens;
pub mod occupancy;
pub mod projections;
pub mod space;
