//! Checks of the crop in the viewer: pages show it alone or everything, and set it for the model.

use crate::view::{FINEST, PICTURE, enter, pixels, trained};
use serde_json::{Value, json};
use std::path::Path;
use trimip_tests::binary::run;
use trimip_tests::watching::{Browser, Shown, view};

#[test]
fn the_page_opens_cropped_and_its_switch_shows_everything() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    let shown = Shown::start_with(here, "run", &["--crop", "ball 0,0,0,0.5"]);
    let Some(mut browser) = Browser::start(1200, 800) else { return };
    browser.open(&shown.address());
    browser.wait(FINEST);
    assert_eq!(browser.value("document.querySelector('#crop code').textContent"), "ball 0,0,0,0.5");
    let state =
        "[document.getElementById('cropped').checked, document.getElementById('crop').offsetHeight > 0]";
    assert_eq!(browser.value(state), json!([true, true]));
    let cropped = browser.value(PICTURE);
    browser.value("document.getElementById('cropped').click()");
    browser.wait(&format!("{PICTURE} !== {cropped} && {FINEST}"));
    browser.value("document.getElementById('cropped').click()");
    browser.wait(&format!("{PICTURE} === {cropped}"));
}

/// Returns the crop that the model of the run has, as a mesh of it tells.
fn crop_of_run(here: &Path) -> String {
    let mesh = ["export", "mesh", "run", "--resolution", "16", "--level", "0.01", "--no-colors"];
    let answer = run(here, &mesh);
    assert_eq!(answer.code, Some(0), "{}", answer.err);
    let told = answer.out.lines().find_map(|line| line.strip_prefix("crop: "));
    told.unwrap_or("none").to_string()
}

#[test]
fn a_crop_that_a_page_sets_is_kept_with_the_model() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    assert_eq!(crop_of_run(here), "none");
    let shown = Shown::start(here, "run");
    let mut page = enter(&shown);
    let [mut clipped, mut cropped] = [1, 2].map(|id| view(id, [3.0, 1.0, 2.0], 40, 30));
    let part = json!([[-0.25, -1e30, -1e30], [1e30, 1e30, 0.5]]);
    (clipped["clip"], cropped["cropped"]) = (part.clone(), json!(true));
    let expected = pixels(&page.finest(&clipped).unwrap());
    assert_ne!(pixels(&page.finest(&cropped).unwrap()), expected, "there is no crop yet");
    page.send(&json!({ "keep": part }).to_string()).unwrap();
    let told: Value = serde_json::from_str(&page.receive().err().expect("a text")).unwrap();
    let crop = told["crop"].as_str().expect("a crop").to_string();
    assert!(crop.starts_with("box -0.25,-") && crop.ends_with(",0.5"), "{crop}");
    cropped["id"] = json!(3);
    assert_eq!(pixels(&page.finest(&cropped).unwrap()), expected);
    // The model has it, and so has a page that opens later.
    assert_eq!(crop_of_run(here), crop);
    let scene = shown.get(&format!("/{}/scene.json", shown.token), &[]).1;
    assert_eq!(serde_json::from_slice::<Value>(&scene).unwrap()["crop"], json!(crop));
    for (part, word) in [
        (json!([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0]]), "empty"),
        (json!([[50.0, 50.0, 50.0], [51.0, 51.0, 51.0]]), "outside"),
    ] {
        page.send(&json!({ "keep": part }).to_string()).unwrap();
        let error = page.receive().err().expect("an error");
        assert!(error.contains(word), "{error}");
    }
    assert_eq!(crop_of_run(here), crop);
    // Pages on other machines may look, not write.
    let mut open = Shown::start_with(here, "run", &["--bind", "0.0.0.0"]);
    open.host = open.host.replace("0.0.0.0", "127.0.0.1");
    let mut page = enter(&open);
    page.send(&json!({ "keep": [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]] }).to_string()).unwrap();
    let error = page.receive().err().expect("an error");
    assert!(error.contains("--crop") && crop_of_run(here) == crop, "{error}");
}

#[test]
fn the_page_makes_what_its_sliders_show_the_crop() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    let shown = Shown::start(here, "run");
    let Some(mut browser) = Browser::start(1200, 800) else { return };
    browser.open(&shown.address());
    browser.wait(FINEST);
    let state = "[document.getElementById('crop').hidden, document.getElementById('keep').disabled]";
    assert_eq!(browser.value(state), json!([true, true]));
    browser.value(
        "(() => { document.querySelector('details').open = true; const s = document.querySelector('#clips input');
         s.value = 40; s.dispatchEvent(new Event('input')); document.getElementById('keep').click(); })()",
    );
    browser.wait("document.querySelector('#crop code').textContent.startsWith('box ')");
    assert_eq!(browser.value(state), json!([false, false]));
    let crop = browser.value("document.querySelector('#crop code').textContent");
    assert_eq!(json!(crop_of_run(here)), crop);
}
