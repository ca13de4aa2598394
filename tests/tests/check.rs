//! Checks that the stiff and extreme cases of the verb `check` pass on every backend of this machine.

use serde_json::Value;
use trimip_tests::binary::run;

#[test]
fn every_law_holds_on_every_backend() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let answer = run(folder.path(), &["check", "--json", "laws.json"]);
    let broken: Vec<&str> = answer.out.lines().filter(|line| line.contains("BROKEN")).collect();
    assert_eq!((answer.code, answer.err.as_str()), (Some(0), ""), "{broken:#?}");
    let written = std::fs::read(folder.path().join("laws.json")).expect("the table");
    let table: Value = serde_json::from_slice(&written).expect("JSON");
    let cases = table["cases"].as_array().expect("a list");
    let backends = if trimip_wgpu::adapters().is_empty() { vec!["cpu"] } else { vec!["cpu", "wgpu"] };
    for backend in backends {
        let count = |part: &str| {
            cases.iter().filter(|case| case["backend"] == backend && case["part"] == part).count()
        };
        assert!(count("optics") >= 15 && count("geometry") >= 30, "{backend}");
        assert!(count("training") >= 30 && count("numbers") >= 15, "{backend}");
    }
    assert!(cases.iter().all(|case| case["holds"] == true && case["worst"].is_number()));
}

#[test]
fn an_unknown_backend_is_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let answer = run(folder.path(), &["check", "--backend", "cuda"]);
    assert_eq!(answer.code, Some(2), "{}", answer.out);
    assert!(answer.err.contains("cuda") && answer.err.lines().count() == 1, "{}", answer.err);
}
