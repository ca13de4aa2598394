//! Advice for a folder without a scene: the command that makes a scene of the files in it.

use crate::material::Material;
use std::path::Path;
use trimip_core::plural::count;

/// Returns the next command for a folder that holds no scene, in words.
pub(crate) fn advice(root: &Path) -> String {
    Next::of(root, root, root)
        .map_or_else(|| "name a folder with one of these files".into(), |next| next.text)
}

/// The next step for a folder without a scene.
pub(crate) struct Next {
    /// The step in words.
    pub(crate) text: String,
    /// True if the command accepts the archive of the folder, so that nobody has to unpack it.
    pub(crate) takes_archive: bool,
}

impl Next {
    /// Returns the next step for the folder `root`, or `None` if it holds no usable file. Messages show the folder as
    /// `named`; commands get `taken`, which may be the archive of the folder.
    pub(crate) fn of(root: &Path, named: &Path, taken: &Path) -> Option<Self> {
        let material = Material::called(root, named);
        let unpacked = |text: String| Some(Self { text, takes_archive: false });
        if let Some(inner) = &material.scene {
            return unpacked(format!("name {}, which holds one", shown(inner)));
        }
        if let Some(capture) = Self::capture(&material, named, taken) {
            return Some(capture);
        }
        if let Some(zip) = &material.zip {
            return unpacked(format!("name {}, which is then unpacked", shown(zip)));
        }
        unpacked(format!("unpack {}, and name the folder in it", shown(material.archive.as_ref()?)))
    }

    /// Returns the command that finds the cameras of photographs or of a film, or `None` if there are neither.
    fn capture(material: &Material, named: &Path, taken: &Path) -> Option<Self> {
        let command = |path: &Path| format!("trimip-cli capture {}", shown(path));
        let convertible = material.foreign.iter().filter(|(_, format)| format.is_heif()).count();
        let photographs = material.pictures.len() + convertible;
        if photographs > 0 {
            let need = match photographs {
                1 => "picture needs".into(),
                several => format!("{} need", count(several, "picture")),
            };
            let mapper = mapper(material, named).unwrap_or_default();
            let text = format!("its {need} cameras, which this command finds: {}{mapper}", command(taken));
            return Some(Self { text, takes_archive: true });
        }
        if let Some((path, format)) = material.foreign.first() {
            let (name, remedy) = (format.name, format.remedy(path));
            let text =
                format!("{} is {name}: {remedy}; then find their cameras: {}", shown(path), command(named));
            return Some(Self { text, takes_archive: false });
        }
        let film = material.films.first()?;
        // With several films, the user has to choose one.
        let takes_archive = !taken.is_dir() && material.films.len() == 1;
        let film_or_archive = if takes_archive { taken } else { film };
        let text = format!(
            "{} is a film, and this command finds the cameras of its frames: {}",
            shown(film),
            command(film_or_archive)
        );
        Some(Self { text, takes_archive })
    }
}

/// Returns the command that continues with the features that COLMAP has found already.
fn mapper(material: &Material, named: &Path) -> Option<String> {
    let database = material.database.as_ref()?;
    let beside = database.parent().unwrap_or(named);
    let folder = material.pictures.first()?.parent().unwrap_or(named);
    Some(format!(
        "; or with the features that COLMAP has found already: mkdir {0}/sparse && colmap mapper --database_path {1} --image_path {2} \
         --output_path {0}/sparse",
        shown(beside),
        shown(database),
        shown(folder)
    ))
}

/// Quotes a path so that a shell reads it as one word and not as an option.
fn shown(path: &Path) -> String {
    let plain = path.display().to_string();
    let plain = if plain.starts_with('-') { format!("./{plain}") } else { plain };
    if plain.contains(char::is_whitespace) { format!("\"{plain}\"") } else { plain }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_folder_without_a_scene_has_a_next_command() {
        let table: [(&[&str], &[&str]); 15] = [
            (&["0.webp", "1.TIF", "2.bmp"], &["its 3 pictures need cameras"]),
            (&["DSC_1.DNG"], &["ROOT/DSC_1.DNG is a camera's raw image", "darktable-cli ROOT/DSC_1.DNG"]),
            (&["a.avif"], &["its picture needs cameras", ": trimip-cli capture ROOT"]),
            (&["a.jxl"], &["ROOT/a.jxl is a JPEG XL image", "djxl ROOT/a.jxl ROOT/a.png"]),
            (&["a/b/transforms_train.json", "a/b/train/r_0.png"], &["name ROOT/a/b, which holds one"]),
            (
                &["images/0.jpg", "images/1.jpg"],
                &["its 2 pictures need cameras, which this command finds: trimip-cli capture ROOT"],
            ),
            (&["0.JPG"], &["its picture needs cameras", ": trimip-cli capture ROOT"]),
            (&["IMG_0.HEIC", "IMG_1.HEIC"], &["its 2 pictures need cameras", ": trimip-cli capture ROOT"]),
            (&["scan.MP4"], &["ROOT/scan.MP4 is a film", ": trimip-cli capture ROOT/scan.MP4"]),
            (&["my scan.mov"], &[": trimip-cli capture \"ROOT/my scan.mov\""]),
            (
                &["database.db", "images/0.png"],
                &[
                    ": trimip-cli capture ROOT; or ",
                    "colmap mapper --database_path ROOT/database.db --image_path ROOT/images",
                ],
            ),
            (&["lego.zip"], &["name ROOT/lego.zip, which is then unpacked"]),
            (&["lego.7z", "lego.tar"], &["unpack ROOT/lego.7z, and name the folder in it"]),
            (&["my walk/0.jpg"], &[": trimip-cli capture ROOT"]),
            (&["notes.txt"], &["name a folder with one of these files"]),
        ];
        for (files, expected) in table {
            let folder = tempfile::tempdir().unwrap();
            for file in files {
                let path = folder.path().join(file);
                fs::create_dir_all(path.parent().unwrap()).unwrap();
                fs::write(path, b"").unwrap();
            }
            let told = advice(folder.path()).replace(&folder.path().display().to_string(), "ROOT");
            for part in expected {
                assert!(told.contains(part), "{files:?}: {told}");
            }
        }
    }
}
