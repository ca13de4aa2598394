//! The registry of scene readers: each reader is one file and one line of the list below.

mod arkitscenes;
pub(crate) mod blender;
pub(crate) mod builtin;
mod bundler;
mod colmap;
mod llff;
mod metashape;
pub(crate) mod multiscale;
mod nsvf;
mod opensfm;
mod polycam;
pub(crate) mod reader;
mod realitycapture;
mod record3d;

use reader::Reader;
use std::path::Path;

/// All readers, in the order in which they are tried on a folder.
pub(crate) static READERS: &[&Reader] = &[
    &multiscale::READER,
    &blender::READER,
    &colmap::READER,
    &llff::READER,
    &opensfm::READER,
    &bundler::READER,
    &polycam::READER,
    &nsvf::READER,
    &metashape::READER,
    &realitycapture::READER,
    &record3d::READER,
    &arkitscenes::READER,
    &builtin::READER,
];

/// Returns the reader that recognises the files in a folder.
pub(crate) fn found(root: &Path) -> Option<&'static Reader> {
    READERS.iter().copied().find(|reader| (reader.recognises)(root))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_documented_in_the_order_of_recognition() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/formats.md");
        let page = std::fs::read_to_string(path).unwrap();
        let (_, table) = page.split_once("| `data.format` | scene | shown by |\n|---|---|---|\n").unwrap();
        let rows: Vec<&str> = table.lines().take_while(|line| line.starts_with('|')).collect();
        assert_eq!(rows.len(), READERS.len(), "docs/formats.md has a row for each reader");
        for (row, reader) in rows.iter().zip(READERS) {
            assert!(row.starts_with(&format!("| `{}` | {}", reader.format, reader.name)), "{row}");
            assert!(
                row.ends_with(&format!(
                    " |{}|",
                    reader.files.map_or(" ".into(), |files| format!(" {files} "))
                ))
            );
        }
    }

    #[test]
    fn examples_are_valid_and_no_reader_takes_another_for_its_own() {
        for reader in READERS.iter().filter(|reader| !reader.camera_files.is_empty()) {
            let folder = tempfile::tempdir().unwrap();
            for file in reader.camera_files {
                let path = folder.path().join(file.file);
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, (file.example)()).unwrap();
                assert!(!(file.cameras)(file.file, &(file.example)()).unwrap().is_empty());
            }
            let shown: Vec<&str> = READERS
                .iter()
                .filter(|other| (other.recognises)(folder.path()))
                .map(|other| other.format)
                .collect();
            assert_eq!(shown, [reader.format]);
        }
    }
}
