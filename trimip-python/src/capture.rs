//! `trimip.capture`, and the guard process between Python and the programs that a capture calls.

use crate::calls::detached;
use crate::error::{raised, refused};
use crate::listening::Listener;
use pyo3::prelude::*;
use serde::de::DeserializeOwned;
use std::ffi::OsString;
use std::path::PathBuf;
use std::time::Duration;
use trimip_capture::{Event, Request, guard};

/// Interval between two checks for Ctrl-C.
const PATIENCE: Duration = Duration::from_millis(100);

/// Python code of the guard process.
const GUARD: &str = "import sys; from trimip import _trimip; sys.exit(_trimip.run_guard(sys.argv[1:]))";

/// Parses the name of a choice.
fn choice<T: DeserializeOwned>(option: &str, name: Option<&str>) -> PyResult<Option<T>> {
    let parsed = |name: &str| {
        serde_json::from_value(name.into())
            .map_err(|error| refused(option, error, "take one of these, or leave it out"))
    };
    name.map(parsed).transpose()
}

/// Finds the cameras of a film or of photographs. Returns the folder of the capture, which is a scene.
///
/// `input` is a film, a folder of photographs, or a zip archive of either; `out` defaults to `captures/<name>`. The same call continues
/// from the results of an earlier one. ffmpeg and COLMAP (the program or the package pycolmap) do the work. If one is missing, the error
/// states its name and how to install it. `poses`, `camera`, `matcher` and `mapper` take the names of `trimip-cli capture --help`.
/// `callback` receives every event as a dictionary; if it returns False, the capture stops and keeps the finished stages, as with Ctrl-C.
#[pyfunction]
#[pyo3(signature = (input, out=None, *, frames=None, poses=None, camera=None, matcher=None, vocab_tree=None, mapper=None, size=None,
    threads=0, fresh=false, callback=None))]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub fn capture(
    py: Python<'_>,
    input: PathBuf,
    out: Option<PathBuf>,
    frames: Option<u32>,
    poses: Option<&str>,
    camera: Option<&str>,
    matcher: Option<&str>,
    vocab_tree: Option<PathBuf>,
    mapper: Option<&str>,
    size: Option<u32>,
    threads: u32,
    fresh: bool,
    callback: Option<Py<PyAny>>,
) -> PyResult<PathBuf> {
    let request = Request {
        input,
        out,
        frames,
        poses: choice("poses", poses)?,
        camera: choice("camera", camera)?,
        matcher: choice("matcher", matcher)?,
        vocab_tree,
        mapper: choice("mapper", mapper)?,
        size,
        threads,
        fresh,
    };
    let interpreter: Option<PathBuf> = py.import("sys")?.getattr("executable")?.extract()?;
    if let Some(interpreter) = interpreter.filter(|path| path.is_file()) {
        guard::set_program(interpreter, vec!["-c".into(), GUARD.into()]);
    } else {
        return Err(refused("sys.executable", "names no interpreter", "call trimip-cli capture instead"));
    }
    let listener = Listener::new(callback);
    let outcome = detached(py, || {
        std::thread::scope(|scope| {
            let work = scope.spawn(|| {
                trimip_capture::run(&request, &listener.stop, &|event: &Event<'_>| listener.tell(event))
            });
            while !work.is_finished() {
                std::thread::sleep(PATIENCE);
                listener.check_signals();
            }
            work.join()
        })
    })?;
    listener.end()?;
    match outcome {
        Ok(captured) => captured.map(|captured| captured.root).map_err(raised),
        Err(panic) => std::panic::resume_unwind(panic),
    }
}

/// Runs a program until it ends or the pipe to this process closes; returns the program's exit code.
#[pyfunction]
pub fn run_guard(py: Python<'_>, words: Vec<OsString>) -> u8 {
    py.detach(|| guard::run(words))
}
