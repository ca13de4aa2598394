//! Programs of the system: their paths, and the command that installs a missing one.

use std::{
    env,
    path::{Path, PathBuf},
};
use trimip::{Advice, Error, Place, Result};

/// File extensions of programs on Windows, in the order of its shell.
const ENDINGS: [&str; 4] = ["exe", "com", "bat", "cmd"];

/// Finds a program on the `PATH`.
pub fn find(name: &str) -> Option<PathBuf> {
    let path = env::var_os("PATH")?;
    let folders = env::split_paths(&path).filter(|folder| !folder.as_os_str().is_empty());
    folders.map(|folder| folder.join(name)).find_map(|path| program_at(&path))
}

#[cfg(windows)]
fn program_at(path: &Path) -> Option<PathBuf> {
    ENDINGS.iter().map(|ending| path.with_extension(ending)).find(|path| path.is_file())
}

#[cfg(not(windows))]
fn program_at(path: &Path) -> Option<PathBuf> {
    let _ = ENDINGS;
    is_executable(path).then(|| std::path::absolute(path).unwrap_or_else(|_| path.into()))
}

#[cfg(unix)]
fn is_executable(path: &Path) -> bool {
    use std::os::unix::fs::PermissionsExt;
    path.metadata().is_ok_and(|found| found.is_file() && found.permissions().mode() & 0o111 != 0)
}

#[cfg(not(any(unix, windows)))]
fn is_executable(path: &Path) -> bool {
    path.is_file()
}

/// A need of a capture for other programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// ffmpeg and ffprobe.
    Films,
    /// A program that reads HEIC.
    Heif,
    /// COLMAP in any form.
    Poses,
    /// The program colmap.
    Colmap,
    /// The Python package pycolmap.
    Pycolmap,
    /// The program glomap.
    Glomap,
}

impl Need {
    /// Describes the missing program in messages.
    fn words(self) -> &'static str {
        match self {
            Self::Films => "no ffmpeg with ffprobe, which take frames out of films,",
            Self::Heif => "no program that reads HEIC (heif-convert, magick, ffmpeg 7, sips)",
            Self::Poses => "neither colmap nor a python3 with pycolmap, which find the cameras,",
            Self::Colmap => "no program colmap",
            Self::Pycolmap => "no python3 with the package pycolmap",
            Self::Glomap => "no program glomap",
        }
    }

    /// Returns the error that states how to install the program. `place` names the input that needs the program.
    pub fn missing(self, place: impl Into<Place>) -> Error {
        let line = install_line(self, env::consts::OS, &os_release());
        Error::input(
            place,
            format!("{} is on this machine", self.words()),
            Advice::Argument(format!("install it: {line}")),
        )
    }
}

/// Returns the path of the program, or the error of `need`.
///
/// # Errors
/// When the program is not on the path.
pub fn expect(name: &str, need: Need, place: impl Into<Place>) -> Result<PathBuf> {
    find(name).ok_or_else(|| need.missing(place))
}

/// Reads Linux's `os-release` file.
fn os_release() -> String {
    ["/etc/os-release", "/usr/lib/os-release"]
        .iter()
        .find_map(|path| std::fs::read_to_string(path).ok())
        .unwrap_or_default()
}

const PIP: &str = "pip install pycolmap";

/// Returns the command that installs what is needed. `os` is Rust's name of the operating system, `release` the text of `os-release`.
fn install_line(need: Need, os: &str, release: &str) -> String {
    let field = |key: &str| {
        let value = release.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix('='));
        value.unwrap_or_default().trim_matches('"').to_lowercase()
    };
    let family = format!("{} {}", field("ID"), field("ID_LIKE"));
    let is = |names: &[&str]| family.split_whitespace().any(|word| names.contains(&word));
    // Install command, then packages for films, HEIC and COLMAP; empty means not packaged.
    let (install, films, heif, colmap) = match os {
        "macos" => ("brew install", "ffmpeg", "libheif", "colmap"),
        "windows" => ("winget install", "Gyan.FFmpeg", "ImageMagick.ImageMagick", ""),
        _ if is(&["debian", "ubuntu"]) => ("sudo apt-get install", "ffmpeg", "libheif-examples", "colmap"),
        _ if is(&["fedora"]) => ("sudo dnf install", "ffmpeg-free", "libheif-tools", ""),
        _ if is(&["rhel", "centos"]) => ("sudo dnf install", "ffmpeg", "libheif-tools", ""),
        _ if is(&["arch"]) => ("sudo pacman -S", "ffmpeg", "libheif", ""),
        _ if is(&["suse", "opensuse"]) => ("sudo zypper install", "ffmpeg", "libheif-tools", ""),
        _ if is(&["alpine"]) => ("sudo apk add", "ffmpeg", "libheif-tools", ""),
        _ => ("", "", "", ""),
    };
    let package = |name: &str, otherwise: &str| match name {
        "" => otherwise.to_string(),
        name => format!("{install} {name}"),
    };
    match need {
        Need::Films => package(films, "see https://ffmpeg.org/download.html"),
        Need::Heif => package(heif, "see https://github.com/strukturag/libheif"),
        Need::Poses if colmap.is_empty() => PIP.into(),
        Need::Poses => format!("{install} {colmap}, or {PIP}"),
        Need::Colmap => package(colmap, "see https://colmap.github.io/install.html"),
        Need::Pycolmap => PIP.into(),
        Need::Glomap => "see https://github.com/colmap/glomap, or leave {poses} out".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_system_has_a_line_that_installs() {
        let debian = "NAME=x\nID=debian\n";
        let mint = "ID=linuxmint\nID_LIKE=\"ubuntu debian\"\n";
        let arch = "ID=arch\n";
        for (need, os, release, line) in [
            (Need::Films, "linux", debian, "sudo apt-get install ffmpeg"),
            (Need::Poses, "linux", mint, "sudo apt-get install colmap, or pip install pycolmap"),
            (Need::Poses, "linux", arch, "pip install pycolmap"),
            (Need::Heif, "linux", arch, "sudo pacman -S libheif"),
            (Need::Films, "linux", "ID=fedora", "sudo dnf install ffmpeg-free"),
            (Need::Poses, "macos", "", "brew install colmap, or pip install pycolmap"),
            (Need::Films, "windows", "", "winget install Gyan.FFmpeg"),
            (Need::Poses, "windows", "", "pip install pycolmap"),
            (Need::Colmap, "linux", "", "see https://colmap.github.io/install.html"),
        ] {
            assert_eq!(install_line(need, os, release), line, "{need:?} {os} {release}");
        }
        let error = Need::Poses.missing("walk.mp4");
        assert!(
            error.kind() == trimip_core::ErrorKind::Input
                && error.message().starts_with("walk.mp4: neither colmap nor"),
            "{error}"
        );
    }

    #[test]
    fn a_program_is_found_by_its_name_alone() {
        let name = if cfg!(windows) { "cmd" } else { "sh" };
        assert!(find(name).is_some_and(|path| path.is_absolute()));
        assert_eq!(find("no-such-program-of-anybody"), None);
    }
}
