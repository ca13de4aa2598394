//! The server: the page and its modules, photographs, and the web socket. Requests without the token, or from another origin,
//! are rejected.

use crate::listener::Patient;
use crate::page;
use crate::picture;
use crate::protocol::{self, Command, MOST_BYTES, MOST_SIDE, Photo, Split};
use crate::render_thread::{Answer, RenderThread};
use crate::scene::{Renderers, Scene};
use axum::Router;
use axum::body::Bytes;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Path, Query, Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde::Deserialize;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, watch};
use tokio::time::{interval, timeout};
use trimip_core::{Advice, Crop, Error, Result};

/// Maximum number of simultaneous pages.
const MOST_PAGES: usize = 64;

/// Interval of the pings that check whether a page is still connected.
const PULSE: Duration = Duration::from_secs(20);

/// A page that accepts no message for this long counts as gone.
const PATIENCE: Duration = Duration::from_secs(30);

/// The files of the page: name, type, text.
const FILES: [(&str, &str, &str); 8] = [
    ("", "text/html; charset=utf-8", include_str!("../page/index.html")),
    ("style.css", "text/css; charset=utf-8", page::STYLE),
    ("main.js", "text/javascript; charset=utf-8", include_str!("../page/main.js")),
    ("orbit.js", "text/javascript; charset=utf-8", page::ORBIT),
    ("gestures.js", "text/javascript; charset=utf-8", page::GESTURES),
    ("link.js", "text/javascript; charset=utf-8", include_str!("../page/link.js")),
    ("training.js", "text/javascript; charset=utf-8", include_str!("../page/training.js")),
    ("frusta.js", "text/javascript; charset=utf-8", include_str!("../page/frusta.js")),
];

/// Name of the report in its address.
const REPORT: &str = "report.html";

/// Content security policy of the page: nothing is loaded from other origins.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Content security policy of reports. A report holds its style and script inline and may come from a stranger, so it is sandboxed: it gets
/// an origin of its own, from which nothing of this server is accessible.
const REPORT_POLICY: &str = "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; \
                             style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; \
                             frame-ancestors 'none'";

struct ServerState {
    token: String,
    /// Token in the address of the report. A report may come from a stranger and reads its own address, which therefore does not
    /// contain the token of the viewer.
    report_token: String,
    /// The description of the scene, except for its crop.
    about: serde_json::Value,
    scene: Arc<Scene>,
    render_thread: RenderThread,
    /// Permits for connected pages.
    places: Arc<Semaphore>,
    /// Status of the watched run, as JSON; empty without a run.
    status: watch::Sender<Arc<str>>,
    callbacks: Callbacks,
}

/// Callback for the commands of pages.
pub type Control = Box<dyn Fn(Command) + Send + Sync>;

/// Callback that stores a crop with the model.
pub type Keep = Box<dyn Fn(Crop) -> Result<()> + Send + Sync>;

/// What pages can do besides looking.
#[derive(Default)]
pub struct Callbacks {
    /// Receives the commands of pages to the run; `None` without a run.
    pub control: Option<Control>,
    /// Stores the crop that a page sets; `None` if pages cannot set one.
    pub keep: Option<Keep>,
}

/// A bound address with its token. Connections wait until the [`Server`] starts.
pub struct Listener {
    listener: std::net::TcpListener,
    token: String,
    /// The address to open; it contains the token.
    pub address: String,
}

impl Listener {
    /// Binds an address; port 0 selects a free port.
    ///
    /// # Errors
    /// When the address is taken or cannot be bound.
    pub fn bind(at: SocketAddr) -> Result<Self> {
        let failed = |error: std::io::Error| {
            let advice = Advice::Argument("choose another {bind} or {port}".into());
            Error::input(format!("{at}"), format!("cannot listen: {error}"), advice)
        };
        let listener = std::net::TcpListener::bind(at).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let own = listener.local_addr().map_err(failed)?;
        let token = token()?;
        let address = format!("http://{own}/{token}/");
        Ok(Self { listener, token, address })
    }
}

/// A running server.
pub struct Server {
    /// The address to open; it contains the token.
    pub address: String,
    state: Arc<ServerState>,
    stop: watch::Sender<bool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Starts serving.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn open(
        listener: Listener,
        scene: Scene,
        renderers: Renderers,
        callbacks: Callbacks,
    ) -> Result<Self> {
        let Listener { listener, token, address } = listener;
        let mut about = scene.describe(&renderers.names(), &renderers.device());
        about["training"] = callbacks.control.is_some().into();
        about["keeps"] = callbacks.keep.is_some().into();
        let report_token = self::token()?;
        if about["report"] == true {
            about["report"] = format!("/{report_token}/report.html").into();
        }
        let scene = Arc::new(scene);
        let render_thread = RenderThread::start(Arc::clone(&scene), renderers)?;
        let status = watch::channel(Arc::from("")).0;
        let state = Arc::new(ServerState {
            token,
            report_token,
            about,
            scene,
            render_thread,
            places: Arc::new(Semaphore::new(MOST_PAGES)),
            status,
            callbacks,
        });
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|error| Error::device(format!("cannot start the server: {error}")))?;
        let (stop, mut stopped) = watch::channel(false);
        let routes = Router::new()
            .route("/{token}/", get(front))
            .route("/{token}/scene.json", get(about_scene))
            .route(&format!("/{{token}}/{REPORT}"), get(report))
            .route("/{token}/photo/{split}/{index}", get(photograph))
            .route("/{token}/socket", get(socket))
            .route("/{token}/{file}", get(file))
            .fallback(async || StatusCode::FORBIDDEN)
            .layer(middleware::from_fn_with_state(Arc::clone(&state), admitted))
            .with_state(Arc::clone(&state));
        let serve = move || {
            runtime.block_on(async {
                let listener = match TcpListener::from_std(listener) {
                    Ok(listener) => listener,
                    Err(error) => return eprintln!("error: the server: {error}"),
                };
                let served = async {
                    if let Err(error) = axum::serve(Patient::new(listener), routes).await {
                        eprintln!("error: the server: {error}");
                    }
                };
                tokio::select! {
                    () = served => {}
                    _ = stopped.wait_for(|stop| *stop) => {}
                }
            });
        };
        let thread = thread::Builder::new()
            .name("server".into())
            .spawn(serve)
            .map_err(|error| Error::device(format!("cannot start the server: {error}")))?;
        Ok(Self { address, state, stop, thread: Some(thread) })
    }

    /// Returns the render thread.
    pub fn render_thread(&self) -> &RenderThread {
        &self.state.render_thread
    }

    /// Sends the status of the run, as JSON, to every page, including those that connect later.
    pub fn tell(&self, status: &str) {
        self.state.status.send_replace(Arc::from(status));
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.send_replace(true);
        self.state.render_thread.close();
        // The panic handler has already printed the reason if the thread panicked.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// Returns 128 random bits as hexadecimal digits.
fn token() -> Result<String> {
    let mut bytes = [0_u8; 16];
    getrandom::fill(&mut bytes).map_err(|error| Error::device(format!("no random numbers: {error}")))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

impl ServerState {
    /// Fails unless `token` is that of the requested `page` and the request comes from the page itself. If the browser sends an `Origin`, it must be this
    /// server's. The only `Host` must be `localhost` or an IP address, because an attacker could make a DNS name resolve to this machine.
    fn admit(&self, token: &str, page: &str, headers: &HeaderMap) -> std::result::Result<(), StatusCode> {
        let mut hosts = headers.get_all(header::HOST).iter();
        let host = hosts.next().and_then(|host| host.to_str().ok()).unwrap_or_default();
        let name = host.rsplit_once(':').map_or(host, |(name, _)| name);
        let known = hosts.next().is_none()
            && (name == "localhost" || name.trim_matches(['[', ']']).parse::<IpAddr>().is_ok());
        let origin = headers.get(header::ORIGIN).map(|origin| origin.to_str().unwrap_or_default());
        let own = origin.is_none_or(|origin| origin == format!("http://{host}"));
        let expected = if page == REPORT { &self.report_token } else { &self.token };
        let same = token.len() == expected.len()
            && token.bytes().zip(expected.bytes()).fold(0, |all, (a, b)| all | (a ^ b)) == 0;
        if same && own && known { Ok(()) } else { Err(StatusCode::FORBIDDEN) }
    }
}

/// Answers 403 to every request that [`ServerState::admit`] refuses, before the rest of the request is read.
async fn admitted(State(state): State<Arc<ServerState>>, request: Request, next: Next) -> Answered {
    let mut parts = request.uri().path().split('/').skip(1);
    let (token, page) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
    state.admit(token, page, request.headers())?;
    Ok(next.run(request).await)
}

/// Result of a handler.
type Answered = std::result::Result<Response, StatusCode>;

fn text(kind: &'static str, body: String) -> Response {
    bounded(kind, POLICY, body)
}

/// Returns a text response with the content security policy `policy`.
fn bounded(kind: &'static str, policy: &'static str, body: String) -> Response {
    let headers = [
        (header::CONTENT_TYPE, kind),
        (header::CACHE_CONTROL, "no-store"),
        (header::CONTENT_SECURITY_POLICY, policy),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ];
    (headers, body).into_response()
}

async fn front() -> Answered {
    file(Path((String::new(), String::new()))).await
}

async fn file(Path((_, name)): Path<(String, String)>) -> Answered {
    let own = FILES.iter().find(|(own, ..)| *own == name).ok_or(StatusCode::NOT_FOUND)?;
    Ok(text(own.1, own.2.into()))
}

async fn about_scene(State(state): State<Arc<ServerState>>) -> Answered {
    let mut about = state.about.clone();
    about["crop"] = state.scene.stated(state.scene.crop()).to_string().into();
    Ok(text("application/json", about.to_string()))
}

/// Serves the report of the model's run, in its current state.
async fn report(State(state): State<Arc<ServerState>>) -> Answered {
    let path = state.scene.report.clone().ok_or(StatusCode::NOT_FOUND)?;
    let read = tokio::task::spawn_blocking(move || trimip_core::plain_file::read_to_string(&path));
    let page =
        read.await.map_err(|_| StatusCode::INTERNAL_SERVER_ERROR)?.map_err(|_| StatusCode::NOT_FOUND)?;
    Ok(bounded("text/html; charset=utf-8", REPORT_POLICY, page))
}

/// Requested size of a photograph, pixels.
#[derive(Deserialize)]
struct Size {
    width: u32,
    height: u32,
}

async fn photograph(
    State(state): State<Arc<ServerState>>,
    Path((_, split, index)): Path<(String, Split, usize)>,
    Query(Size { width, height }): Query<Size>,
) -> Answered {
    if ![width, height].iter().all(|side| (1..=MOST_SIDE).contains(side)) {
        return Err(StatusCode::BAD_REQUEST);
    }
    let scene = Arc::clone(&state.scene);
    let work = move || {
        let image = scene.photographs.image(Photo { split, index }, width, height)?;
        picture::jpeg(&image)
    };
    let jpeg = tokio::task::spawn_blocking(work).await.map_err(|_| StatusCode::INTERNAL_SERVER_ERROR)?;
    let jpeg = jpeg.map_err(|_| StatusCode::NOT_FOUND)?;
    let headers = [
        (header::CONTENT_TYPE, "image/jpeg"),
        (header::CACHE_CONTROL, "no-store"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ];
    Ok((headers, jpeg).into_response())
}

async fn socket(State(state): State<Arc<ServerState>>, upgrade: WebSocketUpgrade) -> Answered {
    let place = Arc::clone(&state.places).try_acquire_owned().map_err(|_| StatusCode::SERVICE_UNAVAILABLE)?;
    let upgrade = upgrade.max_message_size(MOST_BYTES).max_frame_size(MOST_BYTES);
    Ok(upgrade.on_upgrade(async move |socket| {
        attend(state, socket).await;
        drop(place);
    }))
}

/// Serves the socket of a page: reads its messages and sends it the newest answer and status, until the page leaves.
async fn attend(state: Arc<ServerState>, mut socket: WebSocket) {
    let (id, mut answers) = state.render_thread.enter();
    let mut status = state.status.subscribe();
    status.mark_changed();
    let mut pulse = interval(PULSE);
    loop {
        let sent = tokio::select! {
            _ = pulse.tick() => send(&mut socket, Message::Ping(Bytes::new())).await,
            message = socket.recv() => match message {
                Some(Ok(Message::Text(text))) => match protocol::Message::read(&text) {
                    Ok(protocol::Message::View(request)) => {
                        state.render_thread.ask(id, request);
                        true
                    }
                    Ok(protocol::Message::Keep(part)) => {
                        let answer = keep(&state, part).await.unwrap_or_else(|error| failure(&error.to_string()));
                        send(&mut socket, answer).await
                    }
                    Ok(protocol::Message::Command(command)) => match &state.callbacks.control {
                        Some(control) => {
                            control(command);
                            true
                        }
                        None => send(&mut socket, failure("there is no run to control")).await,
                    },
                    Err(error) => send(&mut socket, failure(&error.to_string())).await,
                },
                Some(Ok(Message::Binary(_))) => send(&mut socket, failure("a message has to be text")).await,
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => true,
                Some(Ok(Message::Close(_)) | Err(_)) | None => false,
            },
            changed = answers.changed() => {
                let answer = answers.borrow_and_update().clone();
                changed.is_ok() && match answer {
                    Some(Answer::Picture(bytes)) => {
                        send(&mut socket, Message::Binary(bytes.to_vec().into())).await
                    }
                    Some(Answer::Failed(error)) => send(&mut socket, failure(&error)).await,
                    None => true,
                }
            }
            changed = status.changed() => {
                let text = Arc::clone(&status.borrow_and_update());
                let message = Message::Text(text.as_ref().into());
                changed.is_ok() && (text.is_empty() || send(&mut socket, message).await)
            }
        };
        if !sent {
            break;
        }
    }
    state.render_thread.leave(id);
}

/// Makes a part of the box the crop of the model; returns the message that tells the page.
async fn keep(state: &Arc<ServerState>, part: [[f64; 3]; 2]) -> Result<Message> {
    if state.callbacks.keep.is_none() {
        return Err(Error::input("crop", "cannot be kept here", "name it with --crop"));
    }
    let work = Arc::clone(state);
    let kept = tokio::task::spawn_blocking(move || {
        let crop = work.scene.part(part)?;
        work.callbacks.keep.as_ref().map_or(Ok(()), |keep| keep(crop))?;
        work.scene.keep(crop);
        Ok(crop)
    });
    let crop = kept.await.map_err(|error| Error::run(format!("the crop was not kept: {error}")))??;
    let crop = state.scene.stated(crop).to_string();
    Ok(Message::Text(serde_json::json!({ "crop": crop }).to_string().into()))
}

/// Sends a message. Returns false if the page is gone or accepts nothing within [`PATIENCE`].
async fn send(socket: &mut WebSocket, message: Message) -> bool {
    timeout(PATIENCE, socket.send(message)).await.is_ok_and(|sent| sent.is_ok())
}

fn failure(error: &str) -> Message {
    Message::Text(serde_json::json!({ "error": error }).to_string().into())
}
