//! Crops as text. A crop is the box or ball around a scene's subject, or one side of a plane, in world units, to which meshes, films and
//! viewers can be confined.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Greatest absolute value of a coordinate; the corners of a scene's box have the same limit.
const FARTHEST: f64 = 1e9;

/// Syntax of a crop, for messages.
pub const SYNTAX: &str = "none, box X,Y,Z,X,Y,Z (lower and upper corner), ball X,Y,Z,RADIUS or half X,Y,Z,X,Y,Z (a point of a plane and the direction \
     to the side that is kept), in world units";

/// A part of the world. As text: `none`, `box 0,0,0,1,1,1` (lower and upper corner), `ball 0,0,0,1` (centre and radius) or
/// `half 0,0,0,0,0,1` (a point of a plane, and its normal on the side that is kept).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Crop {
    /// All of the world.
    #[default]
    None,
    /// An axis-aligned box.
    Box {
        /// Lower corner.
        min: [f64; 3],
        /// Upper corner.
        max: [f64; 3],
    },
    /// A ball.
    Ball {
        /// Centre.
        centre: [f64; 3],
        /// Radius.
        radius: f64,
    },
    /// A half-space: one side of a plane.
    Half {
        /// A point of the plane.
        point: [f64; 3],
        /// A normal of the plane, of any length, that points to the side that is kept.
        normal: [f64; 3],
    },
}

impl fmt::Display for Crop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let list = |numbers: &[f64]| numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
        match self {
            Self::None => write!(f, "none"),
            Self::Box { min, max } => write!(f, "box {}", list(&[*min, *max].concat())),
            Self::Ball { centre, radius } => write!(f, "ball {},{radius}", list(centre)),
            Self::Half { point, normal } => write!(f, "half {}", list(&[*point, *normal].concat())),
        }
    }
}

impl FromStr for Crop {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refuse = |what: &str| Err(format!("`{text}` is not a crop: {what}; expected {SYNTAX}"));
        let (kind, rest) = text.trim().split_once(char::is_whitespace).unwrap_or((text.trim(), ""));
        let numbers: Result<Vec<f64>, _> = match rest.trim() {
            "" => Ok(Vec::new()),
            rest => rest.split(',').map(|number| number.trim().parse()).collect(),
        };
        let Ok(numbers) = numbers else { return refuse("a number cannot be read") };
        // The negated comparison also refuses NaN.
        if numbers.iter().any(|x| !(x.abs() <= FARTHEST)) {
            return refuse("a number is not within ±1e9");
        }
        match (kind, &numbers[..]) {
            ("none", []) => Ok(Self::None),
            ("box", &[a, b, c, d, e, f]) => {
                let [min, max] = [[a, b, c], [d, e, f]];
                match (0..3).all(|i| min[i] < max[i]) {
                    true => Ok(Self::Box { min, max }),
                    false => refuse("the second corner must be above the first on every axis"),
                }
            }
            ("ball", &[x, y, z, radius]) if radius > 0.0 => Ok(Self::Ball { centre: [x, y, z], radius }),
            ("ball", &[_, _, _, _]) => refuse("the radius must be above 0"),
            ("half", &[x, y, z, a, b, c]) if [a, b, c] != [0.0; 3] => {
                Ok(Self::Half { point: [x, y, z], normal: [a, b, c] })
            }
            ("half", &[_, _, _, _, _, _]) => refuse("the direction has no length"),
            ("box", _) => refuse("a box has six numbers"),
            ("ball", _) => refuse("a ball has four numbers"),
            ("half", _) => refuse("a half-space has six numbers"),
            _ => refuse("a crop begins with none, box, ball or half"),
        }
    }
}

impl TryFrom<String> for Crop {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Crop> for String {
    fn from(crop: Crop) -> Self {
        crop.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crop_is_written_as_it_is_read() {
        for text in ["none", "box -1,0,0.5,1,2,3", "ball 0.1,-2,3,4.5", "half 1,2,3,0,-0.5,0"] {
            assert_eq!(text.parse::<Crop>().unwrap().to_string(), text);
        }
        let spaced: Crop = "  box  0, 0, 0,\t1, 1, 1e0 ".parse().unwrap();
        assert_eq!(spaced, Crop::Box { min: [0.0; 3], max: [1.0; 3] });
        for (text, word) in [
            ("", "begins with"),
            ("cube 1,2,3", "begins with"),
            ("none 1", "begins with"),
            ("box 0,0,0,1,1", "six numbers"),
            ("box 0,0,0,1,0,1", "above the first"),
            ("box 0,0,0,1,x,1", "cannot be read"),
            ("ball 0,0,0", "four numbers"),
            ("ball 0,0,0,0", "above 0"),
            ("half 0,0,0,1", "six numbers"),
            ("half 0,0,0,0,-0,0", "no length"),
            ("ball 0,0,0,nan", "within"),
            ("ball 0,0,0,inf", "within"),
            ("box 0,0,0,1,1,2e9", "within"),
        ] {
            let error = text.parse::<Crop>().unwrap_err();
            assert!(error.contains(word) && error.contains("ball X,Y,Z,RADIUS"), "{text}: {error}");
        }
    }
}
