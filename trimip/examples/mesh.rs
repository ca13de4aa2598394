//! Extracts the surface of a model as a triangle mesh in the world of the cameras.
//!
//! `cargo run --release -p trimip --example mesh -- runs/example mesh.ply`

use std::path::Path;
use trimip::mesh::{self, Extraction, Mesh};
use trimip::{Error, backends, data, read_model};

fn main() -> trimip::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [model, file] = &arguments[..] else {
        return Err(Error::input("arguments", "not two", "name a run folder or model file, and a mesh file"));
    };
    let mesh = extract(Path::new(model), 512)?;
    let bytes = mesh::write(&mesh, Path::new(file))?;
    println!("{} triangles, {bytes} bytes", mesh.triangles.len());
    Ok(())
}

/// Returns the mesh of a model from a grid of `resolution` cells along the longest side of the box.
pub fn extract(model: &Path, resolution: u32) -> trimip::Result<Mesh> {
    let model = read_model(model)?;
    let cameras: Vec<_> =
        data::open(&model.config.section()?)?.train.views.iter().map(|view| view.camera).collect();
    let settings = Extraction { resolution, ..Extraction::of(&model.config, &cameras) };
    let mut viewer = backends::load(&model)?;
    let extracted = mesh::extract(viewer.as_mut(), &model, &settings, &cameras, &mut |_| true)?;
    extracted.map(|extracted| extracted.mesh).ok_or_else(|| Error::run("stopped"))
}
