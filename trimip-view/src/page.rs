//! Parts of the page that a page without a server has too (`trimip-cli export web`).

/// The look: light and dark.
pub const STYLE: &str = include_str!("../page/style.css");

/// A camera that turns around a point.
pub const ORBIT: &str = include_str!("../page/orbit.js");

/// Mouse, touch, wheel and keys, and the dialog that lists them.
pub const GESTURES: &str = include_str!("../page/gestures.js");
