//! Keeps track of the finished views in a folder, so that a large set of views can be rendered in several sessions.

use super::{Named, PictureFormat, Quantity, files::paths};
use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use trimip_core::{Advice, Error, Result, atomic::write_atomically, field::model::Model, scene::fingerprint};

/// File of a folder that lists its finished views: the first line names the job, each other line a view.
const LIST: &str = "views.txt";

/// Beginning of the first line of the list.
const HEAD: &str = "views rendered by trimip, job ";

/// The finished views of a folder. A job is defined by a model, its cameras, and the quantities and format of the pictures. If the folder
/// has pictures of another job, they are rendered again.
pub struct RenderJob {
    folder: PathBuf,
    what: Vec<Quantity>,
    format: PictureFormat,
    done: BTreeSet<String>,
    list: File,
}

impl RenderJob {
    /// Opens the job of a folder. Starts a new list if `fresh`, or if the folder has no job or a different one.
    ///
    /// # Errors
    /// When the list cannot be read or written.
    pub fn open(
        folder: &Path,
        model: &Model,
        cameras: &[Named],
        what: &[Quantity],
        format: PictureFormat,
        fresh: bool,
    ) -> Result<Self> {
        let path = folder.join(LIST);
        let failed = |error| Error::run(format!("{}: {error}", path.display()));
        let head = format!("{HEAD}{:016x}\n", identity(model, cameras, what, format)?);
        let text = match trimip_core::plain_file::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(failed(error)),
        };
        let mut done = BTreeSet::new();
        match text.strip_prefix(&head) {
            Some(views) if !fresh => {
                // A line without a line break is incomplete.
                let whole = views.rfind('\n').map_or("", |end| &views[..=end]);
                done.extend(whole.lines().map(str::to_string));
                if views.len() > whole.len() {
                    write_atomically(&path, &text.as_bytes()[..head.len() + whole.len()])?;
                }
            }
            _ if !text.is_empty() && !text.starts_with(HEAD) => {
                return Err(Error::input(
                    path.display(),
                    "is not a list of rendered views",
                    Advice::OtherFolder,
                ));
            }
            _ => write_atomically(&path, head.as_bytes())?,
        }
        let list = OpenOptions::new().append(true).open(&path).map_err(failed)?;
        Ok(Self { folder: folder.into(), what: what.to_vec(), format, done, list })
    }

    /// Returns the paths of a view's pictures, if the view is finished and its pictures exist.
    pub fn finished(&self, name: &str) -> Option<Vec<PathBuf>> {
        let paths = paths(&self.folder, name, &self.what, self.format);
        (self.done.contains(name) && paths.iter().all(|path| path.is_file())).then_some(paths)
    }

    /// Records that the pictures of a view are written.
    ///
    /// # Errors
    /// When the list cannot be written.
    pub fn finish(&mut self, name: &str) -> Result<()> {
        let line = format!("{name}\n");
        self.list
            .write_all(line.as_bytes())
            .map_err(|error| Error::run(format!("{}: {error}", self.folder.join(LIST).display())))?;
        self.done.insert(name.into());
        Ok(())
    }
}

/// Returns a number that differs for jobs whose pictures differ. It is stored in the list of a folder, so it has to be the same in every
/// build of this version.
fn identity(model: &Model, cameras: &[Named], what: &[Quantity], format: PictureFormat) -> Result<u64> {
    let mut parts = vec![
        env!("CARGO_PKG_VERSION").as_bytes().to_vec(),
        model.hash()?.to_le_bytes().to_vec(),
        format!("{what:?} {format:?}").into_bytes(),
    ];
    for (name, camera) in cameras {
        parts.push(name.as_bytes().to_vec());
        parts.push(camera.numbers().into_iter().flat_map(f64::to_le_bytes).collect());
    }
    Ok(fingerprint::hash_of(parts))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use std::fs;
    use trimip_core::{Camera, Config, Intrinsics, field::tensors::TensorFile};

    fn model(seed: u64) -> Model {
        Model::new(Config { seed, ..Config::default() }, TensorFile::default())
    }

    fn cameras(distance: f64) -> Vec<Named> {
        let camera = |i: u32| {
            let eye = DVec3::new(distance, f64::from(i), 0.0);
            let k = Intrinsics::from_angle(8, 8, 0.7);
            (format!("{i:04}"), Camera::look_at(k, eye, DVec3::ZERO, DVec3::Z))
        };
        (0..3).map(camera).collect()
    }

    fn open(folder: &Path, model: &Model, cameras: &[Named], what: &[Quantity]) -> RenderJob {
        RenderJob::open(folder, model, cameras, what, PictureFormat::Png, false).unwrap()
    }

    const COLOR: &[Quantity] = &[Quantity::Color];

    #[test]
    fn a_view_is_finished_when_it_is_listed_and_its_pictures_are_there() {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        let mut job = open(here, &model(1), &cameras(4.0), COLOR);
        assert_eq!(job.finished("0000"), None);
        fs::write(here.join("0000_color.png"), "a").unwrap();
        assert_eq!(job.finished("0000"), None, "a file of that name may be anybody's");
        job.finish("0000").unwrap();
        job.finish("0001").unwrap();
        drop(job);
        let job = open(here, &model(1), &cameras(4.0), COLOR);
        assert_eq!(job.finished("0000"), Some(vec![here.join("0000_color.png")]));
        assert_eq!(job.finished("0001"), None, "its picture is gone");
        // Another model, camera or quantity starts a new list, and `fresh` does too.
        for job in [
            open(here, &model(2), &cameras(4.0), COLOR),
            open(here, &model(1), &cameras(4.5), COLOR),
            open(here, &model(1), &cameras(4.0), &[Quantity::Color, Quantity::Depth]),
        ] {
            assert_eq!(job.finished("0000"), None);
        }
        let mut job = open(here, &model(1), &cameras(4.0), COLOR);
        assert_eq!(job.finished("0000"), None, "the list of another job is gone");
        job.finish("0000").unwrap();
        let fresh = RenderJob::open(here, &model(1), &cameras(4.0), COLOR, PictureFormat::Png, true).unwrap();
        assert_eq!(fresh.finished("0000"), None);
    }

    #[test]
    fn a_torn_line_is_no_view_and_a_foreign_list_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        let mut job = open(here, &model(1), &cameras(4.0), COLOR);
        ["0000_color.png", "0001_color.png", "00_color.png"]
            .iter()
            .for_each(|name| fs::write(here.join(name), "a").unwrap());
        job.finish("0000").unwrap();
        drop(job);
        let mut list = OpenOptions::new().append(true).open(here.join(LIST)).unwrap();
        list.write_all(b"00").unwrap();
        let mut job = open(here, &model(1), &cameras(4.0), COLOR);
        assert!(job.finished("0000").is_some() && job.finished("00").is_none());
        job.finish("0001").unwrap();
        drop(job);
        let job = open(here, &model(1), &cameras(4.0), COLOR);
        assert!(["0000", "0001"].iter().all(|name| job.finished(name).is_some()));
        fs::write(here.join(LIST), "milk\neggs\n").unwrap();
        let refused = RenderJob::open(here, &model(1), &cameras(4.0), COLOR, PictureFormat::Png, true);
        assert!(refused.is_err_and(|error| error.message().contains("not a list of rendered views")));
        assert_eq!(fs::read_to_string(here.join(LIST)).unwrap(), "milk\neggs\n");
    }

    /// Checks the first line of a list, because other builds read it. The hash of the model is computed here, because new settings change
    /// it.
    #[test]
    fn a_list_names_its_job_by_a_stated_hash() {
        let folder = tempfile::tempdir().unwrap();
        let model = model(1);
        drop(open(folder.path(), &model, &cameras(4.0)[..1], COLOR));
        let list = fs::read_to_string(folder.path().join(LIST)).unwrap();
        let numbers = cameras(4.0)[0].1.numbers().into_iter().flat_map(f64::to_le_bytes).collect();
        let parts = [
            env!("CARGO_PKG_VERSION").as_bytes().to_vec(),
            model.hash().unwrap().to_le_bytes().to_vec(),
            b"[Color] Png".to_vec(),
            b"0000".to_vec(),
            numbers,
        ];
        assert_eq!(list, format!("{HEAD}{:016x}\n", fingerprint::hash_of(parts)));
    }
}
