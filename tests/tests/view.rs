//! Checks of the verb `view`: access control, answers to requests, and the page in a real browser.

use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::Stdio;
use trimip_data::settings::DataConfig;
use trimip_tests::binary::{command, refuses, run, tiny_and};
use trimip_tests::pages::{TELEPHONE, expect_nothing_cut_off, resize};
use trimip_tests::watching::{Browser, Page, Received, Shown, view};

/// Trains a run into `here/run`.
pub(crate) fn trained(here: &Path) {
    let answer = run(here, &tiny_and(&["--out", "run"]));
    assert_eq!(answer.code, Some(0), "{answer:?}");
}

pub(crate) fn enter(shown: &Shown) -> Page {
    shown.join(&shown.token, Some(&format!("http://{}", shown.host))).expect("the page may enter")
}

pub(crate) fn pixels(received: &Received) -> image::RgbImage {
    image::load_from_memory(&received.jpeg).expect("a JPEG").to_rgb8()
}

#[test]
fn only_who_knows_the_token_and_comes_from_the_page_may_enter() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    let mut shown = Shown::start(here, "run");
    let own = format!("/{}/", shown.token);
    let (status, page) = shown.get(&own, &[]);
    let page = String::from_utf8(page).unwrap();
    assert!(status == 200 && page.contains("<canvas"), "{page}");
    assert!(!page.contains("http://") && !page.contains("https://"), "nothing is fetched from elsewhere");
    for file in [
        "main.js",
        "orbit.js",
        "gestures.js",
        "link.js",
        "frusta.js",
        "training.js",
        "style.css",
        "scene.json",
    ] {
        assert_eq!(shown.get(&format!("{own}{file}"), &[]).0, 200, "{file}");
    }
    assert_eq!(shown.get(&format!("{own}photo/test/0?width=8&height=8"), &[]).0, 200);
    assert_eq!(shown.get(&format!("{own}photo/test/99?width=8&height=8"), &[]).0, 404);
    assert_eq!(shown.get(&format!("{own}photo/test/0?width=8&height=99999"), &[]).0, 400);
    let wrong = format!("/{}/", "0".repeat(32));
    for path in [
        "/",
        "/main.js",
        &wrong,
        &format!("{wrong}main.js"),
        &format!("{wrong}photo/test/0?width=8&height=8"),
        &format!("{wrong}photo/nonsense/0"),
        &format!("{wrong}socket"),
        &format!("{wrong}nothing"),
    ] {
        assert_eq!(shown.get(path, &[]).0, 403, "{path}");
    }
    assert_eq!(shown.get(&own, &["Origin: http://elsewhere.example"]).0, 403);
    assert_eq!(shown.get(&own, &["Host: elsewhere.example"]).0, 403, "a name that points here");
    let both = [&format!("Host: {}", shown.host), "Host: elsewhere.example"];
    assert_ne!(shown.get(&own, &both).0, 200, "two hosts");
    assert_eq!(shown.get(&format!("{own}report.html"), &[]).0, 403, "the report has an address of its own");
    let (_, scene) = shown.get(&format!("{own}scene.json"), &[]);
    let report: Value = serde_json::from_slice(&scene).unwrap();
    let report = report["report"].as_str().unwrap();
    assert_eq!(shown.get(report, &[]).0, 200);
    for file in ["", "scene.json", "photo/test/0?width=8&height=8", "socket"] {
        assert_eq!(shown.get(&report.replace("report.html", file), &[]).0, 403, "{file}");
    }
    assert_eq!(shown.join(&"0".repeat(32), None).err(), Some(403));
    let token = shown.token.clone();
    assert_eq!(shown.join(&token, Some("http://elsewhere.example")).err(), Some(403));
    assert_eq!(shown.join(&token, Some("null")).err(), Some(403));
    enter(&shown);
    assert!(shown.lives());
}

#[test]
fn a_view_is_the_picture_that_render_writes() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    let shown = Shown::start(here, "run");
    let mut page = enter(&shown);
    let request = view(1, [3.0, 1.0, 2.0], 40, 30);
    let received = page.finest(&request).unwrap();
    assert_eq!((&received.header["width"], &received.header["height"]), (&json!(40), &json!(30)));
    let numbers: Vec<String> =
        request["pose"].as_array().unwrap().iter().map(|number| number.to_string()).collect();
    let pose = format!("[{}]", numbers.join(","));
    let answer = run(
        here,
        &[
            "render", "run", "--pose", &pose, "--width", "40", "--height", "30", "--fov", "40", "--out",
            "there",
        ],
    );
    assert_eq!(answer.code, Some(0), "{answer:?}");
    let expected = image::open(here.join("there/pose_color.png")).unwrap().to_rgb8();
    let found = pixels(&received);
    let errors = found.as_raw().iter().zip(expected.as_raw()).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
    let psnr = 20.0 * 255_f64.log10() - 10.0 * (errors.sum::<f64>() / found.as_raw().len() as f64).log10();
    assert!(psnr > 30.0, "{psnr:.1} dB, which JPEG alone does not explain");

    // Selecting a photograph selects its camera, and the difference picture is not the colour picture.
    let mut compared = request.clone();
    compared["photo"] = json!({ "split": "test", "index": 1 });
    compared["id"] = json!(2);
    let color = pixels(&page.finest(&compared).unwrap());
    assert_eq!(color.dimensions(), (40, 40), "photographs are square");
    let mut before = color;
    for (id, show) in [(3, "difference"), (4, "depth"), (5, "opacity"), (6, "normals")] {
        (compared["show"], compared["id"]) = (json!(show), json!(id));
        let found = pixels(&page.finest(&compared).unwrap());
        assert_ne!(found, before, "{show}");
        before = found;
    }
}

#[test]
fn nonsense_is_answered_and_giants_are_shown_out() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    let mut shown = Shown::start(here, "run");
    let mut page = enter(&shown);
    for text in ["", "{", "[]", "{\"id\":1}", &"[".repeat(10_000)] {
        page.send(text).unwrap();
        let error = page.receive().err().expect("an error");
        assert!(error.contains("error"), "{error}");
    }
    let mut wrong = view(1, [3.0, 1.0, 2.0], 40, 30);
    for (key, value) in [
        ("width", json!(0)),
        ("width", json!(1_000_000)),
        ("fov", json!(1e9)),
        ("pose", json!([1, 2])),
        ("photo", json!({ "split": "test", "index": 1_000_000 })),
    ] {
        let right = wrong[key].clone();
        wrong[key] = value;
        page.send(&wrong.to_string()).unwrap();
        assert!(page.receive().is_err(), "{key}");
        wrong[key] = right;
    }
    page.finest(&view(9, [3.0, 1.0, 2.0], 20, 20)).expect("it goes on after mistakes");
    // The server closes the socket, at the latest after it has read the whole message.
    let giant = "x".repeat(4 << 20);
    let closed = page.send(&giant).is_err() || page.receive().is_err();
    assert!(closed && shown.lives());
    enter(&shown).finest(&view(1, [3.0, 1.0, 2.0], 20, 20)).expect("others are not disturbed");
}

#[test]
fn pages_do_not_disturb_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    let shown = Shown::start(here, "run");
    let (mut first, mut second) = (enter(&shown), enter(&shown));
    let alone = pixels(&first.finest(&view(1, [3.0, 1.0, 2.0], 40, 30)).unwrap());
    first.send(&view(2, [3.0, 1.0, 2.0], 40, 30).to_string()).unwrap();
    second.send(&view(7, [-1.0, 3.0, 2.0], 24, 24).to_string()).unwrap();
    let finest = |page: &mut Page, id: u64| loop {
        let received = page.receive().unwrap();
        if received.header["id"] == id && received.header["done"] == true {
            return pixels(&received);
        }
    };
    assert_eq!(finest(&mut first, 2), alone);
    assert_eq!(finest(&mut second, 7).dimensions(), (24, 24));
}

#[test]
fn it_survives_a_thousand_connections() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    let mut shown = Shown::start(here, "run");
    enter(&shown).finest(&view(1, [3.0, 1.0, 2.0], 20, 20)).unwrap();
    let before = shown.memory();
    for i in 0..1000 {
        let mut stream = TcpStream::connect(&shown.host).expect("the server listens");
        match i % 4 {
            0 => {}
            1 => drop(stream.write_all(b"GET / HT")),
            2 => drop(enter(&shown).send(&view(1, [3.0, 1.0, 2.0], 400, 400).to_string())),
            _ => drop(stream.write_all(&[0xff; 256])),
        }
    }
    enter(&shown).finest(&view(2, [3.0, 1.0, 2.0], 20, 20)).expect("it still answers");
    assert!(shown.lives());
    if let (Some(before), Some(after)) = (before, shown.memory()) {
        assert!(after < before + (64 << 20), "{before} bytes became {after}");
    }
}

#[test]
fn a_wrong_model_or_address_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    refuses(here, &["view", "nothing"], &["nothing"]);
    refuses(here, &["view", "run", "--set", "field.hidden=32"], &["belongs to the trained model"]);
    refuses(here, &["view", "run", "--bind", "192.0.2.1"], &["192.0.2.1", "cannot listen"]);
    let shown = Shown::start(here, "run");
    let port = shown.host.rsplit(':').next().unwrap();
    refuses(here, &["view", "run", "--port", port], &[port, "cannot listen"]);
    // A model is shown even without its photographs.
    std::fs::create_dir(here.join("alone")).unwrap();
    std::fs::copy(here.join("run/model.safetensors"), here.join("alone/model.safetensors")).unwrap();
    let mut child = command(
        here,
        &["view", "alone/model.safetensors", "--set", "data.format=blender", "--set", "data.root=gone"],
    )
    .stdout(Stdio::piped())
    .stderr(Stdio::piped())
    .spawn()
    .unwrap();
    let mut line = String::new();
    std::io::BufRead::read_line(&mut std::io::BufReader::new(child.stdout.as_mut().unwrap()), &mut line)
        .unwrap();
    assert!(line.starts_with("http://127.0.0.1:"), "{line}");
    child.kill().unwrap();
    let mut err = String::new();
    Read::read_to_string(child.stderr.as_mut().unwrap(), &mut err).unwrap();
    assert!(err.contains("warning: no photographs"), "{err}");
    child.wait().unwrap();
}

/// Starts a run of many steps that serves a page.
fn in_training(here: &Path) -> Shown {
    let long = ["train.steps=1000000", "eval.points=400", "train.log_seconds=0.1"];
    let sets: Vec<&str> = long.iter().flat_map(|set| ["--set", set]).collect();
    Shown::training(here, &tiny_and(&[&sets[..], &["--out", "run", "--view"]].concat()))
}

#[test]
fn a_run_is_watched_paused_and_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let mut run = in_training(here);
    let mut page = enter(&run);
    assert_eq!(page.status()["state"], "running");
    let later = |page: &mut Page| loop {
        let status = page.status();
        if status["step"].as_u64().is_some_and(|step| step > 0) {
            return status;
        }
    };
    let status = later(&mut page);
    assert!(status["progress"].as_f64().is_some_and(|fraction| (0.0..1.0).contains(&fraction)), "{status}");

    // The picture changes as the model learns, without another request.
    page.send(&view(1, [3.0, 1.0, 2.0], 40, 30).to_string()).unwrap();
    let first = loop {
        let received = page.picture();
        if received.header["done"] == true {
            break pixels(&received);
        }
    };
    while pixels(&page.picture()) == first {}

    // A paused run takes no step, but answers.
    page.send(r#"{"command":"pause"}"#).unwrap();
    let paused = loop {
        let status = page.status();
        if status["state"] == "paused" {
            break status["step"].clone();
        }
    };
    page.send(&view(2, [-3.0, 1.0, 2.0], 24, 24).to_string()).unwrap();
    let received = loop {
        let received = page.picture();
        if received.header["id"] == 2 && received.header["done"] == true {
            break received;
        }
    };
    assert_eq!(pixels(&received).dimensions(), (24, 24));
    let mut second = enter(&run);
    let status = second.status();
    assert_eq!((&status["state"], &status["step"]), (&json!("paused"), &paused), "who comes later is told");

    page.send(r#"{"command":"resume"}"#).unwrap();
    while page.status()["state"] != "running" {}
    assert!(later(&mut page)["step"].as_u64() >= paused.as_u64());
    page.send(r#"{"command":"stop"}"#).unwrap();
    assert_eq!(run.ended(), Some(130), "as by Ctrl-C");
    assert!(here.join("run/checkpoint.safetensors").is_file());
}

#[test]
fn a_finished_model_has_no_run_to_steer() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    let shown = Shown::start(here, "run");
    let mut page = enter(&shown);
    page.send(r#"{"command":"stop"}"#).unwrap();
    let error = page.receive().err().expect("an error");
    assert!(error.contains("no run"), "{error}");
    page.finest(&view(1, [3.0, 1.0, 2.0], 20, 20)).expect("it goes on");
}

#[test]
fn a_part_of_the_box_and_its_quantities_are_shown() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    let shown = Shown::start(here, "run");
    let mut page = enter(&shown);
    let mut request = view(1, [3.0, 1.0, 2.0], 40, 30);
    request["show"] = json!("opacity");
    let whole = pixels(&page.finest(&request).unwrap());
    (request["id"], request["clip"]) = (json!(2), json!([[50.0, 50.0, 50.0], [51.0, 51.0, 51.0]]));
    let nothing = pixels(&page.finest(&request).unwrap());
    assert!(whole.pixels().any(|pixel| pixel.0[0] > 128));
    assert!(nothing.pixels().all(|pixel| pixel.0[0] < 3), "outside of the box there is nothing");
    (request["id"], request["clip"]) = (json!(3), Value::Null);
    assert_eq!(pixels(&page.finest(&request).unwrap()), whole);
    for (id, show) in [(4, "level"), (5, "samples")] {
        (request["id"], request["show"]) = (json!(id), json!(show));
        let received = page.finest(&request).unwrap();
        let range = received.header["range"].as_array().expect("a scale of colours");
        assert!(range[0] == 0.0 && range[1].as_f64() >= Some(1.0), "{show}: {range:?}");
    }
}

/// Script that returns a hash of the canvas, a number that differs for different pictures.
pub(crate) const PICTURE: &str = "(() => { const c = document.getElementById('view'); const d = c.getContext('2d')
    .getImageData(0, 0, c.width, c.height).data; let h = 0; for (const b of d) h = (h * 31 + b) | 0; return h; })()";

/// Script that returns true once the picture has all its pixels. While the camera moves, a picture is done with fewer.
pub(crate) const FINEST: &str =
    "(() => { const c = document.getElementById('view'); return c?.dataset.done === 'true'
    && document.getElementById('size').textContent.startsWith(`${c.width}×${c.height},`); })()";

/// Returns the file that the page saves for a path of the current view only.
fn path_of_one_view(browser: &mut Browser) -> String {
    let path = browser.value(
        "(async () => { const create = URL.createObjectURL; let blob; URL.createObjectURL = (b) => (blob = b, create(b));
            for (const id of ['clear', 'add', 'path']) document.getElementById(id).click();
            URL.createObjectURL = create; return await blob.text(); })()",
    );
    path.as_str().expect("a text").into()
}

#[test]
fn the_page_works_in_a_browser() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    let shown = Shown::start(here, "run");
    let Some(mut browser) = Browser::start(1200, 800) else { return };
    browser.open(&shown.address());
    browser.wait("document.getElementById('view')?.dataset.done === 'true'");
    assert_eq!(browser.value("document.getElementById('name').textContent"), "run");
    let first = browser.value(PICTURE);

    browser.drag([300.0, 300.0], [500.0, 340.0]);
    browser.wait("document.getElementById('view').dataset.done === 'true'");
    browser.wait(&format!("{PICTURE} !== {first}"));
    for id in ["rendered", "waited", "size"] {
        let text = browser.value(&format!("document.getElementById('{id}').textContent"));
        assert!(
            text.as_str().is_some_and(|text| text.contains(|c: char| c.is_ascii_digit())),
            "{id}: {text}"
        );
    }

    // Keys turn the view too.
    let turned = browser.value(PICTURE);
    browser.value("document.getElementById('view').focus()");
    browser.press("ArrowLeft");
    browser.wait(&format!("{PICTURE} !== {turned}"));
    browser.check_list_of_keys();

    // A slider splits the picture between the model and a photograph.
    assert_eq!(
        browser.value("document.getElementById('photo').hidden || document.getElementById('split').hidden"),
        true
    );
    browser.value("document.getElementById('next').click()");
    browser.wait(
        "(() => { const c = document.getElementById('photo'); const d = c.getContext('2d')
            .getImageData(0, 0, c.width, c.height).data; return !c.hidden && d.some((b) => b !== 0); })()",
    );
    assert_eq!(browser.value("document.getElementById('cameras').value"), "test 0");
    let clip = "document.getElementById('photo').style.clipPath";
    let middle = browser.value(clip);
    browser.value(
        "(() => { const s = document.getElementById('split'); s.value = 80; s.dispatchEvent(new Event('input')); })()",
    );
    assert_ne!(browser.value(clip), middle);

    // Another quantity changes the picture; cameras are drawn over it.
    browser.wait("document.getElementById('view').dataset.done === 'true'");
    let color = browser.value(PICTURE);
    browser.value("(() => { const s = document.getElementById('show'); s.value = 'normals'; s.dispatchEvent(new Event('change')); })()");
    browser.wait(&format!("{PICTURE} !== {color}"));
    browser.value("document.getElementById('show-frusta').click()");
    let drawn = browser.value(
        "(() => { const c = document.getElementById('frusta'); const d = c.getContext('2d')
            .getImageData(0, 0, c.width, c.height).data; return !c.hidden && d.some((b) => b !== 0); })()",
    );
    assert_eq!(drawn, true);

    // `render --path` accepts the saved path.
    let path = path_of_one_view(&mut browser);
    std::fs::write(here.join("path.json"), &path).unwrap();
    let frames: Value = serde_json::from_str(&path).unwrap();
    assert_eq!(frames["frames"].as_array().unwrap().len(), 1);
    let answer = run(here, &["render", "run", "--path", "path.json", "--out", "film"]);
    assert_eq!(answer.code, Some(0), "{answer:?}");

    // Clipping changes the picture, and unclipping restores it.
    browser.wait("document.getElementById('view').dataset.done === 'true'");
    let whole = browser.value(PICTURE);
    browser.value(
        "(() => { const s = document.querySelectorAll('#clips input')[5]; s.value = 40; s.dispatchEvent(new Event('input')); })()",
    );
    browser.wait(&format!("{PICTURE} !== {whole}"));
    browser.value("document.getElementById('unclip').click()");
    browser.wait(&format!("{PICTURE} === {whole}"));

    let picture = browser.screenshot();
    assert!(image::load_from_memory(&picture).is_ok_and(|picture| picture.width() >= 1000));
    browser.keep("view.png");

    // The page links to the report of the run, and the report links back.
    assert_eq!(browser.value("document.getElementById('report').hidden"), false);
    browser.value("document.querySelector('#report a').click()");
    browser.wait(
        "location.pathname.endsWith('report.html') && document.getElementById('viewer')?.hidden === false",
    );
    assert_eq!(browser.value("document.querySelector('main img').naturalWidth > 0"), true);
    assert_eq!(browser.value("origin"), "null", "the report has no part in the viewer's origin");
    // Nothing that a script in the report can read contains the token of the viewer.
    let readable = "[location.href, document.referrer, document.documentElement.outerHTML,
        ...(window.navigation ? navigation.entries().map((entry) => entry.url) : [])].join(' ')";
    let readable = browser.value(readable);
    assert!(!readable.as_str().unwrap().contains(&shown.token), "{readable}");
    browser.value("document.getElementById('viewer').click()");
    browser.wait("document.getElementById('view')?.dataset.done === 'true'");
}

/// Writes the built-in scene to `here/scene`; its test photographs have the given names.
fn write_photographs(here: &Path, names: [&str; 2]) {
    let builtin = DataConfig { builtin_size: 16, builtin_train: 2, builtin_test: 2, ..DataConfig::default() };
    let scene = here.join("scene");
    trimip_data::write_builtin(&builtin, &scene, &trimip_data::unwatched).unwrap();
    let list = scene.join("transforms_test.json");
    let mut transforms: Value = serde_json::from_slice(&std::fs::read(&list).unwrap()).unwrap();
    for (index, name) in names.into_iter().enumerate() {
        let at = |name: &str| scene.join("test").join(format!("{name}.png"));
        std::fs::rename(at(&format!("r_{index}")), at(name)).unwrap();
        transforms["frames"][index]["file_path"] = json!(format!("./test/{name}"));
    }
    std::fs::write(&list, transforms.to_string()).unwrap();
}

#[test]
fn photographs_are_listed_by_their_names() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    // One name would be another text if it were read as HTML, the other is wider than the list.
    let long = format!("first of all{}the last", "_".repeat(40));
    let names = ["&lt;i&gt;Zoë's 1 &amp; 2", &long];
    write_photographs(here, names);
    let shown = Shown::start_with(here, "run", &["--set", "data.format=blender", "--set", "data.root=scene"]);
    let (_, scene) = shown.get(&format!("/{}/scene.json", shown.token), &[]);
    let scene: Value = serde_json::from_slice(&scene).unwrap();
    let listed = scene["cameras"][0]["views"].as_array().unwrap();
    let told: Vec<&Value> = listed.iter().map(|view| &view["name"]).collect();
    assert_eq!(told, names);

    let Some(mut browser) = Browser::start(1200, 800) else { return };
    browser.open(&shown.address());
    browser.wait("document.querySelectorAll('#cameras optgroup').length === 2");
    let listed = browser.value(
        "[...document.querySelectorAll('#cameras optgroup')].map((group) =>
            [group.label, ...[...group.children].flatMap((option) => [option.textContent, option.title])])",
    );
    let short = "first of all…___the last";
    assert_eq!(
        listed,
        json!([
            ["test views", names[0], names[0], short, names[1]],
            ["training views", "r_0", "r_0", "r_1", "r_1"],
        ])
    );
    browser.wait("document.getElementById('view')?.dataset.done === 'true'");
    for name in names {
        browser.value("document.getElementById('next').click()");
        assert_eq!(browser.value("document.getElementById('cameras').title"), name);
    }
    browser.keep("names.png");
}

#[test]
fn a_place_opens_at_a_photograph_and_home_returns_there() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let place = ["--set", "scene.contraction=ball", "--set", "plan.hull=off"];
    let answer = run(here, &tiny_and(&[&place[..], &["--out", "run"]].concat()));
    assert_eq!(answer.code, Some(0), "{answer:?}");
    let shown = Shown::start(here, "run");
    let (_, scene) = shown.get(&format!("/{}/scene.json", shown.token), &[]);
    let scene: Value = serde_json::from_slice(&scene).unwrap();
    let home = &scene["home"];
    let train = scene["cameras"][1]["views"].as_array().unwrap();
    assert!(train.iter().any(|view| view["pose"] == home["pose"] && view["fov"] == home["fov"]), "{home}");

    let Some(mut browser) = Browser::start(1200, 800) else { return };
    browser.open(&shown.address());
    browser.wait(FINEST);
    // Compares the field of view, the position and the direction of the camera; the page keeps the picture upright.
    let is_home = |browser: &mut Browser| {
        let path: Value = serde_json::from_str(&path_of_one_view(browser)).unwrap();
        let frame = &path["frames"][0];
        let rows = &frame["transform_matrix"];
        let near = |found: f64, expected: &Value| (found - expected.as_f64().unwrap()).abs() < 1e-6;
        let same = |row: usize, column: usize| {
            near(rows[row][column].as_f64().unwrap(), &home["pose"][4 * row + column])
        };
        near(frame["camera_angle_x"].as_f64().unwrap().to_degrees(), &home["fov"])
            && (0..3).all(|row| same(row, 2) && same(row, 3))
    };
    assert!(is_home(&mut browser));
    let first = browser.value(PICTURE);
    browser.drag([300.0, 300.0], [500.0, 340.0]);
    browser.wait(&format!("{PICTURE} !== {first}"));
    assert!(!is_home(&mut browser));
    browser.press("Home");
    assert!(is_home(&mut browser));
    browser.wait(&format!("{PICTURE} === {first}"));

    // The key also returns there from another photograph.
    browser.value("document.getElementById('next').click()");
    assert!(!is_home(&mut browser));
    browser.value("document.getElementById('view').focus()");
    browser.press("Home");
    assert!(is_home(&mut browser));
    assert_eq!(browser.value("document.getElementById('cameras').value"), "");
    browser.wait(&format!("{PICTURE} === {first}"));
}

#[test]
fn the_page_fits_a_telephone() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here);
    let shown = Shown::start(here, "run");
    let Some(mut browser) = Browser::start(500, 800) else { return };
    resize(&mut browser, TELEPHONE, 800);
    browser.open(&shown.address());
    browser.wait(FINEST);
    expect_nothing_cut_off(&mut browser, "the viewer");
    browser.keep("telephone.png");
    browser.value("document.getElementById('show-keys').click()");
    expect_nothing_cut_off(&mut browser, "the list of keys");
    browser.keep("telephone-keys.png");
}

#[test]
fn a_run_is_watched_in_a_browser() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    // The screen is small.
    let Some(mut browser) = Browser::start(420, 800) else { return };
    let mut run = in_training(here);
    browser.open(&run.address());
    browser.wait("document.getElementById('view')?.dataset.done === 'true'");
    browser.wait("document.querySelectorAll('#curve circle').length > 1");
    let first = browser.value(PICTURE);
    browser.wait(&format!("{PICTURE} !== {first}"));
    browser.keep("training.png");
    browser.value("document.getElementById('pause').click()");
    browser.wait("document.getElementById('state').textContent === 'paused'");
    browser.value("document.getElementById('pause').click()");
    browser.wait("document.getElementById('state').textContent === 'training'");
    browser.value("document.getElementById('stop').click()");
    assert_eq!(run.ended(), Some(130));
    assert!(here.join("run/checkpoint.safetensors").is_file());
}
