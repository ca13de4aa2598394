//! A backend outside of the workspace can define its own section of settings. The section is read, range-checked, documented,
//! written and resumed, and no other crate mentions it.

use serde::{Deserialize, Serialize};
use std::sync::Arc;
use trimip::{Settings, Training, events::Event};
use trimip_core::{
    Checker, Config, Definitions, ErrorKind, ForeignSection, Fragment, Result, Section, field::model::Model,
};

/// The settings of a backend on tensor processors.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct TpuConfig {
    chips: u32,
    host: String,
    rounding: Rounding,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Rounding {
    Nearest,
    Stochastic,
}

impl Section for TpuConfig {
    const NAME: &'static str = "tpu";
    const FRAGMENTS: &'static [Fragment] = &[Fragment {
        after: "",
        table: r#"
[tpu]
section = { meaning = 'tensor processors, for backend = "tpu"' }
chips = { default = 4, range = [1, 64], free = true, meaning = "processors of a run, a power of two" }
host = { default = "", free = true, meaning = 'address of the host; "" = this machine' }
rounding = { default = "nearest", meaning = 'of sums: "nearest" | "stochastic"' }
"#,
    }];

    fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check(self.chips.is_power_of_two(), "tpu.chips", "a power of two from 1 to 64")
    }
}

/// Returns the definitions of a program that has the backend.
fn definitions() -> Arc<Definitions> {
    Definitions::new(&[trimip_data::SECTION, ForeignSection::of::<TpuConfig>()], &[]).into()
}

/// Returns the settings of a small training of the built-in scene on the CPU.
fn small() -> Settings {
    let mut settings = Settings::of(definitions());
    for assignment in [
        "data.format=builtin",
        "data.builtin_size=16",
        "data.builtin_train=4",
        "data.builtin_test=1",
        "encoder.plane_size=32",
        "encoder.levels=4",
        "train.steps=4",
        "train.samples_per_step=512",
        "eval.final=false",
        "eval.points=0",
        "threads=1",
    ] {
        settings.apply_assignment(assignment).unwrap();
    }
    settings
}

#[test]
fn a_setting_of_a_foreign_backend_is_read_and_ranged() {
    let mut settings = small();
    settings.apply_file("run.toml", "[tpu]\nchips = 8\nrounding = \"stochastic\"\n").unwrap();
    let config = Config::from_settings(&settings).unwrap();
    let expected = TpuConfig { chips: 8, host: String::new(), rounding: Rounding::Stochastic };
    assert_eq!(config.section::<TpuConfig>().unwrap(), expected);
    for (text, expected) in [
        ("chips = 65", "run.toml:2:1: tpu.chips = 65: out of range; expected 1 to 64"),
        ("chips = 6", "expected a power of two"),
        ("chips = \"all\"", "expected a whole number"),
        ("rounding = \"up\"", "run.toml:2:1: tpu.rounding = \"up\""),
        ("cores = 3", "unknown setting `tpu.cores`; expected one of: tpu.chips, tpu.host, tpu.rounding"),
    ] {
        let mut settings = small();
        let read = settings.apply_file("run.toml", &format!("[tpu]\n{text}\n"));
        let error = read.and_then(|()| Config::from_settings(&settings)).unwrap_err();
        assert!(error.kind() == ErrorKind::Input && error.message().contains(expected), "{error}");
    }
    // The program of this workspace does not have the backend.
    let mut own = trimip::settings::defaults();
    assert!(own.apply_assignment("tpu.chips=8").unwrap_err().message().contains("unknown setting"));
}

#[test]
fn a_setting_of_a_foreign_backend_is_documented() {
    let definitions = definitions();
    let section = definitions.documented().iter().find(|section| section.name == "tpu").unwrap();
    assert_eq!(section.meaning, "tensor processors, for backend = \"tpu\"");
    let chips = &section.settings[0];
    assert_eq!((chips.key.as_str(), chips.default.as_str(), chips.range.as_str()), ("chips", "4", "1 to 64"));
    assert!(
        chips.free && chips.meaning == "processors of a run, a power of two" && !section.settings[2].free
    );
    assert!(definitions.page().contains("| `chips` | `4` | 1 to 64 | processors of a run, a power of two |"));
    assert!(definitions.text().contains("\n[tpu] ") && definitions.text().ends_with("\"stochastic\"\n"));
    let shown = trimip::settings::text(&small());
    assert!(shown.lines().any(|line| line.starts_with("rounding") && line.ends_with("# default")), "{shown}");
}

#[test]
fn a_run_goes_on_with_another_free_setting_of_a_foreign_backend() {
    let temporary = tempfile::tempdir().unwrap();
    let folder = temporary.path().join("run");
    let train = |assignment: &str| {
        let mut settings = small();
        settings.apply_assignment(assignment).unwrap();
        Training::new(settings, &folder).run(&mut |event: &Event| drop(event.clone())).map(|_| ())
    };
    train("tpu.chips=8").unwrap();
    let text = std::fs::read_to_string(folder.join("config.toml")).unwrap();
    assert!(text.ends_with("[tpu]\nchips = 8\nhost = \"\"\nrounding = \"nearest\"\n"), "{text}");
    // The model contains the section too.
    let model = Model::read(&folder.join("model.safetensors")).unwrap();
    assert_eq!((model.config.to_toml(), model.config.section::<TpuConfig>().unwrap().chips), (text, 8));
    train("tpu.chips=16").unwrap();
    let error = train("tpu.rounding=stochastic").unwrap_err();
    assert!(error.message().contains("tpu.rounding is \"stochastic\", was \"nearest\""), "{error}");
}
