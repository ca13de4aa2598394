//! Abilities and versions of the installed programs.

/// Abilities of the installed pose programs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ability {
    /// Name and version of the program that finds features and matches.
    pub name: String,
    /// True if cameras can be placed all at once (global mapper).
    pub global: bool,
    /// True if the user requested glomap, which has no incremental mapper.
    pub only_global: bool,
    /// True if the program uses CUDA and a GPU is present.
    pub gpu: bool,
    /// Reason why no GPU is used.
    pub why_no_gpu: String,
}
