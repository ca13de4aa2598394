//! `export web`: writes a folder with a page that renders the model in the browser.

use crate::{args::WebArguments, terminal};
use serde_json::json;
use std::path::Path;
use trimip::{
    Config, Error, Result, model::Model, run::cameras::training_cameras, run::folder as run_folder,
};
use trimip_core::{atomic::write_atomically, scene::origin::LocalOrigin};
use trimip_view::page;

/// Files of the page's program. `tools/web.sh` builds them.
const PROGRAM: [&str; 2] = ["trimip_web.js", "trimip_web_bg.wasm"];

/// File name of the model.
const MODEL: &str = "model.trimip";

/// File that names the page's model, and marks the folder as written by this program.
const ABOUT: &str = "about.json";

/// Files of the page: name, text.
const PAGE: [(&str, &str); 5] = [
    ("index.html", include_str!("../../../page/index.html")),
    ("main.js", include_str!("../../../page/main.js")),
    ("orbit.js", page::ORBIT),
    ("gestures.js", page::GESTURES),
    ("style.css", page::STYLE),
];

/// Writes the folder.
pub fn export(arguments: &WebArguments) -> Result<u8> {
    let model = run_folder::read_model(&arguments.model)?;
    // The path of the photographs is private and not exported.
    let mut config = model.config.clone();
    config.data.root = Config::default().data.root;
    let cropped = arguments.crop.opens(&mut config);
    let model = Model::new(config, model.file);
    let beside = || {
        let own = &arguments.model;
        let folder = if own.is_dir() { own } else { own.parent().unwrap_or(Path::new("")) };
        folder.join("web")
    };
    let out = arguments.out.clone().unwrap_or_else(beside);
    let mut program = Vec::new();
    for name in PROGRAM {
        let path = arguments.viewer.join(name);
        let bytes = trimip_core::plain_file::read(&path).map_err(|error| {
            let advice = "build the page's program with tools/web.sh, or name its folder with --viewer";
            Error::input(path.display(), error, advice)
        })?;
        program.push((name, bytes));
    }
    let whole = arguments.model.canonicalize().unwrap_or_else(|_| arguments.model.clone());
    let folder = if whole.is_dir() { Some(&*whole) } else { whole.parent() };
    let name = folder.and_then(Path::file_name).map_or_else(|| "model".into(), |name| name.to_string_lossy());
    if out.join("index.html").exists() && !out.join(ABOUT).exists() {
        return Err(Error::input(
            out.display(),
            "holds a page that `export web` did not write",
            "choose another --out",
        ));
    }
    run_folder::create_writable(&out)?;
    let origin = LocalOrigin::of(&model.config.data);
    let cameras = training_cameras(&arguments.model, origin)?.unwrap_or_default();
    let home = trimip::view::home(&model.config.scene, &cameras);
    let about = json!({ "name": name, "model": MODEL, "cropped": cropped, "home": home }).to_string();
    for (name, text) in PAGE.into_iter().chain([(ABOUT, &*about)]) {
        write_atomically(&out.join(name), text.as_bytes())?;
    }
    let mut code = 0;
    for (name, bytes) in &program {
        write_atomically(&out.join(name), bytes)?;
        code += bytes.len() as u64;
    }
    let bytes = model.write_packed(&out.join(MODEL))?;
    terminal::line(format!(
        "{}: the model {}, the page {}; put the folder on a web server with https",
        out.display(),
        terminal::bytes(bytes),
        terminal::bytes(code + PAGE.iter().map(|(_, text)| text.len() as u64).sum::<u64>())
    ));
    Ok(0)
}
