//! Options and versions of the installed programs.

/// What the installed pose programs can do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ability {
    /// Name and version of the program that finds features and matches.
    pub name: String,
    /// True if cameras can be placed all at once (global mapper).
    pub global: bool,
    /// True if the user asked for glomap, which has no incremental mapper.
    pub only_global: bool,
    /// True if the program uses CUDA and a GPU is present.
    pub gpu: bool,
    /// Why no GPU is used.
    pub why_no_gpu: String,
}
