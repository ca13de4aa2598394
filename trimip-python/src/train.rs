//! `trimip.train`, and the run that it returns.

use crate::calls::detached;
use crate::error::{raised, refused};
use crate::listening::Listener;
use crate::model::Model;
use crate::value;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use trimip::report::{Status, text};
use trimip::run::Recorded;
use trimip::{Listeners, Outcome, Settings, Training, events::Event};

/// A training run: its folder, how it ended, and its measures.
#[pyclass(frozen, module = "trimip")]
pub struct Run {
    recorded: Recorded,
    ended: Outcome,
}

#[pymethods]
impl Run {
    /// Opens the run of a folder that this package or trimip-cli trained. Its photographs are not needed.
    #[staticmethod]
    fn load(py: Python<'_>, folder: PathBuf) -> PyResult<Self> {
        let recorded = detached(py, || Recorded::open(&folder))?.map_err(raised)?;
        let ended =
            if recorded.status == Status::Stopped { Outcome::Stopped } else { Outcome::AlreadyComplete };
        Ok(Self { recorded, ended })
    }

    /// The run folder.
    #[getter]
    fn folder(&self) -> &Path {
        self.recorded.folder.root()
    }

    /// How the run ended: "finished", "stopped", or "before" if the folder already held the finished run and nothing was done.
    #[getter]
    fn ended(&self) -> &'static str {
        match self.ended {
            Outcome::Finished => "finished",
            Outcome::Stopped => "stopped",
            Outcome::AlreadyComplete => "before",
        }
    }

    /// All settings, including those that the scene plan decided, as nested dictionaries.
    #[getter]
    fn config<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        value::python(py, &self.recorded.settings)
    }

    /// The evaluations in order: dictionaries with `step`, `seconds`, `samples`, `psnr` (dB), `ssim`, `scales` and `last`.
    #[getter]
    fn evaluations<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        value::python(py, &evaluations(&self.recorded))
    }

    /// The verdict on the model in one line: its grade, the mean PSNR with the views and scales behind it, and possible remedies.
    #[getter]
    fn verdict(&self) -> String {
        self.recorded.report().verdict().words()
    }

    /// Returns the measures per scale as a LaTeX `tabular`, as in report.tex.
    fn to_latex(&self) -> String {
        text::latex(&self.recorded.report())
    }

    /// Returns the measures per scale as a Markdown table, as in report.md.
    fn to_markdown(&self) -> String {
        text::markdown(&self.recorded.report())
    }

    /// Rewrites the report, as after training: report.html with its pictures, report.json, tables. Returns the path of report.html.
    fn report(&self, py: Python<'_>) -> PyResult<PathBuf> {
        detached(py, || trimip_report::write(&self.recorded))?.map_err(raised)?;
        Ok(self.recorded.folder.html())
    }

    /// Loads the trained model.
    fn model(&self, py: Python<'_>) -> PyResult<Model> {
        let model = detached(py, || trimip::read_model(self.recorded.folder.root()))?.map_err(raised)?;
        Model::open(py, model)
    }

    fn __repr__(&self) -> String {
        format!("Run({:?}, {})", self.folder().display().to_string(), self.ended())
    }
}

/// Merges the settings of a system, then of a file or a dictionary, then of another dictionary; also returns the default run folder.
fn given(
    config: Option<&Bound<'_, PyAny>>,
    settings: Option<&Bound<'_, PyDict>>,
    system: Option<&str>,
) -> PyResult<(Settings, PathBuf)> {
    let mut all = trimip::settings::defaults();
    let mut name = None;
    if let Some(system) = system {
        trimip::systems::find(system).and_then(|system| system.apply(&mut all)).map_err(raised)?;
        name = Some(system.to_string());
    }
    if let Some(config) = config {
        if let Ok(values) = config.cast::<PyDict>() {
            value::apply(&mut all, values)?;
        } else {
            let path: PathBuf = config.extract().map_err(|_| {
                refused(
                    "config",
                    "neither a dictionary nor a path",
                    "give settings, or a configuration file (TOML)",
                )
            })?;
            let text =
                trimip_core::text::read(&path, "name an existing configuration file").map_err(raised)?;
            all.apply_file(&path.display().to_string(), &text).map_err(raised)?;
            name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        }
    }
    if let Some(settings) = settings {
        value::apply(&mut all, settings)?;
    }
    let root = trimip::Config::from_settings(&all).map_err(raised)?.data.root;
    let scene = match Path::new(&root) {
        archive if trimip::data::is_archive(archive) => archive.file_stem(),
        folder => folder.file_name(),
    };
    let scene = scene.map(|name| name.to_string_lossy().into_owned());
    let name = name.or(scene).unwrap_or_else(|| "python".into());
    Ok((all, Path::new("runs").join(name)))
}

/// Trains in a run folder, or resumes the run of that folder.
///
/// `config` is a dictionary of settings or the path of a configuration file; `settings` overrides it, and `system` is one of `systems()`.
/// `out` defaults to `runs/<name>`. `callback` receives every event as a dictionary. If the callback returns False or raises an exception,
/// the run stops after the current step and saves; it does the same at Ctrl-C and then raises KeyboardInterrupt. The same call resumes the
/// run, and the resumed run is bit-identical to an uninterrupted run. The run folder has the files that trimip-cli writes.
#[pyfunction]
#[pyo3(signature = (config=None, out=None, *, settings=None, system=None, callback=None, fresh=false))]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn train(
    py: Python<'_>,
    config: Option<&Bound<'_, PyAny>>,
    out: Option<PathBuf>,
    settings: Option<&Bound<'_, PyDict>>,
    system: Option<&str>,
    callback: Option<Py<PyAny>>,
    fresh: bool,
) -> PyResult<Run> {
    let (settings, default) = given(config, settings, system)?;
    let out = out.unwrap_or(default);
    let listener = Listener::new(callback);
    let outcome = detached(py, || {
        let mut events = |event: &Event| {
            listener.check_signals();
            listener.tell(event);
        };
        let reading = |_, _| {
            listener.check_signals();
            !listener.stop.load(Ordering::Relaxed)
        };
        let listeners =
            Listeners { events: &mut events, reading: &reading, observer: &mut (), stop: &listener.stop };
        let trained = Training::new(settings, &out).overwrite(fresh).run_with(listeners)?;
        let recorded = Recorded::of(&trained);
        let written = trimip_report::write(&recorded);
        let ended = trained.outcome.clone()?;
        written?;
        if let Some(error) = &trained.unwritten {
            return Err(error.clone());
        }
        trained.judge()?;
        Ok(Run { recorded, ended })
    })?;
    listener.end()?;
    outcome.map_err(raised)
}

fn evaluations(run: &Recorded) -> Value {
    let one = |own: &trimip::run::history::Evaluation| {
        json!({
            "step": own.totals.step,
            "seconds": own.totals.seconds,
            "samples": own.totals.samples,
            "psnr": own.psnr,
            "ssim": own.ssim,
            "scales": own.scales,
            "last": own.last,
        })
    };
    run.history.evaluations.iter().map(one).collect()
}

/// Returns all settings with their defaults, as nested dictionaries.
#[pyfunction]
pub fn defaults(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    value::python(py, &trimip::settings::defaults())
}

/// Returns the names of the systems that `train` accepts.
#[pyfunction]
pub fn systems() -> Vec<&'static str> {
    trimip::systems::SYSTEMS.iter().map(|system| system.name).collect()
}

/// Returns the names of the backends that this machine can run.
#[pyfunction]
pub fn backends() -> Vec<String> {
    trimip::backends::usable()
}
