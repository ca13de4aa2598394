//! Checks that every reader copes with random changes of valid files ([`trimip_tests::formats`]). `TRIMIP_FUZZ_CASES`
//! is the number of changes of each format, and `TRIMIP_FUZZ_SEED` selects other changes.

use trimip_data::in_memory::camera_files;
use trimip_tests::formats::{Format, memory::Counting};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn stated(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).ok().and_then(|value| value.parse().ok()).unwrap_or(otherwise)
}

/// Tries `TRIMIP_FUZZ_CASES` changes; by default `otherwise` changes, which take about a second.
fn keeps_its_laws(name: &str, otherwise: u64) {
    let cases = stated("TRIMIP_FUZZ_CASES", otherwise);
    let valid = Format::of(name).try_changes(stated("TRIMIP_FUZZ_SEED", 1), cases);
    println!("{name}: {cases} executions, {valid} of them of valid files");
}

/// Tries changes of the camera files of all registered scene readers.
#[test]
fn cameras_of_any_bytes() {
    camera_files().for_each(|file| keeps_its_laws(file.kind, 20_000));
}

macro_rules! formats {
    ($($test:ident $name:literal $cases:literal)*) => {
        $(#[test]
        fn $test() {
            keeps_its_laws($name, $cases);
        })*

        #[test]
        fn every_format_has_a_test() {
            let mut tested = vec![$($name),*];
            tested.extend(camera_files().map(|file| file.kind));
            let mut all: Vec<&str> = trimip_tests::formats::FORMATS.iter().map(|format| format.name).collect();
            tested.sort_unstable();
            all.sort_unstable();
            assert_eq!(tested, all);
        }
    };
}

formats! {
    text_models_of_any_bytes "colmap-text" 20_000
    binary_models_of_any_bytes "colmap-binary" 20_000
    points_of_any_bytes "ply" 20_000
    photographs_of_any_bytes "photograph" 5_000
    masks_of_any_bytes "mask" 5_000
    configurations_of_any_bytes "configuration" 500
    assignments_of_any_bytes "assignment" 500
    paths_of_any_bytes "path" 20_000
    archives_of_any_bytes "archive" 10_000
    models_of_any_bytes "model" 1_000
    checkpoints_of_any_bytes "checkpoint" 1_000
    curves_of_any_bytes "curve" 20_000
    events_of_any_bytes "events" 20_000
    views_of_any_bytes "views" 20_000
    plans_of_any_bytes "plan" 20_000
}
