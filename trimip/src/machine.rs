//! The machine that the program runs on: processor, memory, operating system, disk. The values come from Linux's system
//! files. A value that another system does not report is `None`, never zero.

use serde::{Deserialize, Serialize};
use std::path::Path;

/// Returns the version of the program, with the commit if the build found one.
pub fn version() -> String {
    match option_env!("TRIMIP_COMMIT") {
        Some(commit) => format!("{} ({commit})", env!("CARGO_PKG_VERSION")),
        None => env!("CARGO_PKG_VERSION").to_string(),
    }
}

/// The machine, for reports and `doctor`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Machine {
    /// Model name of the processor.
    pub cpu: String,
    /// Threads that this process may run at once.
    pub cores: usize,
    /// Instruction sets that training can use.
    pub simd: Vec<String>,
    /// Operating system and kernel.
    pub os: String,
    /// Total memory of this process in bytes: the machine's, or a container's limit.
    pub memory_total_bytes: Option<u64>,
    /// Memory available at the time of the call, bytes.
    pub memory_available_bytes: Option<u64>,
}

impl Machine {
    /// Reads the properties of this machine.
    pub fn detect() -> Self {
        let meminfo = read("/proc/meminfo");
        let limit = read("/sys/fs/cgroup/memory.max").trim().parse().ok();
        let total = kilobytes(&meminfo, "MemTotal:");
        Self {
            cpu: field(&read("/proc/cpuinfo"), "model name", ':')
                .unwrap_or_else(|| std::env::consts::ARCH.into()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            simd: simd(),
            os: os(),
            memory_total_bytes: smaller(total, limit),
            memory_available_bytes: trimip_core::memory::available_memory(),
        }
    }
}

/// Returns the peak resident memory of this process so far (`VmHWM`), bytes.
pub fn peak_memory() -> Option<u64> {
    kilobytes(&read("/proc/self/status"), "VmHWM:")
}

/// Resets the peak that [`peak_memory`] returns, so that it covers only the time after this call. Returns false if the
/// system cannot do that; the peak then remains that of the whole process.
pub fn reset_peak_memory() -> bool {
    std::fs::write("/proc/self/clear_refs", "5").is_ok()
}

/// Returns the number of bytes free for an ordinary user on the disk that holds `path`.
#[cfg(unix)]
pub fn disk_free(path: &Path) -> Option<u64> {
    let stat = rustix::fs::statvfs(path).ok()?;
    Some(stat.f_bavail * stat.f_frsize)
}

/// Returns `None`: on this system the free bytes on a disk are unknown.
#[cfg(not(unix))]
pub fn disk_free(_path: &Path) -> Option<u64> {
    None
}

fn read(path: &str) -> String {
    std::fs::read_to_string(path).unwrap_or_default()
}

fn smaller(a: Option<u64>, b: Option<u64>) -> Option<u64> {
    a.into_iter().chain(b).min()
}

/// Returns the value after `name` and `separator` on the first line that starts with `name`, without quotes.
fn field(text: &str, name: &str, separator: char) -> Option<String> {
    let line = text.lines().find(|line| line.starts_with(name))?;
    let value = line.split_once(separator)?.1.trim().trim_matches('"');
    (!value.is_empty()).then(|| value.to_string())
}

/// Returns the `kB` value on the line that starts with `name`, in bytes.
fn kilobytes(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.trim().trim_end_matches("kB").trim().parse::<u64>().ok().map(|value| value * 1024)
}

fn os() -> String {
    let name = field(&read("/etc/os-release"), "PRETTY_NAME", '=');
    let kernel = read("/proc/sys/kernel/osrelease");
    let kind = std::env::consts::OS;
    match name {
        Some(name) => format!("{name} ({kind} {})", kernel.trim()),
        None => kind.to_string(),
    }
}

#[cfg(target_arch = "x86_64")]
fn simd() -> Vec<String> {
    let found = [
        ("sse4.2", std::is_x86_feature_detected!("sse4.2")),
        ("avx2", std::is_x86_feature_detected!("avx2")),
        ("fma", std::is_x86_feature_detected!("fma")),
        ("f16c", std::is_x86_feature_detected!("f16c")),
        ("avx512f", std::is_x86_feature_detected!("avx512f")),
    ];
    found.into_iter().filter(|(_, present)| *present).map(|(name, _)| name.to_string()).collect()
}

#[cfg(not(target_arch = "x86_64"))]
fn simd() -> Vec<String> {
    if cfg!(target_feature = "neon") { vec!["neon".into()] } else { Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_read_and_missing_ones_are_unknown() {
        let status = "Name:\tx\nVmHWM:\t  1234 kB\n";
        assert_eq!(kilobytes(status, "VmHWM:"), Some(1234 * 1024));
        assert_eq!(kilobytes(status, "VmPeak:"), None);
        assert_eq!(field("PRETTY_NAME=\"A B\"", "PRETTY_NAME", '='), Some("A B".into()));
        assert_eq!(field("", "model name", ':'), None);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_peak_of_memory_is_that_since_it_was_reset() {
        let large = std::hint::black_box(vec![1_u8; 1 << 28]);
        let before = peak_memory().unwrap();
        assert!(before > large.len() as u64);
        drop(large);
        // A container may forbid the reset.
        if reset_peak_memory() {
            assert!(peak_memory().unwrap() < before);
        }
    }

    #[test]
    fn this_machine_has_a_core() {
        assert!(Machine::detect().cores >= 1);
    }
}
