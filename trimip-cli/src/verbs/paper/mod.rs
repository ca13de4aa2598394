//! `paper`: trains the systems of the paper's tables on the same scenes, splits and seeds, and compares them with each other and with the
//! published figures. Every run has a run folder, so the same command resumes an interrupted one. The pages are rewritten after every run.
//! A run that fails is reported and does not end the others.

mod plan;
mod request;

use crate::args::{PaperArguments, ProgressStyle};
use crate::curves::aligned;
use crate::interrupt;
use crate::{
    ranks, terminal,
    verbs::{jobs, train},
};
use request::{PaperRun, Request};
use std::sync::atomic::Ordering;
use trimip::ranks::{digest, work_on_jobs};
use trimip::run::{folder::create_writable, history::History};
use trimip::{Error, ErrorKind, Outcome, Result, RunFolder, Trained, Training, machine, systems::SYSTEMS};
use trimip_core::engine::exchange::Ranks;
use trimip_report::comparison::{
    Comparison, Figures, Run, Scales, Status, TableRow, columns, json, latex, markdown,
};
use trimip_report::{paper as page, save};

/// Trains the runs that are not trained yet, measures them, and writes the pages.
pub fn run(arguments: &PaperArguments) -> Result<u8> {
    if arguments.list {
        terminal::line(list());
        return Ok(0);
    }
    let request = Request::new(arguments)?;
    plan::lines(&request).iter().for_each(terminal::aside);
    create_writable(&request.out)?;
    // Without the lock, two processes would write the same page and train the same runs.
    let _held = RunFolder::new(&request.out).lock()?;
    let mut comparison = request.comparison();
    let stop = interrupt::install()?;
    if let Some(ranks) = ranks::all() {
        // The loop below then finds these runs trained, and only measures them.
        let waiting: Vec<usize> =
            (0..request.jobs.len()).filter(|&i| !request.jobs[i].is_trained()).collect();
        if !jobs::spread(
            &*ranks,
            &request.digest(),
            &waiting,
            |i| request.jobs[i].config.section(),
            |i| Ok(request.jobs[i].training()),
        )? {
            return Ok(interrupt::EXIT_CODE);
        }
    }
    for (i, job) in request.jobs.iter().enumerate() {
        terminal::aside(format!("run {} of {}: {}", i + 1, request.jobs.len(), job.name()));
        let (status, figures) = carry_out(job);
        if let Status::Failed(reason) = &status {
            terminal::aside(format!("failed: {}: {reason}", job.name()));
        }
        let stopped = status == Status::Stopped || stop.load(Ordering::Relaxed);
        (comparison.runs[i].status, comparison.runs[i].figures) = (status, figures);
        write(&request, &comparison)?;
        if stopped {
            terminal::aside(format!("page so far: {}; the same command resumes", request.page().display()));
            return Ok(interrupt::EXIT_CODE);
        }
    }
    for &scales in &comparison.scales {
        let rows = match &comparison.scenes[..] {
            [scene] => comparison.scene_rows(scales, scene),
            _ => comparison.whole_rows(scales),
        };
        terminal::line(table(scales, &rows));
    }
    terminal::aside(format!("page: {}", request.page().display()));
    let failed = comparison.failed().count();
    match comparison.failed().next() {
        None => Ok(0),
        Some((run, reason)) => Err(Error::run(format!(
            "{failed} of {} failed, the first is {}: {reason}",
            terminal::count(comparison.runs.len() as u64, "run"),
            run.folder.display()
        ))),
    }
}

/// Does this rank's part of [`run`]; called on ranks other than 0.
///
/// # Errors
/// When a scene or a setting is wrong.
pub fn work(arguments: &PaperArguments, ranks: &dyn Ranks) -> Result<()> {
    let request = Request::new(arguments)?;
    work_on_jobs(ranks, &request.digest(), |i| Ok(jobs::job(ranks, Ok(request.jobs[i].training()))))
}

impl PaperRun {
    /// Returns true if the run is trained, whether or not it has been measured.
    fn is_trained(&self) -> bool {
        History::of(&self.folder.events()).finished
    }

    fn training(&self) -> Training {
        Training::new(self.training.clone(), self.folder.root())
    }
}

/// Trains and measures a run, unless it is finished. Returns its status and, if it was measured, its figures.
fn carry_out(job: &PaperRun) -> (Status, Option<Figures>) {
    let style = if terminal::watched() { ProgressStyle::Bar } else { ProgressStyle::Json };
    machine::reset_peak_memory();
    if !job.is_trained() {
        let trained = train::train(job.training(), style);
        let whole = |trained: &Trained| {
            matches!(trained.outcome, Ok(Outcome::Finished | Outcome::AlreadyComplete))
                && trained.unwritten.is_none()
        };
        if !trained.as_ref().is_ok_and(whole) {
            return concluded(trained, style);
        }
    }
    concluded(train::train(Training::new(job.measuring.clone(), job.folder.root()), style), style)
}

/// Returns the status and the figures of a training that has ended.
fn concluded(trained: Result<Trained>, style: ProgressStyle) -> (Status, Option<Figures>) {
    let failed = |error: Error| match error.kind() {
        ErrorKind::Stopped => Status::Stopped,
        _ => Status::Failed(error.message()),
    };
    match trained {
        Err(error) => (failed(error), None),
        Ok(trained) => {
            let status = match train::conclude(&trained, style) {
                Ok(0) => Status::Finished,
                Ok(_) => Status::Stopped,
                Err(error) => failed(error),
            };
            (status, Figures::of(&trained))
        }
    }
}

/// Writes the page, the JSON, the Markdown and the LaTeX.
fn write(request: &Request, comparison: &Comparison) -> Result<()> {
    save(&request.out.join("paper.json"), &json(comparison)?)?;
    save(&request.out.join("paper.md"), &markdown(comparison))?;
    save(&request.out.join("paper.tex"), &latex(comparison))?;
    save(&request.page(), &page::page(comparison)?)
}

impl Request {
    /// Returns a digest that is equal on all ranks with the same jobs.
    fn digest(&self) -> String {
        let job = |job: &PaperRun| format!("{} {:?}", job.config.to_toml(), job.folder.root());
        digest(self.jobs.iter().map(job))
    }

    /// Returns the comparison before the first run.
    fn comparison(&self) -> Comparison {
        let run = |job: &PaperRun| Run {
            scales: job.scales,
            scene: job.scene.clone(),
            system: job.system.name,
            seed: job.seed,
            folder: job.folder.root().to_path_buf(),
            status: Status::Waiting,
            figures: None,
        };
        Comparison {
            systems: self.systems.clone(),
            scenes: self.scenes.iter().map(|scene| scene.name.clone()).collect(),
            missing: self.missing.clone(),
            scales: self.scales.clone(),
            split: self.split.iter().map(|split| (*split).to_string()).collect(),
            budget: self.budget(),
            runs: self.jobs.iter().map(run).collect(),
            machine: machine::Machine::detect(),
            command: trimip::run::provenance::here_and_now(0).command,
        }
    }
}

/// Returns the table of systems for a terminal.
fn list() -> String {
    let mut rows = vec![["name", "system", "kind", "compared with"].map(String::from).to_vec()];
    rows.extend(SYSTEMS.iter().map(|system| {
        vec![
            system.name.to_string(),
            system.title.to_string(),
            system.kind.word().to_string(),
            system.beside.unwrap_or("–").to_string(),
        ]
    }));
    // All columns are text and therefore left-aligned.
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..4).map(width).collect();
    let line = |row: &Vec<String>| {
        let cells: Vec<String> =
            row.iter().zip(&widths).map(|(cell, width)| format!("{cell:width$}", width = *width)).collect();
        cells.join("  ").trim_end().to_string()
    };
    let mut text: Vec<String> = rows.iter().map(line).collect();
    text.push(String::new());
    text.push("Differences from the published systems:".into());
    text.extend(SYSTEMS.iter().map(|system| format!("  {}: {}", system.name, system.differs)));
    text.join("\n")
}

/// Returns a table of results for a terminal.
fn table(scales: Scales, rows: &[TableRow]) -> String {
    let columns = columns(scales, rows);
    let mut cells = vec![vec![scales.title().to_string()]];
    cells[0].extend(columns.iter().map(|column| column.head.clone()));
    cells.extend(rows.iter().map(|row| {
        let texts = columns.iter().map(|column| (column.text)(row));
        std::iter::once(row.title.to_string()).chain(texts).collect::<Vec<_>>()
    }));
    aligned(&cells)
}
