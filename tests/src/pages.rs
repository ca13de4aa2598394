//! Checks in a real browser that every page the program writes fits telephones and wide screens.

use crate::watching::Browser;
use serde_json::{Value, json};
use std::path::Path;

/// Width of a telephone in pixels.
pub const TELEPHONE: u32 = 390;

/// Widths of the windows in pixels: a telephone, a laptop and a wide screen.
const WIDTHS: [u32; 3] = [TELEPHONE, 1200, 1920];

/// Height of the windows, and of the tallest screenshot of a page, in pixels.
const HEIGHT: u32 = 900;
const TALLEST: u64 = 12_000;

/// Script that opens all closed sections and lists the cut-off elements. An element is cut off if it extends beyond the window
/// and no element around it scrolls; a label is cut off if it extends beyond its drawing.
const CUT_OFF: &str = "(() => {
    document.querySelectorAll('details').forEach((part) => { part.open = true; });
    const scrolls = (element) => element && element !== document.body
        && (/auto|scroll/.test(getComputedStyle(element).overflowX) || scrolls(element.parentElement));
    const told = (element) => `${element.tagName} ${element.getAttribute('class') ?? ''}: ${element.textContent.slice(0, 40)}`;
    const out = [];
    for (const element of document.body.querySelectorAll('*')) {
        const own = element.getBoundingClientRect();
        if (own.width === 0 || own.height === 0 || scrolls(element)) continue;
        const drawing = element.tagName === 'text' ? element.closest('svg').getBoundingClientRect() : { left: 0, right: innerWidth };
        if (own.right > drawing.right + 1 || own.left < drawing.left - 1) out.push(told(element));
    }
    return out;
})()";

/// Opens a page in windows of all widths, in light colours, in dark colours and in print.
///
/// # Panics
/// If any part of the page is cut off.
pub fn expect_fits(path: &Path) {
    let Some(mut browser) = Browser::start(WIDTHS[1], HEIGHT) else { return };
    let name = path.file_stem().expect("a page has a name").to_string_lossy().into_owned();
    browser.open(&format!("file://{}", path.canonicalize().expect("the page is there").display()));
    browser.wait("document.readyState === 'complete' && document.querySelector('main') !== null");
    for width in WIDTHS {
        for (look, media, scheme) in
            [("light", "screen", "light"), ("dark", "screen", "dark"), ("print", "print", "light")]
        {
            let scheme = json!([{ "name": "prefers-color-scheme", "value": scheme }]);
            browser.call("Emulation.setEmulatedMedia", json!({ "media": media, "features": scheme }));
            resize(&mut browser, width, HEIGHT);
            expect_nothing_cut_off(&mut browser, &format!("{name} at {width} pixels, {look}"));
            if Browser::keeps() {
                let tall = browser.value("document.documentElement.scrollHeight").as_u64().unwrap_or(0);
                resize(&mut browser, width, tall.clamp(HEIGHT.into(), TALLEST) as u32);
                browser.keep(&format!("{name}-{width}-{look}.png"));
            }
        }
    }
}

/// Asserts that no part of the open page is cut off; `what` describes the page.
///
/// # Panics
/// If any part is cut off.
pub fn expect_nothing_cut_off(browser: &mut Browser, what: &str) {
    assert_eq!(browser.value(CUT_OFF), json!([]), "{what}");
}

/// Sets the size of the page's viewport in pixels. Chromium's own windows cannot be as narrow as telephones.
pub fn resize(browser: &mut Browser, width: u32, height: u32) {
    let size: Value = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
    browser.call("Emulation.setDeviceMetricsOverride", size);
    browser.wait(&format!("innerWidth === {width}"));
}
