//! The lists of ARCHITECTURE.md: the files that a new member of a registry needs, with `NAME` for the member's name. Every path quoted in
//! a numbered item is an entry of the list, a file or a folder. A sentence that begins with "If" names entries that only some members
//! need; a sentence with `TRIMIP_WRITE_DOCS` names entries that a command writes. Paths between the items are not entries.

/// States which members need an entry of a list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Every member.
    Every,
    /// Some members.
    Some,
    /// No member: a command writes the entry.
    Written,
}

/// An entry of a list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// A file, or a folder with a slash at its end, relative to the root of the workspace.
    pub path: String,
    /// The members that need it.
    pub need: Need,
}

impl Place {
    /// Returns true if `file` is this entry, or lies in this folder.
    pub fn holds(&self, file: &str) -> bool {
        file == self.path || self.path.ends_with('/') && file.starts_with(&self.path)
    }
}

/// Returns the text of a section of ARCHITECTURE.md.
///
/// # Panics
/// If the document has no such section.
pub fn section<'a>(text: &'a str, title: &str) -> &'a str {
    let begin =
        text.find(&format!("## {title}\n")).unwrap_or_else(|| panic!("ARCHITECTURE.md has no \"{title}\""));
    let rest = &text[begin + 3..];
    &rest[..rest.find("\n## ").unwrap_or(rest.len())]
}

/// Returns the entries that the numbered items of a section name, for the member `name`.
pub fn places(section: &str, name: &str) -> Vec<Place> {
    let section = section.replace("NAME", name);
    let mut found = Vec::new();
    for item in items(&section) {
        for sentence in item.split(". ") {
            let need = match sentence {
                _ if sentence.trim_start().starts_with("If ") => Need::Some,
                _ if sentence.contains("TRIMIP_WRITE_DOCS") => Need::Written,
                _ => Need::Every,
            };
            found.extend(paths(sentence).map(|path| Place { path: path.into(), need }));
        }
    }
    found
}

/// Returns the numbered items of a section, each as one line.
fn items(section: &str) -> Vec<String> {
    let mut items: Vec<String> = Vec::new();
    let mut open = false;
    for line in section.lines() {
        let numbered = line.split_once(". ").filter(|(number, _)| number.parse::<u32>().is_ok());
        match (numbered, items.last_mut()) {
            (Some((_, text)), _) => {
                items.push(text.into());
                open = true;
            }
            (None, Some(item)) if open && line.starts_with("   ") => *item += &format!(" {}", line.trim()),
            _ => open = false,
        }
    }
    items
}

/// Returns the paths that a text quotes: those with a slash, and Markdown files at the root.
fn paths(text: &str) -> impl Iterator<Item = &str> {
    let quoted = text.split('`').skip(1).step_by(2);
    quoted.filter(|text| !text.contains(' ') && (text.contains('/') || text.ends_with(".md")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_those_of_the_items_with_their_need() {
        let page = "## Other\n\n1. `a/b.rs`.\n\n## Adding\n\nAs in `a/c.rs`.\n\n1. `a/NAME.rs`: a mod line,\n   \
                    and `README.md`. `TRIMIP_WRITE_DOCS=1 cargo test` renews `d/`. If it has `e.rs`, `f/g.rs`.\n\nAlso `h/i.rs`.\n";
        let found = places(section(page, "Adding"), "dummy");
        let of = |path: &str, need| Place { path: path.into(), need };
        let expected = [
            of("a/dummy.rs", Need::Every),
            of("README.md", Need::Every),
            of("d/", Need::Written),
            of("f/g.rs", Need::Some),
        ];
        assert_eq!(found, expected);
        assert!(found[2].holds("d/x.md") && !found[0].holds("a/dummy.rs2") && !found[3].holds("f/g.rs/x"));
    }
}
