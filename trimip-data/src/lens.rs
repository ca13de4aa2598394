//! The lens of a frame in the JSON layouts of instant-ngp and nerfstudio. Frame keys override file keys.

use crate::json::Node;
use serde_json::Value;
use trimip_core::{Error, Lens, Place, Result, geometry::projections::Model};

/// Keys of the coefficients in the files.
const TERMS: [&str; 10] = ["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "sx1", "sy1"];

/// Reads the lens of a frame of a camera file; coefficients that the frame does not have come from the file. `place`
/// names the frame in errors.
///
/// # Errors
/// If the model is unknown, or does not have these coefficients.
pub fn lens_of(place: &Place, file: &Value, frame: &Value) -> Result<Lens> {
    read(&Node::new(place, file)?, &Node::new(place, frame)?)
}

/// Returns the camera model of a lens and its coefficients other than 0, under the keys that [`lens_of`] reads; `None` for a pinhole.
pub fn lens_terms(lens: &Lens) -> Option<(&'static str, Vec<(&'static str, f64)>)> {
    if lens.is_straight() {
        return None;
    }
    let ([k1, k2, k3, k4], [d1, d2, d3]) = (lens.radial, lens.denominator);
    let ([p1, p2], [s1, s2]) = (lens.tangential, lens.prism);
    let definition = lens.model.definition();
    let (model, terms) = if !definition.distorted {
        (definition.file_names[0], [0.0; 10])
    } else if lens.model == Model::Fisheye {
        let bent = [p1, p2, s1, s2] != [0.0; 4];
        let model = if bent { "THIN_PRISM_FISHEYE" } else { "OPENCV_FISHEYE" };
        (model, [k1, k2, k3, k4, 0.0, 0.0, p1, p2, s1, s2])
    } else if [d1, d2, d3] != [0.0; 3] {
        ("FULL_OPENCV", [k1, k2, k3, d1, d2, d3, p1, p2, 0.0, 0.0])
    } else {
        ("OPENCV", [k1, k2, k3, k4, 0.0, 0.0, p1, p2, 0.0, 0.0])
    };
    Some((model, TERMS.into_iter().zip(terms).filter(|(_, term)| *term != 0.0).collect()))
}

/// Reads the lens of entry `index` of a file that holds one array for each key.
///
/// # Errors
/// As [`lens_of`].
pub(crate) fn of_column(place: &Place, file: &Node<'_>, index: usize) -> Result<Lens> {
    let mut frame = serde_json::Map::new();
    for key in TERMS.into_iter().chain(["camera_model"]).filter(|key| file.get(key).is_some()) {
        if let Some(value) = file.array(key)?.get(index) {
            frame.insert(key.into(), value.clone());
        }
    }
    lens_of(place, &Value::Object(serde_json::Map::new()), &Value::Object(frame))
}

/// Describes a lens: its model and coefficients.
pub(crate) fn described(lens: &Lens) -> Option<String> {
    let (model, terms) = lens_terms(lens)?;
    let terms: Vec<String> = terms.iter().map(|(key, term)| format!("{key} = {term}")).collect();
    Some(format!("{model} {}", terms.join(", ")).trim_end().to_string())
}

/// Reads the lens of `frame`.
///
/// # Errors
/// If the model is unknown, or does not have these coefficients.
pub(crate) fn read(file: &Node<'_>, frame: &Node<'_>) -> Result<Lens> {
    let mut terms = [0.0; 10];
    for (term, key) in terms.iter_mut().zip(TERMS) {
        // nerfstudio's importer of RealityCapture writes numbers as texts.
        *term = frame.number_or_text(key)?.or(file.number_or_text(key)?).unwrap_or(0.0);
    }
    let [k1, k2, k3, k4, k5, k6, p1, p2, s1, s2] = terms;
    let refuse = |model: &str, known: &str| {
        let stated = TERMS.iter().zip(terms).filter(|(_, term)| *term != 0.0);
        let stated: Vec<String> = stated.map(|(key, term)| format!("{key} = {term}")).collect();
        Err(Error::input(
            &frame.place,
            format!("\"camera_model\" is {model}, but the coefficients are {}", stated.join(", ")),
            format!("this model has {known}: name the model of these coefficients, or remove them"),
        ))
    };
    let (own, model) = model(file, frame)?;
    match model {
        _ if !own.definition().distorted && terms == [0.0; 10] => Ok(Lens::of(own)),
        _ if !own.definition().distorted => refuse(model, "no coefficients"),
        "OPENCV_FISHEYE" if [k5, k6, p1, p2, s1, s2] == [0.0; 6] => {
            Ok(Lens::fisheye([k1, k2, k3, k4], [0.0; 2], [0.0; 2]))
        }
        "OPENCV_FISHEYE" => refuse(model, "k1 to k4"),
        "THIN_PRISM_FISHEYE" if [k5, k6] == [0.0; 2] => {
            Ok(Lens::fisheye([k1, k2, k3, k4], [p1, p2], [s1, s2]))
        }
        "THIN_PRISM_FISHEYE" => refuse(model, "k1 to k4, p1, p2, sx1 and sy1"),
        "FISHEYE" | "SIMPLE_FISHEYE" if terms != [0.0; 10] => refuse(model, "no coefficients"),
        _ if own == Model::Fisheye && [k3, k4, k5, k6, p1, p2, s1, s2] == [0.0; 8] => {
            Ok(Lens::fisheye([k1, k2, 0.0, 0.0], [0.0; 2], [0.0; 2]))
        }
        _ if own == Model::Fisheye => refuse(model, "k1 and k2"),
        "FULL_OPENCV" if [s1, s2] == [0.0; 2] => {
            Ok(Lens::perspective([k1, k2, k3, 0.0], [p1, p2], [k4, k5, k6]))
        }
        "FULL_OPENCV" => refuse(model, "k1 to k6, p1 and p2"),
        "SIMPLE_PINHOLE" | "PINHOLE" if terms != [0.0; 10] => refuse(model, "no coefficients"),
        _ if [k5, k6, s1, s2] != [0.0; 4] => refuse(model, "k1 to k4, p1 and p2"),
        _ => Ok(Lens::perspective([k1, k2, k3, k4], [p1, p2], [0.0; 3])),
    }
}

/// Returns the camera model that is stated, and its name in the file. If none is stated, this is the model that a flag
/// of instant-ngp chooses, otherwise nerfstudio's `OPENCV`.
fn model(file: &Node<'_>, frame: &Node<'_>) -> Result<(Model, &'static str)> {
    let stated = |key: &str| [frame, file].into_iter().find_map(|node| Some((node, node.get(key)?)));
    let Some((node, value)) = stated("camera_model") else {
        for model in Model::ALL {
            let definition = model.definition();
            for flag in definition.flags {
                match stated(flag).map(|(node, value)| (node, value, value.as_bool())) {
                    None | Some((_, _, Some(false))) => {}
                    Some((_, _, Some(true))) => return Ok((*model, definition.file_names[0])),
                    Some((node, value, None)) => return Err(node.unexpected(flag, "true or false", value)),
                }
            }
        }
        return Ok((Model::Perspective, "OPENCV"));
    };
    let named = value.as_str().ok_or_else(|| node.unexpected("camera_model", "a text", value))?;
    let known = || {
        Model::ALL.iter().flat_map(|model| model.definition().file_names.iter().map(|name| (*model, *name)))
    };
    known().find(|(_, name)| name.eq_ignore_ascii_case(named)).ok_or_else(|| {
        let names: Vec<&str> = known().map(|(_, name)| name).collect();
        Error::input(
            &node.place,
            format!("\"camera_model\" is \"{}\"", named.chars().take(80).collect::<String>()),
            format!("known models are {}; undistort the images to one of them", names.join(", ")),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn lens(file: Value, frame: Value) -> Result<Lens> {
        read(&Node::new("file", &file)?, &Node::new("frame 3", &frame)?)
    }

    #[test]
    fn models_take_their_own_coefficients() {
        let terms = json!({ "k1": 0.1, "k2": -0.02, "p1": 0.003, "p2": -0.001 });
        let opencv = Lens::perspective([0.1, -0.02, 0.0, 0.0], [0.003, -0.001], [0.0; 3]);
        assert_eq!(lens(terms.clone(), json!({})).unwrap(), opencv);
        // The frame's own numbers override those of the file.
        let own = Lens::perspective([0.2, -0.02, 0.0, 0.0], [0.003, -0.001], [0.0; 3]);
        assert_eq!(lens(terms, json!({ "k1": 0.2, "camera_model": "OPENCV" })).unwrap(), own);
        let four = json!({ "k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4 });
        let fisheye = Lens::fisheye([0.1, 0.2, 0.3, 0.4], [0.0; 2], [0.0; 2]);
        assert_eq!(lens(json!({ "camera_model": "OPENCV_FISHEYE" }), four.clone()).unwrap(), fisheye);
        assert_eq!(lens(json!({ "is_fisheye": true }), four.clone()).unwrap(), fisheye);
        let rational = Lens::perspective([0.1, 0.2, 0.3, 0.0], [0.0; 2], [0.4, 0.0, 0.0]);
        assert_eq!(lens(json!({ "camera_model": "FULL_OPENCV" }), four).unwrap(), rational);
        let texts = lens(json!({ "k1": "0.1", "k2": " -2e-002" }), json!({ "p1": "0.003" })).unwrap();
        assert_eq!(texts, Lens::perspective([0.1, -0.02, 0.0, 0.0], [0.003, 0.0], [0.0; 3]));
        assert!(lens(json!({ "camera_model": "PINHOLE", "k1": 0.0 }), json!({})).unwrap().is_straight());
    }

    #[test]
    fn terms_come_back_as_the_same_lens() {
        for own in [
            Lens::perspective([0.1, 0.0, 0.3, 0.4], [0.01, 0.0], [0.0; 3]),
            Lens::perspective([0.1, 0.2, 0.3, 0.0], [0.0, 0.02], [0.4, 0.5, 0.6]),
            Lens::fisheye([0.0; 4], [0.0; 2], [0.0; 2]),
            Lens::fisheye([0.1, 0.0, 0.0, 0.02], [0.01, 0.02], [0.0, 0.03]),
            Lens::default(),
        ] {
            let mut frame = json!({});
            if let Some((model, terms)) = lens_terms(&own) {
                frame["camera_model"] = json!(model);
                terms.into_iter().for_each(|(key, term)| frame[key] = json!(term));
            }
            let found = lens_of(&"frame 0".into(), &json!({}), &frame).unwrap();
            assert!(found == own || (found.is_straight() && own.is_straight()), "{frame}");
        }
    }

    #[test]
    fn what_a_model_does_not_have_is_refused() {
        let refused = |file: Value, names: &str| {
            let error = lens(file, json!({})).unwrap_err();
            assert!(
                error.kind() == trimip_core::ErrorKind::Input && error.message().contains(names),
                "{error}"
            );
        };
        refused(json!({ "camera_model": "PINHOLE", "k1": 0.1 }), "k1 = 0.1");
        refused(json!({ "camera_model": "OPENCV_FISHEYE", "p1": 0.1 }), "p1 = 0.1");
        refused(json!({ "k6": 0.1 }), "k6 = 0.1");
        refused(json!({ "camera_model": "FOV" }), "OPENCV_FISHEYE");
        refused(json!({ "camera_model": 3 }), "camera_model");
        refused(json!({ "is_fisheye": "yes" }), "is_fisheye");
        refused(json!({ "k1": "much" }), "k1");
        refused(json!({ "k1": "NaN" }), "k1");
    }
}
