//! The strip of views around a finished model, at the top of its report.

use std::time::Duration;
use trimip::run::{Recorded, cameras::training_cameras};
use trimip::view::{pictures, strip};
use trimip::{Result, backends};
use trimip_core::{atomic::write_atomically, scene::origin::LocalOrigin};

/// Pixels along a side of each view.
const SIDE: u32 = 192;

/// Time limit for drawing a strip; a strip that takes longer is left out. The views of some models take minutes.
const LONGEST: Duration = Duration::from_secs(20);

/// Writes the strip of a finished model, unless the file exists or the settings request no pictures or no final
/// evaluation. A report is complete without the strip.
///
/// # Errors
/// When the model cannot be loaded or rendered, or the picture cannot be written.
pub fn draw(run: &Recorded) -> Result<()> {
    let (folder, config) = (&run.folder, &run.config);
    let path = folder.turntable();
    if path.exists() || config.eval.images == 0 || config.eval.final_stride(1).is_none() {
        return Ok(());
    }
    let mut viewer = backends::load(&trimip::read_model(folder.root())?)?;
    // Without these cameras, the views of an unbounded scene are on a circle, as for an object.
    let photographed =
        training_cameras(folder.root(), LocalOrigin::of(&config.data)).ok().flatten().unwrap_or_default();
    let cameras = strip::cameras(&config.scene, &photographed, SIDE)?;
    let strip = strip::strip(&mut *viewer, &cameras, SIDE, LONGEST)?;
    strip.map_or(Ok(()), |strip| write_atomically(&path, &pictures::png(strip)?))
}
