//! The folder of a run: the names of its files, its state, and functions that read and write its events.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use trimip_core::{
    Advice, Config, Error, Result,
    atomic::{temporary_file, write_atomically},
    engine::{checkpoint::Checkpoint, events::Event},
    field::model::Model,
    plain_file,
    scene_plan::Finding,
};

/// Paths of a run's files.
#[derive(Clone, Debug)]
pub struct RunFolder {
    root: PathBuf,
}

/// Names of all files that a run writes, except `images/`. The events come last, because they mark the folder as a run's.
const FILES: [&str; 15] = [
    "config.toml",
    "plan.json",
    "cameras.json",
    "metrics.csv",
    "model.safetensors",
    "checkpoint.safetensors",
    "views.json",
    "turntable.png",
    "error_vs_time.csv",
    "events.out.tfevents.run",
    "report.html",
    "report.json",
    "report.md",
    "report.tex",
    "metrics.jsonl",
];

impl RunFolder {
    /// Wraps the path of a folder without touching the disk.
    pub fn new(root: &Path) -> Self {
        Self { root: root.to_path_buf() }
    }

    /// Returns the path of the folder itself.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Returns the path of the effective configuration.
    pub fn config(&self) -> PathBuf {
        self.root.join("config.toml")
    }

    /// Returns the path of the events, one JSON object per line.
    pub fn metrics(&self) -> PathBuf {
        self.root.join("metrics.jsonl")
    }

    /// Returns the path of the finished model.
    pub fn model(&self) -> PathBuf {
        self.root.join("model.safetensors")
    }

    /// Returns the path of the state to resume from.
    pub fn checkpoint(&self) -> PathBuf {
        self.root.join("checkpoint.safetensors")
    }

    /// Returns the path of the metrics of every view of the final evaluation.
    pub fn views(&self) -> PathBuf {
        self.root.join("views.json")
    }

    /// Returns the path of the picture that shows the model from all around.
    pub fn turntable(&self) -> PathBuf {
        self.root.join("turntable.png")
    }

    /// Returns the path of the decisions of the scene plan.
    pub fn plan(&self) -> PathBuf {
        self.root.join("plan.json")
    }

    /// Returns the path of the cameras of the training photographs at their finest scale, with refined poses if training has refined them.
    pub fn cameras(&self) -> PathBuf {
        self.root.join("cameras.json")
    }

    /// Reads the decisions that the scene plan made when the run began; `None` if the file does not exist.
    ///
    /// # Errors
    /// When the file is not valid.
    pub fn findings(&self) -> Result<Option<Vec<Finding>>> {
        let Ok(bytes) = plain_file::read(&self.plan()) else { return Ok(None) };
        serde_json::from_slice(&bytes)
            .map(Some)
            .map_err(|error| Error::input(self.plan().display(), error, Advice::StartOver))
    }

    /// Writes the decisions of the scene plan.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn write_findings(&self, findings: &[Finding]) -> Result<()> {
        let text = serde_json::to_string_pretty(findings).map_err(Error::run)?;
        write_atomically(&self.plan(), text.as_bytes())
    }

    /// Returns the path of the curve of error against time.
    pub fn curve(&self) -> PathBuf {
        self.root.join("error_vs_time.csv")
    }

    /// Returns the path of the report for people.
    pub fn html(&self) -> PathBuf {
        self.root.join("report.html")
    }

    /// Returns the path of the report for programs.
    pub fn json(&self) -> PathBuf {
        self.root.join("report.json")
    }

    /// Returns the path of the report's table as Markdown.
    pub fn markdown(&self) -> PathBuf {
        self.root.join("report.md")
    }

    /// Returns the path of the report's table as LaTeX.
    pub fn latex(&self) -> PathBuf {
        self.root.join("report.tex")
    }

    /// Returns the path of the step events as a table.
    pub fn steps(&self) -> PathBuf {
        self.root.join("metrics.csv")
    }

    /// Returns the path of the run's scalars for TensorBoard, which recognises its files by `tfevents` in their names.
    pub fn tensorboard(&self) -> PathBuf {
        self.root.join("events.out.tfevents.run")
    }

    /// Returns the path of the folder with pictures of test views.
    pub fn images(&self) -> PathBuf {
        self.root.join("images")
    }

    /// Creates the folder and checks that it is writable, before any long work begins.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn prepare(&self) -> Result<()> {
        create_writable(&self.root)
    }

    /// Creates the folder of pictures.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn prepare_images(&self) -> Result<()> {
        create_writable(&self.images())
    }

    /// Reads the folder's checkpoint, if any.
    ///
    /// # Errors
    /// When the folder contains a run with other settings, or incomplete files.
    pub fn resume_point(&self, config: &Config) -> Result<Option<Checkpoint>> {
        let path = self.checkpoint();
        if path.exists() {
            let checkpoint = Checkpoint::read(&path)?;
            self.expect_none(&config.differences(&checkpoint.config))?;
            return Ok(Some(checkpoint));
        }
        if self.model().exists() {
            return Err(Error::input(
                self.model().display(),
                "is a model without the checkpoint of its run",
                Advice::AnyOf(vec![Advice::OtherFolder, Advice::StartOver]),
            ));
        }
        Ok(None)
    }

    /// Refuses the folder if there are `differences` between its run and the given one.
    ///
    /// # Errors
    /// When `differences` is not empty.
    pub(super) fn expect_none(&self, differences: &[String]) -> Result<()> {
        if differences.is_empty() {
            return Ok(());
        }
        let budget = |text: &String| text.starts_with("train.seconds") || text.starts_with("train.steps");
        let mut advice = vec!["give the same settings to resume it".into()];
        if differences.iter().all(budget) {
            advice.push(Advice::Argument("{continue-for} 5m to train a finished run longer".into()));
        }
        advice.extend([Advice::StartOver, Advice::OtherFolder]);
        Err(Error::input(
            self.root.display(),
            format!("holds a run with other settings ({})", differences.join(", ")),
            Advice::AnyOf(advice),
        ))
    }

    /// Returns the paths of all files that a run writes, except pictures, whether they exist or not; the events last.
    pub fn files(&self) -> Vec<PathBuf> {
        FILES.iter().map(|name| self.root.join(name)).collect()
    }

    /// Removes the files of an earlier run. Other files stay.
    ///
    /// # Errors
    /// When a file cannot be removed.
    pub fn clear(&self) -> Result<()> {
        for path in self.pictures().into_iter().chain(self.files()) {
            match std::fs::remove_file(&path) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                    return Err(Error::input(
                        path.display(),
                        format!("cannot remove: {error}"),
                        Advice::OtherFolder,
                    ));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Returns the pictures in `images/` that runs wrote, recognised by name. Other files in `images/` belong to the user.
    pub fn pictures(&self) -> Vec<PathBuf> {
        let entries = std::fs::read_dir(self.images()).into_iter().flatten().flatten();
        let ours = entries.filter(|entry| is_picture(&entry.file_name().to_string_lossy()));
        ours.map(|entry| entry.path()).collect()
    }

    /// Removes the files that a killed process left half written. The folder is locked, so no other process writes such
    /// files.
    pub fn sweep(&self) {
        if !self.is_ours() {
            return;
        }
        let entries = std::fs::read_dir(self.images()).into_iter().flatten().flatten();
        let half = entries.map(|entry| entry.path()).filter(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name.strip_suffix(".trimip.tmp").is_some_and(is_picture)
        });
        for path in self.files().iter().map(|path| temporary_file(path)).chain(half) {
            // A file that cannot be removed only takes space.
            let _ = std::fs::remove_file(path);
        }
    }

    /// Protects a configuration file that a new run would overwrite with its effective settings.
    ///
    /// # Errors
    /// When `given` is the folder's `config.toml`, and no run wrote it.
    pub fn spare(&self, given: &Path) -> Result<()> {
        let same = std::fs::canonicalize(given).ok();
        if same.is_none() || same != std::fs::canonicalize(self.config()).ok() || self.is_ours() {
            return Ok(());
        }
        Err(Error::input(
            given.display(),
            "would be overwritten with the effective settings of the run",
            Advice::AnyOf(vec![Advice::OtherFolder, "choose another name for the file".into()]),
        ))
    }

    /// Reads the events written so far. Skips a line that a killed run left incomplete.
    pub fn events(&self) -> Vec<Event> {
        events_of(&plain_file::read(&self.metrics()).unwrap_or_default())
    }

    /// Replaces the events with `events` and opens the file for appending.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn restart_events(&self, events: &[Event]) -> Result<File> {
        let mut text = String::new();
        for event in events {
            text += &serde_json::to_string(event).map_err(Error::run)?;
            text.push('\n');
        }
        write_atomically(&self.metrics(), text.as_bytes())?;
        File::options()
            .append(true)
            .open(self.metrics())
            .map_err(|error| Error::input(self.metrics().display(), error, Advice::OtherFolder))
    }
}

/// Returns the events in the bytes of `metrics.jsonl`. Lines that are not events are skipped.
pub fn events_of(bytes: &[u8]) -> Vec<Event> {
    // A torn line may end within a UTF-8 character.
    let lines = bytes.split(|&byte| byte == b'\n');
    lines.filter_map(|line| serde_json::from_slice(line).ok()).collect()
}

/// Advice for a path at which a run or a model is expected.
const NAME_A_RUN: &str = "name the folder of a run, such as runs/quickstart, or a model file (.safetensors)";

/// Fails if there is nothing at the path of a run or a model.
///
/// # Errors
/// Of kind `Input`, if nothing is there.
pub fn expect_any(path: &Path) -> Result<()> {
    match path.exists() {
        true => Ok(()),
        false => Err(Error::input(path.display(), "there is no run or model of this name", NAME_A_RUN)),
    }
}

/// Reads the model of a run folder or a model file. For an unfinished run, reads the model of its checkpoint.
///
/// # Errors
/// When there is no model, or it is incomplete.
pub fn read_model(path: &Path) -> Result<Model> {
    expect_any(path)?;
    if !path.is_dir() {
        return Model::read(path);
    }
    let folder = RunFolder::new(path);
    if folder.model().exists() {
        return Model::read(&folder.model());
    }
    if !folder.checkpoint().exists() {
        return Err(Error::input(
            path.display(),
            "holds neither model.safetensors nor checkpoint.safetensors",
            NAME_A_RUN,
        ));
    }
    Ok(Checkpoint::read(&folder.checkpoint())?.into_model())
}

/// Returns true for the file name of a picture, a comparison or a map of FLIP errors whose stem [`picture_stem`] made.
fn is_picture(name: &str) -> bool {
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let Some(stem) = name.strip_suffix(".png") else { return false };
    let stem = ["_compare", "_flip"].iter().find_map(|end| stem.strip_suffix(end)).unwrap_or(stem);
    let Some((front, scale)) = stem.rsplit_once("_scale") else { return false };
    front.split_once('_').is_some_and(|(index, _)| index.len() >= 4 && digits(index)) && digits(scale)
}

/// Returns the name of a test view's picture, without extension.
pub fn picture_stem(index: usize, photograph: &str, scale: u32) -> String {
    format!("{index:04}_{photograph}_scale{scale}")
}

/// Creates a folder and its parents, and checks that files can be written there.
///
/// # Errors
/// When it cannot be written.
pub fn create_writable(folder: &Path) -> Result<()> {
    let attempt = || {
        std::fs::create_dir_all(folder)?;
        // A file without a name: it vanishes in whatever way the process ends.
        tempfile::tempfile_in(folder)?.write_all(b"x")
    };
    attempt().map_err(|error| {
        Error::input(
            folder.display(),
            format!("cannot write there: {error}"),
            "choose a folder that can be written",
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::fixtures::evaluation;
    use trimip_core::{
        Layout,
        engine::checkpoint::{OCCUPANCY_DENSITY, TrainState},
        field::{
            model::OCCUPANCY,
            tensors::{Tensor, TensorFile},
        },
    };

    /// Returns the checkpoint of a run that has not begun.
    fn untrained(config: &Config) -> Checkpoint {
        let (mut file, layout, cells) =
            (TensorFile::default(), Layout::new(config), config.occupancy.cells());
        let values = vec![0.0; layout.len()];
        ["", ".m", ".v"].iter().for_each(|suffix| layout.to_tensors(&values, suffix, &mut file));
        file.tensors.insert(OCCUPANCY.into(), Tensor::u8(&[cells / 8], vec![0; cells / 8]));
        file.tensors.insert(OCCUPANCY_DENSITY.into(), Tensor::f32(&[cells], vec![0.0; cells]));
        let state = TrainState { rays_per_step: 16, ..TrainState::default() };
        Checkpoint { config: config.clone(), state, file }
    }

    fn folder() -> (tempfile::TempDir, RunFolder) {
        let temporary = tempfile::tempdir().unwrap();
        let folder = RunFolder::new(&temporary.path().join("a/run"));
        folder.prepare().unwrap();
        (temporary, folder)
    }

    #[test]
    fn a_torn_last_line_of_events_is_passed_over() {
        let (_keep, folder) = folder();
        drop(folder.restart_events(&[evaluation(10, 1, false, 20.0)]).unwrap());
        let whole = std::fs::read(folder.metrics()).unwrap();
        // Half a line and half a character.
        let torn = [&whole[..], &whole[..whole.len() / 2], &"×".as_bytes()[..1]].concat();
        std::fs::write(folder.metrics(), torn).unwrap();
        assert_eq!(folder.events().len(), 1);
    }

    #[test]
    fn files_of_others_stay() {
        let (_keep, folder) = folder();
        folder.prepare_images().unwrap();
        let ours = [
            picture_stem(3, "r_3", 1),
            format!("{}_compare", picture_stem(12345, "a_scale_b", 16)),
            format!("{}_flip", picture_stem(3, "r_3", 2)),
        ];
        let theirs = ["r_3", "0001", "0001_scale", "a_0001_scale2", "0001_scale2_more"];
        let path = |stem: &str| folder.images().join(format!("{stem}.png"));
        for stem in ours.iter().map(String::as_str).chain(theirs) {
            std::fs::write(path(stem), "x").unwrap();
        }
        folder.clear().unwrap();
        assert!(ours.iter().all(|stem| !path(stem).exists()));
        assert!(theirs.iter().all(|stem| path(stem).exists()));

        std::fs::write(folder.config(), "seed = 1").unwrap();
        let error = folder.spare(&folder.config()).unwrap_err();
        assert!(
            error.kind() == trimip_core::ErrorKind::Input
                && error.message().contains("choose another folder"),
            "{}",
            error.message()
        );
        assert!(folder.spare(&folder.root().join("other.toml")).is_ok());
        drop(folder.restart_events(&[evaluation(10, 1, false, 20.0)]).unwrap());
        assert!(folder.spare(&folder.config()).is_ok(), "a run wrote it");
    }

    #[test]
    fn what_a_killed_process_left_half_written_is_swept_up_in_a_folder_of_a_run_alone() {
        let (_keep, folder) = folder();
        folder.prepare_images().unwrap();
        let picture = folder.images().join(format!("{}.png", picture_stem(3, "r_3", 1)));
        let files = folder.files().into_iter().chain([picture]);
        let half: Vec<_> = files.map(|path| temporary_file(&path)).collect();
        let theirs = [folder.root().join("notes.tmp"), folder.images().join("r_3.png.tmp")];
        half.iter().chain(&theirs).for_each(|path| std::fs::write(path, "x").unwrap());
        folder.sweep();
        assert!(half.iter().chain(&theirs).all(|path| path.exists()), "no run wrote this folder");
        drop(folder.restart_events(&[evaluation(10, 1, false, 20.0)]).unwrap());
        half.iter().for_each(|path| std::fs::write(path, "x").unwrap());
        folder.sweep();
        assert!(half.iter().all(|path| !path.exists()) && theirs.iter().all(|path| path.exists()));
    }

    #[test]
    fn a_checkpoint_of_other_settings_is_refused_and_kept() {
        let (_keep, folder) = folder();
        let mut config = Config::default();
        config.encoder.plane_size = 128;
        config.occupancy.resolution = 16;
        assert!(folder.resume_point(&config).unwrap().is_none());
        untrained(&config).write(&folder.checkpoint()).unwrap();
        assert!(folder.resume_point(&config).unwrap().is_some());
        let other = Config { seed: 1, ..config };
        let error = folder.resume_point(&other).unwrap_err();
        assert!(
            error.kind() == trimip_core::ErrorKind::Input
                && error.message().contains("seed")
                && error.message().contains("start the run over")
        );
        assert!(folder.checkpoint().exists());
        folder.clear().unwrap();
        assert!(folder.resume_point(&other).unwrap().is_none());
    }

    #[test]
    fn a_place_that_cannot_be_written_is_found_at_once() {
        let temporary = tempfile::tempdir().unwrap();
        let file = temporary.path().join("file");
        std::fs::write(&file, "x").unwrap();
        assert_eq!(
            RunFolder::new(&file.join("run")).prepare().unwrap_err().kind(),
            trimip_core::ErrorKind::Input
        );
    }
}
