//! Checks that a capture trains to the same bits from COLMAP's text files as from its binary files.

#[path = "../../trimip-data/tests/common/mod.rs"]
mod common;

use common::{assert_same, colmap::capture, save_image, settings};
use std::path::Path;
use trimip_core::{Config, ViewSet, field::tensors::TensorFile};

/// Returns the model after a few steps on the CPU.
fn trained(set: ViewSet) -> TensorFile {
    let mut config = Config::default();
    (config.encoder.plane_size, config.field.hidden, config.occupancy.resolution) = (128, 16, 16);
    (config.train.steps, config.train.samples_per_step) = (8, 2048);
    let mut session = trimip_cpu::open(&config, set).unwrap();
    let before = session.model().unwrap().file;
    for step in 0..4 {
        session.step(f64::from(step) / 8.0).unwrap();
    }
    let after = session.model().unwrap().file;
    assert_ne!(before, after, "nothing was learned");
    after
}

#[test]
fn text_and_binary_models_train_to_the_same_bits() {
    let sparse = capture();
    let roots = [0; 2].map(|_| tempfile::tempdir().unwrap());
    for root in &roots {
        for (.., name, _) in &sparse.images {
            save_image(&root.path().join("images").join(name), 60, 40);
        }
    }
    let [text, binary] = [0, 1].map(|i| roots[i].path());
    sparse.write_text(&text.join("sparse/0"));
    sparse.write_binary(&binary.join("sparse/0"));
    let open = |root: &Path| trimip_data::open(&settings(root, 2)).unwrap().train;
    let (ours, theirs) = (open(text), open(binary));
    assert_same(&ours, &theirs);
    assert!(trained(ours) == trained(theirs));
}
