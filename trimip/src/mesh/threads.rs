//! The number of threads that a setting means.

/// Returns the number of threads: 0 means one per core.
pub(super) fn count(setting: usize) -> usize {
    match setting {
        0 => std::thread::available_parallelism().map_or(1, usize::from),
        given => given,
    }
}
