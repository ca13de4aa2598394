//! Estimates the poses of pictures with other programs, in three stages: features, matches, a model. COLMAP is called and not linked: it is
//! a large C++ program with its own solvers and GPU code, prebuilt packages exist for every system, and it writes its results to files that
//! this program can read anyway.

mod colmap;
mod counts;
mod python;

use super::{
    ability::Ability,
    decisions::{Decisions, Pairs},
    folder::Folder,
    pictures::Pictures,
    process::{self, Call},
    programs::{self, Need},
};
use crate::PosesProgram;
use colmap::Colmap;
use counts::Counter;
use python::Python;
use std::{
    fs,
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};
use trimip::{Error, Place, Result};

/// The programs that estimate poses.
pub struct Poses {
    /// Finds features and matches, and places cameras unless glomap does.
    engine: Engine,
    /// Path of glomap, which can place the cameras instead of `engine`.
    glomap: Option<PathBuf>,
    /// True if the user requested glomap.
    only_glomap: bool,
}

enum Engine {
    Colmap(Colmap),
    Python(Python),
}

/// Control of a running stage: a flag that stops it, and a callback for its progress.
pub struct Watching<'a> {
    /// Set when the user stops the capture.
    pub stop: &'a AtomicBool,
    /// Receives the number of items done and their total.
    pub progress: &'a mut dyn FnMut(u64, u64),
}

impl Poses {
    /// Finds the program `wanted`. If it is `None`, the order is: the program that computed the features of this capture (`began`), colmap,
    /// pycolmap. A pycolmap of version 4 or later is preferred to a colmap before version 4, whose matching takes several times as long on
    /// a CPU. Error messages name `place`, the input.
    ///
    /// # Errors
    /// Of kind `Input`; the message has the command that installs what is missing.
    pub fn find(wanted: Option<PosesProgram>, began: Option<PosesProgram>, place: &Path) -> Result<Self> {
        let glomap = programs::find("glomap");
        let only_glomap = wanted == Some(PosesProgram::Glomap);
        if only_glomap && glomap.is_none() {
            return Err(Need::Glomap.missing(Place::argument("poses", "glomap")));
        }
        let colmap = || Colmap::find().map(Engine::Colmap);
        let python = || Python::find().map(Engine::Python);
        let engine = match wanted {
            Some(PosesProgram::Colmap) => {
                colmap().ok_or_else(|| Need::Colmap.missing(Place::argument("poses", "colmap")))
            }
            Some(PosesProgram::Pycolmap) => {
                python().ok_or_else(|| Need::Pycolmap.missing(Place::argument("poses", "pycolmap")))
            }
            // glomap only places cameras; another program must find features and matches.
            _ if began == Some(PosesProgram::Pycolmap) => {
                python().or_else(colmap).ok_or_else(|| Need::Poses.missing(place.display()))
            }
            _ => {
                let old = Colmap::find();
                let new = match &old {
                    Some(colmap) if is_old(&colmap.version) && began.is_none() => {
                        Python::find().filter(|python| !is_old(&python.version))
                    }
                    Some(_) => None,
                    None => Python::find(),
                };
                let engine = new.map(Engine::Python).or(old.map(Engine::Colmap));
                engine.ok_or_else(|| Need::Poses.missing(place.display()))
            }
        };
        let glomap = glomap.filter(|_| wanted.is_none() || only_glomap);
        Ok(Self { engine: engine?, glomap, only_glomap })
    }

    /// Returns the name and version of the program that finds features and matches.
    pub fn name(&self) -> &str {
        match &self.engine {
            Engine::Colmap(colmap) => &colmap.version,
            Engine::Python(python) => &python.version,
        }
    }

    /// Returns a hint about a faster program, if this one is slow.
    pub fn hint(&self) -> Option<&'static str> {
        let is_slow =
            matches!(&self.engine, Engine::Colmap(colmap) if is_old(&colmap.version) && !colmap.has_cuda);
        is_slow
            .then_some("pip install pycolmap installs version 4, which takes a fraction of the time on a CPU")
    }

    /// Returns the abilities of these programs.
    pub fn ability(&self) -> Ability {
        let (own, gpu, why_no_gpu) = match &self.engine {
            Engine::Colmap(colmap) => {
                (colmap.has_global, colmap.has_cuda, "this COLMAP is built without CUDA")
            }
            Engine::Python(python) => {
                (python.has_global, python.has_cuda, "this pycolmap is built without CUDA")
            }
        };
        let has_gpu = gpu && has_nvidia();
        Ability {
            name: self.name().into(),
            global: own || self.glomap.is_some(),
            only_global: self.only_glomap,
            gpu: has_gpu,
            why_no_gpu: if gpu { "this machine has no NVIDIA GPU".into() } else { why_no_gpu.into() },
        }
    }

    /// Returns the name of the program that places the cameras.
    pub fn mapper_name(&self, decisions: &Decisions) -> String {
        match self.glomap_of(decisions) {
            Some(_) => "glomap".into(),
            None => self.name().into(),
        }
    }

    /// Returns the path of glomap, if it places the cameras.
    fn glomap_of(&self, decisions: &Decisions) -> Option<&Path> {
        let own = match &self.engine {
            Engine::Colmap(colmap) => colmap.has_global,
            Engine::Python(python) => python.has_global,
        };
        self.glomap.as_deref().filter(|_| decisions.global && (self.only_glomap || !own))
    }

    /// Finds the features of all pictures and writes them to the new file `database` of the folder.
    ///
    /// # Errors
    /// When the program fails.
    pub fn features(
        &self,
        folder: &Folder,
        database: &str,
        pictures: &Pictures,
        decisions: &Decisions,
        watching: &mut Watching<'_>,
    ) -> Result<()> {
        let all = pictures.pictures.len() as u64;
        let call = match &self.engine {
            Engine::Colmap(colmap) => colmap.features(folder, database, decisions),
            Engine::Python(python) => python.features(folder, database, decisions)?,
        };
        run(&call, Counter::features(all), watching)
    }

    /// Compares pairs of pictures and adds the matches to `database` of the folder.
    ///
    /// # Errors
    /// When a program fails.
    pub fn matches(
        &self,
        folder: &Folder,
        database: &str,
        pictures: &Pictures,
        decisions: &Decisions,
        watching: &mut Watching<'_>,
    ) -> Result<()> {
        let call = match &self.engine {
            Engine::Colmap(colmap) => colmap.matches(folder, database, decisions),
            Engine::Python(python) => python.matches(folder, database, decisions)?,
        };
        run(&call, Counter::matches(), watching)?;
        let Pairs::Sequential { every: every @ 1.., .. } = decisions.pairs else { return Ok(()) };
        // Pictures far apart in the film may show the same place, so a second pass compares evenly spread pictures.
        let list = "log/pairs.txt";
        let spread: Vec<&str> =
            pictures.pictures.iter().step_by(every).map(|picture| picture.name.as_str()).collect();
        let mut text = String::new();
        for (index, first) in spread.iter().enumerate() {
            for second in &spread[index + 1..] {
                text += &format!("{first} {second}\n");
            }
        }
        let path = folder.path(list);
        fs::write(&path, text).map_err(|error| super::folder::unwritable(&path, &error))?;
        let call = match &self.engine {
            Engine::Colmap(colmap) => colmap.loops(folder, database, list, decisions),
            Engine::Python(python) => python.loops(folder, database, list, decisions)?,
        };
        run(&call, Counter::matches(), watching)
    }

    /// Places cameras. Writes each model to a numbered folder in the new folder `models`.
    ///
    /// # Errors
    /// When the program fails for any reason other than finding no model.
    pub fn model(
        &self,
        folder: &Folder,
        models: &str,
        pictures: &Pictures,
        decisions: &Decisions,
        watching: &mut Watching<'_>,
    ) -> Result<()> {
        let path = folder.path(models);
        fs::create_dir_all(&path).map_err(|error| super::folder::unwritable(&path, &error))?;
        let all = pictures.pictures.len() as u64;
        let call = match (self.glomap_of(decisions), &self.engine) {
            (Some(glomap), _) => colmap::glomap(folder, glomap, models),
            (None, Engine::Colmap(colmap)) => colmap.model(folder, models, decisions),
            (None, Engine::Python(python)) => python.model(folder, models, decisions)?,
        };
        let mut counter = Counter::model(all);
        let ended = call.run_to_end(watching.stop, &mut |line: &str| {
            if let Some((done, all)) = counter.count(line) {
                (watching.progress)(done, all);
            }
            true
        })?;
        // COLMAP reports failure if no camera can be placed.
        if ended.is_success() || counter.found_nothing() {
            return Ok(());
        }
        Err(call.failed(&ended))
    }

    /// Returns the error for a capture in which no camera could be placed.
    pub fn placed_nothing(&self, folder: &Folder) -> Error {
        Error::input(
            folder.path("images").display(),
            format!("{} placed none of these pictures", self.name()),
            format!(
                "take more and sharper ones with more overlap, or try the matcher `exhaustive`; the output of the mapper is in {}",
                folder.log("model").display()
            ),
        )
    }
}

/// Returns true for a version before 4, such as `colmap 3.8`: these versions match features much more slowly.
fn is_old(version: &str) -> bool {
    let number = version.split_whitespace().nth(1).and_then(|number| number.split('.').next());
    number.and_then(|major| major.parse::<u32>().ok()).is_some_and(|major| major < 4)
}

fn run(call: &Call<'_>, mut counter: Counter, watching: &mut Watching<'_>) -> Result<()> {
    let progress = &mut watching.progress;
    call.run(watching.stop, &mut |line: &str| {
        if let Some((done, all)) = counter.count(line) {
            progress(done, all);
        }
        true
    })
    .map(drop)
}

/// Returns true if NVIDIA's driver lists a GPU.
fn has_nvidia() -> bool {
    let lists = programs::find("nvidia-smi").and_then(|program| process::ask(&program, &["-L"]));
    lists.is_some_and(|list| list.contains("GPU "))
}
