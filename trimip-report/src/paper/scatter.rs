//! A panel of named points, PSNR in dB against a logarithmic axis, as SVG text.

use crate::page::escape;
use crate::svg::{Axis, round_step, short};

const WIDTH: f64 = 500.0;
const HEIGHT: f64 = 330.0;
const LEFT: f64 = 46.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 44.0;
/// Approximate width of a letter of 12 pixels.
const LETTER: f64 = 7.0;
/// Gap between a point and its name.
const GAP: f64 = 9.0;
/// Height of a line of text.
const LINE: f64 = 14.0;

/// A point with its name.
#[derive(Clone, Debug)]
pub struct Mark {
    /// Value on the horizontal axis, above 0.
    pub x: f64,
    /// PSNR, dB.
    pub psnr: f64,
    /// Name.
    pub label: String,
    /// A CSS colour.
    pub color: &'static str,
    /// True for a published value, which is drawn as a ring; false for a measured one.
    pub quoted: bool,
    /// Tooltip.
    pub hint: String,
}

impl Mark {
    /// Returns false for values that no axis can show.
    pub fn is_drawn(&self) -> bool {
        self.x > 0.0 && self.x.is_finite() && self.psnr.is_finite()
    }
}

/// A rectangle: left, top, right, bottom.
type Area = [f64; 4];

/// Position of a name.
#[derive(Clone, Copy, Debug)]
struct Label {
    area: Area,
    /// True if the name is aligned to the right side of its area. The width of the area is an estimate from the average letter.
    at_right: bool,
}

/// Returns the range of quality that contains every value, rounded outwards.
pub fn range(psnr: &[f64]) -> [f64; 2] {
    let low = psnr.iter().copied().fold(f64::INFINITY, f64::min);
    let high = psnr.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let step = round_step(((high - low) / 6.0).max(0.2));
    [((low - 0.3 * step) / step).floor() * step, ((high + 0.3 * step) / step).ceil() * step]
}

/// Draws the panel; `None` without points. `quality` is the range of its vertical axis, dB.
pub fn panel(marks: &[Mark], title: &str, quality: [f64; 2]) -> Option<String> {
    let low = marks.iter().map(|mark| mark.x).reduce(f64::min)?;
    let high = marks.iter().map(|mark| mark.x).reduce(f64::max)?;
    // The axis spans at least a factor of four. Otherwise equal values would need labels with many digits.
    let middle = (low * high).sqrt();
    let (low, high) = ((low / 1.6).min(middle / 2.0), (high * 1.6).max(middle * 2.0));
    let x = Axis { low, high, logarithmic: true, start: LEFT, end: WIDTH - RIGHT };
    let y = Axis { low: quality[0], high: quality[1], logarithmic: false, start: HEIGHT - BOTTOM, end: TOP };
    let mut svg =
        format!("<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"PSNR against {title}\">");
    for tick in y.ticks() {
        let at = y.place(tick);
        svg += &format!(
            "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{:.1}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            x.end,
            LEFT - 7.0,
            at + 4.0,
            short(tick)
        );
    }
    for tick in x.ticks() {
        let at = x.place(tick);
        svg += &format!(
            "<line class=\"grid\" x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{TOP}\" y2=\"{:.1}\"/>\
             <text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            y.start,
            y.start + 18.0,
            short(tick)
        );
    }
    svg += &format!(
        "<text class=\"faint\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{title}</text>\
         <text class=\"faint\" transform=\"translate(12 {:.1}) rotate(-90)\" text-anchor=\"middle\">PSNR / dB</text>",
        0.5 * (x.start + x.end),
        HEIGHT - 6.0,
        0.5 * (y.start + y.end)
    );
    let places: Vec<[f64; 2]> = marks.iter().map(|mark| [x.place(mark.x), y.place(mark.psnr)]).collect();
    let labels = labels(marks, &places);
    for ((mark, place), label) in marks.iter().zip(&places).zip(&labels) {
        svg += &drawn(mark, *place, label);
    }
    Some(svg + "</svg>")
}

/// Draws a point, its name, and a thin line between them if the name is not next to the point.
fn drawn(mark: &Mark, [x, y]: [f64; 2], label: &Label) -> String {
    let [left, top, right, bottom] = label.area;
    let (class, faint) = if mark.quoted { ("quoted", " class=\"faint\"") } else { ("dot", "") };
    let (at, anchor) = if label.at_right { (right, " text-anchor=\"end\"") } else { (left, "") };
    let nearest = [x.clamp(left, right), y.clamp(top + 3.0, bottom - 3.0)];
    let far = (nearest[0] - x).hypot(nearest[1] - y) > GAP + 3.0;
    let leader = match far {
        true => format!(
            "<line class=\"leader\" x1=\"{x:.1}\" y1=\"{y:.1}\" x2=\"{:.1}\" y2=\"{:.1}\"/>",
            nearest[0], nearest[1]
        ),
        false => String::new(),
    };
    format!(
        "{leader}<g style=\"color:{}\"><circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"5\"><title>{}</title></circle></g>\
         <text{faint}{anchor} x=\"{at:.1}\" y=\"{:.1}\">{}</text>",
        mark.color,
        escape(&mark.hint),
        top + LINE - 3.0,
        escape(&mark.label)
    )
}

/// Returns a position near its point for each name, such that it covers as little as possible of points and other names.
fn labels(marks: &[Mark], places: &[[f64; 2]]) -> Vec<Label> {
    let points: Vec<Area> = places.iter().map(|[x, y]| [x - 6.0, y - 6.0, x + 6.0, y + 6.0]).collect();
    let mut labels: Vec<Label> = Vec::new();
    for (mark, [x, y]) in marks.iter().zip(places) {
        let width = LETTER * mark.label.chars().count() as f64;
        let at = |left: f64, top: f64, at_right: bool| {
            let left = left.clamp(LEFT, (WIDTH - RIGHT - width).max(LEFT));
            let top = top.clamp(TOP, HEIGHT - BOTTOM - LINE);
            Label { area: [left, top, left + width, top + LINE], at_right }
        };
        let mut tried = Vec::new();
        for shift in [0.0, -9.0, 9.0, -18.0, 18.0, -30.0, 30.0, -44.0, 44.0] {
            tried.push(at(x + GAP, y - 0.5 * LINE + shift, false));
            tried.push(at(x - GAP - width, y - 0.5 * LINE + shift, true));
        }
        let covered = |label: &Label| {
            let of_points = points.iter().map(|other| shared(&label.area, other)).sum::<f64>();
            of_points + labels.iter().map(|other| shared(&label.area, &other.area)).sum::<f64>()
        };
        // Positions are tried from near to far, so the nearest of equally good ones wins.
        let best = tried.iter().min_by(|a, b| covered(a).total_cmp(&covered(b))).copied();
        labels.push(best.unwrap_or_else(|| at(*x, *y, false)));
    }
    labels
}

/// Returns the area that two rectangles share.
fn shared(a: &Area, b: &Area) -> f64 {
    let side = |low: usize, high: usize| (a[high].min(b[high]) - a[low].max(b[low])).max(0.0);
    side(0, 2) * side(1, 3)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn marks(points: &[(f64, f64)]) -> Vec<Mark> {
        let mark = |&(x, psnr): &(f64, f64)| Mark {
            x,
            psnr,
            label: "a name < b".into(),
            color: "red",
            quoted: false,
            hint: String::new(),
        };
        points.iter().map(mark).collect()
    }

    #[test]
    fn names_of_near_points_do_not_cover_each_other() {
        let points = [(10.0, 30.0), (10.5, 30.05), (10.0, 30.1), (900.0, 31.0)];
        let near = marks(&points);
        let axis = |value: f64| (value.log10() * 100.0) + 60.0;
        let places: Vec<[f64; 2]> = points.iter().map(|(x, psnr)| [axis(*x), 400.0 - 10.0 * psnr]).collect();
        let labels: Vec<Area> = labels(&near, &places).iter().map(|label| label.area).collect();
        for (i, one) in labels.iter().enumerate() {
            assert!(labels[..i].iter().all(|other| shared(one, other) == 0.0), "{labels:?}");
            assert!(one[0] >= LEFT && one[2] <= WIDTH - RIGHT + 1e-9 && one[1] >= TOP);
        }
    }

    #[test]
    fn a_panel_holds_its_points_and_escapes_their_names() {
        let marks = marks(&[(5.0, 30.0), (500.0, 20.0)]);
        let svg = panel(&marks, "model / MB", range(&[30.0, 20.0])).unwrap();
        assert!(svg.contains("a name &lt; b") && !svg.contains("NaN"));
        assert_eq!(svg.matches("class=\"dot\"").count(), 2);
        // A single point and equal points also have an axis.
        assert!(!panel(&marks[..1], "x", range(&[30.0])).unwrap().contains("NaN"));
        assert!(panel(&[], "x", [0.0, 1.0]).is_none());
    }
}
