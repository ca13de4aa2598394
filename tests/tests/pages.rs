//! Checks of the pages of a run, a data set and a comparison, in windows of every width. The tests that write the pages of `bench` and
//! `paper` check those pages too.

use trimip_tests::binary::{run, tiny_and};
use trimip_tests::pages::expect_fits;
use trimip_tests::watching::Browser;

#[test]
fn nothing_of_a_page_is_cut_off() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let done = |arguments: &[&str]| {
        let answer = run(here, arguments);
        assert_eq!(answer.code, Some(0), "{arguments:?}: {answer:?}");
    };
    let long = "a-run-with-a-name-that-is-too-long-for-one-line-of-a-telephone";
    done(&tiny_and(&["--out", "run", "--set", "eval.points=3"]));
    done(&tiny_and(&["--out", long, "--set", "data.scales=1", "--set", "eval.points=3"]));
    done(&["compare", "run", long, "--html", "compared.html"]);
    done(&["data", "builtin", "scene", "--set", "data.builtin_size=32"]);
    done(&["data", "inspect", "scene", "--html", "inspected.html"]);
    for page in ["run/report.html", &format!("{long}/report.html"), "compared.html", "inspected.html"] {
        expect_fits(&here.join(page));
    }
}

#[test]
fn what_is_cut_off_is_found() {
    let folder = tempfile::tempdir().unwrap();
    if Browser::start(390, 600).is_none() {
        return;
    }
    for (name, wrong) in [
        ("wide", "<p style='width: 2000px'>wide</p>"),
        ("closed", "<details><p style='width: 2000px'>wide</p></details>"),
        ("label", "<svg width='50' height='20'><text x='10' y='15'>longer than its drawing</text></svg>"),
    ] {
        let page = folder.path().join(format!("{name}.html"));
        std::fs::write(&page, format!("<!doctype html><body><main>{wrong}</main></body>")).unwrap();
        assert!(std::panic::catch_unwind(|| expect_fits(&page)).is_err(), "{name}");
    }
    let page = folder.path().join("scrolls.html");
    let scrolls = "<div style='overflow-x: auto'><p style='width: 2000px'>wide</p></div>";
    std::fs::write(&page, format!("<!doctype html><body><main>{scrolls}</main></body>")).unwrap();
    expect_fits(&page);
}
