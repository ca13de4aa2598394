//! Settings as lines of TOML: finds sections and inserts lines into them.

/// Returns the name of the section that a line begins; `None` for other lines.
pub(crate) fn section_begun(line: &str) -> Option<&str> {
    line.strip_prefix('[').and_then(|rest| rest.split_once(']')).map(|(name, _)| name)
}

/// Splits a dotted path into section and key. Settings above all sections have an empty section name.
pub(crate) fn parts_of(path: &str) -> (&str, &str) {
    path.split_once('.').unwrap_or(("", path))
}

/// Inserts the line of a setting into its section: after the line with the key `after`, at the beginning of the section if
/// `after` is empty, or at its end if no line has that key. A missing section is appended to the text and begins with the
/// line `header`.
pub(crate) fn insert(lines: &mut Vec<String>, header: &str, after: &str, line: String) {
    let section = section_begun(header).unwrap_or_default();
    let begin = match lines.iter().position(|line| section_begun(line) == Some(section)) {
        Some(at) => at + 1,
        None => {
            lines.extend([String::new(), header.to_string()]);
            lines.len()
        }
    };
    let own = lines[begin..].iter().take_while(|line| section_begun(line).is_none());
    let (mut at, mut end) = (None, begin);
    for (i, line) in own.enumerate() {
        let key = line.split_once(" = ").map(|(key, _)| key.trim());
        if key.is_some() {
            end = begin + i + 1;
        }
        if key == Some(after) {
            at = Some(begin + i + 1);
        }
    }
    let at = if after.is_empty() { begin } else { at.unwrap_or(end) };
    lines.insert(at, line);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_stands_behind_the_one_that_it_names() {
        let mut lines: Vec<String> =
            ["seed = 1", "", "[a] # of a", "x = 1", "y = 2", "", "[b]", "x = 3"].map(String::from).into();
        for (header, after, line) in [
            ("[a]", "x", "m = 0"),
            ("[a]", "", "first = 0"),
            ("[a]", "z", "last = 0"),
            ("[c] # new", "q", "x = 4"),
        ] {
            insert(&mut lines, header, after, line.to_string());
        }
        let expected = [
            "seed = 1",
            "",
            "[a] # of a",
            "first = 0",
            "x = 1",
            "m = 0",
            "y = 2",
            "last = 0",
            "",
            "[b]",
            "x = 3",
            "",
            "[c] # new",
            "x = 4",
        ];
        assert_eq!(lines, expected);
    }
}
