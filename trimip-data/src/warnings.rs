//! Warnings that concern the frames of a scene together: pixels without rays, EXIF orientations, mixed alpha.

use crate::{orientation::Turn, source::Source};
use trimip_core::{Alpha, Intrinsics};

/// Returns a warning if the lens has no rays for some pixels: they are neither trained nor compared.
pub(crate) fn blind<'a>(sources: impl Iterator<Item = &'a Source>) -> Option<String> {
    let mut known: Vec<(Intrinsics, u64)> = Vec::new();
    let (mut blind, mut all) = (0, 0);
    for (_, camera) in sources.filter_map(|source| source.views.first()) {
        let k = camera.intrinsics;
        let own = known.iter().find(|(other, _)| *other == k).map(|(_, count)| *count);
        let own = own.unwrap_or_else(|| {
            known.push((k, k.blind_pixels()));
            known[known.len() - 1].1
        });
        blind += own;
        all += u64::from(k.width) * u64::from(k.height);
    }
    (blind > 0).then(|| {
        format!(
            "the lens model has no rays for {blind} of {all} pixels ({:.2} %), which are left out",
            100.0 * blind as f64 / all as f64
        )
    })
}

/// Returns a warning if photographs have an EXIF orientation that was not applied but may be intended.
pub(crate) fn orientation<'a>(sources: impl Iterator<Item = &'a Source>) -> Option<String> {
    let mut doubtful = sources.flat_map(Source::files).filter(|file| file.turn == Turn::Doubtful);
    let first = doubtful.next()?;
    let count = 1 + doubtful.count();
    Some(format!(
        "{count} photographs, the first {}, have an EXIF orientation that is not applied, because no stated size requires it; \
         if the cameras are those of the turned photographs, turn the pixels (magick mogrify -auto-orient) or state w and h",
        first.path.display()
    ))
}

/// Returns a warning if some photographs have alpha and others do not.
pub(crate) fn alpha(train: &[Source], alpha: Alpha) -> Option<String> {
    let silhouette = |source: &Source| alpha.is_opacity() && source.mask.is_some();
    let files = || train.iter().flat_map(|source| source.files().iter().map(move |file| (source, file)));
    let masked = files().filter(|(source, file)| file.has_alpha() || silhouette(source)).count();
    let total = files().count();
    (0 < masked && masked < total).then(|| {
        format!(
            "{} of {total} training images {} no alpha, unlike the others: every pixel without alpha counts as the object",
            total - masked,
            if total - masked == 1 { "has" } else { "have" }
        )
    })
}
