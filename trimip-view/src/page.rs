//! Parts of the page that are also used by the serverless page of `trimip-cli export web`.

/// The style sheet, light and dark.
pub const STYLE: &str = include_str!("../page/style.css");

/// The module of a camera that orbits a point.
pub const ORBIT: &str = include_str!("../page/orbit.js");

/// The module for mouse, touch, wheel and keys, with the dialog that lists the keys.
pub const GESTURES: &str = include_str!("../page/gestures.js");
