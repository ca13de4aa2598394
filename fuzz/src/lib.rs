//! Targets for libFuzzer: one for each file reader, and `cameras` for every registered format of camera files. Each target passes the
//! bytes to [`Format::check`], which the tests call too. `docs/fuzzing.md` explains how to run them.

pub use libfuzzer_sys::fuzz_target;
pub use trimip_tests::formats::{Format, memory::Counting};

/// Defines a fuzz program that passes bytes to the reader of a format.
#[macro_export]
macro_rules! target {
    ($name:expr) => {
        #[global_allocator]
        static ALLOCATOR: $crate::Counting = $crate::Counting;

        $crate::fuzz_target!(|bytes: &[u8]| {
            $crate::Format::of($name).check(bytes);
        });
    };
}
