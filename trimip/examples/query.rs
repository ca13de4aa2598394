//! Evaluates density and colour of a model at points of the world, without rendering a picture.
//!
//! `cargo run --release -p trimip --example query -- runs/example`

use std::path::Path;
use trimip::{Error, Query, Radiance, backends, read_model};

fn main() -> trimip::Result<()> {
    let model = std::env::args().nth(1);
    let model = model.ok_or_else(|| Error::input("arguments", "none", "name a run folder or model file"))?;
    let points: Vec<_> = (-4..=4).map(|i| [0.25 * f64::from(i), 0.0, 0.0]).collect();
    for (point, radiance) in points.iter().zip(query(Path::new(&model), &points, 0.01)?) {
        println!("{point:?}: density {:.4}, colour {:.3?}", radiance.density, radiance.rgb);
    }
    Ok(())
}

/// Returns the radiance at points of the world, seen along +y. A query is a sphere of `radius` world units, which selects the mip
/// level.
pub fn query(model: &Path, points: &[[f64; 3]], radius: f32) -> trimip::Result<Vec<Radiance>> {
    let queries: Vec<_> =
        points.iter().map(|&point| Query { point, radius, direction: [0.0, 1.0, 0.0] }).collect();
    backends::load(&read_model(model)?)?.query(&queries)
}
