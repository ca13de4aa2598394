//! The messages between page and server. A page sends a [`Request`] or a [`Command`] as JSON. The server answers a request with binary
//! messages: the length of a JSON header (u32, little-endian), the header (a [`Header`]), and a JPEG picture.

use serde::{Deserialize, Serialize};
use trimip::view::cameras::{posed, resized};
use trimip_core::{Camera, Crop, Error, Intrinsics, Result};

/// Largest width or height of a picture, pixels.
pub const MOST_SIDE: u32 = 2048;

/// Maximum size of a message from a page, bytes.
pub const MOST_BYTES: usize = 16 << 10;

/// Quantity that a picture shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Show {
    /// Colour on the background of the model.
    Color,
    /// Opacity, black to white.
    Opacity,
    /// Distance along the optical axis, from white at the near end of the box to black at the far end.
    Depth,
    /// Direction of the surface, from neighbouring depths: x, y, z of the world as red, green, blue.
    Normals,
    /// Mip level from which the surface is read, fine to coarse; the mean of the three planes.
    Level,
    /// Number of samples whose colour is evaluated, few to many.
    Samples,
    /// Absolute difference from the photograph, four times as bright.
    Difference,
    /// FLIP errors relative to the photograph.
    Flip,
}

impl Show {
    /// Returns true if the picture needs a photograph.
    pub fn compares(self) -> bool {
        matches!(self, Self::Difference | Self::Flip)
    }
}

/// Placement of samples when a view is rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Renderer {
    /// Samples along the whole ray.
    Volume,
    /// Samples only where the proxy of the model has weight.
    Hybrid,
}

/// A set of photographs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Test views.
    Test,
    /// Training views.
    Train,
}

/// A photograph, by its index in a set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Photo {
    /// Set of the photograph.
    pub split: Split,
    /// Index in the set.
    pub index: usize,
}

/// A view that a page requests.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Number of the request, which the answer repeats.
    pub id: u64,
    /// Camera-to-world matrix [R|t], 12 numbers row by row, OpenGL axes.
    pub pose: Vec<f64>,
    /// Horizontal field of view, degrees.
    pub fov: f64,
    /// Width of the finest picture, pixels.
    pub width: u32,
    /// Height of the finest picture, pixels.
    pub height: u32,
    /// Quantity that the picture shows.
    pub show: Show,
    /// How the picture is rendered.
    pub renderer: Renderer,
    /// True while the camera moves; the answer is then one coarse picture. Otherwise finer pictures follow, up to full resolution.
    pub moving: bool,
    /// A photograph, whose camera and aspect ratio replace `pose`, `fov` and the ratio of `width` to `height`.
    #[serde(default)]
    pub photo: Option<Photo>,
    /// The visible part of the box: its lower and upper corner, world units.
    #[serde(default)]
    pub clip: Option<[[f64; 3]; 2]>,
    /// True to show only the model's crop (`scene.crop`).
    #[serde(default)]
    pub cropped: bool,
}

/// A command that a page sends to the run that it watches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Command {
    /// Pauses training until [`Command::Resume`].
    Pause,
    /// Continues training.
    Resume,
    /// Ends the run after the current step and saves, like Ctrl-C.
    Stop,
}

/// A message from a page.
#[derive(Clone, Debug, PartialEq)]
pub enum Message {
    /// A request for a view.
    View(Request),
    /// A command to the run.
    Command(Command),
    /// The part of the box that becomes the crop of the model: its lower and upper corner, world units.
    Keep([[f64; 3]; 2]),
}

impl Message {
    /// Reads a message.
    ///
    /// # Errors
    /// When the text is neither a command, nor a crop, nor a request, or a number is out of range. The page shows the text of the error.
    pub fn read(text: &str) -> Result<Self> {
        /// `{"command": "pause"}`.
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Steering {
            command: Command,
        }
        /// `{"keep": [[0, 0, 0], [1, 1, 1]]}`.
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Keeping {
            keep: [[f64; 3]; 2],
        }
        if let Ok(steering) = serde_json::from_str::<Steering>(text) {
            return Ok(Self::Command(steering.command));
        }
        match serde_json::from_str::<Keeping>(text) {
            Ok(Keeping { keep }) => part(keep).map(Self::Keep),
            Err(_) => Request::read(text).map(Self::View),
        }
    }
}

/// Refuses a part of the box that is empty.
fn part([low, high]: [[f64; 3]; 2]) -> Result<[[f64; 3]; 2]> {
    if !(0..3).all(|axis| low[axis] < high[axis]) {
        return Err(Error::input("message", "has an empty clipping box", "expected a view to render"));
    }
    Ok([low, high])
}

impl Request {
    /// Reads a request.
    ///
    /// # Errors
    /// When the text is no request, or a number is out of range. The page shows the text of the error.
    pub fn read(text: &str) -> Result<Self> {
        let refuse = |what: String| Err(Error::input("message", what, "expected a view to render"));
        let request: Self = match serde_json::from_str(text) {
            Ok(request) => request,
            Err(error) => return refuse(error.to_string()),
        };
        let sides = [request.width, request.height];
        if sides.iter().any(|side| !(1..=MOST_SIDE).contains(side)) {
            return refuse(format!("{} by {} pixels; a side has 1 to {MOST_SIDE}", sides[0], sides[1]));
        }
        if !(request.fov > 0.0 && request.fov < 180.0) {
            return refuse(format!("a field of view of {} degrees", request.fov));
        }
        if request.show.compares() && request.photo.is_none() {
            return refuse("a comparison without a photograph".into());
        }
        request.clip.map(part).transpose()?;
        request.camera(None)?;
        Ok(request)
    }

    /// Returns the parts of the world whose intersection is visible. `crop` is the model's crop.
    pub fn kept(&self, crop: Crop) -> Vec<Crop> {
        let part = self.clip.map(|[min, max]| Crop::Box { min, max });
        let crop = Some(crop).filter(|crop| self.cropped && *crop != Crop::None);
        part.into_iter().chain(crop).collect()
    }

    /// Returns the camera of the finest picture. `photographed` is the camera of the chosen photograph, if there is one.
    ///
    /// # Errors
    /// When the pose is not rigid.
    pub fn camera(&self, photographed: Option<Camera>) -> Result<Camera> {
        if let Some(camera) = photographed {
            let factor = f64::from(self.width) / f64::from(camera.intrinsics.width.max(1));
            return Ok(Camera { intrinsics: resized(camera.intrinsics, factor)?, ..camera });
        }
        let intrinsics = Intrinsics::from_angle(self.width, self.height, self.fov.to_radians());
        posed("message: pose", &self.pose, intrinsics)
    }
}

/// The header of a picture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// Number of the request.
    pub id: u64,
    /// Width of the picture, pixels.
    pub width: u32,
    /// Height of the picture, pixels.
    pub height: u32,
    /// Rendering time, milliseconds.
    pub rendered: f64,
    /// Time from the arrival of the request to the finished picture, milliseconds.
    pub waited: f64,
    /// True if no finer picture follows.
    pub done: bool,
    /// Mean number of samples per pixel, if they were counted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub samples: Option<f64>,
    /// The values of the darkest and the brightest colour, if the picture shows a quantity with a colour scale.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<[f32; 2]>,
}

/// Returns a binary message: header and picture.
pub fn message(header: &Header, jpeg: &[u8]) -> Vec<u8> {
    let json = serde_json::to_vec(header).unwrap_or_default();
    [&(json.len() as u32).to_le_bytes()[..], &json, jpeg].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn json(more: &str) -> String {
        let pose = "[1,0,0,0, 0,1,0,0, 0,0,1,4]";
        format!(
            r#"{{"id":7,"pose":{pose},"fov":50,"width":40,"height":30,"show":"color","renderer":"volume","moving":true{more}}}"#
        )
    }

    #[test]
    fn a_view_is_read_and_nonsense_is_refused() {
        let request = Request::read(&json("")).unwrap();
        let camera = request.camera(None).unwrap();
        assert_eq!((request.id, camera.intrinsics.width, camera.origin.z), (7, 40, 4.0));
        let broken = [
            String::new(),
            "{}".into(),
            json(r#","more":1"#),
            json("").replace("40", "0"),
            json("").replace("30", "1000000"),
            json("").replace("50", "180"),
            json("").replace("50", "1e999"),
            json("").replace("[1,0,0,0,", "[2,0,0,0,"),
            json("").replace("[1,0,0,0,", "["),
            json("").replace("color", "flip"),
            json("").replace("color", "taste"),
            json(r#","clip":[[0,0,0],[1,0,1]]"#),
            json(r#","clip":[[0,0],[1,1]]"#),
        ];
        for text in broken {
            assert!(Request::read(&text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_page_chooses_parts_of_the_world() {
        let crop = Crop::Ball { centre: [0.0; 3], radius: 2.0 };
        let kept = |more: &str, crop| Request::read(&json(more)).unwrap().kept(crop);
        let part = Crop::Box { min: [0.0; 3], max: [1.0; 3] };
        assert_eq!(kept("", crop), []);
        assert_eq!(kept(r#","cropped":true"#, crop), [crop]);
        assert_eq!(kept(r#","cropped":true"#, Crop::None), [], "there is none");
        assert_eq!(kept(r#","clip":[[0,0,0],[1,1,1]]"#, crop), [part]);
        assert_eq!(kept(r#","clip":[[0,0,0],[1,1,1]],"cropped":true"#, crop), [part, crop]);
    }

    #[test]
    fn a_message_asks_or_steers() {
        assert_eq!(Message::read(r#"{"command":"pause"}"#).unwrap(), Message::Command(Command::Pause));
        assert!(matches!(Message::read(&json("")).unwrap(), Message::View(request) if request.id == 7));
        for text in [r#"{"command":"jump"}"#, r#"{"command":"stop","more":1}"#, "3"] {
            assert!(Message::read(text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_photograph_brings_its_camera_at_the_asked_width() {
        let request = Request::read(&json(r#","photo":{"split":"train","index":3}"#)).unwrap();
        let own = Camera::look_at(
            Intrinsics::from_angle(800, 400, 0.7),
            glam::DVec3::X,
            glam::DVec3::ZERO,
            glam::DVec3::Z,
        );
        let camera = request.camera(Some(own)).unwrap();
        assert_eq!((camera.intrinsics.width, camera.intrinsics.height), (40, 20));
        assert_eq!(camera.origin, own.origin);
    }

    #[test]
    fn a_message_is_length_header_picture() {
        let header = Header {
            id: 1,
            width: 2,
            height: 3,
            rendered: 4.0,
            waited: 5.0,
            done: true,
            samples: None,
            range: None,
        };
        let bytes = message(&header, b"jpeg");
        let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
        assert_eq!(serde_json::from_slice::<Header>(&bytes[4..4 + length]).unwrap(), header);
        assert_eq!(&bytes[4 + length..], b"jpeg");
    }
}
