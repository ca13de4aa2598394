//! Measures how fast `view` responds in a real browser: pictures per second while the camera turns, milliseconds from
//! input to picture, bytes per picture, and memory of the server.
//!
//! `cargo run --release -p trimip-tests --example view_rate -- RUN [volume|hybrid] [SIDE]`

use serde_json::{Value, json};
use std::path::Path;
use std::time::{Duration, Instant};
use trimip_tests::watching::{Browser, Shown};

/// Time during which the camera turns.
const TURNING: Duration = Duration::from_secs(10);

/// Time allowed for the finest picture to arrive.
const SETTLING: Duration = Duration::from_secs(3);

/// Interval between two mouse moves, as on a display with 60 Hz.
const MOVE: Duration = Duration::from_millis(16);

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [run, rest @ ..] = &arguments[..] else {
        eprintln!("usage: view_rate RUN [volume|hybrid] [SIDE]");
        std::process::exit(2);
    };
    let renderer = rest.first().map_or("volume", String::as_str);
    let side: u32 = rest.get(1).and_then(|side| side.parse().ok()).unwrap_or(400);
    let run = Path::new(run).canonicalize().expect("a run folder");
    let shown = Shown::start(Path::new("."), run.to_str().expect("a path of UTF-8"));
    let mut browser = Browser::start(side + 600, side + 100).expect("Chromium");
    let size = json!({ "width": side + 600, "height": side + 100, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", size);
    browser.open(&shown.address());
    browser.wait("document.getElementById('view')?.dataset.done === 'true'");
    browser.value(&format!(
        "(() => {{ document.getElementById('stage').style = 'width: {side}px; height: {side}px';
            for (const [id, value] of [['scale', 100], ['renderer', '{renderer}']]) {{
            const s = document.getElementById(id); s.value = value;
            s.dispatchEvent(new Event(id === 'scale' ? 'input' : 'change')); }} }})()"
    ));
    std::thread::sleep(SETTLING);
    browser.value(
        "(() => { window.seen = []; new MutationObserver(() => { const d = document.getElementById('view').dataset;
            seen.push([performance.now(), Number(d.waited), Number(d.bytes), document.getElementById('size').textContent]); })
            .observe(document.getElementById('view'), { attributeFilter: ['data-id'] }); })()",
    );
    let middle = f64::from(side) / 2.0;
    let mut mouse = |kind: &str, x: f64, buttons: u32| {
        let parameters = json!({ "type": kind, "x": x, "y": middle, "button": "left", "buttons": buttons, "clickCount": 1 });
        browser.call("Input.dispatchMouseEvent", parameters);
    };
    mouse("mousePressed", middle, 1);
    let started = Instant::now();
    let mut step = 0_u32;
    while started.elapsed() < TURNING {
        step += 1;
        // The mouse moves back and forth over half of the picture.
        let x = middle * (1.0 + 0.5 * (f64::from(step) * 0.05).sin());
        mouse("mouseMoved", x, 1);
        std::thread::sleep(MOVE);
    }
    mouse("mouseReleased", middle, 0);
    let seconds = started.elapsed().as_secs_f64();
    let seen = browser.value("window.seen");
    let seen = seen.as_array().expect("a list");
    let column = |i: usize| {
        let mut numbers: Vec<f64> = seen.iter().filter_map(|own| own[i].as_f64()).collect();
        numbers.sort_by(f64::total_cmp);
        numbers
    };
    let quantile = |numbers: &[f64], fraction: f64| numbers[((numbers.len() - 1) as f64 * fraction) as usize];
    let (waited, bytes) = (column(1), column(2));
    println!("{renderer}, {side}×{side}, {step} moves of the mouse in {seconds:.1} s");
    println!("pictures per second: {:.1}", seen.len() as f64 / seconds);
    println!(
        "input to picture: median {:.0} ms, 95 % {:.0} ms",
        quantile(&waited, 0.5),
        quantile(&waited, 0.95)
    );
    println!("bytes of a picture: median {:.0}, most {:.0}", quantile(&bytes, 0.5), quantile(&bytes, 1.0));
    println!("a picture while moving: {}", seen[seen.len() / 2][3].as_str().unwrap_or_default());
    let still: Value = {
        std::thread::sleep(SETTLING);
        browser.value("document.getElementById('size').textContent")
    };
    println!("a picture when still: {}", still.as_str().unwrap_or_default());
    if let Some(memory) = shown.memory() {
        println!("resident memory of the server: {:.0} MB", memory as f64 / 1e6);
    }
}
