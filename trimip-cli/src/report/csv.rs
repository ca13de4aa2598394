//! `error_vs_time.csv`: one line per evaluation, with PSNR in dB and SSIM per scale and their means.

use crate::history::History;
use std::path::Path;
use trimip_core::{Result, tensors::write_atomically};

/// Writes the curve.
pub fn write(path: &Path, history: &History) -> Result<()> {
    write_atomically(path, text(history).as_bytes())
}

/// Columns: seconds, step, samples, rays, stride, views, last, the means, then PSNR and SSIM of each scale.
fn text(history: &History) -> String {
    let mut scales: Vec<u32> =
        history.evaluations.iter().flat_map(|e| e.scales.iter().map(|q| q.scale)).collect();
    scales.sort_unstable();
    scales.dedup();
    let mut text = "seconds,step,samples,rays,stride,views,last,psnr_mean,ssim_mean".to_string();
    for measure in ["psnr", "ssim"] {
        scales.iter().for_each(|scale| text += &format!(",{measure}_{scale}"));
    }
    text.push('\n');
    for e in &history.evaluations {
        let t = &e.totals;
        let views = e.scales.iter().map(|q| q.images).max().unwrap_or(0);
        text += &format!(
            "{:.3},{},{},{},{},{views},{},{:.4},{:.6}",
            t.seconds, t.step, t.samples, t.rays, e.stride, e.last, e.psnr, e.ssim
        );
        let of = |scale: &u32| e.scales.iter().find(|q| q.scale == *scale);
        for scale in &scales {
            text += &of(scale).map_or(",".into(), |q| format!(",{:.4}", q.psnr));
        }
        for scale in &scales {
            text += &of(scale).map_or(",".into(), |q| format!(",{:.6}", q.ssim));
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::tests::evaluation;

    #[test]
    fn every_line_has_every_column() {
        let text = text(&History::of(&[evaluation(10, 5, false, 20.0), evaluation(20, 1, true, 30.0)]));
        let lines: Vec<_> = text.lines().collect();
        assert!(lines[0].ends_with("psnr_1,psnr_2,ssim_1,ssim_2"));
        assert_eq!(
            lines[1],
            "1.000,10,10000,100,5,8,false,20.0000,0.900000,19.0000,21.0000,0.900000,0.900000"
        );
        let columns = |line: &str| line.split(',').count();
        assert!(lines.iter().all(|line| columns(line) == columns(lines[0])));
    }
}
