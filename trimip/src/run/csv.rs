//! `error_vs_time.csv`: one line per evaluation, with PSNR in dB and SSIM per scale and their means. `metrics.csv`: one
//! line per step event.

use crate::run::history::History;
use std::path::Path;
use trimip_core::{Result, atomic::write_atomically, engine::events::Event};

/// Writes the curve.
///
/// # Errors
/// When the file cannot be written.
pub fn write(path: &Path, history: &History) -> Result<()> {
    write_atomically(path, text(history).as_bytes())
}

/// Formats a value with `digits` after the point; returns an empty text if the value is not finite, as `compare` expects.
fn cell(value: f64, digits: usize) -> String {
    if value.is_finite() { format!("{value:.digits$}") } else { String::new() }
}

/// Returns the curve as CSV: seconds, step, samples, rays, stride, views, last, the means, then PSNR and SSIM of each scale.
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
            "{:.3},{},{},{},{},{views},{},{},{}",
            t.seconds,
            t.step,
            t.samples,
            t.rays,
            e.stride,
            e.last,
            cell(e.psnr, 4),
            cell(e.ssim, 6)
        );
        let of = |scale: &u32| e.scales.iter().find(|q| q.scale == *scale);
        for scale in &scales {
            text += &format!(",{}", of(scale).map_or(String::new(), |q| cell(q.measures.psnr, 4)));
        }
        for scale in &scales {
            text += &format!(",{}", of(scale).map_or(String::new(), |q| cell(q.measures.ssim, 6)));
        }
        text.push('\n');
    }
    text
}

/// Writes the step events among `events`.
///
/// # Errors
/// When the file cannot be written.
pub fn write_steps(path: &Path, events: &[Event]) -> Result<()> {
    write_atomically(path, steps(events).as_bytes())
}

/// Returns the steps as CSV: step, seconds of training, samples kept and rays so far; loss and PSNR (dB) of the step's
/// own pixels; learning rate; share of occupied cells; kept samples per second. A value that is not finite is left
/// empty.
fn steps(events: &[Event]) -> String {
    let mut text =
        "step,seconds,samples,rays,loss,batch_psnr,learning_rate,occupied,samples_per_second\n".to_string();
    let number = |value: f64| if value.is_finite() { format!("{value}") } else { String::new() };
    for event in events {
        let Event::Step { totals, loss, batch_psnr, learning_rate, occupied, samples_per_second, .. } = event
        else {
            continue;
        };
        let values = [*loss, *batch_psnr, *learning_rate, *occupied, *samples_per_second].map(number);
        text += &format!(
            "{},{:.3},{},{},{}\n",
            totals.step,
            totals.seconds,
            totals.samples,
            totals.rays,
            values.join(",")
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::fixtures::{evaluation, step};

    #[test]
    fn step_events_become_lines_and_infinity_an_empty_cell() {
        let text = steps(&[evaluation(10, 5, false, 20.0), step(3, 20, 500, 400)]);
        assert_eq!(text.lines().nth(1), Some("3,3.000,400,20,0.25,,0.002,0.125,1000"));
        assert_eq!(text.lines().count(), 2);
    }

    #[test]
    fn every_line_has_every_column() {
        let text = text(&History::of(&[evaluation(10, 5, false, 20.0), evaluation(20, 1, true, 30.0)]));
        let lines: Vec<_> = text.lines().collect();
        assert!(lines[0].ends_with("psnr_1,psnr_2,ssim_1,ssim_2"));
        assert_eq!(
            lines[1],
            "1.000,10,10000,100,5,8,false,20.0000,0.900000,19.0000,21.0000,0.900000,0.900000"
        );
        let nothing = super::text(&History::of(&[evaluation(10, 5, false, f64::NAN)]));
        assert!(nothing.ends_with(",8,false,,0.900000,,,0.900000,0.900000\n"), "{nothing}");
        let columns = |line: &str| line.split(',').count();
        assert!(lines.iter().all(|line| columns(line) == columns(lines[0])));
    }
}
