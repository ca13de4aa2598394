//! The error type of the workspace. An [`Error`] holds its cause, the place of the fault, what was found there and what to do, each
//! as data. Its text is one line. A program may phrase places and advice in its own terms, see [`Error::text_with`].

use crate::config::origin::Origin;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Cause of an [`Error`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The user's files, settings or arguments are wrong.
    Input,
    /// The run failed, or missed its quality floor.
    Run,
    /// The device is missing, too small or lost.
    Device,
    /// The user stopped the program.
    Stopped,
}

/// Where the fault of an [`Error`] is.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Place {
    /// A file or folder.
    File(PathBuf),
    /// A position in a text file.
    Text {
        /// The file, or the name of a text that is not in a file.
        file: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// Number of the column, from 1, if it is known.
        column: Option<usize>,
    },
    /// A part of a file: a frame, a tensor, an entry.
    Part {
        /// The file.
        file: PathBuf,
        /// Part of the file, such as `frame 3`.
        part: String,
    },
    /// A setting with its value.
    Setting {
        /// The dotted path.
        path: String,
        /// The value as TOML text.
        value: String,
        /// Where the value came from.
        origin: Origin,
    },
    /// An argument of a function or program.
    Argument {
        /// Name of the argument.
        name: String,
        /// Value of the argument, if the value is at fault.
        value: Option<String>,
    },
    /// Any other place, in words.
    Other(String),
}

impl Place {
    /// Creates the place of an argument with its value.
    pub fn argument(name: impl Into<String>, value: impl Display) -> Self {
        Self::Argument { name: name.into(), value: Some(value.to_string()) }
    }

    /// Creates the place of an argument, whatever its value is.
    pub fn option(name: impl Into<String>) -> Self {
        Self::Argument { name: name.into(), value: None }
    }

    /// Creates the place of a part of a file.
    pub fn part(file: impl Into<PathBuf>, part: impl Display) -> Self {
        Self::Part { file: file.into(), part: part.to_string() }
    }

    /// Creates the place of a line of a text file; lines are counted from 1.
    pub fn line(file: impl Into<PathBuf>, line: usize) -> Self {
        Self::Text { file: file.into(), line, column: None }
    }

    /// Returns a part of this place.
    pub fn within(&self, part: impl Display) -> Self {
        match self {
            Self::File(file) => Self::part(file, part),
            Self::Part { file, part: whole } => Self::part(file, format_args!("{whole}: {part}")),
            place => Self::Other(format!("{place}: {part}")),
        }
    }

    /// Returns the file of the place, if the place is in a file.
    pub fn file(&self) -> Option<&Path> {
        match self {
            Self::File(file) | Self::Text { file, .. } | Self::Part { file, .. } => Some(file),
            _ => None,
        }
    }
}

impl Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => write!(f, "{}", path.display()),
            Self::Text { file, line, column: Some(column) } => {
                write!(f, "{}:{line}:{column}", file.display())
            }
            Self::Text { file, line, column: None } => write!(f, "{}:{line}", file.display()),
            Self::Part { file, part } => write!(f, "{}: {part}", file.display()),
            Self::Setting { path, value, origin } => write!(f, "{origin}: {path} = {value}"),
            Self::Argument { name, value: Some(value) } => write!(f, "{name} {value}"),
            Self::Argument { name, value: None } => f.write_str(name),
            Self::Other(text) => f.write_str(text),
        }
    }
}

impl From<&Self> for Place {
    fn from(place: &Self) -> Self {
        place.clone()
    }
}

impl From<&Path> for Place {
    fn from(path: &Path) -> Self {
        Self::File(path.into())
    }
}

impl From<&PathBuf> for Place {
    fn from(path: &PathBuf) -> Self {
        Self::File(path.clone())
    }
}

impl From<std::path::Display<'_>> for Place {
    fn from(path: std::path::Display<'_>) -> Self {
        Self::File(path.to_string().into())
    }
}

/// Implements the conversion of texts into a variant that holds text.
macro_rules! in_words {
    ($($name:ident::$variant:ident: $($text:ty),+;)+) => {
        $($(
            impl From<$text> for $name {
                fn from(text: $text) -> Self {
                    Self::$variant(text.into())
                }
            }
        )+)+
    };
}

in_words! {
    Place::Other: &str, String, &String;
    Advice::Words: &str, String, &String, Cow<'_, str>;
}

/// Advice on what to do about an [`Error`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Advice {
    /// The value has to be as described, such as `0 to 5`.
    Expected(String),
    /// The run has to start over.
    StartOver,
    /// Another folder has to be chosen for what is written.
    OtherFolder,
    /// An argument has to be used or left out: a text in which `{name}` stands for the argument of this name.
    Argument(String),
    /// Any other advice, in words.
    Words(String),
    /// One of several pieces of advice.
    AnyOf(Vec<Self>),
}

impl Display for Advice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Expected(what) => write!(f, "expected {what}"),
            Self::StartOver => f.write_str("start the run over"),
            Self::OtherFolder => f.write_str("choose another folder"),
            Self::Argument(text) => f.write_str(&text.replace(['{', '}'], "")),
            Self::Words(text) => f.write_str(text),
            Self::AnyOf(several) => {
                let several: Vec<String> = several.iter().map(Self::to_string).collect();
                f.write_str(&several.join(", or "))
            }
        }
    }
}

/// An error: its cause, the place of the fault, what was found there, what to do, and the error of another library behind it.
/// Processes send errors to each other; the error of another library is not sent.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Error(Box<Parts>);

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Parts {
    kind: ErrorKind,
    /// The process in which the error happened, if several processes train together.
    rank: Option<usize>,
    place: Option<Place>,
    found: String,
    advice: Option<Advice>,
    /// Further information, such as what was kept.
    notes: Vec<String>,
    #[serde(skip)]
    source: Option<Arc<dyn std::error::Error + Send + Sync>>,
}

/// Result type of the workspace.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    fn new(kind: ErrorKind, place: Option<Place>, found: impl Display, advice: Option<Advice>) -> Self {
        let found = one_line(found);
        Self(Box::new(Parts { kind, rank: None, place, found, advice, notes: Vec::new(), source: None }))
    }

    /// Creates an error for wrong input by the user: `found` is the fault at `place`.
    pub fn input(place: impl Into<Place>, found: impl Display, advice: impl Into<Advice>) -> Self {
        Self::new(ErrorKind::Input, Some(place.into()), found, Some(advice.into()))
    }

    /// Creates an error for a run that failed with valid input.
    pub fn run(found: impl Display) -> Self {
        Self::new(ErrorKind::Run, None, found, None)
    }

    /// Creates an error for a device that failed.
    pub fn device(found: impl Display) -> Self {
        Self::new(ErrorKind::Device, None, found, None)
    }

    /// Creates an error for a program that the user stopped before it changed anything.
    pub fn stopped() -> Self {
        Self::stopped_with("stopped before anything was changed; the same command begins again")
    }

    /// Creates an error for a program that the user stopped; `found` says how the program continues.
    pub fn stopped_with(found: impl Display) -> Self {
        Self::new(ErrorKind::Stopped, None, found, None)
    }

    /// Adds the error of another library that caused this one, see [`source`](std::error::Error::source).
    pub fn caused_by(mut self, source: impl std::error::Error + Send + Sync + 'static) -> Self {
        self.0.source = Some(Arc::new(source));
        self
    }

    /// Adds a sentence, such as what was kept.
    pub fn with_note(mut self, note: impl Display) -> Self {
        self.0.notes.push(one_line(note));
        self
    }

    /// Returns the same error, marked as having happened in the process `rank`. An error that already names a rank
    /// keeps it.
    pub fn of_rank(mut self, rank: usize) -> Self {
        self.0.rank.get_or_insert(rank);
        self
    }

    /// Returns the cause.
    pub fn kind(&self) -> ErrorKind {
        self.0.kind
    }

    /// Returns the place of the fault; `None` for errors of runs and devices.
    pub fn place(&self) -> Option<&Place> {
        self.0.place.as_ref()
    }

    /// Returns what was found at the place, as one line.
    pub fn found(&self) -> &str {
        &self.0.found
    }

    /// Returns the advice on what to do.
    pub fn advice(&self) -> Option<&Advice> {
        self.0.advice.as_ref()
    }

    /// Returns the error as one line: place, fault, advice and notes.
    pub fn message(&self) -> String {
        self.text_with(Place::to_string, Advice::to_string)
    }

    /// Returns the error as one line, with places and advice as a program phrases them.
    pub fn text_with(&self, place: impl Fn(&Place) -> String, advice: impl Fn(&Advice) -> String) -> String {
        let parts = &*self.0;
        let mut text = parts.rank.map_or(String::new(), |rank| format!("rank {rank}: "));
        if let Some(at) = &parts.place {
            text += &format!("{}: ", one_line(place(at)));
        }
        text += &parts.found;
        for more in parts.advice.iter().map(advice).chain(parts.notes.iter().cloned()) {
            text += "; ";
            text += &one_line(more);
        }
        text
    }
}

impl Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message())
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.0.source.as_deref().map(|source| source as &(dyn std::error::Error + 'static))
    }
}

/// Largest number of characters of a part of a message. Paths and lists of names are shorter. If a value from a user or
/// a file is longer, its beginning and its end suffice.
const MOST: usize = 600;

/// Returns a part of a message: one line, shortened, with characters escaped that act on a terminal. Messages of other
/// libraries may span lines.
fn one_line(part: impl Display) -> String {
    let text = part.to_string();
    let lines = text.split(['\n', '\r']).map(str::trim).filter(|line| !line.is_empty());
    let line = lines.collect::<Vec<_>>().join(" ");
    let length = line.chars().count();
    let kept =
        line.chars().enumerate().filter(|(i, _)| length <= MOST || *i < MOST / 2 || *i >= length - MOST / 4);
    let mut shown = String::new();
    for (i, character) in kept {
        if length > MOST && i == length - MOST / 4 {
            shown += &format!(" .. ({length} characters) .. ");
        }
        // Control characters, and those that change the direction of the text.
        match character.is_control() || matches!(character, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
        {
            true => shown.extend(character.escape_unicode()),
            false => shown.push(character),
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::error::Error as _;

    #[test]
    fn a_message_is_one_short_line_without_control_characters() {
        let error = Error::input("a\n  b.toml", "\u{1b}[31mred\u{202e}\t", "x".repeat(100_000));
        let message = error.message();
        assert!(message.starts_with("a b.toml: \\u{1b}[31mred\\u{202e}"), "{error}");
        assert!(message.contains("xx .. (100000 characters) .. xx"), "{error}");
        assert!(message.chars().count() < 700 && !message.contains(char::is_control), "{error}");
        assert_eq!(Error::run("60 % of ×").message(), "60 % of ×");
    }

    #[test]
    fn a_program_reads_the_parts_and_phrases_them() {
        let io = std::io::Error::other("the disk is full");
        let advice = Advice::AnyOf(vec![Advice::StartOver, Advice::OtherFolder]);
        let error = Error::input(Path::new("run/a.toml"), format!("cannot write: {io}"), advice.clone());
        let error = error.caused_by(io).with_note("step 3 is kept");
        assert_eq!((error.kind(), error.found()), (ErrorKind::Input, "cannot write: the disk is full"));
        assert_eq!(error.place().and_then(Place::file), Some(Path::new("run/a.toml")));
        assert_eq!(error.advice(), Some(&advice));
        assert_eq!(error.source().unwrap().to_string(), "the disk is full");
        assert_eq!(
            error.to_string(),
            "run/a.toml: cannot write: the disk is full; start the run over, or choose another folder; step 3 is kept"
        );
        let phrased = error.text_with(|_| "here".into(), |_| "give --fresh".into());
        assert_eq!(phrased, "here: cannot write: the disk is full; give --fresh; step 3 is kept");
    }

    #[test]
    fn places_and_advice_are_shown_in_words() {
        let setting = Place::Setting { path: "a.b".into(), value: "3".into(), origin: Origin::Code };
        let text = Place::Text { file: "a.toml".into(), line: 3, column: Some(9) };
        let shown = [
            setting,
            text,
            Place::part("a.json", "frame 3"),
            Place::argument("up", "0,0,0"),
            Place::option("scale"),
        ];
        let words = ["settings: a.b = 3", "a.toml:3:9", "a.json: frame 3", "up 0,0,0", "scale"];
        assert_eq!(shown.map(|place| place.to_string()), words);
        assert_eq!(Advice::Expected("0 to 5".into()).to_string(), "expected 0 to 5");
        assert_eq!(Advice::Argument("use {turntable} or {path}".into()).to_string(), "use turntable or path");
    }
}
