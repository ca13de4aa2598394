//! The reader refuses models and checkpoints whose configuration, state and tensors contradict each other. It names the file, and
//! it refuses before it allocates anything for them.

use trimip_core::{engine::checkpoint::Checkpoint, field::model::Model};
use trimip_tests::formats::{Format, memory::Counting};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Returns the bytes that `write` writes to a file.
fn written(write: impl FnOnce(&std::path::Path) -> trimip_core::Result<u64>) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    write(&path).unwrap();
    std::fs::read(path).unwrap()
}

fn model() -> Model {
    Model::from_bytes("valid", &Format::of("model").valid()[0]).unwrap()
}

fn checkpoint() -> Checkpoint {
    Checkpoint::from_bytes("valid", &Format::of("checkpoint").valid()[0]).unwrap()
}

/// Asserts that the reader refuses `bytes` within the format's memory limit, with an error that contains `parts`.
fn refused(format: &str, bytes: &[u8], parts: &[&str]) {
    assert!(!Format::of(format).check(bytes), "{parts:?}");
    let read = match format {
        "model" => Model::from_bytes("f", bytes).map(|_| ()),
        _ => Checkpoint::from_bytes("f", bytes).map(|_| ()),
    };
    let error = read.unwrap_err();
    assert!(
        error.message().starts_with("f: ") && parts.iter().all(|part| error.message().contains(part)),
        "{error}"
    );
}

#[test]
fn a_model_without_the_tensors_of_its_configuration_is_refused() {
    // The files have a few kilobytes, but their settings imply 3 GB of planes, a grid of 2^30 cells, or wide layers.
    for (setting, parts) in [
        ("encoder.plane_size=4096", ["`planes`", "4096"]),
        ("occupancy.resolution=1024", ["`occupancy`", "134217728"]),
        ("field.hidden=512", ["`density.0.weight`", "512"]),
    ] {
        let Model { config, file } = model();
        let mut settings = trimip::settings::defaults();
        settings.apply_file("own", &config.to_toml()).unwrap();
        settings.apply_assignment(setting).unwrap();
        let other = Model::new(trimip_core::Config::from_settings(&settings).unwrap(), file);
        refused("model", &written(|path| other.write(path)), &parts);
    }
    let mut lacking = model();
    lacking.file.tensors.remove("color.0.weight");
    refused("model", &written(|path| lacking.write(path)), &["`color.0.weight`", "missing"]);
}

#[test]
fn a_checkpoint_with_an_impossible_state_is_refused() {
    type Change = fn(&mut Checkpoint);
    let cases: [(Change, &[&str]); 6] = [
        (|c| c.state.stage = 2, &["halvings is 2", "0 to 1"]),
        (|c| c.state.stage = u32::MAX, &["halvings is 4294967295"]),
        (|c| c.state.spacing = -0.5, &["step_scale is -0.5"]),
        (|c| c.state.totals.seconds = -1.0, &["seconds is -1"]),
        (|c| drop(c.file.tensors.remove("planes.v")), &["`planes.v`", "missing"]),
        (|c| drop(c.file.tensors.remove("occupancy.density")), &["`occupancy.density`", "missing"]),
    ];
    for (change, parts) in cases {
        let mut checkpoint = checkpoint();
        change(&mut checkpoint);
        refused("checkpoint", &written(|path| checkpoint.write(path)), parts);
    }
}

/// A model keeps the settings that it is given after it is read: in its file, in its packed file and in its hash.
#[test]
fn settings_given_to_a_model_are_written_with_it() {
    let mut changed = model();
    let before = changed.hash().unwrap();
    let given = ["renderer.min_transmittance=0.01", "data.background=[0.25, 0.5, 0.75]"].map(String::from);
    trimip::settings::override_model(&mut changed, &given).unwrap();
    assert_ne!(changed.config, model().config);
    assert_ne!(changed.hash().unwrap(), before);
    let again = Model::from_bytes("again", &written(|path| changed.write(path))).unwrap();
    assert_eq!(again, changed);
    assert_eq!(again.hash().unwrap(), changed.hash().unwrap());
    let packed = Model::from_bytes("packed", &written(|path| changed.write_packed(path))).unwrap();
    assert_eq!(packed.config, changed.config);
    // A field that is assigned directly counts as a given setting.
    changed.config.threads = 3;
    let again = Model::from_bytes("again", &written(|path| changed.write(path))).unwrap();
    assert_eq!(again.config.threads, 3);
}
