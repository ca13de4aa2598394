//! `doctor`: capabilities of this machine and this build, to check before a long run and to attach to bug reports.

use crate::terminal;
use std::path::Path;
use trimip::{Result, backends, machine, machine::Machine};

/// Prints one aligned line per fact.
pub fn run() -> Result<u8> {
    let machine = Machine::detect();
    let bytes = |value: Option<u64>| value.map_or("unknown".to_string(), terminal::bytes);
    let mut facts = vec![
        ("version", format!("trimip-cli {}", machine::version())),
        ("build", format!("{}, EXR {}", profile(), if cfg!(feature = "exr") { "yes" } else { "no" })),
        ("measures", measures()),
        ("system", format!("{}, {}", machine.os, std::env::consts::ARCH)),
        ("processor", machine.cpu),
        ("cores", machine.cores.to_string()),
        ("simd", if machine.simd.is_empty() { "none found".into() } else { machine.simd.join(", ") }),
        (
            "memory",
            format!(
                "{} in all, {} available",
                bytes(machine.memory_total_bytes),
                bytes(machine.memory_available_bytes)
            ),
        ),
        ("disk free here", bytes(machine::disk_free(Path::new(".")))),
    ];
    facts.extend(backends::describe().into_iter().map(|line| ("backend", line)));
    facts.extend(backends::adapters().into_iter().map(|line| ("adapters", line)));
    for (name, value) in facts {
        terminal::line(format!("{name:<15} {value}"));
    }
    Ok(0)
}

/// Returns the metrics of this build, and how to add those that it lacks.
fn measures() -> String {
    let flip = if cfg!(feature = "flip") {
        "FLIP"
    } else {
        "no FLIP (build with --features flip and a C++ compiler)"
    };
    let lpips = if cfg!(feature = "lpips") {
        "LPIPS by eval.lpips (tools/lpips_onnx.py makes its file)"
    } else {
        "no LPIPS (build with --features lpips; tools/lpips_onnx.py makes its weights)"
    };
    format!("PSNR, SSIM, MS-SSIM, {flip}, {lpips}")
}

fn profile() -> &'static str {
    if cfg!(debug_assertions) { "debug (train with a release build)" } else { "release" }
}
