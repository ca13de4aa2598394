//! Decisions that a capture makes by itself, each with its reason: cameras, features, pairs, mapper.

use super::{ability::Ability, pictures::Pictures};
use crate::{Lens, Mapper, Matcher, Request};
use serde::Serialize;
use trimip::{Advice, Error, Place, Result, formatting::count};

/// Maximum number of photographs for exhaustive matching: 19,900 pairs.
const EXHAUSTIVE: usize = 200;

/// Maximum number of pictures for an incremental mapper.
const INCREMENTAL: usize = 300;

/// Longest side of the pictures for feature detection, pixels: on a CPU, and on a GPU (COLMAP's default).
const CPU_SIZE: u32 = 1600;
const GPU_SIZE: u32 = 3200;

/// Each picture size gets a camera if there are at most this many sizes, and at least so many pictures of each size.
const MOST_SIZES: usize = 8;
const FEWEST_OF_A_SIZE: usize = 3;

/// Number of next neighbours that sequential matching compares each picture with. It also compares pictures at doubling distances, up to
/// 2^9 pictures apart.
const OVERLAP: u32 = 10;

/// Maximum number of loop-closing pairs among evenly spread pictures: for a film or a request for sequential matching, and otherwise.
const LOOP_PAIRS: usize = 1500;
const LOOP_PAIRS_OF_PHOTOGRAPHS: usize = 8000;

/// Which pictures share a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Cameras {
    /// One camera for all pictures.
    One,
    /// One camera per folder; all pictures in a folder have the same size.
    PerFolder,
    /// One camera per picture.
    PerImage,
}

/// Pairs of pictures that are compared.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Pairs {
    /// Each picture with every other.
    Exhaustive,
    /// Each picture with its next neighbours; to close loops, every `every`-th picture is also compared with all others of these.
    Sequential {
        /// Number of neighbours.
        overlap: u32,
        /// Step between the pictures that are also compared with each other to close loops; 0 = none.
        every: usize,
        /// Path of a vocabulary tree, which closes loops instead of `every`.
        tree: Option<String>,
    },
    /// Each picture with those that look alike according to a vocabulary tree.
    Vocabulary {
        /// Path of the vocabulary tree.
        tree: String,
    },
}

/// All decisions of a capture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Decisions {
    /// COLMAP's name of the camera model.
    pub camera: &'static str,
    /// Which pictures share a camera.
    pub cameras: Cameras,
    /// True if the mapper estimates lens distortion; otherwise the distortion is zero.
    pub distortion: bool,
    /// Longest side of the pictures for feature detection, pixels.
    pub size: u32,
    /// True if features and matches are computed on a GPU.
    pub gpu: bool,
    /// Pairs that are compared.
    pub pairs: Pairs,
    /// True for the global mapper, which places all cameras at once.
    pub global: bool,
    /// Number of threads; 0 = all.
    pub threads: u32,
    /// Each decision with its reason, as lines for the user.
    pub lines: Vec<String>,
}

impl Decisions {
    /// Returns these decisions without lens distortion; `None` for the global mapper, or if the camera model has no distortion.
    pub fn without_distortion(&self) -> Option<Self> {
        let has_terms = !self.camera.ends_with("PINHOLE");
        (has_terms && !self.global).then(|| Self { distortion: false, ..self.clone() })
    }
}

/// Refuses options that contradict each other or that the programs do not support. Returns the path of the vocabulary tree.
///
/// # Errors
/// Of kind `Input`: a missing vocabulary tree, or a mapper that no installed program has.
pub fn expect(request: &Request, able: &Ability) -> Result<Option<String>> {
    match request.mapper {
        Some(Mapper::Global) if !able.global => {
            let what = format!("{} has no global mapper", able.name);
            return Err(Error::input(
                Place::argument("mapper", "global"),
                what,
                "install COLMAP 4 or glomap, or leave it out",
            ));
        }
        Some(Mapper::Incremental) if able.only_global => {
            let what = "does not fit glomap, which places all cameras at once";
            return Err(Error::input(
                Place::argument("mapper", "incremental"),
                what,
                "leave one of the two out",
            ));
        }
        _ => {}
    }
    let Some(path) = &request.vocab_tree else {
        return match request.matcher {
            Some(Matcher::Vocabulary) => Err(Error::input(
                Place::argument("matcher", "vocabulary"),
                "needs a vocabulary tree",
                Advice::Argument("name its file with {vocab-tree}".into()),
            )),
            _ => Ok(None),
        };
    };
    if !path.is_file() {
        return Err(Error::input(
            path.display(),
            "is no vocabulary tree",
            Advice::Argument("name a file of one, or leave {vocab-tree} out".into()),
        ));
    }
    let whole = std::path::absolute(path).unwrap_or_else(|_| path.clone());
    match whole.to_str() {
        Some(text) => Ok(Some(text.into())),
        None => Err(Error::input(path.display(), "the path is not UTF-8", "rename the file")),
    }
}

/// Makes the decisions from the pictures, the user's options and the abilities of the programs.
///
/// # Errors
/// As [`expect`].
pub fn decide(request: &Request, pictures: &Pictures, able: &Ability) -> Result<Decisions> {
    let tree = expect(request, able)?;
    let number = pictures.pictures.len();
    let mut lines = Vec::new();
    let (cameras, why) = cameras(pictures);
    let (lens, because) = match request.camera {
        Some(lens) => (lens, "as asked for"),
        None if cameras == Cameras::PerImage => (Lens::SimpleRadial, "one picture determines no more terms"),
        None => (
            Lens::Radial,
            "ordinary lenses; --camera opencv adds terms that few pictures cannot separate from the focal length, \
             and opencv-fisheye is for lenses that see 120° and more",
        ),
    };
    lines.push(format!("cameras: {} ({because}), {why}", lens.name()));

    let size = request.size.unwrap_or(if able.gpu { GPU_SIZE } else { CPU_SIZE });
    let largest = pictures.pictures.iter().flat_map(|picture| picture.size).max().unwrap_or(0);
    let reason = match request.size {
        Some(_) => "as asked for".to_string(),
        None if able.gpu => "on the GPU".into(),
        None => format!("on the CPU: {}", able.why_no_gpu),
    };
    lines.push(match largest <= size {
        true => format!("features: of whole pictures, at most {size} pixels a side ({reason})"),
        false => {
            format!("features: of pictures reduced to {size} of {largest} pixels a side ({reason}; --size N)")
        }
    });

    let (pairs, why) = pairs(request.matcher, pictures.of_film, number, tree);
    lines.push(format!("pairs: {why}"));

    let (global, why) = match request.mapper {
        Some(mapper) => (mapper == Mapper::Global, "as asked for".to_string()),
        None if able.only_global => (true, "as glomap does".into()),
        None if number <= INCREMENTAL => (false, format!("{number} pictures, up to {INCREMENTAL}")),
        None if able.global => (true, format!("{number} pictures, more than {INCREMENTAL}")),
        None => (false, format!("{number} pictures take long; COLMAP 4 or glomap would place them at once")),
    };
    let how = if global { "all at once" } else { "one after the other" };
    lines.push(format!("mapper: cameras are placed {how} ({why})"));
    Ok(Decisions {
        camera: lens.name(),
        cameras,
        distortion: true,
        size,
        gpu: able.gpu,
        pairs,
        global,
        threads: request.threads,
        lines,
    })
}

fn cameras(pictures: &Pictures) -> (Cameras, String) {
    let sizes = pictures.sizes();
    let fewest = sizes.values().min().copied().unwrap_or(0);
    match sizes.len() {
        0 | 1 => (Cameras::One, "one for all pictures: they have one size, so one lens and zoom".into()),
        several if several <= MOST_SIZES && fewest >= FEWEST_OF_A_SIZE => {
            (Cameras::PerFolder, format!("one for each of {several} sizes of pictures"))
        }
        several => {
            (Cameras::PerImage, format!("one for each picture: they have {several} sizes, some of them rare"))
        }
    }
}

/// Returns the pairs that are compared, and the reason.
fn pairs(wanted: Option<Matcher>, of_film: bool, number: usize, tree: Option<String>) -> (Pairs, String) {
    let all = number * number.saturating_sub(1) / 2;
    let sequential = |tree: Option<String>, most: usize, why: &str| {
        let every = if tree.is_some() { 0 } else { spread(number, most) };
        let loops = match (&tree, every) {
            (Some(_), _) => "; the vocabulary tree closes loops".to_string(),
            (None, 0) => String::new(),
            (None, every) => format!("; one picture in {every} with all others of these, which closes loops"),
        };
        let text = format!("each picture with the {OVERLAP} next ones and some farther on ({why}){loops}");
        (Pairs::Sequential { overlap: OVERLAP, every, tree }, text)
    };
    let exhaustive = |why: &str| {
        (Pairs::Exhaustive, format!("each picture with every other, {} ({why})", count(all as u64, "pair")))
    };
    match (wanted, tree) {
        (Some(Matcher::Exhaustive), _) => exhaustive("as asked for"),
        (Some(Matcher::Sequential), tree) => sequential(tree, LOOP_PAIRS, "as asked for"),
        (Some(Matcher::Vocabulary), Some(tree)) => {
            (Pairs::Vocabulary { tree }, "each picture with those that look alike (as asked for)".into())
        }
        (None, tree) if of_film => sequential(tree, LOOP_PAIRS, "a film"),
        (None, _) if number <= EXHAUSTIVE => exhaustive(&format!("up to {EXHAUSTIVE} photographs")),
        (None, Some(tree)) => (
            Pairs::Vocabulary { tree },
            format!(
                "each picture with those that look alike (more than {EXHAUSTIVE} photographs, by the vocabulary tree)"
            ),
        ),
        // `expect` refuses --matcher vocabulary without a tree.
        (Some(Matcher::Vocabulary) | None, None) => sequential(
            None,
            LOOP_PAIRS_OF_PHOTOGRAPHS,
            &format!("more than {EXHAUSTIVE} photographs and no --vocab-tree, in the order of their names"),
        ),
    }
}

/// Returns the smallest step, at least 2, at which the evenly spread pictures form at most `most` pairs; 0 if the pictures are so few that
/// neighbours suffice.
fn spread(number: usize, most: usize) -> usize {
    if number <= 2 * OVERLAP as usize {
        return 0;
    }
    let pairs = |every: usize| {
        let few = number.div_ceil(every);
        few * few.saturating_sub(1) / 2
    };
    (2..).find(|&every| pairs(every) <= most).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pictures::Picture;

    fn pictures(sizes: &[(u32, usize)], of_film: bool) -> Pictures {
        let picture = |width: u32| Picture {
            name: "a.jpg".into(),
            source: "a.jpg".into(),
            size: [width, 1000],
            seconds: None,
            sharpness: None,
        };
        let pictures =
            sizes.iter().flat_map(|&(width, count)| std::iter::repeat_n(picture(width), count)).collect();
        Pictures { pictures, of_film, ..Pictures::default() }
    }

    fn able(global: bool, gpu: bool) -> Ability {
        Ability { name: "colmap 3.8".into(), global, only_global: false, gpu, why_no_gpu: "none here".into() }
    }

    #[test]
    fn decisions_follow_the_pictures() {
        let decided = |pictures: &Pictures, able: &Ability| decide(&Request::default(), pictures, able);
        let film = decided(&pictures(&[(1920, 120)], true), &able(false, false)).unwrap();
        assert_eq!(
            (film.camera, film.cameras, film.size, film.global),
            ("RADIAL", Cameras::One, 1600, false)
        );
        assert_eq!(film.pairs, Pairs::Sequential { overlap: 10, every: 3, tree: None });
        let few = decided(&pictures(&[(1920, 50)], false), &able(true, true)).unwrap();
        assert_eq!((few.pairs, few.size, few.global), (Pairs::Exhaustive, 3200, false));
        let many = decided(&pictures(&[(1920, 400)], false), &able(true, false)).unwrap();
        assert!(matches!(many.pairs, Pairs::Sequential { every: 4, .. }) && many.global, "{many:?}");
        let phones = pictures(&[(1920, 50), (1000, 5)], false);
        assert_eq!(decided(&phones, &able(false, false)).unwrap().cameras, Cameras::PerFolder);
        let mixed = decided(&pictures(&[(1920, 50), (1000, 1)], false), &able(false, false)).unwrap();
        assert_eq!((mixed.cameras, mixed.camera), (Cameras::PerImage, "SIMPLE_RADIAL"));
        assert_eq!(mixed.lines.len(), 4);
    }

    #[test]
    fn what_the_user_gives_counts() {
        let photographs = pictures(&[(1920, 50)], false);
        let request = Request {
            camera: Some(Lens::OpencvFisheye),
            matcher: Some(Matcher::Sequential),
            size: Some(800),
            mapper: Some(Mapper::Global),
            ..Request::default()
        };
        let decided = decide(&request, &photographs, &able(true, false)).unwrap();
        assert_eq!((decided.camera, decided.size, decided.global), ("OPENCV_FISHEYE", 800, true));
        assert!(matches!(decided.pairs, Pairs::Sequential { .. }));
        let global = Request { mapper: Some(Mapper::Global), ..Request::default() };
        let vocabulary = Request { matcher: Some(Matcher::Vocabulary), ..Request::default() };
        let nowhere = Request { vocab_tree: Some("nowhere.bin".into()), ..Request::default() };
        for (request, what) in
            [(global, "no global mapper"), (vocabulary, "vocab-tree"), (nowhere, "no vocabulary tree")]
        {
            let error = decide(&request, &photographs, &able(false, false)).unwrap_err();
            assert!(
                error.kind() == trimip_core::ErrorKind::Input && error.message().contains(what),
                "{error}"
            );
        }
        let glomap = Ability { only_global: true, ..able(true, false) };
        let incremental = Request { mapper: Some(Mapper::Incremental), ..Request::default() };
        let error = decide(&incremental, &photographs, &glomap).unwrap_err();
        assert!(error.message().contains("glomap"), "{error}");
    }

    #[test]
    fn pairs_that_close_loops_are_bounded() {
        assert_eq!((spread(20, 1500), spread(50, 1500), spread(300, 1500)), (0, 2, 6));
    }
}
