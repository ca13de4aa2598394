//! A program that shows a model, and its clients: plain HTTP, a web socket, a real browser.

use crate::binary::command;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};

/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(240);

/// Expected list of keys on a page that shows a model: the input and its effect.
const KEYS: [[&str; 2]; 6] = [
    ["drag, ← → ↑ ↓", "turn"],
    ["drag with the right button or shift, shift and ← → ↑ ↓", "move sideways"],
    ["wheel, two fingers, + −", "nearer and farther"],
    ["Home", "the first view"],
    ["f", "full screen, and back"],
    ["?", "these keys"],
];

/// A running program that serves a page. Dropping the value kills the program.
pub struct Shown {
    child: Child,
    /// Host and port of the server: `127.0.0.1:PORT`.
    pub host: String,
    /// Token in the address of the page.
    pub token: String,
}

impl Shown {
    /// Starts the program on the model `model` in `folder`.
    ///
    /// # Panics
    /// If the program does not print an address.
    pub fn start(folder: &Path, model: &str) -> Self {
        Self::start_with(folder, model, &[])
    }

    /// Starts the program as [`start`](Self::start) does, with the given options.
    ///
    /// # Panics
    /// As [`start`](Self::start).
    pub fn start_with(folder: &Path, model: &str, options: &[&str]) -> Self {
        let mut child = command(folder, &[&["view", model], options].concat())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        let out = child.stdout.take().expect("its output is piped");
        Self::at(child, BufReader::new(out))
    }

    /// Starts a training run that serves a page.
    ///
    /// # Panics
    /// If the program does not print an address.
    pub fn training(folder: &Path, arguments: &[&str]) -> Self {
        let mut child = command(folder, arguments)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let err = child.stderr.take().expect("its messages are piped");
        Self::at(child, BufReader::new(err))
    }

    /// Reads the address that a program prints in its first line.
    fn at(child: Child, mut told: impl BufRead + Send + 'static) -> Self {
        let mut line = String::new();
        told.read_line(&mut line).expect("it prints its address");
        let address = line.split_once("http://").map(|(_, rest)| rest).expect("an address");
        let address = address.split_whitespace().next().expect("an address").trim_end_matches('/');
        let (host, token) = address.split_once('/').expect("a token");
        let (host, token) = (host.to_string(), token.to_string());
        // Later output is read too, so that the program never blocks.
        std::thread::spawn(move || std::io::copy(&mut told, &mut std::io::sink()));
        Self { child, host, token }
    }

    /// Waits for the end of the program; returns its exit code.
    ///
    /// # Panics
    /// If the program does not end.
    pub fn ended(&mut self) -> Option<i32> {
        let until = Instant::now() + PATIENCE;
        loop {
            if let Some(status) = self.child.try_wait().expect("a child of ours") {
                return status.code();
            }
            assert!(Instant::now() < until, "it ends");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Returns the address of the page.
    pub fn address(&self) -> String {
        format!("http://{}/{}/", self.host, self.token)
    }

    /// Returns the status and the body of `GET /path` with additional header lines.
    ///
    /// # Panics
    /// If the server does not answer.
    pub fn get(&self, path: &str, headers: &[&str]) -> (u16, Vec<u8>) {
        let mut stream = TcpStream::connect(&self.host).expect("the server listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket has a timeout");
        let host = format!("Host: {}", self.host);
        let own = if headers.iter().any(|line| line.starts_with("Host:")) { "" } else { &host };
        let lines: String = [own]
            .iter()
            .chain(headers)
            .filter(|line| !line.is_empty())
            .map(|line| format!("{line}\r\n"))
            .collect();
        write!(stream, "GET {path} HTTP/1.1\r\n{lines}Connection: close\r\n\r\n").expect("a request is sent");
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).expect("an answer comes");
        let end = answer.windows(4).position(|four| four == b"\r\n\r\n").expect("an answer has a head");
        let head = String::from_utf8_lossy(&answer[..end]).into_owned();
        let status = head.split(' ').nth(1).and_then(|code| code.parse().ok()).expect("a status");
        (status, answer[end + 4..].to_vec())
    }

    /// Opens the web socket as a page of `origin` would.
    ///
    /// # Errors
    /// The HTTP status with which the server refuses.
    pub fn join(&self, token: &str, origin: Option<&str>) -> Result<Page, u16> {
        let mut request =
            format!("ws://{}/{token}/socket", self.host).into_client_request().expect("an address");
        if let Some(origin) = origin {
            request.headers_mut().insert("Origin", HeaderValue::from_str(origin).expect("a header"));
        }
        match tungstenite::connect(request) {
            Ok((socket, _)) => Ok(Page { socket: patient(socket) }),
            Err(tungstenite::Error::Http(answer)) => Err(answer.status().as_u16()),
            Err(error) => panic!("{error}"),
        }
    }

    /// Returns the resident memory in bytes; `None` if the system does not report it.
    pub fn memory(&self) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let line = status.lines().find(|line| line.starts_with("VmRSS"))?;
        Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? * 1024)
    }

    /// Returns true while the program runs.
    pub fn lives(&mut self) -> bool {
        self.child.try_wait().is_ok_and(|ended| ended.is_none())
    }
}

impl Drop for Shown {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// Returns the socket with a timeout: reads fail after [`PATIENCE`].
fn patient(socket: WebSocket<MaybeTlsStream<TcpStream>>) -> WebSocket<MaybeTlsStream<TcpStream>> {
    if let MaybeTlsStream::Plain(stream) = socket.get_ref() {
        stream.set_read_timeout(Some(PATIENCE)).expect("a socket has a timeout");
    }
    socket
}

/// An open web socket.
pub struct Page {
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
}

/// A picture that the server sent.
pub struct Received {
    /// JSON header before the picture.
    pub header: Value,
    /// JPEG bytes.
    pub jpeg: Vec<u8>,
}

impl Page {
    /// Sends a text.
    ///
    /// # Errors
    /// When the socket is closed.
    pub fn send(&mut self, text: &str) -> Result<(), tungstenite::Error> {
        self.socket.send(Message::text(text))
    }

    /// Returns the next status of the training run; pictures before it are dropped.
    ///
    /// # Panics
    /// If the socket closes first, or if a text other than a status arrives.
    pub fn status(&mut self) -> Value {
        loop {
            match self.socket.read().expect("news") {
                Message::Text(text) => {
                    let words: Value = serde_json::from_str(&text).expect("JSON");
                    assert!(words["training"].is_object(), "{text}");
                    return words["training"].clone();
                }
                Message::Close(_) => panic!("closed"),
                _ => {}
            }
        }
    }

    /// Returns the next picture; status messages before it are dropped.
    ///
    /// # Panics
    /// If the socket closes first, or if an error message arrives.
    pub fn picture(&mut self) -> Received {
        loop {
            match self.receive() {
                Ok(received) => return received,
                Err(text) => assert!(text.contains("training"), "{text}"),
            }
        }
    }

    /// Returns the next message: a picture, or a text as the error.
    ///
    /// # Errors
    /// The text of the message, or the reason why the socket closed.
    pub fn receive(&mut self) -> Result<Received, String> {
        loop {
            match self.socket.read().map_err(|error| error.to_string())? {
                Message::Text(text) => return Err(text.to_string()),
                Message::Binary(bytes) => {
                    let length = u32::from_le_bytes(bytes[..4].try_into().expect("four bytes")) as usize;
                    let header = serde_json::from_slice(&bytes[4..4 + length]).expect("a header is JSON");
                    return Ok(Received { header, jpeg: bytes[4 + length..].to_vec() });
                }
                Message::Close(_) => return Err("closed".into()),
                _ => {}
            }
        }
    }

    /// Requests a view and waits for its finest picture.
    ///
    /// # Errors
    /// As [`receive`](Self::receive).
    pub fn finest(&mut self, request: &Value) -> Result<Received, String> {
        self.send(&request.to_string()).map_err(|error| error.to_string())?;
        loop {
            let received = self.receive()?;
            if received.header["id"] == request["id"] && received.header["done"] == true {
                return Ok(received);
            }
        }
    }
}

/// Returns the request for a view from `eye` to the origin, with z up.
///
/// # Panics
/// If `eye` is on the z axis.
pub fn view(id: u64, eye: [f64; 3], width: u32, height: u32) -> Value {
    let eye = glam::DVec3::from_array(eye);
    let back = eye.normalize();
    let right = glam::DVec3::Z.cross(back).normalize();
    let up = back.cross(right);
    let pose: Vec<f64> = (0..3).flat_map(|i| [right[i], up[i], back[i], eye[i]]).collect();
    json!({
        "id": id, "pose": pose, "fov": 40.0, "width": width, "height": height,
        "show": "color", "renderer": "volume", "moving": false,
    })
}

/// A headless browser with one page, driven by the Chrome DevTools Protocol.
pub struct Browser {
    child: Child,
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    next: u64,
    _profile: tempfile::TempDir,
}

impl Browser {
    /// Starts Chromium. If the machine has no Chromium, prints a line and returns `None`, or panics if `TRIMIP_REQUIRE_BROWSER`
    /// is set.
    ///
    /// # Panics
    /// If Chromium does not start.
    pub fn start(width: u32, height: u32) -> Option<Self> {
        Self::start_with(width, height, &["--disable-gpu"])
    }

    /// Starts Chromium as [`start`](Self::start) does, but with the given options.
    ///
    /// # Panics
    /// As [`start`](Self::start).
    pub fn start_with(width: u32, height: u32, options: &[&str]) -> Option<Self> {
        let names = ["chromium", "chromium-browser", "google-chrome"];
        let folders: Vec<PathBuf> =
            std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default()).collect();
        let found = names.iter().find_map(|name| folders.iter().map(|f| f.join(name)).find(|p| p.is_file()));
        let Some(program) = found else {
            assert!(std::env::var_os("TRIMIP_REQUIRE_BROWSER").is_none(), "no Chromium on this machine");
            eprintln!("skipped: there is no Chromium on this machine");
            return None;
        };
        let profile = tempfile::tempdir().expect("a folder");
        let child = Command::new(program)
            .args(["--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--no-first-run"])
            .args(options)
            .args(["--remote-debugging-port=0", "--remote-allow-origins=*"])
            .arg(format!("--window-size={width},{height}"))
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("Chromium starts");
        let until = Instant::now() + PATIENCE;
        let port = loop {
            let text = std::fs::read_to_string(profile.path().join("DevToolsActivePort")).unwrap_or_default();
            if let Some(port) = text.lines().next().filter(|line| !line.is_empty()) {
                break port.to_string();
            }
            assert!(Instant::now() < until, "Chromium opens its port");
            std::thread::sleep(Duration::from_millis(50));
        };
        let target = loop {
            let own = Self::pages(&port).and_then(|pages| {
                let page = pages.as_array()?.iter().find(|page| page["type"] == "page")?.clone();
                Some(page["webSocketDebuggerUrl"].as_str()?.to_string())
            });
            if let Some(own) = own {
                break own;
            }
            assert!(Instant::now() < until, "Chromium has a page");
            std::thread::sleep(Duration::from_millis(50));
        };
        let (socket, _) = tungstenite::connect(target).expect("Chromium answers");
        let mut browser = Self { child, socket: patient(socket), next: 0, _profile: profile };
        browser.call("Page.enable", json!({}));
        browser.call("Runtime.enable", json!({}));
        Some(browser)
    }

    fn pages(port: &str) -> Option<Value> {
        let mut stream = TcpStream::connect(format!("127.0.0.1:{port}")).ok()?;
        stream.set_read_timeout(Some(Duration::from_secs(5))).ok()?;
        write!(stream, "GET /json/list HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n\r\n")
            .ok()?;
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).ok();
        let start = answer.windows(4).position(|four| four == b"\r\n\r\n")?;
        serde_json::from_slice(&answer[start + 4..]).ok()
    }

    /// Calls a method and returns its result.
    ///
    /// # Panics
    /// If the browser refuses.
    pub fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.try_call(method, parameters).unwrap_or_else(|error| panic!("{method}: {error}"))
    }

    /// Calls a method and returns its result; `Err` is the error that the browser returns.
    fn try_call(&mut self, method: &str, parameters: Value) -> Result<Value, Value> {
        self.next += 1;
        let id = self.next;
        let message = json!({ "id": id, "method": method, "params": parameters });
        self.socket.send(Message::text(message.to_string())).expect("Chromium listens");
        loop {
            let Message::Text(text) = self.socket.read().expect("Chromium answers") else { continue };
            let mut answer: Value = serde_json::from_str(&text).expect("JSON");
            if answer["id"] == id {
                return if answer["error"].is_null() {
                    Ok(answer["result"].take())
                } else {
                    Err(answer["error"].take())
                };
            }
        }
    }

    /// Opens an address.
    pub fn open(&mut self, address: &str) {
        self.call("Page.navigate", json!({ "url": address }));
    }

    /// Returns the value of a JavaScript expression; promises are awaited.
    ///
    /// # Panics
    /// If the expression throws.
    pub fn value(&mut self, expression: &str) -> Value {
        self.evaluate(expression).unwrap_or_else(|error| panic!("{expression}: {error}"))
    }

    /// Returns the value of an expression; `Err` is the exception that it throws, or the reason why the page does not answer.
    fn evaluate(&mut self, expression: &str) -> Result<Value, Value> {
        let parameters = json!({ "expression": expression, "returnByValue": true, "awaitPromise": true });
        let answer = self.try_call("Runtime.evaluate", parameters)?;
        if answer["exceptionDetails"].is_null() {
            Ok(answer["result"]["value"].clone())
        } else {
            Err(answer["exceptionDetails"].clone())
        }
    }

    /// Waits until an expression is true. A page that is being left or loaded may refuse to answer or throw; this counts as
    /// not yet true.
    ///
    /// # Panics
    /// If the expression stays false; the panic message contains the last answer.
    pub fn wait(&mut self, expression: &str) {
        let until = Instant::now() + PATIENCE;
        loop {
            let answer = self.evaluate(expression);
            if answer.as_ref().is_ok_and(|answer| *answer == true) {
                return;
            }
            assert!(Instant::now() < until, "never true: {expression}; at last: {answer:?}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Drags the mouse in ten steps.
    pub fn drag(&mut self, from: [f64; 2], to: [f64; 2]) {
        let mut event = |kind: &str, [x, y]: [f64; 2], buttons: u32| {
            let button = if buttons > 0 || kind == "mouseReleased" { "left" } else { "none" };
            let parameters = json!({ "type": kind, "x": x, "y": y, "button": button, "buttons": buttons, "clickCount": 1 });
            self.call("Input.dispatchMouseEvent", parameters);
        };
        event("mousePressed", from, 1);
        for i in 1..=10 {
            let fraction = f64::from(i) / 10.0;
            event("mouseMoved", [0, 1].map(|c| from[c] + fraction * (to[c] - from[c])), 1);
        }
        event("mouseReleased", to, 0);
    }

    /// Presses and releases a key, given by its name in JavaScript. The event goes to the element that has the focus.
    pub fn press(&mut self, key: &str) {
        let text = if key.chars().count() == 1 { key } else { "" };
        self.call("Input.dispatchKeyEvent", json!({ "type": "keyDown", "key": key, "text": text }));
        self.call("Input.dispatchKeyEvent", json!({ "type": "keyUp", "key": key }));
    }

    /// Opens the list of keys of a page that shows a model, by its key and by its button, and closes it again.
    ///
    /// # Panics
    /// If the list does not open or close, or lacks a key.
    pub fn check_list_of_keys(&mut self) {
        let open = "document.getElementById('keys').open";
        let rows = "[...document.querySelectorAll('#keys dt')].map((keys) =>
            [keys.textContent, keys.nextElementSibling.textContent])";
        for by_key in [true, false] {
            if by_key {
                self.value("document.getElementById('view').focus()");
                self.press("?");
            } else {
                self.value("document.getElementById('show-keys').click()");
            }
            assert_eq!(self.value(open), true, "by its key: {by_key}");
            assert_eq!(self.value(rows), json!(KEYS));
            self.value("document.querySelector('#keys button').click()");
            assert_eq!(self.value(open), false);
        }
    }

    /// Returns true if screenshots are kept for inspection: `TRIMIP_SCREENSHOTS` names their folder.
    pub fn keeps() -> bool {
        std::env::var_os("TRIMIP_SCREENSHOTS").is_some()
    }

    /// Writes a screenshot if `TRIMIP_SCREENSHOTS` is set.
    ///
    /// # Panics
    /// If the screenshot cannot be written.
    pub fn keep(&mut self, name: &str) {
        if let Some(folder) = std::env::var_os("TRIMIP_SCREENSHOTS") {
            std::fs::write(Path::new(&folder).join(name), self.screenshot())
                .expect("the folder of screenshots");
        }
    }

    /// Returns the window as a PNG.
    ///
    /// # Panics
    /// If the browser takes no screenshot.
    pub fn screenshot(&mut self) -> Vec<u8> {
        let answer = self.call("Page.captureScreenshot", json!({ "format": "png" }));
        let text = answer["data"].as_str().expect("a picture");
        let digit = |byte: u8| match byte {
            b'A'..=b'Z' => byte - b'A',
            b'a'..=b'z' => byte - b'a' + 26,
            b'0'..=b'9' => byte - b'0' + 52,
            b'+' => 62,
            _ => 63,
        };
        let digits: Vec<u8> = text.bytes().filter(|byte| *byte != b'=').map(digit).collect();
        let bytes = digits.chunks(4).flat_map(|four| {
            let all =
                four.iter().fold(0_u32, |all, digit| all << 6 | u32::from(*digit)) << (6 * (4 - four.len()));
            all.to_be_bytes()[1..four.len()].to_vec()
        });
        bytes.collect()
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}
