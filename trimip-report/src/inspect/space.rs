//! Cameras, points and the planned box from three sides, as SVG drawings of parallel projections. World units.

use super::super::{page::escape, svg::round_step};
use glam::DVec3;
use std::collections::HashMap;
use trimip::Camera;
use trimip::inspect::Inspection;

/// Side of a drawing and its margins for labels, SVG units.
const SIDE: f64 = 440.0;
const LEFT: f64 = 46.0;
const BOTTOM: f64 = 34.0;

/// Maximum numbers of points and of cameras that are drawn; larger sets are thinned evenly.
const MOST_POINTS: usize = 3000;
const MOST_CAMERAS: usize = 400;

/// Length of a drawn frustum, relative to half the side of the drawn cube.
const FRUSTUM: f64 = 0.06;

/// Maximum tangent of half the angle of view in a drawn frustum; that of a fisheye would be unbounded.
const WIDEST: f64 = 1.5;

/// The two axes of each drawing, to the right and upwards, and its title.
const SIDES: [([usize; 2], &str); 3] =
    [([0, 1], "along z, from above"), ([0, 2], "along y, from −y"), ([1, 2], "along x, from +x")];

const AXES: [&str; 3] = ["x", "y", "z"];

/// A camera as drawn.
struct DrawnCamera<'a> {
    name: &'a str,
    camera: &'a Camera,
    /// `train`, `test` or `doubt`.
    class: &'static str,
    split: &'static str,
    doubts: String,
}

/// The part of the world that all three drawings show.
struct Frame {
    centre: DVec3,
    half: f64,
}

impl Frame {
    /// Returns the position of a point in the drawing with these two axes.
    fn place(&self, [right, up]: [usize; 2], at: DVec3) -> [f64; 2] {
        let (width, height) = (SIDE - LEFT, SIDE - BOTTOM);
        let scale = 0.5 * width.min(height) / self.half;
        let x = LEFT + 0.5 * width + scale * (at[right] - self.centre[right]);
        [x, 0.5 * height - scale * (at[up] - self.centre[up])]
    }
}

/// Returns the section with the drawings; empty without cameras.
pub fn section(seen: &Inspection, doubts: &HashMap<usize, Vec<String>>) -> String {
    let scene = &seen.seen.scene;
    let views = scene.train.scales.first().map_or(0..0, |scale| scale.views.clone());
    let train = views.enumerate().map(|(view, index)| {
        let (class, doubts) = match doubts.get(&view) {
            Some(doubts) => ("doubt", format!("; {}", doubts.join(", "))),
            None => ("train", String::new()),
        };
        let view = &scene.train.views[index];
        DrawnCamera { name: &view.name, camera: &view.camera, class, split: "training", doubts }
    });
    let test = seen.seen.scene.test_views.iter().map(|(name, camera)| DrawnCamera {
        name,
        camera,
        class: "test",
        split: "test",
        doubts: String::new(),
    });
    let all: Vec<DrawnCamera<'_>> = train.chain(test).collect();
    let stride = all.len().div_ceil(MOST_CAMERAS).max(1);
    let thinned = |(i, drawn): &(usize, DrawnCamera<'_>)| i % stride == 0 || drawn.class == "doubt";
    let total = all.len();
    // Suspicious cameras are drawn last, so that nothing covers them.
    let mut drawn: Vec<DrawnCamera<'_>> =
        all.into_iter().enumerate().filter(thinned).map(|(_, drawn)| drawn).collect();
    drawn.sort_by_key(|drawn| drawn.class == "doubt");
    let Some(frame) = frame(seen, &drawn) else { return String::new() };
    let drawings: String = SIDES
        .iter()
        .map(|(axes, title)| {
            format!(
                "<figure><svg viewBox=\"0 0 {SIDE} {SIDE}\" role=\"img\" aria-label=\"{title}\">{}{}{}{}</svg>\
                 <figcaption>{title}</figcaption></figure>",
                grid(&frame, *axes),
                points(seen, &frame, *axes),
                drawn.iter().map(|drawn| frustum(&frame, *axes, drawn)).collect::<String>(),
                outline(seen, &frame, *axes),
            )
        })
        .collect();
    let shown = match drawn.len() < total {
        true => format!("{} of {total} cameras are drawn. ", drawn.len()),
        false => String::new(),
    };
    let bounds = match seen.space.ball() {
        Some(ball) => {
            format!("Space is contracted outside the ball of radius {}.", number(ball.radius))
        }
        None => {
            let sides = seen.space.aabb().extent().map(number);
            format!("The box measures {} units.", sides.join(" × "))
        }
    };
    let from = match scene.origin.is_zero() {
        true => String::new(),
        false => format!(", relative to {} in the photographs' coordinates", scene.origin),
    };
    let points = match scene.points.len() {
        0 => "",
        _ => "<span><i style=\"color:#7f7f7f\"></i>points, thinned</span>",
    };
    format!(
        "<section><h2>Cameras and space</h2><div class=\"legend\">\
         <span><i style=\"color:#0072b2\"></i>training</span><span><i style=\"color:#e69f00\"></i>test</span>\
         <span><i style=\"color:#d01c1c\"></i>suspicious</span><span><i style=\"color:#009e73\"></i>planned space</span>{points}\
         </div><div class=\"wide sides\">{drawings}</div><p class=\"lead\">{shown}{bounds} Numbers are world units{from}. Point at a \
         camera for its name.</p></section>\n"
    )
}

/// Returns the cube that contains the cameras and the planned space; `None` if nothing has a finite size.
fn frame(seen: &Inspection, drawn: &[DrawnCamera<'_>]) -> Option<Frame> {
    let space = match seen.space.ball() {
        Some(ball) => {
            let centre = DVec3::from_array(ball.centre);
            [centre - ball.radius, centre + ball.radius]
        }
        None => [DVec3::from_array(seen.space.aabb().min), DVec3::from_array(seen.space.aabb().max)],
    };
    let places = || drawn.iter().map(|drawn| drawn.camera.origin).chain(space).filter(|at| at.is_finite());
    let (low, high) = (places().reduce(DVec3::min)?, places().reduce(DVec3::max)?);
    let half = 0.5 * (1.0 + 2.0 * FRUSTUM) * (high - low).max_element();
    (half.is_normal() && !drawn.is_empty()).then_some(Frame { centre: 0.5 * (low + high), half })
}

/// Draws grid lines at round values, with their labels and the names of the axes.
fn grid(frame: &Frame, [right, up]: [usize; 2]) -> String {
    let step = round_step(2.0 * frame.half / 5.0);
    let digits = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    let ticks = |axis: usize| {
        let [low, high] = [-1.0, 1.0].map(|side| (frame.centre[axis] + side * frame.half) / step);
        // Far from the origin, f64 may be too coarse for the steps, so the number of ticks is bounded.
        (0..12).map(move |i| (low.ceil() + f64::from(i)) * step).filter(move |tick| *tick <= high * step)
    };
    let bottom = SIDE - BOTTOM;
    let mut svg = String::new();
    for tick in ticks(right) {
        let mut at = frame.centre;
        at[right] = tick;
        let [x, _] = frame.place([right, up], at);
        svg += &format!(
            "<line class=\"grid\" x1=\"{x:.1}\" y1=\"0\" x2=\"{x:.1}\" y2=\"{bottom}\"/>\
             <text class=\"faint\" x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{tick:.digits$}</text>",
            bottom + 14.0
        );
    }
    for tick in ticks(up) {
        let mut at = frame.centre;
        at[up] = tick;
        let [_, y] = frame.place([right, up], at);
        svg += &format!(
            "<line class=\"grid\" x1=\"{LEFT}\" y1=\"{y:.1}\" x2=\"{SIDE}\" y2=\"{y:.1}\"/>\
             <text class=\"faint\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{tick:.digits$}</text>",
            LEFT - 5.0,
            y + 4.0
        );
    }
    svg + &format!(
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{} →</text>\
         <text x=\"12\" y=\"{:.1}\" text-anchor=\"middle\">{} ↑</text>",
        0.5 * (LEFT + SIDE),
        SIDE - 4.0,
        AXES[right],
        0.5 * bottom,
        AXES[up],
    )
}

/// Draws the points of structure from motion in their colours.
fn points(seen: &Inspection, frame: &Frame, axes: [usize; 2]) -> String {
    let all = &seen.seen.scene.points;
    let stride = all.len().div_ceil(MOST_POINTS).max(1);
    let dot = |point: &trimip::data::Point| {
        let [x, y] = frame.place(axes, DVec3::from_array(point.position));
        let inside = (LEFT..SIDE).contains(&x) && (0.0..SIDE - BOTTOM).contains(&y);
        let [r, g, b] = point.color;
        let place = inside.then(|| format!("x=\"{:.0}\" y=\"{:.0}\"", x - 1.0, y - 1.0))?;
        Some(format!("<rect {place} width=\"2\" height=\"2\" fill=\"#{r:02x}{g:02x}{b:02x}\"/>"))
    };
    all.iter().step_by(stride).filter_map(dot).collect()
}

/// Draws a camera as the pyramid of its field of view.
fn frustum(frame: &Frame, axes: [usize; 2], drawn: &DrawnCamera<'_>) -> String {
    let (camera, k) = (drawn.camera, &drawn.camera.intrinsics);
    let length = FRUSTUM * frame.half;
    let corner = |u: f64, v: f64| {
        let across = ((u - k.cx) / k.fx).clamp(-WIDEST, WIDEST);
        let along = (-(v - k.cy) / k.fy).clamp(-WIDEST, WIDEST);
        camera.origin + length * (camera.rotation * DVec3::new(across, along, -1.0))
    };
    let (width, height) = (f64::from(k.width), f64::from(k.height));
    let tip = camera.origin;
    let corners = [corner(0.0, 0.0), corner(width, 0.0), corner(width, height), corner(0.0, height)];
    let [o, a, b, c, d] =
        [tip, corners[0], corners[1], corners[2], corners[3]].map(|at| frame.place(axes, at));
    if [o, a, b, c, d].iter().flatten().any(|place| !place.is_finite()) {
        return String::new();
    }
    let at = |[x, y]: [f64; 2]| format!("{x:.1} {y:.1}");
    let [o, a, b, c, d] = [o, a, b, c, d].map(at);
    let [x, y, z] = camera.origin.to_array().map(number);
    format!(
        "<path class=\"{}\" d=\"M{a}L{b}L{c}L{d}ZM{a}L{o}L{b}M{c}L{o}L{d}\"><title>{}, {}: {}x{}, focal length {} pixels, at \
         ({x}, {y}, {z}){}</title></path>",
        drawn.class,
        escape(drawn.name),
        drawn.split,
        k.width,
        k.height,
        number(k.fx),
        escape(&drawn.doubts)
    )
}

/// Draws the planned box or, for an unbounded scene, the ball.
fn outline(seen: &Inspection, frame: &Frame, axes: [usize; 2]) -> String {
    if let Some(ball) = seen.space.ball() {
        let centre = DVec3::from_array(ball.centre);
        let [x, y] = frame.place(axes, centre);
        let [edge, _] = frame.place(axes, centre + DVec3::splat(ball.radius));
        return format!(
            "<circle class=\"space\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{:.1}\"/>",
            (edge - x).abs()
        );
    }
    let aabb = seen.space.aabb();
    let [left, lower] = frame.place(axes, DVec3::from_array(aabb.min));
    let [right, upper] = frame.place(axes, DVec3::from_array(aabb.max));
    format!(
        "<rect class=\"space\" x=\"{left:.1}\" y=\"{upper:.1}\" width=\"{:.1}\" height=\"{:.1}\"/>",
        right - left,
        lower - upper
    )
}

/// Formats a length with three significant figures.
pub fn number(value: f64) -> String {
    if !value.is_finite() {
        return "–".into();
    }
    if value.abs() < 1e-12 {
        return "0".into();
    }
    let digits = (2.0 - value.abs().log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{value:.digits$}")
}
