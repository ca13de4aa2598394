//! Progress of a run for the user: a bar on a terminal, or one JSON object per event on standard output.

use crate::{args::ProgressStyle, measures, terminal};
use indicatif::{ProgressBar, ProgressStyle as BarStyle};
use std::sync::OnceLock;
use std::time::{Duration, Instant};
use trimip_core::{
    Result,
    engine::events::{Event, EventSink, Totals},
};
use trimip_data::settings::DataConfig;
use trimip_data::{Scene, Watch};

/// Template of the training bar, which has a thousand steps; the message takes the rest of the terminal's width.
const TRAINING: &str = "{bar:12} {percent:>3} %  {wide_msg}";

/// Message while a scene is opened.
const READING: &str = "reading photographs";

/// Shows events to the user.
pub enum Display {
    /// One JSON object per line.
    Json,
    /// A bar, with lines printed above it.
    Bar(Training),
}

/// The bar of a training run.
pub struct Training {
    bar: ProgressBar,
    /// True to show all lines of the plan; otherwise only its summary is shown.
    verbose: bool,
    started: Instant,
}

impl Display {
    /// Creates the display for a style; `Auto` selects the bar if both outputs are terminals.
    pub fn new(style: ProgressStyle, verbose: bool) -> Self {
        match style {
            ProgressStyle::Json => Self::Json,
            ProgressStyle::Auto if !terminal::watched() => Self::Json,
            _ => Self::Bar(Training { bar: bar(TRAINING, 1000), verbose, started: Instant::now() }),
        }
    }

    /// Shows one event.
    pub fn show(&self, event: &Event) {
        match self {
            Self::Json => {
                if let Ok(text) = serde_json::to_string(event) {
                    terminal::line(text);
                }
            }
            Self::Bar(training) => training.show(event),
        }
    }
}

impl EventSink for Display {
    fn emit(&mut self, event: &Event) {
        self.show(event);
    }
}

/// Creates a bar of `length` units on standard error.
pub fn bar(template: &str, length: u64) -> ProgressBar {
    let style = BarStyle::with_template(template).unwrap_or_else(|_| BarStyle::default_bar());
    ProgressBar::new(length).with_style(style.progress_chars("━╸─"))
}

/// Creates a spinner on standard error for work of unknown length; it is hidden unless both outputs are terminals.
pub fn spinner() -> ProgressBar {
    if !terminal::watched() {
        return ProgressBar::hidden();
    }
    let template = "{spinner} {elapsed} {wide_msg}";
    let style = BarStyle::with_template(template).unwrap_or_else(|_| BarStyle::default_spinner());
    let spinner = ProgressBar::new_spinner().with_style(style);
    spinner.enable_steady_tick(Duration::from_millis(200));
    spinner
}

/// Does work that reports its progress in rows. On a terminal, a bar shows the progress and the text `doing`.
pub fn by_rows<T>(doing: &'static str, work: impl FnOnce(Watch<'_>) -> T) -> T {
    if !terminal::watched() {
        return work(&trimip_data::unwatched);
    }
    let bar = bar("{bar:20} {percent:>3} %  {msg}, {eta} left", 0).with_message(doing);
    let result = work(&|done, total| {
        bar.set_length(total);
        bar.set_position(done);
        true
    });
    bar.finish_and_clear();
    result
}

/// A bar of the rows that have been read. It appears with the first report and disappears at the end; without a terminal it is hidden.
#[derive(Default)]
pub struct Reading {
    bar: OnceLock<ProgressBar>,
}

impl Reading {
    /// Reports that `done` of `total` rows have been read.
    pub fn rows(&self, done: u64, total: u64) {
        let bar = self.bar.get_or_init(|| match terminal::watched() {
            true => bar("{bar:20} {percent:>3} %  {msg}, {eta} left", 0).with_message(READING),
            false => ProgressBar::hidden(),
        });
        bar.set_length(total);
        bar.set_position(done);
    }

    /// Removes the bar.
    pub fn finish(&self) {
        if let Some(bar) = self.bar.get().filter(|bar| !bar.is_finished()) {
            bar.finish_and_clear();
        }
    }
}

/// Opens a scene, with a bar on a terminal.
///
/// # Errors
/// As [`trimip_data::open`].
pub fn open(config: &DataConfig) -> Result<Scene> {
    by_rows(READING, |watch| trimip_data::open_watched(config, watch))
}

impl Training {
    fn show(&self, event: &Event) {
        let bar = &self.bar;
        match event {
            Event::Plan { lines, summary, .. } => {
                let lines = if self.verbose { lines } else { summary };
                bar.suspend(|| lines.iter().for_each(terminal::prose));
            }
            Event::Resumed { totals } => bar.suspend(|| {
                terminal::line(format!(
                    "resumed: step {}, {}",
                    totals.step,
                    terminal::duration(totals.seconds)
                ));
            }),
            Event::Step { totals, batch_psnr, samples_per_second, seconds_left, .. } => {
                // The bar shows which share of the expected total time has passed. It never moves back when the estimate grows.
                let passed = self.started.elapsed().as_secs_f64();
                let left = if seconds_left.is_finite() { seconds_left.max(0.0) } else { f64::INFINITY };
                let part = passed / (passed + left);
                bar.set_position(((part * 1000.0) as u64).clamp(bar.position(), 1000));
                bar.set_message(message(totals.step, *batch_psnr, *samples_per_second, *seconds_left));
            }
            Event::Extended { message, .. } => bar.suspend(|| terminal::line(message)),
            Event::EvaluationProgress { done, total, part } => {
                bar.set_message(format!("evaluating view {} of {total}, {:.0} %", done + 1, 100.0 * part));
            }
            Event::Evaluation { totals, scales, psnr, ssim, last: false, .. } => bar.suspend(|| {
                let per_scale: Vec<_> =
                    scales.iter().map(|q| format!("1/{} {:.2}", q.scale, q.measures.psnr)).collect();
                terminal::prose(format!(
                    "{:>10}  step {:<7} {psnr:.2} dB ({})  SSIM {ssim:.4}",
                    terminal::duration(totals.seconds),
                    totals.step,
                    per_scale.join("  ")
                ));
            }),
            Event::Evaluation { scales, .. } => {
                bar.suspend(|| measures::table(scales).iter().for_each(terminal::prose));
            }
            Event::Poses { moved, aligned } => bar.suspend(|| {
                terminal::prose(moved.to_string());
                aligned.iter().for_each(|aligned| terminal::prose(aligned.to_string()));
            }),
            Event::Warning { message } => bar.suspend(|| terminal::prose(format!("warning: {message}"))),
            Event::Stopped { totals } => {
                bar.abandon();
                terminal::prose(format!(
                    "stopped at step {}; the same command resumes from there",
                    totals.step
                ));
            }
            Event::Finished { totals, .. } => {
                bar.suspend(|| terminal::prose(trained(totals)));
            }
            Event::SessionEnded { .. } => bar.finish_and_clear(),
            // Checkpoints, and events of later library versions.
            _ => {}
        }
    }
}

/// Returns a line about a finished training: steps, time, samples and rays with their rates.
pub fn trained(totals: &Totals) -> String {
    let drawn = totals.backward_fraction().filter(|fraction| *fraction < 1.0);
    let drawn =
        drawn.map_or(String::new(), |fraction| format!(", {:.0} % with a backward pass", 100.0 * fraction));
    let kept = totals.samples_per_ray().map_or(String::new(), |kept| format!(" ({kept:.1} a ray{drawn})"));
    let rate = totals
        .rays_per_second()
        .map_or(String::new(), |rate| format!(" ({})", terminal::number(rate, "rays/s")));
    format!(
        "trained: {} in {}, {} kept{kept} and {}{rate}",
        terminal::count(totals.step, "step"),
        terminal::duration(totals.seconds),
        terminal::many(totals.samples, "sample"),
        terminal::many(totals.rays, "ray"),
    )
}

/// Returns the message next to the training bar: step, PSNR of the step's own pixels in dB, kept samples per second, seconds left.
fn message(step: u64, psnr: f64, samples_per_second: f64, seconds_left: f64) -> String {
    let speed = terminal::number(samples_per_second, "samples/s");
    format!("step {step}  {psnr:.2} dB  {speed}  {} left", terminal::duration(seconds_left))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_line_tells_samples_of_a_ray_and_rays_of_a_second() {
        let totals = Totals { step: 40, seconds: 8.0, samples: 36_000, rays: 3000, ..Totals::default() };
        let line = trained(&totals);
        assert!(line.contains("36.0 k samples kept (12.0 a ray)") && line.contains("(375 rays/s)"), "{line}");
        let line = trained(&Totals { left_out: 27_000, ..totals });
        assert!(line.contains("(12.0 a ray, 25 % with a backward pass)"), "{line}");
        let line = trained(&Totals::default());
        assert!(!line.contains('('), "{line}");
    }

    #[test]
    fn bar_and_message_fit_eighty_columns() {
        // "{bar:12} {percent:>3} %  " precedes the message.
        let before = 12 + 1 + 3 + 2 + 2;
        for (step, psnr, speed, left) in [
            (0, f64::NAN, f64::NAN, f64::NAN),
            (25_000, 27.4, 1.02e6, 3599.0),
            (9_999_999, -10.25, 999_499.0, 99.0 * 3600.0),
        ] {
            let message = message(step, psnr, speed, left);
            assert!(before + message.chars().count() <= 80, "{message}");
        }
    }
}
