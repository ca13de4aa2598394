//! Checks of `export web`: in a real browser, the page renders a model by itself, and its pictures match those of the CPU
//! backend.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use trimip::{backends, view::cameras};
use trimip_core::{Intrinsics, config::RendererKind, measures::metrics};
use trimip_tests::binary::{refuses, run, tiny_and};
use trimip_tests::watching::{Browser, view};

/// Returns the folder of the page's program. If `tools/web.sh` has not built the program, prints a line and returns `None`, or
/// panics if `TRIMIP_REQUIRE_WEB` is set.
fn program() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../target/web");
    if folder.join("trimip_web_bg.wasm").is_file() {
        return Some(folder);
    }
    assert!(std::env::var_os("TRIMIP_REQUIRE_WEB").is_none(), "tools/web.sh has not been run");
    eprintln!("skipped: tools/web.sh has not been run");
    None
}

/// Serves the files of a folder on a free port, as any static server does; returns its address.
fn serve(folder: PathBuf) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let folder = folder.clone();
            std::thread::spawn(move || {
                let mut lines = BufReader::new(&stream).lines();
                let first = lines.next().and_then(Result::ok).unwrap_or_default();
                while lines.next().and_then(Result::ok).is_some_and(|line| !line.is_empty()) {}
                let name = first.split(' ').nth(1).unwrap_or("/").trim_start_matches('/').to_string();
                let name = if name.is_empty() { "index.html" } else { &name };
                let kind = match name.rsplit('.').next() {
                    Some("html") => "text/html",
                    Some("js") => "text/javascript",
                    Some("css") => "text/css",
                    Some("wasm") => "application/wasm",
                    _ => "application/octet-stream",
                };
                let (status, body) = match std::fs::read(folder.join(name)) {
                    Ok(body) => ("200 OK", body),
                    Err(_) => ("404 Not Found", Vec::new()),
                };
                let head = format!(
                    "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
                    body.len()
                );
                let mut stream = &stream;
                let _ = stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(&body));
            });
        }
    });
    address
}

/// Trains a run into `here/run`, larger than the smallest one.
fn trained(here: &Path) {
    let more = ["--set", "train.steps=400", "--set", "data.builtin_size=32", "--out", "run"];
    let answer = run(here, &tiny_and(&more));
    assert_eq!(answer.code, Some(0), "{answer:?}");
}

#[test]
fn a_packed_model_is_small_and_near() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    let model = trimip::read_model(&here.join("run")).unwrap();
    let small = here.join("small.trimip");
    let bytes = model.write_packed(&small).unwrap();
    let whole = std::fs::metadata(here.join("run/model.safetensors")).unwrap().len();
    assert!(bytes == std::fs::metadata(&small).unwrap().len() && bytes < whole, "{bytes} of {whole}");
    let packed = trimip::read_model(&small).unwrap();
    assert_eq!(packed.config, model.config);
    let camera = camera();
    let [exact, near] =
        [&model, &packed].map(|model| backends::load(model).unwrap().render(&camera).unwrap().rgb());
    let psnr = metrics::psnr(&near, &exact);
    assert!(psnr > 40.0, "{psnr:.1} dB");
    // A packed model has no proxy, so it is volume-rendered.
    let baked = run(here, &["bake", "run"]);
    assert_eq!(baked.code, Some(0), "{baked:?}");
    let baked = trimip::read_model(&here.join("run")).unwrap();
    assert_eq!(baked.config.renderer.kind, RendererKind::Hybrid);
    baked.write_packed(&small).unwrap();
    let volume = trimip::read_model(&small).unwrap();
    assert!(backends::load(&volume).unwrap().render(&camera).unwrap().rgb() == near);
    // Packing a packed model again hardly changes its picture.
    packed.write_packed(&here.join("again.trimip")).unwrap();
    let again = trimip::read_model(&here.join("again.trimip")).unwrap();
    let apart = backends::load(&again).unwrap().render(&camera).unwrap().rgb();
    assert!(metrics::psnr(&apart, &near) > 80.0);
}

/// Returns a camera that looks at the built-in scene.
fn camera() -> trimip_core::Camera {
    let pose: Vec<f64> = view(1, [3.0, 1.0, 2.0], 1, 1)["pose"]
        .as_array()
        .unwrap()
        .iter()
        .map(|n| n.as_f64().unwrap())
        .collect();
    cameras::posed("test", &pose, Intrinsics::from_angle(64, 48, 40_f64.to_radians())).unwrap()
}

#[test]
fn a_page_without_a_server_renders_as_the_cpu_does() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    refuses(here, &["export", "web", "run", "--viewer", "nowhere"], &["trimip_web.js", "tools/web.sh"]);
    refuses(here, &["export", "web", "nothing", "--viewer", "nowhere"], &["nothing"]);
    let Some(program) = program() else { return };
    let program = program.to_str().unwrap();
    let crop = "ball 0,0,0,0.5";
    let answer = run(here, &["export", "web", "run", "--viewer", program, "--out", "site", "--crop", crop]);
    assert_eq!(answer.code, Some(0), "{answer:?}");
    let site = serve(here.join("site"));
    let Some(mut browser) = Browser::start_with(900, 600, &["--enable-unsafe-webgpu"]) else { return };
    browser.open(&site);
    browser.wait("document.getElementById('message')?.textContent !== 'Loading…' && document.readyState === 'complete'");
    browser.wait("!document.getElementById('message').textContent.startsWith('Loading')");
    assert_eq!(browser.value("document.getElementById('message').textContent"), "");
    browser.wait("document.getElementById('view').dataset.done === 'true'");
    let request = view(1, [3.0, 1.0, 2.0], 64, 48);
    let model = trimip::read_model(&here.join("site/model.trimip")).unwrap();
    assert_eq!(model.config.scene.crop.to_string(), crop);
    let mut viewer = backends::load(&model).unwrap();
    let mut pictures = Vec::new();
    for (cropped, keep) in [(true, &[model.config.scene.crop][..]), (false, &[])] {
        let call =
            format!("(async () => [...await trimip.render({}, 40, 64, 48, {cropped})])()", request["pose"]);
        let found = browser.value(&call);
        let found = found.as_array().expect("numbers").iter();
        let found: Vec<f32> = found.map(|byte| byte.as_f64().unwrap() as f32 / 255.0).collect();
        let found: Vec<[f32; 3]> = found.chunks_exact(4).map(|rgba| [rgba[0], rgba[1], rgba[2]]).collect();
        viewer.clip(keep).unwrap();
        let psnr = metrics::psnr(&found, &viewer.render(&camera()).unwrap().rgb());
        println!("browser against CPU, cropped {cropped}: {psnr:.1} dB");
        assert!(psnr > 45.0, "{psnr:.1} dB");
        pictures.push(found);
    }
    assert!(metrics::psnr(&pictures[0], &pictures[1]) < 40.0, "the crop leaves something out");
    // The page opened with the crop on; its switch shows everything.
    let picture = "document.getElementById('view').toDataURL()";
    assert_eq!(browser.value("document.querySelector('#crop code').textContent"), crop);
    assert_eq!(browser.value("document.getElementById('cropped').checked"), true);
    let cropped = browser.value(picture);
    browser.value("document.getElementById('cropped').click()");
    browser
        .wait(&format!("{picture} !== {cropped} && document.getElementById('view').dataset.done === 'true'"));
    browser.value("document.getElementById('cropped').click()");
    browser.wait(&format!("{picture} === {cropped}"));
    // A drag and a key change the picture.
    let before = browser.value(picture);
    browser.drag([200.0, 200.0], [300.0, 240.0]);
    browser.wait(&format!("{picture} !== {before}"));
    browser.wait("document.getElementById('view').dataset.done === 'true'");
    let before = browser.value(picture);
    browser.press("+");
    browser.wait(&format!("{picture} !== {before}"));
    browser.check_list_of_keys();
    let shown = browser.screenshot();
    if let Some(folder) = std::env::var_os("TRIMIP_SCREENSHOTS") {
        std::fs::write(Path::new(&folder).join("web.png"), shown).unwrap();
    }
}

#[test]
fn a_browser_without_webgpu_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    let Some(program) = program() else { return };
    let answer = run(here, &["export", "web", "run", "--viewer", program.to_str().unwrap(), "--out", "site"]);
    assert_eq!(answer.code, Some(0), "{answer:?}");
    let site = serve(here.join("site"));
    let Some(mut browser) = Browser::start_with(900, 600, &["--disable-features=WebGPU", "--disable-webgpu"])
    else {
        return;
    };
    browser.open(&site);
    browser.wait("document.getElementById('message')?.textContent.includes('WebGPU')");
}
