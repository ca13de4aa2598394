//! Means as in the tables of papers: over the seeds of a scene, then over the scenes.

use super::figures::Figures;
use super::runs::{Run, Scales, Status};
use serde::Serialize;
use trimip::{
    run::curve::Measure,
    systems::{Kind, System, published::Published},
};

/// A row of a table: a system on one scene, or the mean of several. Unknown values are NaN, `null` in JSON.
#[derive(Clone, Debug, Serialize)]
pub struct TableRow {
    /// Name of the system.
    pub system: &'static str,
    /// Title of the system.
    pub title: &'static str,
    /// Number of scenes in the mean, and number of all scenes.
    pub scenes: [usize; 2],
    /// Number of runs in the mean, and number of all runs.
    pub runs: [usize; 2],
    /// Runs that failed.
    pub failed: usize,
    /// Reduction and PSNR of each scale, dB.
    pub scales: Vec<(u32, f64)>,
    /// The figures.
    #[serde(flatten)]
    pub cell: Cell,
    /// Published figure to compare with, dB: that of *lego* in the row of *lego*, that of the mean of the eight scenes in the row of their
    /// means. Smaller variants have none.
    pub published: Option<f64>,
}

/// Figures of a row.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Cell {
    /// Mean PSNR of the scales, dB.
    pub psnr: f64,
    /// Mean PSNR without the set's edge exponents, dB; published figures are measured without them.
    pub plain: f64,
    /// Difference between the best and the worst seed, dB.
    pub spread: f64,
    /// Mean SSIM of the scales.
    pub ssim: f64,
    /// Mean MS-SSIM of the scales that have one.
    pub ms_ssim: f64,
    /// Mean FLIP of the scales.
    pub flip: f64,
    /// Mean LPIPS of the scales.
    pub lpips: f64,
    /// Seconds of training.
    pub seconds: f64,
    /// Size of the model file, bytes.
    pub model_bytes: f64,
    /// Peak resident memory, bytes.
    pub memory_bytes: f64,
    /// Number of trained parameters.
    pub parameters: f64,
}

impl Cell {
    /// All values are unknown.
    pub const UNKNOWN: Self = Self {
        psnr: f64::NAN,
        plain: f64::NAN,
        spread: f64::NAN,
        ssim: f64::NAN,
        ms_ssim: f64::NAN,
        flip: f64::NAN,
        lpips: f64::NAN,
        seconds: f64::NAN,
        model_bytes: f64::NAN,
        memory_bytes: f64::NAN,
        parameters: f64::NAN,
    };

    fn of(figures: &Figures) -> Self {
        let bytes = |bytes: Option<u64>| bytes.map_or(f64::NAN, |bytes| bytes as f64);
        Self {
            psnr: figures.mean.psnr,
            plain: figures.mean.psnr_plain,
            spread: 0.0,
            ssim: figures.mean.ssim,
            ms_ssim: figures.mean.ms_ssim,
            flip: figures.mean.flip,
            lpips: figures.mean.lpips,
            seconds: figures.seconds,
            model_bytes: bytes(figures.model_bytes),
            memory_bytes: bytes(figures.peak_memory_bytes),
            parameters: figures.parameters.iter().sum::<u64>() as f64,
        }
    }

    /// Returns the means of cells; NaN without cells, and for values that are unknown in any cell.
    fn mean(cells: &[Self]) -> Self {
        let mean = |value: fn(&Self) -> f64| mean(cells.iter().map(value));
        Self {
            psnr: mean(|c| c.psnr),
            plain: mean(|c| c.plain),
            spread: mean(|c| c.spread),
            ssim: mean(|c| c.ssim),
            ms_ssim: mean(|c| c.ms_ssim),
            flip: mean(|c| c.flip),
            lpips: mean(|c| c.lpips),
            seconds: mean(|c| c.seconds),
            model_bytes: mean(|c| c.model_bytes),
            memory_bytes: mean(|c| c.memory_bytes),
            parameters: mean(|c| c.parameters),
        }
    }
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    sum / count as f64
}

/// Returns the published row that a system is compared with; smaller variants have none.
fn quoted(system: &System) -> Option<&'static Published> {
    system.published().filter(|_| system.kind != Kind::Smaller)
}

/// Returns the row of a system on a scene: the mean of its seeds.
pub fn scene_row(system: &'static System, scales: Scales, scene: &str, runs: &[&Run]) -> TableRow {
    let known: Vec<&Figures> = runs.iter().filter_map(|run| run.figures.as_ref()).collect();
    let cells: Vec<Cell> = known.iter().map(|figures| Cell::of(figures)).collect();
    let psnr = || cells.iter().map(|cell| cell.psnr);
    let spread = psnr().fold(f64::NEG_INFINITY, f64::max) - psnr().fold(f64::INFINITY, f64::min);
    let first = known.first().map_or(&[][..], |figures| &figures.scales);
    let of_scale = |i: usize| {
        mean(known.iter().map(|figures| figures.scales.get(i).map_or(f64::NAN, |q| q.measures.psnr)))
    };
    let published = quoted(system).filter(|_| scene == "lego").and_then(|row| match scales {
        Scales::Four => row.lego,
        Scales::One => row.single_lego,
    });
    TableRow {
        system: system.name,
        title: system.title,
        scenes: [usize::from(!known.is_empty()), 1],
        runs: [known.len(), runs.len()],
        failed: runs.iter().filter(|run| matches!(run.status, Status::Failed(_))).count(),
        scales: first.iter().enumerate().map(|(i, quality)| (quality.scale, of_scale(i))).collect(),
        cell: match cells.is_empty() {
            true => Cell::UNKNOWN,
            false => Cell { spread, ..Cell::mean(&cells) },
        },
        published,
    }
}

/// Returns the mean over the scenes of each scene's mean. `whole_set` is true for the eight scenes of the papers.
pub fn whole_row(system: &'static System, scales: Scales, rows: &[TableRow], whole_set: bool) -> TableRow {
    let known: Vec<&TableRow> = rows.iter().filter(|row| row.runs[0] > 0).collect();
    let sum = |pick: fn(&TableRow) -> usize| rows.iter().map(pick).sum::<usize>();
    // Scenes with different scales have no mean per scale.
    let factors = |row: &TableRow| row.scales.iter().map(|(factor, _)| *factor).collect::<Vec<_>>();
    let first = known.first().map_or_else(Vec::new, |row| factors(row));
    let alike = known.iter().all(|row| factors(row) == first);
    let of_scale = |i: usize| mean(known.iter().map(|row| row.scales[i].1));
    let published = quoted(system).filter(|_| whole_set).and_then(|row| match scales {
        Scales::Four => row.average,
        Scales::One => row.single,
    });
    let cells: Vec<Cell> = known.iter().map(|row| row.cell).collect();
    TableRow {
        system: system.name,
        title: system.title,
        scenes: [known.len(), rows.len()],
        runs: [sum(|row| row.runs[0]), sum(|row| row.runs[1])],
        failed: sum(|row| row.failed),
        scales: if alike {
            first.iter().enumerate().map(|(i, &factor)| (factor, of_scale(i))).collect()
        } else {
            Vec::new()
        },
        cell: if cells.is_empty() { Cell::UNKNOWN } else { Cell::mean(&cells) },
        published,
    }
}

/// Returns the mean of curves. Curves with equally many points are averaged point by point. Otherwise the result has the times of the curve
/// with the fewest points, as far as all curves reach them; the curves are interpolated linearly over the logarithm of time. `None` without
/// curves or without such a time.
pub fn mean_curve(curves: &[&[Measure]]) -> Option<Vec<Measure>> {
    let fewest = curves.iter().min_by_key(|curve| curve.len())?;
    let points: Vec<Measure> = if curves.iter().all(|curve| curve.len() == fewest.len()) {
        let at = |i: usize| Measure {
            seconds: mean(curves.iter().map(|curve| curve[i].seconds)),
            psnr: mean(curves.iter().map(|curve| curve[i].psnr)),
        };
        (0..fewest.len()).map(at).collect()
    } else {
        let at = |seconds: f64| {
            let psnr: Option<Vec<f64>> = curves.iter().map(|curve| between(curve, seconds)).collect();
            psnr.map(|psnr| Measure { seconds, psnr: mean(psnr.into_iter()) })
        };
        fewest.iter().filter_map(|point| at(point.seconds)).collect()
    };
    (!points.is_empty()).then_some(points)
}

/// Returns a curve's PSNR at a time; `None` outside of the curve. Within 1 % of a point's time it is that point's PSNR.
fn between(curve: &[Measure], seconds: f64) -> Option<f64> {
    let near = |point: &&Measure| (point.seconds - seconds).abs() <= 0.01 * seconds;
    if let Some(point) = curve.iter().find(near) {
        return Some(point.psnr);
    }
    let pair = curve
        .windows(2)
        .find(|pair| pair[0].seconds > 0.0 && (pair[0].seconds..=pair[1].seconds).contains(&seconds))?;
    let fraction = (seconds / pair[0].seconds).ln() / (pair[1].seconds / pair[0].seconds).ln();
    Some(pair[0].psnr + fraction * (pair[1].psnr - pair[0].psnr))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comparison::fixtures::run;
    use trimip::systems::find;

    #[test]
    fn the_mean_of_scenes_is_that_of_each_scenes_mean() {
        let system = find("ngp").unwrap();
        // Two seeds on one scene, one on the other: both scenes have the same weight.
        let (a, b, c) = (
            run("ngp", "lego", 1, [20.0, 30.0]),
            run("ngp", "lego", 2, [22.0, 32.0]),
            run("ngp", "ship", 1, [28.0, 40.0]),
        );
        let lego = scene_row(system, Scales::Four, "lego", &[&a, &b]);
        let ship = scene_row(system, Scales::Four, "ship", &[&c]);
        assert_eq!((lego.cell.psnr, lego.cell.spread, lego.cell.plain), (26.0, 2.0, 25.0));
        assert_eq!(lego.scales, [(1, 21.0), (2, 31.0)]);
        assert_eq!((lego.published, ship.published), (Some(31.83), None));
        let whole = whole_row(system, Scales::Four, &[lego, ship], false);
        assert_eq!((whole.cell.psnr, whole.cell.plain), (30.0, 29.0));
        assert_eq!(whole.scales, [(1, 24.5), (2, 35.5)]);
        assert_eq!((whole.scenes, whole.runs, whole.published), ([2, 2], [3, 3], None));
        assert!(whole.cell.memory_bytes.is_nan() && whole.cell.parameters == 1_024.0);
    }

    #[test]
    fn what_failed_is_counted_and_not_averaged() {
        let system = find("ngp").unwrap();
        let good = run("ngp", "lego", 1, [20.0, 30.0]);
        let bad =
            Run { status: Status::Failed("why".into()), figures: None, ..run("ngp", "ship", 1, [0.0, 0.0]) };
        let rows = [
            scene_row(system, Scales::Four, "lego", &[&good]),
            scene_row(system, Scales::Four, "ship", &[&bad]),
        ];
        assert!(rows[1].cell.psnr.is_nan());
        let whole = whole_row(system, Scales::Four, &rows, false);
        assert_eq!((whole.scenes, whole.failed, whole.cell.psnr), ([1, 2], 1, 25.0));
    }

    #[test]
    fn curves_are_averaged_at_common_times() {
        let point = |seconds, psnr| Measure { seconds, psnr };
        let (a, b) = ([point(1.0, 20.0), point(2.0, 22.0)], [point(3.0, 30.0), point(4.0, 34.0)]);
        assert_eq!(mean_curve(&[&a, &b]), Some(vec![point(2.0, 25.0), point(3.0, 28.0)]));
        // The curve with more points is interpolated at the times of the other curve that both reach; here halfway in the logarithm.
        let (long, short) =
            ([point(1.0, 20.0), point(4.0, 24.0), point(16.0, 30.0)], [point(8.0, 20.0), point(30.0, 40.0)]);
        assert_eq!(mean_curve(&[&long[..], &short[..]]), Some(vec![point(8.0, 23.5)]));
        assert_eq!(mean_curve(&[&a[..1], &b]), None);
        assert_eq!(mean_curve(&[]), None);
    }
}
