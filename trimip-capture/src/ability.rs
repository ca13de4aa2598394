//! Options and versions of the installed programs.

/// What the programs at hand can do.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ability {
    /// Their name with their version.
    pub name: String,
    /// True if cameras can be placed all at once.
    pub global: bool,
    /// True if they cannot be placed otherwise.
    pub only_global: bool,
    /// True if there is a GPU that they use.
    pub gpu: bool,
    /// Why not.
    pub why_no_gpu: String,
}
