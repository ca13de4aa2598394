//! The render thread. Each page has one request, its newest, and pages are served in turn. A coarse picture of one page goes before a
//! full-resolution picture of another, and a full-resolution render is cancelled and restarted later if another page waits for its first
//! picture. During training, the thread loads each new state of the model between two pictures and then renders every page's view again.

use crate::picture::{RenderedView, jpeg};
use crate::protocol::{Header, Renderer, Request, Show, message};
use crate::scene::{Renderers, Scene};
use std::collections::BTreeMap;
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use tokio::sync::watch;
use trimip::view::cameras::resized;
use trimip_core::field::model::Model;
use trimip_core::{Camera, Crop, Error, Result};

/// Returns the time limit of a coarse picture. Hybrid rendering is four times as fast: half of the gain goes into more pictures, half into
/// finer ones.
fn coarse_time(renderer: Renderer) -> Duration {
    match renderer {
        Renderer::Volume => Duration::from_millis(70),
        Renderer::Hybrid => Duration::from_millis(35),
    }
}

/// Time limit of a full-resolution render of a still view. If the render would take longer, a coarse picture comes first.
const PATIENCE: Duration = Duration::from_millis(140);

/// Rendering speed that is assumed before the first picture, pixels per second.
const ASSUMED_SPEED: f64 = 400_000.0;

/// Weight of the newest picture in the moving average of the speed.
const NEWEST: f64 = 0.4;

/// Minimum number of pixels along the longer side of a coarse picture.
const LEAST_SIDE: f64 = 48.0;

/// An answer to a request: a binary message, or the text of an error.
#[derive(Clone, Debug)]
pub enum Answer {
    /// Header and picture.
    Picture(Arc<Vec<u8>>),
    /// Text of an error.
    Failed(String),
}

/// A connected page.
struct Client {
    request: Option<(Request, Instant)>,
    /// The newest request, served or not.
    last: Option<Request>,
    /// True if the coarse picture of the request has been rendered.
    begun: bool,
    answers: watch::Sender<Option<Answer>>,
}

#[derive(Default)]
struct Queue {
    clients: BTreeMap<u64, Client>,
    next: u64,
    /// The page that was served last.
    last: u64,
    /// A newer state of the model that is not loaded yet.
    model: Option<Model>,
    /// True while a state of the model is being loaded.
    loading: bool,
    /// Time that the last state of the model took to load.
    load_time: Duration,
    closed: bool,
}

impl Queue {
    /// Returns the page to serve next. Pages without any picture of their current view come first; otherwise pages take turns.
    fn select(&self) -> Option<u64> {
        let waiting = |begun: bool| {
            let own = move |(_, client): &(&u64, &Client)| client.request.is_some() && client.begun == begun;
            let after = self.clients.range(self.last + 1..).find(own);
            after.or_else(|| self.clients.iter().find(own)).map(|(id, _)| *id)
        };
        waiting(false).or_else(|| waiting(true))
    }

    /// Returns true if the full-resolution render of page `id` must be cancelled: the thread closes, the page has left, or a page waits for
    /// its first picture.
    fn interrupts(&self, id: u64) -> bool {
        let asks = |client: &Client| client.request.is_some() && !client.begun;
        self.closed || !self.clients.contains_key(&id) || self.clients.values().any(asks)
    }
}

#[derive(Default)]
struct Shared {
    queue: Mutex<Queue>,
    changed: Condvar,
}

impl Shared {
    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
    }
}

/// The render thread and its queue of requests.
pub struct RenderThread {
    shared: Arc<Shared>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl RenderThread {
    /// Starts the thread.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn start(scene: Arc<Scene>, mut renderers: Renderers) -> Result<Self> {
        let shared = Arc::new(Shared::default());
        let own = Arc::clone(&shared);
        let run = move || {
            Worker { scene, speed: BTreeMap::new(), shared: own, clips: BTreeMap::new() }.run(&mut renderers);
        };
        let thread = thread::Builder::new()
            .name("render".into())
            .spawn(run)
            .map_err(|error| Error::device(format!("cannot start the render thread: {error}")))?;
        Ok(Self { shared, thread: Mutex::new(Some(thread)) })
    }

    /// Adds a page. Returns its number and the channel of its newest answer.
    pub fn enter(&self) -> (u64, watch::Receiver<Option<Answer>>) {
        let mut queue = self.shared.queue();
        queue.next += 1;
        let (answers, receiver) = watch::channel(None);
        let id = queue.next;
        queue.clients.insert(id, Client { request: None, last: None, begun: false, answers });
        (id, receiver)
    }

    /// Returns the number of connected pages.
    pub fn watchers(&self) -> usize {
        self.shared.queue().clients.len()
    }

    /// Requests a view for a page, in place of the page's earlier request.
    pub fn ask(&self, id: u64, request: Request) {
        if let Some(client) = self.shared.queue().clients.get_mut(&id) {
            client.last = Some(request.clone());
            client.request = Some((request, Instant::now()));
            client.begun = false;
        }
        self.shared.changed.notify_all();
    }

    /// Shows a newer state of the model. A state that is still waiting to be loaded is dropped.
    pub fn show(&self, model: Model) {
        self.shared.queue().model = Some(model);
        self.shared.changed.notify_all();
    }

    /// Returns the time that the last state of the model took to load; `None` while a newer one waits or is being loaded.
    pub fn load_time(&self) -> Option<Duration> {
        let queue = self.shared.queue();
        (queue.model.is_none() && !queue.loading).then_some(queue.load_time)
    }

    /// Removes a page.
    pub fn leave(&self, id: u64) {
        self.shared.queue().clients.remove(&id);
    }

    /// Ends the thread and cancels the picture in progress.
    pub fn close(&self) {
        self.shared.queue().closed = true;
        self.shared.changed.notify_all();
        let thread = self.thread.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).take();
        // The panic handler has already printed the reason if the thread panicked.
        let _ = thread.map(JoinHandle::join);
    }
}

/// State of the render thread.
struct Worker {
    scene: Arc<Scene>,
    /// Rendering speed in pixels per second, by renderer.
    speed: BTreeMap<Renderer, f64>,
    /// The crops that are currently set in each renderer.
    clips: BTreeMap<Renderer, Vec<Crop>>,
    shared: Arc<Shared>,
}

/// The next task of the render thread.
enum Task {
    /// Loads a newer state of the model.
    Load(Box<Model>),
    /// Serves page `id`: its request, the time of the request, and true if the coarse picture has been rendered.
    Serve(u64, Request, Instant, bool),
}

impl Worker {
    fn run(mut self, renderers: &mut Renderers) {
        while let Some(run) = self.next() {
            let (id, request, asked, begun) = match run {
                Task::Serve(id, request, asked, begun) => (id, request, asked, begun),
                Task::Load(model) => {
                    self.load(renderers, &model);
                    continue;
                }
            };
            let outcome = self.serve(renderers, id, &request, asked, begun);
            let mut queue = self.shared.queue();
            let Some(client) = queue.clients.get_mut(&id) else { continue };
            let current = client.request.as_ref().is_some_and(|(own, _)| *own == request);
            match outcome {
                // The render was cancelled; the page's newer request stays in the queue.
                Ok(None) => {}
                Ok(Some((bytes, done))) => {
                    if current {
                        client.begun = true;
                        client.request = client.request.take().filter(|_| !done);
                    }
                    client.answers.send_replace(Some(Answer::Picture(Arc::new(bytes))));
                }
                Err(error) => {
                    client.request = client.request.take().filter(|_| !current);
                    client.answers.send_replace(Some(Answer::Failed(error.to_string())));
                }
            }
        }
    }

    /// Waits for a task; `None` when the thread closes.
    fn next(&self) -> Option<Task> {
        let mut queue = self.shared.queue();
        loop {
            if queue.closed {
                return None;
            }
            if let Some(model) = queue.model.take() {
                queue.loading = true;
                return Some(Task::Load(Box::new(model)));
            }
            if let Some(id) = queue.select() {
                queue.last = id;
                let client = queue.clients.get(&id)?;
                let (request, asked) = client.request.clone()?;
                return Some(Task::Serve(id, request, asked, client.begun));
            }
            queue = self.shared.changed.wait(queue).unwrap_or_else(|poisoned| poisoned.into_inner());
        }
    }

    /// Loads a state of the model and repeats the last request of every page.
    fn load(&mut self, renderers: &mut Renderers, model: &Model) {
        let started = Instant::now();
        let loaded = Renderers::open(model);
        let mut queue = self.shared.queue();
        (queue.loading, queue.load_time) = (false, started.elapsed());
        match loaded {
            Ok(loaded) => {
                *renderers = loaded;
                self.clips.clear();
                for client in queue.clients.values_mut().filter(|client| client.request.is_none()) {
                    client.request = client.last.clone().map(|request| (request, Instant::now()));
                    // Marked as begun, so that the last picture stays until the full-resolution one is ready, without a coarse picture in
                    // between.
                    client.begun = client.request.is_some();
                }
            }
            Err(error) => queue.clients.values().for_each(|client| {
                client.answers.send_replace(Some(Answer::Failed(error.to_string())));
            }),
        }
    }

    /// Renders the next picture of a request. Returns the message and whether it is the last one; `None` if the render was cancelled.
    fn serve(
        &mut self,
        renderers: &mut Renderers,
        id: u64,
        request: &Request,
        asked: Instant,
        begun: bool,
    ) -> Result<Option<(Vec<u8>, bool)>> {
        let photographs = &self.scene.photographs;
        let photographed = request.photo.map(|photo| photographs.camera(photo)).transpose()?;
        let finest = request.camera(photographed)?;
        let pixels = f64::from(finest.intrinsics.width) * f64::from(finest.intrinsics.height);
        let renderer = renderers.known(request.renderer);
        let speed = self.speed.get(&renderer).copied().unwrap_or(ASSUMED_SPEED);
        let coarse_time = coarse_time(renderer);
        let limit = if request.moving { coarse_time } else { PATIENCE };
        let fine = begun || pixels / speed <= limit.as_secs_f64();
        let factor = if fine { 1.0 } else { coarse(&finest, speed * coarse_time.as_secs_f64()) };
        let camera = Camera { intrinsics: resized(finest.intrinsics, factor)?, ..finest };
        let Some(viewer) = renderers.get(renderer) else {
            return Err(Error::run("there is no renderer"));
        };
        let keep = request.kept(self.scene.crop());
        if self.clips.get(&renderer).map_or(&[][..], Vec::as_slice) != keep {
            viewer.clip(&keep)?;
            self.clips.insert(renderer, keep);
        }
        let started = Instant::now();
        let shared = &self.shared;
        let watch = &mut |_: u32, _: u32| !(begun && shared.queue().interrupts(id));
        let Some(frame) = viewer.render_watched(&camera, watch)? else { return Ok(None) };
        let rendered = started.elapsed().as_secs_f64();
        let photograph = match request.photo.filter(|_| request.show.compares()) {
            Some(photo) => Some(photographs.image(photo, frame.width, frame.height)?),
            None => None,
        };
        let samples = match request.show {
            Show::Samples => match viewer.samples(&camera, watch)? {
                Some(samples) => samples,
                None => return Ok(None),
            },
            _ => Vec::new(),
        };
        let config = &self.scene.config;
        let view = RenderedView {
            frame: &frame,
            camera: &camera,
            config,
            samples: &samples,
            photograph: photograph.as_ref(),
        };
        let shown = view.picture(request.show);
        // The time includes all work for a picture of this kind, not only rendering.
        let spent = started.elapsed().as_secs_f64();
        let measured = f64::from(frame.width) * f64::from(frame.height) / spent.max(1e-6);
        self.speed.insert(renderer, speed + NEWEST * (measured - speed));
        let done = request.moving || factor >= 1.0;
        let header = Header {
            id: request.id,
            width: frame.width,
            height: frame.height,
            rendered: 1e3 * rendered,
            waited: 1e3 * asked.elapsed().as_secs_f64(),
            done,
            samples: (!samples.is_empty())
                .then(|| samples.iter().map(|&count| f64::from(count)).sum::<f64>() / samples.len() as f64),
            range: shown.range,
        };
        Ok(Some((message(&header, &jpeg(&shown.picture)?), done)))
    }
}

/// Returns the factor by which the sides are reduced so that a picture has about `pixels` pixels.
fn coarse(finest: &Camera, pixels: f64) -> f64 {
    let (width, height) = (f64::from(finest.intrinsics.width), f64::from(finest.intrinsics.height));
    let least = LEAST_SIDE / width.max(height);
    (pixels / (width * height)).sqrt().max(least).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn client(asks: bool, begun: bool) -> Client {
        let text = r#"{"id":1,"pose":[1,0,0,0,0,1,0,0,0,0,1,4],"fov":50,"width":4,"height":3,"show":"color","renderer":"volume","moving":false}"#;
        let request = Request::read(text).unwrap();
        let last = Some(request.clone());
        Client {
            request: asks.then(|| (request, Instant::now())),
            last,
            begun,
            answers: watch::channel(None).0,
        }
    }

    #[test]
    fn pages_take_turns_and_first_pictures_go_before_fine_ones() {
        let mut queue = Queue::default();
        assert_eq!(queue.select(), None);
        queue.clients = BTreeMap::from([
            (1, client(true, true)),
            (2, client(true, false)),
            (3, client(false, false)),
            (4, client(true, false)),
        ]);
        assert_eq!(queue.select(), Some(2));
        queue.last = 2;
        assert_eq!(queue.select(), Some(4));
        queue.last = 4;
        assert_eq!(queue.select(), Some(2), "in turn");
        assert!(queue.interrupts(1), "somebody waits for a first picture");
        queue.clients.retain(|id, _| [1, 3].contains(id));
        assert_eq!(queue.select(), Some(1));
        assert!(!queue.interrupts(1) && queue.interrupts(9), "who left needs no picture");
    }

    #[test]
    fn a_coarse_picture_has_the_pixels_that_the_time_allows() {
        let intrinsics = trimip_core::Intrinsics::from_angle(400, 200, 0.7);
        let camera = Camera::look_at(intrinsics, glam::DVec3::X, glam::DVec3::ZERO, glam::DVec3::Z);
        assert_eq!(coarse(&camera, 1e9), 1.0);
        assert!((coarse(&camera, 20_000.0) - 0.5).abs() < 1e-12);
        assert!(
            (coarse(&camera, 0.0) - 0.12).abs() < 1e-12,
            "never less than 48 pixels along the longer side"
        );
    }
}
