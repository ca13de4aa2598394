//! The description of a scene in a few lines, which a run stores.

use crate::settings::DataConfig;
use crate::{masks, source::Source, survey::Survey};
use trimip_core::{
    Alpha, ViewSet,
    plural::{count, noun},
};

/// Returns the first lines of a run: layout, views, sizes, scales, convention, memory.
pub(crate) fn description(survey: &Survey, config: &DataConfig, train: &ViewSet) -> Vec<String> {
    let splits: Vec<String> =
        survey.train_splits.iter().map(|(split, count)| format!("{split} {count}")).collect();
    let factors: Vec<String> = train
        .scales
        .iter()
        .map(|scale| if scale.factor == 1 { "1".into() } else { format!("1/{}", scale.factor) })
        .collect();
    let convention = match train.alpha {
        Alpha::Straight => "straight RGBA means, truncated (public convention)",
        Alpha::Premultiplied => "premultiplied RGBA means, rounded",
        Alpha::Kept => "means over the pixels that masks keep, rounded",
    };
    let mut lines = vec![
        format!(
            "{}: {}, {} ({}), {} ({})",
            survey.name,
            survey.layout,
            count(survey.train.len(), "training view"),
            splits.join(", "),
            count(survey.test.len(), "test view"),
            config.tested_on()
        ),
        format!("images {}, {}", sizes(&survey.train), alpha(&survey.train)),
        format!("{} {}: {convention}", noun(factors.len(), "scale"), factors.join(", ")),
        format!(
            "{:.1} MB of training pixels {}",
            4e-6 * train.pixels.len() as f64,
            if train.pixels.bytes_in_memory() > 0 { "in memory" } else { "in a file" }
        ),
    ];
    if !survey.origin.is_zero() {
        lines.push(format!(
            "coordinates are relative to the point {} of the files (data.origin)",
            survey.origin
        ));
    }
    lines.extend(survey.unpacked.iter().chain(&survey.notes).cloned());
    lines.extend(masks::described(&survey.train, train));
    lines
}

/// Returns the size of the views as "800x800", or their range of sizes.
pub(crate) fn sizes(sources: &[Source]) -> String {
    let mut sizes: Vec<(u32, u32)> = sources
        .iter()
        .filter_map(|source| source.views.first())
        .map(|(_, camera)| (camera.intrinsics.width, camera.intrinsics.height))
        .collect();
    sizes.sort_unstable();
    sizes.dedup();
    match sizes.as_slice() {
        [] => "none".into(),
        [(width, height)] => format!("{width}x{height}"),
        [first, .., last] => {
            format!("of {} sizes from {}x{} to {}x{}", sizes.len(), first.0, first.1, last.0, last.1)
        }
    }
}

/// Returns "with alpha", or how many of the photographs have alpha.
pub(crate) fn alpha(sources: &[Source]) -> String {
    let files = || sources.iter().flat_map(Source::files);
    match (files().filter(|file| file.has_alpha()).count(), files().count()) {
        (_, 0) => "alpha rendered".into(),
        (0, _) => "no alpha".into(),
        (masked, total) if masked == total => "with alpha".into(),
        (masked, total) => format!("{masked} of {total} with alpha"),
    }
}
