//! Memory that this process may still take: the smallest of the amounts that the machine, a container and the limit of
//! the process's address space leave. Amounts are in bytes and come from `/proc` and the control groups of Linux.

use std::fs;
use std::path::Path;

/// Address space in bytes that an allocator reserves for each thread, in addition to the memory that it hands out
/// (glibc: 64 MiB).
const RESERVED_BY_THREAD: u64 = 64 << 20;

/// Returns the memory in bytes that this process may still take; `None` where the system does not report it.
pub fn available_memory() -> Option<u64> {
    [common_memory(), own_memory()].into_iter().flatten().min()
}

/// Returns the memory in bytes that all processes of this machine or container together may still take; `None` where
/// the system does not report it.
pub fn common_memory() -> Option<u64> {
    [kilobytes("/proc/meminfo", "MemAvailable:"), of_groups()].into_iter().flatten().min()
}

/// Returns the memory in bytes that this process uses.
pub fn resident_memory() -> Option<u64> {
    kilobytes("/proc/self/status", "VmRSS:")
}

/// Returns the memory that the control groups of this process leave (cgroup v2, then v1). A group is also bounded by
/// the groups above it. Inactive pages of files count as free.
fn of_groups() -> Option<u64> {
    let groups = read("/proc/self/cgroup");
    let own = groups.lines().find_map(|line| line.strip_prefix("0::/")).unwrap_or_default();
    let root = Path::new("/sys/fs/cgroup");
    let second = root
        .join(own)
        .ancestors()
        .take_while(|path| path.starts_with(root))
        .filter_map(|group| {
            let number = |name: &str| read(group.join(name)).trim().parse::<u64>().ok();
            let idle = value(&read(group.join("memory.stat")), "inactive_file ").unwrap_or(0);
            Some(remaining(number("memory.max")?, number("memory.current")?, idle))
        })
        .min();
    let first = || {
        let number = |name: &str| read(root.join("memory").join(name)).trim().parse::<u64>().ok();
        let idle = value(&read(root.join("memory/memory.stat")), "total_inactive_file ").unwrap_or(0);
        Some(remaining(number("memory.limit_in_bytes")?, number("memory.usage_in_bytes")?, idle))
    };
    second.or_else(first)
}

/// Returns the memory that a limit leaves after `used` bytes; `idle` of the used bytes can be reclaimed.
fn remaining(limit: u64, used: u64, idle: u64) -> u64 {
    limit.saturating_sub(used.saturating_sub(idle))
}

/// Returns the memory in bytes that the limit of this process's address space (`ulimit -v`) leaves after the
/// reservations of its threads; `None` without a limit.
pub fn own_memory() -> Option<u64> {
    let limits = read("/proc/self/limits");
    let limit = value(&limits, "Max address space")?;
    let taken = kilobytes("/proc/self/status", "VmSize:")?;
    let threads = std::thread::available_parallelism().map_or(1, usize::from) as u64;
    Some(limit.saturating_sub(taken).saturating_sub(threads * RESERVED_BY_THREAD))
}

fn read(path: impl AsRef<Path>) -> String {
    fs::read_to_string(path).unwrap_or_default()
}

/// Returns the number that follows `name` at the beginning of a line.
fn value(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.split_whitespace().next()?.parse().ok()
}

/// Returns the number that follows `name` in a file, converted from kB to bytes.
fn kilobytes(path: &str, name: &str) -> Option<u64> {
    value(&read(path), name).map(|kilobytes| 1024 * kilobytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_read_and_no_limit_is_none() {
        let limits =
            "Limit     Soft Limit   Hard Limit   Units\nMax address space   1073741824   unlimited   bytes\n";
        assert_eq!(value(limits, "Max address space"), Some(1 << 30));
        assert_eq!(value(&limits.replace("1073741824", "unlimited"), "Max address space"), None);
        assert_eq!(value("MemAvailable:   12 kB\n", "MemAvailable:"), Some(12));
    }

    #[test]
    fn what_gives_way_is_not_counted() {
        assert_eq!(remaining(100, 70, 30), 60);
        assert_eq!(remaining(100, 170, 30), 0);
    }

    #[test]
    fn this_process_uses_memory_and_may_take_more() {
        if cfg!(target_os = "linux") {
            assert!(available_memory().is_some_and(|bytes| bytes > 0));
            assert!(resident_memory().is_some_and(|bytes| bytes > 100_000));
        }
    }
}
