//! The measures of a model as a table on the terminal.

use trimip_core::measures::quality::{Measures, ScaleQuality, mean_quality};

/// PSNR, SSIM and what was measured of perception per scale and their mean as aligned lines. `plain` is
/// without the edge exponents of the set, `box` against a true box filter of the finest photographs, `exposed` at the
/// exposure of each photograph.
pub fn table(scales: &[ScaleQuality]) -> Vec<String> {
    let head = ["PSNR/dB", "plain", "box", "at 8 bit", "exposed", "on opposite"];
    let mean = mean_quality(scales);
    let perception =
        [("MS-SSIM", (|m| m.ms_ssim) as fn(&Measures) -> f64), ("FLIP", |m| m.flip), ("LPIPS", |m| m.lpips)];
    let perception: Vec<_> = perception.into_iter().filter(|(_, of)| !of(&mean).is_nan()).collect();
    let line = |name: &str, images: &str, psnr: [String; 6], fractions: Vec<String>| {
        let cells: Vec<String> = head
            .iter()
            .zip(psnr)
            .map(|(head, cell)| format!("{cell:>width$}", width = head.len().max(7)))
            .collect();
        let fractions: String = fractions.iter().map(|fraction| format!("  {fraction:>7}")).collect();
        format!("{name:>7}  {images:>6}  {}{fractions}", cells.join("  "))
    };
    let names = ["SSIM"].into_iter().chain(perception.iter().map(|(name, _)| *name));
    let mut lines = vec![line("scale", "images", head.map(String::from), names.map(String::from).collect())];
    let row = |name: &str, images: usize, m: &Measures| {
        let psnr = [m.psnr, m.psnr_plain, m.psnr_box, m.psnr_8bit, m.psnr_exposed, m.psnr_opposite];
        let fraction = |value: f64| if value.is_nan() { "–".into() } else { format!("{value:.4}") };
        let fractions = [m.ssim].into_iter().chain(perception.iter().map(|(_, of)| of(m))).map(fraction);
        line(name, &images.to_string(), psnr.map(|psnr| format!("{psnr:.3}")), fractions.collect())
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
        let lines = table(&[scale(1, 20.0), scale(2, 30.0)]);
        assert_eq!(lines.len(), 4);
        assert!(lines[1].contains("full") && lines[2].contains("1/2") && lines[3].contains("25.000"));
        assert!(!lines[0].contains("FLIP"), "nothing was measured of perception");
        let mut scales = [scale(1, 20.0), scale(2, 30.0)];
        (scales[0].measures.ms_ssim, scales[0].measures.flip, scales[1].measures.flip) = (0.75, 0.125, 0.25);
        let lines = table(&scales);
        assert!(lines[0].ends_with("SSIM  MS-SSIM     FLIP"), "{}", lines[0]);
        assert!(lines[2].ends_with("0.5000        –   0.2500"), "{}", lines[2]);
        assert!(lines[3].ends_with("0.5000   0.7500   0.1875"), "{}", lines[3]);
    }
}
