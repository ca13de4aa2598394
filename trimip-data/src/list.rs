//! The list of test frames (`data.test_list`): a text file with one image name per line, in any form that [`Index`]
//! finds. Empty lines and lines that begin with # are skipped.

use crate::{
    names::{Index, Match},
    source::Source,
};
use std::path::Path;
use trimip_core::{Error, Result, text};

/// Most names that a message repeats.
const MOST_NAMED: usize = 5;

/// Divides `sources` into training frames and those that the file `named` in `root` lists.
pub(crate) fn divide(root: &Path, named: &str, sources: Vec<Source>) -> Result<(Vec<Source>, Vec<Source>)> {
    let path = root.join(named);
    let text = text::read(&path, "set data.test_list to a text file, relative to data.root")?;
    let wrong = |what: String, advice: &str| Err(Error::input(path.display(), what, advice));
    let names = || text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    let index = Index::new(sources.iter().map(|source| written(root, source)));
    let mut tested = vec![false; sources.len()];
    let (mut absent, mut several) = (Vec::new(), Vec::new());
    for name in names() {
        match index.find(name) {
            Match::One(frame) => tested[frame] = true,
            Match::None => absent.push(name),
            Match::Several => several.push(name),
        }
    }
    if !absent.is_empty() {
        return wrong(
            format!("lists names that match no frame of the scene: {}", some(&absent)),
            "correct or remove these lines",
        );
    }
    if !several.is_empty() {
        return wrong(
            format!("lists names that match more than one frame: {}", some(&several)),
            "add the folders to these names",
        );
    }
    let (test, train): (Vec<_>, Vec<_>) = sources.into_iter().zip(tested).partition(|(_, tested)| *tested);
    if test.is_empty() || train.is_empty() {
        let left = if test.is_empty() { "test" } else { "training" };
        return wrong(format!("leaves no {left} frame"), "name some of the frames, not all");
    }
    let frames = |part: Vec<(Source, bool)>| part.into_iter().map(|(source, _)| source).collect();
    Ok((frames(train), frames(test)))
}

/// Returns the path of a frame's photograph within the scene.
fn written(root: &Path, source: &Source) -> String {
    let path = source.files().first().map_or(Path::new(&source.name), |file| file.path.as_path());
    path.strip_prefix(root).unwrap_or(path).to_string_lossy().into_owned()
}

/// Lists the first of several names, for a message.
fn some(names: &[&str]) -> String {
    let shown: Vec<String> =
        names.iter().take(MOST_NAMED).map(|name| name.chars().take(80).collect()).collect();
    let more = names.len() - shown.len();
    shown.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
}
