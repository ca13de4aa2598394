//! Plots of error against time as SVG text. The vertical axis is PSNR in dB (the right axis labels the same error as
//! RMSE), the horizontal axis training seconds, linear or logarithmic. A report has one line per scale and one for
//! their mean; a comparison has one line per run.

use super::escape::escape;
use trimip::formatting;
use trimip::{report::scale_name, run::history::Evaluation};

/// Width and height of a drawing, pixels.
type Size = [f64; 2];

/// Sizes of the drawing: for wide windows and files, and for telephones.
const WIDE: Size = [960.0, 440.0];
const NARROW: Size = [420.0, 340.0];

const LEFT: f64 = 56.0;
const RIGHT: f64 = 66.0;
const TOP: f64 = 14.0;
const BOTTOM: f64 = 48.0;

/// Line colours from fine to coarse (Okabe and Ito's palette, distinguishable without colour vision).
pub const COLORS: [&str; 8] =
    ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#7f7f7f", "#a6761d"];

/// Class of a dashed line. Dashed lines reuse the colours when there are more lines than colours.
pub const DASHED: &str = "dashed";

/// An axis: the range of its values, and the range of pixels that it covers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Axis {
    pub(crate) low: f64,
    pub(crate) high: f64,
    pub(crate) logarithmic: bool,
    pub(crate) start: f64,
    pub(crate) end: f64,
}

impl Axis {
    /// Returns the pixel position of a value.
    pub(crate) fn place(&self, value: f64) -> f64 {
        let f = |x: f64| if self.logarithmic { x.log10() } else { x };
        let fraction = (f(value) - f(self.low)) / (f(self.high) - f(self.low));
        self.start + fraction * (self.end - self.start)
    }

    /// Returns round values for the tick labels.
    pub(crate) fn ticks(&self) -> Vec<f64> {
        if self.logarithmic {
            let digits: &[f64] = if self.high / self.low > 2e3 { &[1.0] } else { &[1.0, 2.0, 5.0] };
            let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
            let all = decades.flat_map(|e| digits.iter().map(move |d| d * 10_f64.powi(e)));
            return all.filter(|t| (self.low * 0.999..=self.high * 1.001).contains(t)).collect();
        }
        let step = round_step((self.high - self.low) / 6.0);
        let first = (self.low / step - 1e-9).ceil() as i64;
        let last = (self.high / step + 1e-9).floor() as i64;
        (first..=last).map(|i| i as f64 * step).collect()
    }
}

/// Returns the smallest number of the form 1, 2 or 5 × 10^n that is at least `rough`.
pub fn round_step(rough: f64) -> f64 {
    let power = 10_f64.powf(rough.log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|d| d * power).find(|s| *s >= rough * 0.999).unwrap_or(10.0 * power)
}

/// A measurement on a line.
#[derive(Clone, Debug)]
pub struct Point {
    /// Training time, seconds.
    pub seconds: f64,
    /// PSNR, dB.
    pub psnr: f64,
    /// Tooltip.
    pub hint: String,
}

impl Point {
    /// Returns false for values that no axis can show.
    fn drawn(&self) -> bool {
        self.psnr.is_finite() && self.seconds > 0.0 && self.seconds.is_finite()
    }
}

/// A line of the plot.
#[derive(Clone, Debug)]
pub struct Line {
    /// Name in the legend; lines with the same name share one entry.
    pub name: String,
    /// A CSS colour.
    pub color: String,
    /// Class of its group in the style sheet.
    pub class: &'static str,
    /// The measurements in order of time.
    pub points: Vec<Point>,
    /// A measurement on different views than those of the line, drawn as a ring.
    pub ring: Option<Point>,
}

/// Returns axes that contain every drawn point, the vertical one rounded outwards.
fn axes(lines: &[Line], logarithmic: bool, [width, height]: Size) -> Option<(Axis, Axis)> {
    let points = || lines.iter().flat_map(|line| line.points.iter().chain(&line.ring)).filter(|p| p.drawn());
    let range = |value: fn(&Point) -> f64| {
        let low = points().map(value).reduce(f64::min)?;
        Some((low, points().map(value).reduce(f64::max)?))
    };
    let ((first, last), (low, high)) = (range(|p| p.seconds)?, range(|p| p.psnr)?);
    let step = round_step(((high - low) / 6.0).max(0.1));
    let vertical = Axis {
        low: (low / step).floor() * step,
        high: ((high / step).ceil() * step).max((low / step).floor() * step + step),
        logarithmic: false,
        start: height - BOTTOM,
        end: TOP,
    };
    let (first, last) = if logarithmic { (first / 1.08, last * 1.08) } else { (0.0, last * 1.02) };
    Some((Axis { low: first, high: last, logarithmic, start: LEFT, end: width - RIGHT }, vertical))
}

/// Returns the lines of a run: one per scale and one for their mean. `whole` is the final evaluation on all views,
/// drawn as a ring because the curve uses other views.
pub fn lines(curve: &[&Evaluation], whole: Option<&Evaluation>) -> Vec<Line> {
    let whole = whole.filter(|w| !curve.contains(w));
    let line = |class, name: String, color: &str, value: &dyn Fn(&Evaluation) -> f64| {
        let point = |e: &Evaluation| Point {
            seconds: e.totals.seconds,
            psnr: value(e),
            hint: format!(
                "{:.2} dB after {} (step {})",
                value(e),
                formatting::duration(e.totals.seconds),
                e.totals.step
            ),
        };
        let points = curve.iter().map(|e| point(e)).collect();
        Line { name, color: color.into(), class, points, ring: whole.map(point) }
    };
    let evaluations = || curve.iter().copied().chain(whole);
    let scales = evaluations().map(|e| &e.scales).max_by_key(|scales| scales.len());
    let mut lines: Vec<Line> = scales
        .into_iter()
        .flatten()
        .enumerate()
        .map(|(i, quality)| {
            let value = move |e: &Evaluation| e.scales.get(i).map_or(f64::NAN, |q| q.measures.psnr);
            line("scale", scale_name(quality.scale), COLORS[i % COLORS.len()], &value)
        })
        .collect();
    lines.push(line("mean", "mean of the scales".into(), "currentColor", &|e| e.psnr));
    lines
}

/// Returns a plot for a page, which adds colours and a [`legend`]. The plot is drawn twice, for wide windows and for
/// telephones, and the page shows one of the two. `None` if there is nothing to draw.
pub fn plot(lines: &[Line], logarithmic: bool) -> Option<String> {
    let drawn = |class: &str, size: Size| {
        let [width, height] = size;
        Some(format!(
            "<svg class=\"{class}\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"PSNR against training time\">{}</svg>",
            draw(lines, logarithmic, TRAINING, size)?
        ))
    };
    Some(drawn("broad", WIDE)? + &drawn("narrow", NARROW)?)
}

/// Returns the legend of a plot as HTML.
pub fn legend(lines: &[Line]) -> String {
    let entry = |line: &&Line| {
        let dashed = if line.class.contains(DASHED) { " class=\"dashed\"" } else { "" };
        format!("<span><i{dashed} style=\"color:{}\"></i>{}</span>", line.color, escape(&line.name))
    };
    let mut legend: String = named(lines).iter().map(entry).collect();
    if lines.iter().any(|line| line.ring.is_some()) {
        legend += "<span><i class=\"ring\"></i>final</span>";
    }
    legend
}

/// Returns the first line of each name.
fn named(lines: &[Line]) -> Vec<&Line> {
    let first = |(i, line): &(usize, &Line)| !lines[..*i].iter().any(|other| other.name == line.name);
    lines.iter().enumerate().filter(first).map(|(_, line)| line).collect()
}

/// Title of a horizontal axis of training time.
pub const TRAINING: &str = "training time / s";

/// Returns a standalone plot with a legend. Its horizontal axis is logarithmic time with the title `time`. `None` if
/// there is nothing to draw.
pub fn alone(lines: &[Line], time: &str) -> Option<String> {
    let style = "text { font: 13px system-ui, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif; fill: #1b1f24; } \
                 text.faint { fill: #606a76; } .grid { stroke: #dde2e8; } \
                 polyline { fill: none; stroke: currentColor; stroke-width: 2.2; stroke-linejoin: round; } \
                 .dot { fill: currentColor; } .ring { fill: none; stroke: currentColor; stroke-width: 2; }";
    let mut legend = String::new();
    let [left, top] = legend_place(lines)?;
    for (i, line) in named(lines).into_iter().enumerate() {
        let y = top + 20.0 * i as f64;
        legend += &format!(
            "<g style=\"color:{}\"><polyline points=\"{:.0},{y:.0} {:.0},{y:.0}\"/></g><text x=\"{:.0}\" y=\"{:.1}\">{}</text>",
            line.color,
            left,
            left + 26.0,
            left + 34.0,
            y + 4.5,
            escape(&line.name)
        );
    }
    let [width, height] = WIDE;
    Some(format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" role=\"img\" \
         aria-label=\"PSNR against {time}\"><style>{style}</style>\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>{}{legend}</svg>\n",
        draw(lines, true, time, WIDE)?
    ))
}

/// Returns the start of the legend's first line, in the corner of the plot where the legend covers the least of the lines.
fn legend_place(lines: &[Line]) -> Option<[f64; 2]> {
    let (x, y) = axes(lines, true, WIDE)?;
    let names = named(lines);
    let letters = names.iter().map(|line| line.name.chars().count()).max().unwrap_or(0);
    // Approximate width of a letter of 13 pixels.
    let (width, height) = (34.0 + 7.0 * letters as f64, 20.0 * names.len() as f64);
    let (left, right) = (LEFT + 14.0, WIDE[0] - RIGHT - 14.0 - width);
    let (top, bottom) = (TOP + 16.0, WIDE[1] - BOTTOM - height);
    let place = |p: &Point| [x.place(p.seconds), y.place(p.psnr)];
    // Points, and positions between them, so that the legend also avoids the lines between points.
    let mut drawn: Vec<[f64; 2]> = Vec::new();
    for line in lines {
        let points: Vec<_> = line.points.iter().filter(|p| p.drawn()).map(place).collect();
        for pair in points.windows(2) {
            let between = |i: u32| {
                [0, 1].map(|axis| pair[0][axis] + (pair[1][axis] - pair[0][axis]) * f64::from(i) / 16.0)
            };
            drawn.extend((1..16).map(between));
        }
        drawn.extend(points);
        drawn.extend(line.ring.iter().filter(|p| p.drawn()).map(place));
    }
    let covered = |[left, top]: &[f64; 2]| {
        let inside = |[x, y]: &&[f64; 2]| {
            (-10.0..width + 10.0).contains(&(x - left)) && (-20.0..height).contains(&(y - top))
        };
        drawn.iter().filter(inside).count()
    };
    // If corners are equally good, the first wins.
    [[left, top], [right, bottom], [left, bottom], [right, top]].into_iter().min_by_key(covered)
}

/// Draws axes, labels and lines.
fn draw(lines: &[Line], logarithmic: bool, time: &str, size: Size) -> Option<String> {
    let (x, y) = axes(lines, logarithmic, size)?;
    let mut svg = String::new();
    for tick in y.ticks() {
        let at = y.place(tick);
        svg += &format!(
            "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{:.1}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>\
             <text class=\"faint\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
            x.end,
            LEFT - 8.0,
            at + 4.5,
            short(tick),
            x.end + 8.0,
            at + 4.5,
            short(10_f64.powf(-tick / 20.0)),
        );
    }
    for tick in x.ticks() {
        let at = x.place(tick);
        svg += &format!(
            "<line class=\"grid\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{TOP}\" y2=\"{:.1}\"/>\
             <text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            y.start,
            y.start + 20.0,
            short(tick),
        );
    }
    svg += &format!(
        "<text class=\"faint\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{time}</text>\
         <text class=\"faint\" transform=\"translate(14 {middle:.1}) rotate(-90)\" text-anchor=\"middle\">PSNR / dB</text>\
         <text class=\"faint\" transform=\"translate({:.1} {middle:.1}) rotate(90)\" text-anchor=\"middle\">RMSE</text>",
        0.5 * (x.start + x.end),
        size[1] - 6.0,
        size[0] - 12.0,
        middle = 0.5 * (y.start + y.end),
    );
    for line in lines {
        svg += &group(line, x, y);
    }
    Some(svg)
}

fn group(line: &Line, x: Axis, y: Axis) -> String {
    let at = |p: &Point| (x.place(p.seconds), y.place(p.psnr));
    let hint = |p: &Point| format!("<title>{}</title>", escape(&p.hint));
    let points: Vec<_> = line.points.iter().filter(|p| p.drawn()).collect();
    let path: Vec<_> = points.iter().map(|p| at(p)).map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
    let mut svg = format!(
        "<g class=\"{}\" style=\"color:{}\"><polyline points=\"{}\"/>",
        line.class,
        line.color,
        path.join(" ")
    );
    for p in points {
        let (x, y) = at(p);
        svg += &format!("<circle class=\"dot\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3.2\">{}</circle>", hint(p));
    }
    if let Some(p) = line.ring.as_ref().filter(|p| p.drawn()) {
        let (x, y) = at(p);
        svg += &format!("<circle class=\"ring\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"6\">{}</circle>", hint(p));
    }
    svg + "</g>"
}

/// Formats a tick's value in few characters.
pub(crate) fn short(value: f64) -> String {
    let digits = if value.abs() >= 9.995 { 1 } else { 3 };
    let text = format!("{value:.digits$}");
    let trimmed = text.trim_end_matches('0').trim_end_matches('.');
    if trimmed.is_empty() { "0".into() } else { trimmed.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_map_their_ends_and_the_logarithm_its_middle() {
        let axis = Axis { low: 1.0, high: 100.0, logarithmic: true, start: 0.0, end: 200.0 };
        assert_eq!((axis.place(1.0), axis.place(10.0), axis.place(100.0)), (0.0, 100.0, 200.0));
        assert_eq!(axis.ticks(), [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0]);
        let axis = Axis { low: 20.0, high: 30.0, logarithmic: false, start: 100.0, end: 0.0 };
        assert_eq!((axis.place(20.0), axis.place(25.0)), (100.0, 50.0));
        assert_eq!(axis.ticks(), [20.0, 22.0, 24.0, 26.0, 28.0, 30.0]);
    }

    #[test]
    fn every_point_lies_inside_the_frame() {
        trimip::run::fixtures::report(|report| {
            for logarithmic in [false, true] {
                let both = plot(&lines(&report.curve(), report.history.last()), logarithmic).unwrap();
                let (broad, narrow) = both.split_once("<svg class=\"narrow\"").unwrap();
                for (svg, [width, _]) in [(broad, WIDE), (narrow, NARROW)] {
                    assert_eq!(svg.matches("<polyline").count(), 3);
                    assert_eq!(svg.matches("class=\"ring\"").count(), 3);
                    for part in svg.split("cx=\"").skip(1) {
                        let x: f64 = part.split('"').next().unwrap().parse().unwrap();
                        assert!((LEFT..=width - RIGHT).contains(&x), "{x}");
                    }
                }
            }
        });
    }

    #[test]
    fn degenerate_curves_draw_nothing_or_stay_finite() {
        assert!(plot(&lines(&[], None), true).is_none());
        trimip::run::fixtures::report(|report| {
            let one = plot(&lines(&report.curve()[..1], None), true).unwrap();
            assert!(!one.contains("NaN") && !one.contains("inf"));
            let mut broken = report.curve()[0].clone();
            broken.psnr = f64::NAN;
            broken.scales[0].measures.psnr = f64::INFINITY;
            let svg = plot(&lines(&[&broken], None), false).unwrap();
            assert!(!svg.contains("NaN") && !svg.contains("inf"));
        });
    }

    #[test]
    fn a_plot_that_stands_alone_names_its_lines() {
        let line = |name: &str, psnr: f64| Line {
            name: name.into(),
            color: COLORS[0].into(),
            class: "mean",
            points: vec![Point { seconds: 1.0, psnr, hint: "a < b".into() }],
            ring: None,
        };
        let svg = alone(&[line("one & two", 20.0), line("three", f64::NAN)], TRAINING).unwrap();
        // The legend avoids the corner with the points.
        let place = |seconds: [f64; 2], psnr: [f64; 2]| {
            let point = |i: usize| Point { seconds: seconds[i], psnr: psnr[i], hint: String::new() };
            let points = vec![point(0), point(1)];
            legend_place(&[Line { points, ..line("a line", 0.0) }]).unwrap()
        };
        let ([rising_x, rising_y], [falling_x, falling_y]) =
            (place([1.0, 9.0], [20.0, 30.0]), place([1.0, 9.0], [30.0, 20.0]));
        assert!(rising_x < 100.0 && rising_y < 60.0 && falling_x < 100.0 && falling_y > 300.0);
        assert!(svg.contains("one &amp; two") && svg.contains("a &lt; b") && svg.contains("xmlns"));
        assert_eq!(svg.matches("class=\"dot\"").count(), 1);
        assert!(alone(&[line("nothing", f64::NAN)], TRAINING).is_none() && alone(&[], TRAINING).is_none());
        // Seeds of a system share its name.
        let seeds = [line("same", 20.0), line("same", 21.0)];
        assert_eq!(alone(&seeds, TRAINING).unwrap().matches(">same<").count(), 1);
        assert_eq!(legend(&seeds).matches(">same<").count(), 1);
    }

    #[test]
    fn ticks_are_short() {
        assert_eq!([short(0.0), short(25.0), short(0.0316), short(2.5)], ["0", "25", "0.032", "2.5"]);
        assert_eq!(short(1000.0), "1000");
    }
}
