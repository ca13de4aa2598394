//! The measures of a model as a table on the terminal.

use trimip_core::measures::quality::{Measures, ScaleQuality, mean_quality};

/// Minimum difference in dB for a second kind of PSNR to be shown.
const TELLING: f64 = 0.005;

/// Formats PSNR, SSIM and the measured perceptual metrics, per scale and as their mean, in aligned lines of at most 80 columns. Shows a
/// second kind of PSNR if it differs from the first: the PSNR at the exposure of each photograph, or else the PSNR without the set's edge
/// exponents. The report has all kinds.
pub fn table(scales: &[ScaleQuality]) -> Vec<String> {
    let mean = mean_quality(scales);
    let psnr = [
        ("PSNR/dB", (|m| m.psnr) as fn(&Measures) -> f64),
        ("exposed", |m| m.psnr_exposed),
        ("plain", |m| m.psnr_plain),
    ];
    let differs = |of: fn(&Measures) -> f64| (of(&mean) - mean.psnr).abs() >= TELLING;
    let psnr: Vec<_> = psnr
        .into_iter()
        .enumerate()
        .filter(|(i, (_, of))| *i == 0 || differs(*of))
        .map(|(_, kind)| kind)
        .take(2)
        .collect();
    let perception =
        [("MS-SSIM", (|m| m.ms_ssim) as fn(&Measures) -> f64), ("FLIP", |m| m.flip), ("LPIPS", |m| m.lpips)];
    let perception: Vec<_> = perception.into_iter().filter(|(_, of)| !of(&mean).is_nan()).collect();
    let line = |name: &str, images: &str, cells: Vec<String>| {
        let cells: String = cells.iter().map(|cell| format!("  {cell:>7}")).collect();
        format!("{name:>7}  {images:>6}{cells}")
    };
    let heads = psnr.iter().map(|(name, _)| *name).chain(["SSIM"]);
    let heads = heads.chain(perception.iter().map(|(name, _)| *name));
    let mut lines = vec![line("scale", "images", heads.map(String::from).collect())];
    let row = |name: &str, images: usize, m: &Measures| {
        let psnr = psnr.iter().map(|(_, of)| format!("{:.3}", of(m)));
        let fraction = |value: f64| if value.is_nan() { "–".into() } else { format!("{value:.4}") };
        let fractions = [m.ssim].into_iter().chain(perception.iter().map(|(_, of)| of(m))).map(fraction);
        line(name, &images.to_string(), psnr.chain(fractions).collect())
    };
    lines.extend(scales.iter().map(|q| {
        let name = if q.scale == 1 { "full".to_string() } else { format!("1/{}", q.scale) };
        row(&name, q.images, &q.measures)
    }));
    let images = scales.iter().map(|q| q.images).sum();
    lines.push(row("mean", images, &mean));
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_ends_with_the_mean_of_the_scales() {
        let scale = |scale, psnr| ScaleQuality {
            scale,
            images: 3,
            perceptual_images: 0,
            measures: Measures { psnr, psnr_constant: 12.0, ssim: 0.5, ..Measures::UNKNOWN },
        };
        let mut scales = [scale(1, 20.0), scale(2, 30.0)];
        let lines = table(&scales);
        assert_eq!(lines.len(), 4);
        assert!(lines[1].contains("full") && lines[2].contains("1/2") && lines[3].contains("25.000"));
        assert!(!lines[0].contains("FLIP"), "nothing was measured of perception");
        (scales[0].measures.ms_ssim, scales[0].measures.flip, scales[1].measures.flip) = (0.75, 0.125, 0.25);
        let lines = table(&scales);
        assert!(lines[0].ends_with("SSIM  MS-SSIM     FLIP"), "{}", lines[0]);
        assert!(lines[2].ends_with("0.5000        –   0.2500"), "{}", lines[2]);
        assert!(lines[3].ends_with("0.5000   0.7500   0.1875"), "{}", lines[3]);
    }
    #[test]
    fn lines_fit_eighty_columns_and_tell_of_the_psnr_that_differs() {
        let all =
            Measures { psnr: 20.0, psnr_plain: 20.0, psnr_exposed: 20.0, ssim: 0.5, ..Measures::UNKNOWN };
        let all =
            Measures { ms_ssim: 0.5, flip: 0.5, lpips: 0.5, psnr_8bit: 19.0, psnr_opposite: 12.0, ..all };
        let heads = |measures| {
            let lines = table(&[ScaleQuality { scale: 8, images: 100_000, perceptual_images: 0, measures }]);
            assert!(lines.iter().all(|line| line.chars().count() <= 80), "{lines:#?}");
            ["PSNR/dB", "exposed", "plain"].map(|head| lines[0].contains(head))
        };
        assert_eq!(heads(all), [true, false, false]);
        assert_eq!(heads(Measures { psnr_plain: 19.0, ..all }), [true, false, true]);
        assert_eq!(heads(Measures { psnr_plain: 19.0, psnr_exposed: 21.0, ..all }), [true, true, false]);
    }
}
