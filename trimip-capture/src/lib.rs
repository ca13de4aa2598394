//! From a film or a folder of photographs to a scene with cameras, in five stages: pictures, features, matches, a model and a page. The
//! result of each stage is kept. Other programs do the computation; this crate finds them, chooses their options, monitors them and checks
//! their results.

#![forbid(unsafe_code)]

mod ability;
mod database;
mod decisions;
mod events;
mod folder;
mod frames;
mod grey;
pub mod guard;
mod models;
mod photographs;
mod pictures;
mod poses;
mod process;
pub mod programs;
mod request;
mod source;
mod unplaced;

pub use events::Event;
pub use process::{quoted, quoted_path};
pub use request::{Lens, Mapper, Matcher, PosesProgram, Request};

use decisions::Decisions;
use events::Teller;
use folder::{AGAIN, Done, Folder, Stage, digest, temporary, unwritable};
use models::Models;
use pictures::Pictures;
use poses::{Poses, Watching};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use source::{Found, Source};
use std::{
    fs,
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
    time::Instant,
};
use trimip::{Advice, Error, Place, Result, formatting::count};
use trimip_data::unwatched;
use trimip_report::inspect::UnplacedPicture;
use unplaced::Unplaced;

/// Maximum number of pictures without a pose that are listed in the terminal.
const NAMED: usize = 8;

/// A finished capture.
pub struct Captured {
    /// Folder of the capture, as a user would type it.
    pub root: PathBuf,
    /// Largest width and largest height of the pictures, pixels.
    pub size: [u32; 2],
}

/// The result of the model stage.
#[derive(Serialize, Deserialize)]
struct Placement {
    /// Digest of the pictures and the user's options. A later command compares it with its own.
    asked: Value,
    /// The program that placed the cameras.
    program: String,
    #[serde(flatten)]
    models: Models,
}

/// Makes the capture that `request` describes, and continues from the results of an earlier call. `events` receives every event. Setting
/// `stop` ends the call and the programs that it runs.
///
/// # Errors
/// When the input is refused, a program is missing or fails, or no camera can be placed; of kind `Stopped` after a stop.
pub fn run(request: &Request, stop: &AtomicBool, events: &dyn Fn(&Event<'_>)) -> Result<Captured> {
    let root = request.out.clone().unwrap_or_else(|| default_folder(&request.input));
    if root.to_str().is_none() {
        return Err(Error::input(root.display(), "the path is not UTF-8", Advice::OtherFolder));
    }
    expect_outside(&request.input, &root)?;
    let Found { source, notes } = source::find(&request.input)?;
    if matches!(source, Source::Photographs(_)) && request.frames.is_some() {
        return Err(Error::input(
            Place::option("frames"),
            "is for films, and these are photographs",
            "leave it out",
        ));
    }
    expect_programs(request, &source, &root)?;
    let input = request.input.canonicalize().unwrap_or_else(|_| request.input.clone());
    let folder = Folder::open(&root, &input)?;
    if request.fresh {
        folder.begin(Stage::Pictures)?;
    }
    let teller = Teller::new(events);
    notes.iter().for_each(|note| teller.note(note));
    Capture { request, folder, teller, stop }.whole(&source, &root)
}

/// Returns the default folder of a capture: `captures/` and the name of the input.
fn default_folder(input: &Path) -> PathBuf {
    let whole = input.canonicalize().unwrap_or_else(|_| input.to_path_buf());
    let name = if whole.is_dir() { whole.file_name() } else { whole.file_stem() };
    Path::new("captures").join(name.unwrap_or("capture".as_ref()))
}

/// Refuses to write into the folder that is captured, because the next command would treat the written pictures as photographs.
fn expect_outside(input: &Path, root: &Path) -> Result<()> {
    let (Ok(input), Ok(whole)) = (input.canonicalize(), std::path::absolute(root)) else { return Ok(()) };
    // The nearest parent folder that exists.
    let above = whole.ancestors().find_map(|folder| folder.canonicalize().ok());
    if !input.is_dir() || !above.is_some_and(|folder| folder.starts_with(&input)) {
        return Ok(());
    }
    Err(Error::input(
        root.display(),
        "lies in the folder that is captured",
        Advice::Argument("name a folder outside with {out}, or run the command in another folder".into()),
    ))
}

/// Fails, before anything is written, if options contradict each other or if a stage that is not done needs a missing program.
fn expect_programs(request: &Request, source: &Source, root: &Path) -> Result<()> {
    let is_done = |stage: Stage| !request.fresh && folder::state(root, stage).is_file();
    if let Source::Film(film) = source
        && !is_done(Stage::Pictures)
    {
        programs::expect("ffmpeg", programs::Need::Films, film.display())?;
        programs::expect("ffprobe", programs::Need::Films, film.display())?;
    }
    if !is_done(Stage::Model) {
        let poses = Poses::find(request.poses, None, &request.input)?;
        decisions::expect(request, &poses.ability())?;
    }
    Ok(())
}

/// A capture in progress.
struct Capture<'a> {
    request: &'a Request,
    folder: Folder,
    teller: Teller<'a>,
    stop: &'a AtomicBool,
}

impl Capture<'_> {
    fn whole(&self, source: &Source, root: &Path) -> Result<Captured> {
        let pictures = self.pictures(source)?;
        let placement = self.placement(&pictures)?;
        let unplaced = self.tell(&pictures, &placement);
        self.page(root, &pictures, &placement, &unplaced)?;
        let [width, height] = pictures.pictures.iter().fold([0, 0], |largest, picture| {
            [largest[0].max(picture.size[0]), largest[1].max(picture.size[1])]
        });
        Ok(Captured { root: root.into(), size: [width, height] })
    }

    /// Returns the result of a stage: the stored one if it has the same inputs, otherwise the result of `work`.
    fn stage<T: Serialize + serde::de::DeserializeOwned>(
        &self,
        stage: Stage,
        doing: &str,
        inputs: Value,
        is_whole: impl Fn(&T) -> bool,
        work: impl FnOnce() -> Result<T>,
    ) -> Result<T> {
        if let Some(done) = self.folder.done::<T>(stage)
            && done.inputs == inputs
            && is_whole(&done.result)
        {
            self.teller.done(stage.name(), done.seconds, true);
            return Ok(done.result);
        }
        self.folder.begin(stage)?;
        self.teller.begin(stage.name(), doing);
        let started = Instant::now();
        let result = work()?;
        let done = Done { inputs, seconds: started.elapsed().as_secs_f64(), result };
        self.folder.finish(stage, &done)?;
        self.teller.done(stage.name(), done.seconds, false);
        Ok(done.result)
    }

    fn pictures(&self, source: &Source) -> Result<Pictures> {
        let bytes = |path: &Path| fs::metadata(path).map_or(0, |found| found.len());
        let inputs = match source {
            Source::Film(film) => {
                let name = film.file_name().unwrap_or_default().to_string_lossy();
                json!({ "film": name, "bytes": bytes(film), "frames": self.request.frames })
            }
            Source::Photographs(all) => {
                let listed = |photograph: &source::Photograph| {
                    json!([photograph.name.to_string_lossy(), bytes(&photograph.path)])
                };
                json!({ "photographs": all.iter().map(listed).collect::<Vec<_>>() })
            }
        };
        let part = temporary("images");
        let images = self.folder.path("images");
        let work = || {
            let mut pictures = match source {
                Source::Film(film) => {
                    let request =
                        frames::Request { film, frames: self.request.frames, threads: self.request.threads };
                    let mut tell = |line: &str| self.teller.note(line);
                    let mut progress =
                        |doing: &'static str, done, total| self.teller.progress(doing, done, total);
                    frames::take(&request, &self.folder, &part, self.stop, &mut tell, &mut progress)?
                }
                Source::Photographs(all) => {
                    let log = self.folder.log("convert");
                    let mut progress = |done, total| self.teller.progress("photographs", done, total);
                    photographs::make(all, self.folder.root(), &part, &log, self.stop, &mut progress)?
                }
            };
            self.folder.keep("images")?;
            pictures.pictures.sort_by(|a, b| a.name.cmp(&b.name));
            Ok(pictures)
        };
        let pictures = self.stage(
            Stage::Pictures,
            "pictures",
            inputs,
            |pictures: &Pictures| pictures.are_in(&images),
            work,
        )?;
        let [width, height] = pictures.pictures.first().map_or([0, 0], |picture| picture.size);
        let by = pictures.converted_by.as_ref().map_or(String::new(), |by| format!(", converted by {by}"));
        self.teller.note(&format!(
            "pictures: {}, the first of {width}×{height}{by}, in {}",
            count(pictures.pictures.len() as u64, "picture"),
            images.display()
        ));
        if !pictures.of_film {
            pictures.notes.iter().for_each(|note| self.teller.note(note));
        }
        for left in pictures.left_out.iter().take(NAMED) {
            self.teller.note(&format!("left out: {}: {}", left.name, left.reason));
        }
        if pictures.left_out.len() > NAMED {
            self.teller.note(&format!("left out: {} more", pictures.left_out.len() - NAMED));
        }
        Ok(pictures)
    }

    /// Computes features, matches and a model.
    fn placement(&self, pictures: &Pictures) -> Result<Placement> {
        let asked = self.asked(pictures)?;
        let earlier =
            [Stage::Features, Stage::Matches].iter().all(|stage| self.folder.done::<Value>(*stage).is_some());
        if let Some(done) =
            self.folder.done::<Placement>(Stage::Model).filter(|done| earlier && done.result.asked == asked)
        {
            self.teller.done(Stage::Model.name(), done.seconds, true);
            return Ok(done.result);
        }
        let poses = Poses::find(self.request.poses, self.began_with(), &self.request.input)?;
        let decisions = decisions::decide(self.request, pictures, &poses.ability())?;
        let hint = poses.hint().map_or(String::new(), |hint| format!("; {hint}"));
        self.teller.note(&format!("poses: by {}{hint}", poses.name()));
        decisions.lines.iter().for_each(|line| self.teller.note(line));

        let inputs = json!({
            "pictures": digest(&pictures.pictures)?,
            "program": poses.name(),
            "camera": decisions.camera,
            "cameras": decisions.cameras,
            "size": decisions.size,
            "gpu": decisions.gpu,
        });
        let features = digest(&inputs)?;
        let part = temporary("features.db");
        self.stage(
            Stage::Features,
            "features",
            inputs,
            |_: &Value| true,
            || {
                let mut progress = |done, total| self.teller.progress("features", done, total);
                let mut watching = Watching { stop: self.stop, progress: &mut progress };
                poses.features(&self.folder, &part, pictures, &decisions, &mut watching)?;
                self.folder.keep_database("features.db").map(|()| Value::Null)
            },
        )?;

        let inputs = json!({ "features": features, "pairs": decisions.pairs });
        let matches = digest(&inputs)?;
        self.stage(
            Stage::Matches,
            "matches",
            inputs,
            |_: &Value| true,
            || self.match_pairs(&poses, pictures, &decisions).map(|()| Value::Null),
        )?;

        let program = poses.mapper_name(&decisions);
        let inputs = json!({ "matches": matches, "program": program, "global": decisions.global });
        self.stage(
            Stage::Model,
            "cameras",
            inputs,
            |_: &Placement| true,
            || {
                let models = self.place(&poses, pictures, &decisions)?;
                Ok(Placement { asked, program, models })
            },
        )
    }

    /// Returns the digest of the pictures and the options that affect their cameras.
    fn asked(&self, pictures: &Pictures) -> Result<Value> {
        let Request { poses, camera, matcher, vocab_tree, mapper, size, .. } = self.request;
        let options = format!("{poses:?} {camera:?} {matcher:?} {vocab_tree:?} {mapper:?} {size:?}");
        Ok(json!({ "pictures": digest(&pictures.pictures)?, "options": options }))
    }

    /// Returns the program that computed the stored features, if there are any.
    fn began_with(&self) -> Option<PosesProgram> {
        let done = self.folder.done::<Value>(Stage::Features)?;
        let program = done.inputs["program"].as_str()?;
        Some(if program.starts_with("pycolmap") { PosesProgram::Pycolmap } else { PosesProgram::Colmap })
    }

    fn match_pairs(&self, poses: &Poses, pictures: &Pictures, decisions: &Decisions) -> Result<()> {
        let part = temporary("database.db");
        for end in ["", "-wal"] {
            let (from, to) =
                (self.folder.path(&format!("features.db{end}")), self.folder.path(&format!("{part}{end}")));
            if from.exists() {
                fs::copy(&from, &to).map_err(|error| unwritable(&to, &error))?;
            }
        }
        let mut progress = |done, total| self.teller.progress("matches", done, total);
        let mut watching = Watching { stop: self.stop, progress: &mut progress };
        poses.matches(&self.folder, &part, pictures, decisions, &mut watching)?;
        self.folder.keep_database("database.db")
    }

    fn place(&self, poses: &Poses, pictures: &Pictures, decisions: &Decisions) -> Result<Models> {
        let mut models = self.models(poses, pictures, decisions, "models")?;
        if let Some(lost) = models.lost()
            && let Some(decisions) = decisions.without_distortion()
        {
            self.teller.note(&format!("cameras: {lost}; all are placed once more, without lens distortion"));
            let others = self.models(poses, pictures, &decisions, AGAIN)?;
            if others.sound() > models.sound() {
                self.folder.replace("models", AGAIN)?;
                models = others;
            } else {
                self.folder.discard(AGAIN)?;
            }
        }
        let Some(best) = models.models.first() else { return Err(poses.placed_nothing(&self.folder)) };
        self.folder.keep("models")?;
        let sparse = self.folder.temporary("sparse");
        models::copy(&self.folder.path("models").join(&best.folder), &sparse.join("0"))?;
        self.folder.keep("sparse")?;
        Ok(models)
    }

    /// Runs the mapper into the temporary folder of `output` and reads the models that it writes.
    fn models(
        &self,
        poses: &Poses,
        pictures: &Pictures,
        decisions: &Decisions,
        output: &str,
    ) -> Result<Models> {
        let part = &temporary(output);
        let mut progress = |done, total| self.teller.progress("cameras", done, total);
        let mut watching = Watching { stop: self.stop, progress: &mut progress };
        poses.model(&self.folder, part, pictures, decisions, &mut watching)?;
        models::read(&self.folder.path(part))
    }

    /// Reports the placed cameras; returns the pictures without a camera, with reasons.
    fn tell(&self, pictures: &Pictures, placement: &Placement) -> Vec<Unplaced> {
        let models = &placement.models;
        let Some(best) = models.models.first() else { return Vec::new() };
        let all = pictures.pictures.len();
        let error = best.error.map_or(String::new(), |error| format!(", mean error {error:.2} pixels"));
        let placed = best.sound();
        self.teller.note(&format!(
            "cameras: {placed} of {} placed by {}, {}{error}",
            count(all as u64, "picture"),
            placement.program,
            count(best.points as u64, "point")
        ));
        if models.models.len() > 1 {
            let sizes: Vec<String> = models
                .models
                .iter()
                .map(|model| format!("{} ({})", model.pictures.len(), model.folder))
                .collect();
            self.teller.note(&format!(
                "models: {} with {} pictures, which share too little with each other; the largest is used",
                models.models.len(),
                sizes.join(", ")
            ));
        }
        let unplaced =
            unplaced::find(pictures, models, &self.folder.path("images"), &self.folder.path("database.db"));
        for one in unplaced.iter().take(NAMED) {
            self.teller.note(&format!("not placed: {} ({}): {}", one.name, one.source, one.reason));
        }
        if unplaced.len() > NAMED {
            let more = unplaced.len() - NAMED;
            self.teller.note(&format!(
                "not placed: {more} more, listed in {}",
                self.folder.path("inspect.html").display()
            ));
        }
        if 2 * placed < all {
            self.teller.note(
                "warning: less than half of the pictures have a camera: take more pictures with more overlap, or try the matcher `exhaustive`",
            );
        }
        unplaced
    }

    /// Writes the page with the results.
    fn page(
        &self,
        root: &Path,
        pictures: &Pictures,
        placement: &Placement,
        unplaced: &[Unplaced],
    ) -> Result<()> {
        let inputs = json!({ "asked": placement.asked, "models": digest(&placement.models)? });
        let path = self.folder.path("inspect.html");
        self.stage(
            Stage::Page,
            "photographs",
            inputs,
            |_: &Value| true,
            || {
                let settings = trimip::settings::defaults().with("data.root", root.display().to_string())?;
                let seen = trimip::inspect::inspect(settings, &unwatched)?;
                let images = self.folder.path("images");
                let of_unplaced = |one: &Unplaced| UnplacedPicture {
                    name: one.name.clone(),
                    path: Some(images.join(&one.name)),
                    reason: format!("{}: {}", one.source, one.reason),
                };
                let of_left_out = |left: &pictures::LeftOut| UnplacedPicture {
                    name: left.name.clone(),
                    path: None,
                    reason: left.reason.clone(),
                };
                let all: Vec<UnplacedPicture> = unplaced
                    .iter()
                    .map(of_unplaced)
                    .chain(pictures.left_out.iter().map(of_left_out))
                    .collect();
                let page = trimip_report::inspect::page_with(&seen, &all)?;
                trimip_report::save(&path, &page)?;
                Ok(Value::Null)
            },
        )?;
        self.teller.note(&format!("page: {}", path.display()));
        Ok(())
    }
}
