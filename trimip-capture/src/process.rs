//! Calls other programs: writes their output to a log file, passes it line by line to a progress counter, ends a called program when this
//! program ends, and reports the last lines of a program that fails.

use super::guard;
use std::{
    collections::VecDeque,
    ffi::{OsStr, OsString},
    fs::File,
    io::{BufWriter, Read, Write},
    path::{Path, PathBuf},
    process::{Child, ExitStatus, Stdio},
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel},
    },
    thread,
    time::Duration,
};
use trimip::{Advice, Error, Result};

/// Interval at which the stop flag is polled while a program is silent.
const PATIENCE: Duration = Duration::from_millis(50);

/// Number of bytes that are read at once, and number of parts that may wait in the channel.
const CHUNK: usize = 1 << 16;
const WAITING: usize = 64;

/// Number of last lines of a failed program that are reported, and maximum number of characters of each.
const LAST: usize = 3;
const WIDTH: usize = 90;

/// A call of a program.
pub struct Call<'a> {
    /// Name of the program in messages.
    pub name: String,
    /// Path of the program.
    pub program: &'a Path,
    /// Arguments.
    pub arguments: Vec<OsString>,
    /// Working directory.
    pub folder: &'a Path,
    /// Log file for the program's output.
    pub log: PathBuf,
}

/// Result of a program that ran to its end.
pub struct Ended {
    /// Last lines of its output.
    pub last: Vec<String>,
    /// Exit code, or 128 + the signal that ended the program.
    code: i32,
}

/// Receives the output of a program.
pub trait Output {
    /// Receives a line of standard error; also of standard output, unless [`takes_bytes`](Self::takes_bytes) returns true. A return value
    /// of false keeps the line out of the log.
    fn line(&mut self, line: &str) -> bool;

    /// Receives a part of standard output, if [`takes_bytes`](Self::takes_bytes) returns true.
    ///
    /// # Errors
    /// An error ends the program.
    fn bytes(&mut self, _: &[u8]) -> Result<()> {
        Ok(())
    }

    /// Returns true if standard output is binary.
    fn takes_bytes(&self) -> bool {
        false
    }
}

impl Ended {
    /// Returns true for exit code 0.
    pub fn is_success(&self) -> bool {
        self.code == 0
    }
}

impl<F: FnMut(&str) -> bool> Output for F {
    fn line(&mut self, line: &str) -> bool {
        self(line)
    }
}

/// A piece of output that a reader thread has read.
enum Part {
    Line(String),
    Bytes(Vec<u8>),
}

impl Call<'_> {
    /// Adds arguments to the call.
    pub fn with<T: AsRef<OsStr>>(mut self, arguments: impl IntoIterator<Item = T>) -> Self {
        self.arguments.extend(arguments.into_iter().map(|argument| argument.as_ref().to_os_string()));
        self
    }

    /// Runs the program to its end and requires exit code 0.
    ///
    /// # Errors
    /// When the program cannot be started or fails, with its last lines and the path of its log; of kind `Stopped` when `stop` was set.
    pub fn run(&self, stop: &AtomicBool, output: &mut dyn Output) -> Result<Ended> {
        let ended = self.run_to_end(stop, output)?;
        if ended.is_success() { Ok(ended) } else { Err(self.failed(&ended)) }
    }

    /// Like [`run`](Self::run), but accepts any exit code.
    ///
    /// # Errors
    /// When the program cannot be started; of kind `Stopped` when `stop` was set.
    pub fn run_to_end(&self, stop: &AtomicBool, output: &mut dyn Output) -> Result<Ended> {
        let mut log = self.open_log()?;
        let mut command = guard::command(self.program)?;
        command.args(&self.arguments).current_dir(self.folder).stdout(Stdio::piped()).stderr(Stdio::piped());
        // If COLMAP finds no GPU by itself, it requests a screen from Qt. Without a display, Qt needs its offscreen platform.
        if std::env::var_os("DISPLAY").is_none() && std::env::var_os("WAYLAND_DISPLAY").is_none() {
            command.env("QT_QPA_PLATFORM", "offscreen");
        }
        command.env("PYTHONUNBUFFERED", "1");
        let mut child = command.spawn().map_err(|error| self.cannot(&error))?;
        let parts = readers(&mut child, output.takes_bytes()).map_err(|error| self.cannot(&error))?;
        let mut last = VecDeque::new();
        let mut heeded = Ok(());
        while heeded.is_ok() {
            if stop.load(Ordering::Relaxed) {
                heeded = Err(stopped());
                break;
            }
            match parts.recv_timeout(PATIENCE) {
                Ok(Part::Bytes(bytes)) => heeded = output.bytes(&bytes),
                Ok(Part::Line(line)) => {
                    if output.line(&line) {
                        // A log that cannot be written does not stop the program.
                        let _ = writeln!(log, "{line}");
                        if !line.trim().is_empty() {
                            last.push_back(line);
                        }
                        if last.len() > LAST {
                            last.pop_front();
                        }
                    }
                }
                Err(RecvTimeoutError::Timeout) => {
                    let _ = log.flush();
                }
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        if heeded.is_err() {
            // Closing the pipe makes the guard end the program and all processes that it started.
            drop(child.stdin.take());
            drop(parts);
        }
        let status = child.wait().map_err(|error| self.cannot(&error))?;
        let _ = log.flush();
        heeded?;
        let ended = Ended { last: last.into(), code: code(status) };
        match ended.code == i32::from(guard::NOT_STARTED) && ended.last.len() == 1 {
            true => Err(self.cannot(&ended.last[0])),
            false => Ok(ended),
        }
    }

    /// Returns the error for a program that ended with a non-zero exit code.
    pub fn failed(&self, ended: &Ended) -> Error {
        let how = match ended.code {
            137 => "was killed, perhaps because memory ran out (a smaller size or fewer threads need less)"
                .into(),
            code @ 129..=192 => format!("was ended by signal {}", code - 128),
            code => format!("ended with exit code {code}"),
        };
        let said: Vec<String> =
            ended.last.iter().map(|line| line.trim().chars().take(WIDTH).collect()).collect();
        let said = if said.is_empty() { "it printed nothing".into() } else { said.join(" | ") };
        Error::run(format!("{} {how}: {said}; its output is in {}", self.name, self.log.display()))
    }

    fn open_log(&self) -> Result<BufWriter<File>> {
        let wrong = |error: std::io::Error| {
            Error::input(self.log.display(), format!("cannot write: {error}"), Advice::OtherFolder)
        };
        if let Some(folder) = self.log.parent() {
            std::fs::create_dir_all(folder).map_err(wrong)?;
        }
        let mut log = BufWriter::new(File::create(&self.log).map_err(wrong)?);
        let words =
            std::iter::once(self.program.as_os_str()).chain(self.arguments.iter().map(OsString::as_os_str));
        let words: Vec<String> = words.map(|word| quoted(&word.to_string_lossy())).collect();
        writeln!(log, "# in {}\n{}", self.folder.display(), words.join(" ")).map_err(wrong)?;
        Ok(log)
    }

    fn cannot(&self, error: &dyn std::fmt::Display) -> Error {
        Error::device(format!("{} ({}) cannot be started: {error}", self.name, self.program.display()))
    }
}

/// Returns the error for a capture that the user stopped.
pub fn stopped() -> Error {
    Error::stopped_with("stopped; the same command continues from here")
}

/// Quotes a word of a command for a shell.
pub fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./:=,+%@".contains(c);
    match !word.is_empty() && word.chars().all(plain) {
        true => word.into(),
        false if cfg!(windows) => format!("\"{word}\""),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

/// Quotes a path for a shell, so that it cannot be read as an option.
pub fn quoted_path(path: &Path) -> String {
    let plain = path.display().to_string();
    quoted(&if plain.starts_with('-') { format!("./{plain}") } else { plain })
}

fn code(status: ExitStatus) -> i32 {
    #[cfg(unix)]
    {
        use std::os::unix::process::ExitStatusExt;
        if let Some(signal) = status.signal() {
            return 128 + signal;
        }
    }
    status.code().unwrap_or(255)
}

/// Starts the threads that read both outputs of a program; returns the channel of what they read.
fn readers(child: &mut Child, as_bytes: bool) -> std::io::Result<Receiver<Part>> {
    let (sender, receiver) = sync_channel(WAITING);
    let named = |name: &str| thread::Builder::new().name(name.into());
    if let Some(pipe) = child.stdout.take() {
        let sender = sender.clone();
        named("stdout")
            .spawn(move || if as_bytes { read_bytes(pipe, &sender) } else { read_lines(pipe, &sender) })?;
    }
    if let Some(pipe) = child.stderr.take() {
        named("stderr").spawn(move || read_lines(pipe, &sender))?;
    }
    Ok(receiver)
}

fn read_bytes(mut pipe: impl Read, sender: &SyncSender<Part>) {
    let mut buffer = vec![0; CHUNK];
    while let Ok(length @ 1..) = pipe.read(&mut buffer) {
        if sender.send(Part::Bytes(buffer[..length].to_vec())).is_err() {
            return;
        }
    }
}

/// Sends lines. A line ends with a line feed or, where a program overwrites its progress, with a carriage return.
fn read_lines(mut pipe: impl Read, sender: &SyncSender<Part>) {
    let (mut buffer, mut line) = (vec![0; CHUNK], Vec::new());
    let send = |line: &mut Vec<u8>| {
        let text = String::from_utf8_lossy(line).trim_end().to_string();
        line.clear();
        text.is_empty() || sender.send(Part::Line(text)).is_ok()
    };
    while let Ok(length @ 1..) = pipe.read(&mut buffer) {
        for &byte in &buffer[..length] {
            let ends = byte == b'\n' || byte == b'\r';
            if !ends {
                line.push(byte);
            }
            if (ends || line.len() >= CHUNK) && !send(&mut line) {
                return;
            }
        }
    }
    send(&mut line);
}

/// Returns the output of a short call that queries a program, standard output before standard error; `None` if the program cannot be
/// started or fails.
pub fn ask(program: &Path, arguments: &[&str]) -> Option<String> {
    let mut command = std::process::Command::new(program);
    command.args(arguments).stdin(Stdio::null()).env("QT_QPA_PLATFORM", "offscreen");
    let output = command.output().ok().filter(|output| output.status.success())?;
    Some([output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_end_with_either_sign_and_hold_any_bytes() {
        let (sender, receiver) = sync_channel(16);
        read_lines(&b"one\r\ntwo\rthr\xffee\n\nlast"[..], &sender);
        drop(sender);
        let lines: Vec<String> = receiver
            .iter()
            .map(|part| match part {
                Part::Line(line) => line,
                Part::Bytes(_) => panic!("lines alone"),
            })
            .collect();
        assert_eq!(lines, ["one", "two", "thr\u{fffd}ee", "last"]);
    }

    #[test]
    fn words_are_quoted_where_a_shell_would_split_them() {
        assert_eq!(quoted("a/b-c.mp4"), "a/b-c.mp4");
        if cfg!(unix) {
            assert_eq!(quoted("it's a film.mp4"), r"'it'\''s a film.mp4'");
            assert_eq!(quoted(""), "''");
        }
        assert_eq!(quoted_path(Path::new("-a.mp4")), "./-a.mp4");
    }
}
