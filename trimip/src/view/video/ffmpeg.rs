//! Films that the program `ffmpeg` of the system encodes.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use trimip_core::{Error, Result};

/// Quality of the encoder, on the scale of H.264's constant rate factor. At this value no difference is visible in motion.
const QUALITY: &str = "16";

/// Returns true if the program runs on this machine.
pub fn is_there() -> bool {
    let found = Command::new("ffmpeg").arg("-version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    found.is_ok_and(|status| status.success())
}

/// Implements [`encode`](super::encode).
pub fn encode(
    path: &Path,
    pictures: &[PathBuf],
    rate: f64,
    watch: &mut dyn FnMut(usize) -> bool,
) -> Result<bool> {
    let failed = |error: &dyn std::fmt::Display| Error::run(format!("{}: {error}", path.display()));
    // The temporary name keeps the extension, because ffmpeg derives the format from it.
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let partial = path.with_file_name(format!(".{}.{name}", std::process::id()));
    let webm = path.extension().is_some_and(|end| end.eq_ignore_ascii_case("webm"));
    let mut command = Command::new("ffmpeg");
    command
        .args(["-hide_banner", "-loglevel", "error", "-nostdin", "-y", "-f", "image2pipe", "-c:v", "png"])
        .args(["-framerate", &rate.to_string(), "-i", "pipe:0"])
        // Most players need even sides and chroma at half the resolution.
        .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", "-crf", QUALITY]);
    if webm {
        command.args(["-b:v", "0"]);
    }
    command.arg(&partial).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = command.spawn().map_err(|error| failed(&error))?;
    let mut fed = Ok(true);
    if let Some(mut pipe) = child.stdin.take() {
        for (i, picture) in pictures.iter().enumerate() {
            if !watch(i) {
                fed = Ok(false);
                break;
            }
            let bytes = std::fs::read(picture);
            fed = bytes.map_err(|error| format!("{}: {error}", picture.display())).and_then(|bytes| {
                pipe.write_all(&bytes).map_err(|_| "ffmpeg ended early".to_string())?;
                Ok(true)
            });
            if fed.is_err() {
                break;
            }
        }
    }
    if fed != Ok(true) {
        // If `ffmpeg` accepts no more pictures, it has already ended, and `kill` has no effect.
        let _ = child.kill();
    }
    let output = child.wait_with_output().map_err(|error| failed(&error))?;
    let result = match fed {
        Ok(true) if output.status.success() => {
            return std::fs::rename(&partial, path).map(|()| true).map_err(|error| failed(&error));
        }
        Ok(false) => Ok(false),
        fed => {
            let said = String::from_utf8_lossy(&output.stderr);
            let last = said.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("it printed nothing");
            Err(failed(&format!("{}: {last}", fed.err().unwrap_or_else(|| "ffmpeg failed".into()))))
        }
    };
    // Removes the unfinished video, if there is one.
    let _ = std::fs::remove_file(&partial);
    result
}
