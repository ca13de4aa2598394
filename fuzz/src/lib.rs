//! Targets of libFuzzer, one for each reader of files, and `cameras` for every registered file of cameras. Each target passes the bytes to
//! [`Format::check`], which the tests call too. `docs/fuzzing.md` explains how to run them.

pub use libfuzzer_sys::fuzz_target;
pub use trimip_tests::formats::{Format, memory::Counting};

/// A program that passes bytes to the reader of a format.
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
