//! Whether the report in a run folder is complete, written by this version of the program, and up to date.

use serde_json::Value;
use std::path::Path;
use std::time::SystemTime;
use trimip::{RunFolder, machine};

/// True if writing the report again would change nothing.
pub fn report_is_fresh(folder: &RunFolder) -> bool {
    let written = [folder.html(), folder.json(), folder.curve()];
    let told = [folder.metrics(), folder.config(), folder.model(), folder.views(), folder.plan()];
    let Some(oldest) = written.iter().map(|path| modified(path)).min().flatten() else { return false };
    is_whole_json(&folder.json())
        && is_whole_page(&folder.html())
        && told.iter().filter_map(|path| modified(path)).all(|time| time <= oldest)
}

/// Modification time of a file; `None`, which is less than any time, if there is no file.
fn modified(path: &Path) -> Option<SystemTime> {
    std::fs::metadata(path).and_then(|metadata| metadata.modified()).ok()
}

fn is_whole_json(path: &Path) -> bool {
    let bytes = std::fs::read(path).unwrap_or_default();
    let report: Value = serde_json::from_slice(&bytes).unwrap_or_default();
    report["version"] == machine::version()
}

fn is_whole_page(path: &Path) -> bool {
    let page = std::fs::read_to_string(path).unwrap_or_default();
    page.trim_end().ends_with("</html>")
        && page.contains(&format!("trimip-cli {}.</footer>", machine::version()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_report_is_fresh_while_it_is_whole_and_newer_than_its_run() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(temporary.path());
        let page =
            format!("<!doctype html><footer>Written by trimip-cli {}.</footer></html>", machine::version());
        let json = format!("{{\"version\": \"{}\"}}", machine::version());
        let texts = [(folder.html(), page.as_str()), (folder.json(), &json), (folder.curve(), "seconds")];
        let write_all = || {
            for path in [folder.metrics(), folder.config(), folder.model()] {
                std::fs::write(path, "x").unwrap();
            }
            texts.iter().for_each(|(path, text)| std::fs::write(path, text).unwrap());
        };
        assert!(!report_is_fresh(&folder));
        write_all();
        assert!(report_is_fresh(&folder));
        for (path, text) in &texts {
            std::fs::remove_file(path).unwrap();
            assert!(!report_is_fresh(&folder), "{} is missing", path.display());
            std::fs::write(path, text).unwrap();
        }
        for (path, text) in &texts[..2] {
            for wrong in [&text[..text.len() / 2], "", &text.replace(&machine::version(), "0.0.1")] {
                std::fs::write(path, wrong).unwrap();
                assert!(!report_is_fresh(&folder), "{}: {wrong}", path.display());
            }
            std::fs::write(path, text).unwrap();
        }
        for path in [folder.metrics(), folder.config(), folder.model()] {
            write_all();
            let later = SystemTime::now() + Duration::from_secs(5);
            std::fs::File::options().append(true).open(&path).unwrap().set_modified(later).unwrap();
            assert!(!report_is_fresh(&folder), "{} is newer", path.display());
        }
    }
}
