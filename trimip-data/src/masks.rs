//! The masks of a scene: where they are found, their meaning, and warnings about them. A mask is named by its frame (`mask_path`,
//! nerfstudio), has the path of its photograph in a folder of masks (COLMAP), or lies next to its photograph (Instant-NGP).

use crate::settings::{DataConfig, MaskKeeps, MaskRole};
use crate::{
    mask::{Mask, Role},
    names::ENDINGS,
    photograph::Photograph,
    source::{Pixels, Source, map_in_order},
};
use std::{
    collections::HashMap,
    path::{Component, Path, PathBuf},
};
use trimip_core::{Alpha, Error, Result, ViewSet, plural::count};

/// The folder that is searched if the settings name none.
const FOLDER: &str = "masks";

/// The value of `data.masks` for no masks.
const NONE: &str = "none";

/// How a mask was found, which decides its meaning.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Stated,
    Folder,
    Dynamic,
}

impl Kind {
    /// Returns true if white marks the kept pixels.
    fn white(self, config: &DataConfig) -> bool {
        match config.mask_keeps {
            MaskKeeps::Auto => self != Self::Dynamic,
            MaskKeeps::White => true,
            MaskKeeps::Black => false,
        }
    }

    fn role(self, config: &DataConfig) -> Role {
        match config.mask_role {
            MaskRole::Auto if self == Self::Folder => Role::Object,
            MaskRole::Auto | MaskRole::Ignore => Role::Ignore,
            MaskRole::Object => Role::Object,
        }
    }
}

/// Finds the masks of all frames and stores them in their sources. Returns the meaning of alpha in the set.
///
/// # Errors
/// If a stated mask is missing, or a mask has another size than its photograph, belongs to two photographs, or has
/// another role than the other masks.
pub(crate) fn find(config: &DataConfig, sources: &mut [&mut Source]) -> Result<Alpha> {
    let straight = Alpha::from(config.convention);
    let named = !["", NONE].contains(&config.masks.as_str());
    if config.masks == NONE {
        return Ok(straight);
    }
    let root = Path::new(&config.root);
    let folder = root.join(if named { &config.masks } else { FOLDER });
    if named && !folder.is_dir() {
        let place = format!("data.masks = \"{}\"", config.masks);
        let what = format!("{} is not a folder", folder.display());
        return Err(Error::input(place, what, "name a folder in data.root, or \"none\""));
    }
    let search = MaskSearch { config, root, folder: folder.is_dir().then_some(folder.as_path()), named };
    let found = map_in_order(sources, |_, source| search.mask_of(source))?;
    unshared(sources, &found)?;
    let mut all = found.iter().flatten().map(|(_, mask)| mask);
    let Some(first) = all.next() else {
        return if named { Err(search.none(sources)) } else { Ok(straight) };
    };
    if let Some(other) = all.find(|other| other.role() != first.role()) {
        return Err(Error::input(
            config.root.as_str(),
            format!(
                "mask {} marks an object, but mask {} marks pixels to ignore, or the other way round",
                first.path().display(),
                other.path().display()
            ),
            "set data.mask_role, or data.masks to one folder",
        ));
    }
    let alpha = if first.role() == Role::Ignore { Alpha::Kept } else { straight };
    for (source, found) in sources.iter_mut().zip(found) {
        source.mask = found.map(|(_, mask)| mask);
    }
    Ok(alpha)
}

/// Refuses a mask of a folder that two photographs would share. One photograph may be in several splits.
fn unshared(sources: &[&mut Source], found: &[Option<(Kind, Mask)>]) -> Result<()> {
    let mut known: HashMap<&Path, &Photograph> = HashMap::new();
    for (source, found) in sources.iter().zip(found) {
        let (Some((Kind::Folder, mask)), [file, ..]) = (found, source.files()) else { continue };
        let before = known.insert(mask.path(), file);
        if let Some(before) = before.filter(|before| before.path != file.path) {
            return Err(Error::input(
                &file.place,
                format!("mask {} would also be the mask of {}", mask.path().display(), before.path.display()),
                "give the folder of masks the same subfolders as the photographs, or set data.masks = \"none\"",
            ));
        }
    }
    Ok(())
}

/// The places that are searched for masks.
struct MaskSearch<'a> {
    config: &'a DataConfig,
    root: &'a Path,
    folder: Option<&'a Path>,
    /// True if the settings name the folder, so that no other place is searched.
    named: bool,
}

impl MaskSearch<'_> {
    fn mask_of(&self, source: &Source) -> Result<Option<(Kind, Mask)>> {
        let Pixels::Photograph(photograph) = &source.pixels else { return Ok(None) };
        let Some((kind, path)) = self.place(source, photograph)? else { return Ok(None) };
        let (white, role) = (kind.white(self.config), kind.role(self.config));
        Ok(Some((kind, Mask::open(path, photograph, white, role)?)))
    }

    fn place(&self, source: &Source, photograph: &Photograph) -> Result<Option<(Kind, PathBuf)>> {
        if let Some(stated) = source.mask_path.as_deref().filter(|_| !self.named) {
            let path = self.root.join(stated);
            if path.is_file() {
                return Ok(Some((Kind::Stated, path)));
            }
            return Err(Error::input(
                &photograph.place,
                format!("mask {} does not exist", path.display()),
                "copy it there, remove \"mask_path\", or set data.masks = \"none\"",
            ));
        }
        if let Some(path) = self.candidates(photograph).into_iter().find(|path| path.is_file()) {
            return Ok(Some((Kind::Folder, path)));
        }
        let beside = dynamic(photograph).filter(|path| !self.named && path.is_file());
        Ok(beside.map(|path| (Kind::Dynamic, path)))
    }

    /// Returns the paths in the folder at which the mask may lie. Their folders are the photograph's subfolder, then this subfolder without
    /// its outer levels. Their names are the photograph's, with and without its extension, followed by any ending of a picture, PNG first.
    fn candidates(&self, photograph: &Photograph) -> Vec<PathBuf> {
        let Some(folder) = self.folder else { return Vec::new() };
        let parts = below(&photograph.path, self.root);
        let Some((name, levels)) = parts.split_last() else { return Vec::new() };
        let stem = Path::new(name).file_stem().unwrap_or_default().to_string_lossy();
        let names = [name.as_str(), &stem];
        let levels = (0..=levels.len()).map(|skipped| levels[skipped..].iter().collect::<PathBuf>());
        let files: Vec<String> =
            names.iter().flat_map(|name| ENDINGS.map(|ending| format!("{name}{ending}"))).collect();
        let within = levels.flat_map(|level| files.iter().map(move |file| folder.join(&level).join(file)));
        within.filter(|path| *path != photograph.path).collect()
    }

    /// Returns the error for a folder without any mask.
    fn none(&self, sources: &[&mut Source]) -> Error {
        let files = || sources.iter().flat_map(|source| source.files());
        let tried: Vec<String> = files()
            .take(1)
            .flat_map(|first| self.candidates(first))
            .filter(|path| path.to_string_lossy().ends_with(ENDINGS[0]))
            .map(|path| path.display().to_string())
            .collect();
        let what = match tried.as_slice() {
            [] => "there is no photograph that could have a mask".to_string(),
            tried => format!(
                "holds no mask of {}: looked for {}, and for the same names with {}",
                count(files().count(), "photograph"),
                tried.join(", "),
                ENDINGS[1..].join(", ")
            ),
        };
        let place = format!("data.masks = \"{}\"", self.config.masks);
        Error::input(place, what, "name masks like their photographs, or set it to \"none\"")
    }
}

/// Returns the parts of a path below `root`, or only the file name if the path is elsewhere.
fn below(path: &Path, root: &Path) -> Vec<String> {
    let parts = path.strip_prefix(root).unwrap_or(Path::new(path.file_name().unwrap_or_default()));
    let mut named = Vec::new();
    for part in parts.components() {
        match part {
            Component::Normal(part) => named.push(part.to_string_lossy().into_owned()),
            Component::CurDir => {}
            // Parts before a `..` or a root are not mirrored in the folder of masks.
            _ => named.clear(),
        }
    }
    named
}

/// Returns the path of Instant-NGP's mask next to a photograph.
fn dynamic(photograph: &Photograph) -> Option<PathBuf> {
    let stem = photograph.path.file_stem()?.to_string_lossy();
    Some(photograph.path.with_file_name(format!("dynamic_mask_{stem}.png")))
}

/// Returns a warning if some of the photographs have no mask, or if the folder of masks exists but holds no mask of any photograph.
pub(crate) fn missing(config: &DataConfig, sources: &[&Source]) -> Option<String> {
    let (all, without): (usize, Vec<&&Source>) =
        (sources.len(), sources.iter().filter(|source| source.mask.is_none()).collect());
    let photographs = sources.iter().any(|source| matches!(source.pixels, Pixels::Photograph(_)));
    let folder = Path::new(&config.root).join(FOLDER);
    match without.first() {
        Some(first) if without.len() < all => Some(format!(
            "{} of {all} photographs, the first {}, have no mask and are kept whole",
            without.len(),
            first.name
        )),
        Some(first) if config.masks.is_empty() && photographs && folder.is_dir() => Some(format!(
            "{} holds no mask of a photograph: expected names such as masks/{}.png",
            folder.display(),
            first.name
        )),
        _ => None,
    }
}

/// Returns a line about the masks of `sources`, measured at the finest scale of `set`, or `None` if there are none.
pub(crate) fn described(sources: &[Source], set: &ViewSet) -> Option<String> {
    let masks: Vec<&Mask> = sources.iter().filter_map(|source| source.mask.as_ref()).collect();
    let first = masks.first()?;
    let kept = measured(sources, set);
    let fraction = kept.iter().map(|(_, kept)| kept.all).sum::<f64>() / kept.len().max(1) as f64;
    Some(format!(
        "masks of {} of {}, the first {}: {} is kept, {:.1} % of the pixels; the rest is {}",
        masks.len(),
        count(sources.len(), "photograph"),
        first.path().display(),
        if first.keeps_white() { "white" } else { "black" },
        100.0 * fraction,
        match first.role() {
            Role::Object => "empty space",
            Role::Ignore => "neither trained nor evaluated",
        }
    ))
}

/// Shares of a view that its mask keeps, in [0, 1]: of all pixels, of a border, and of the centre.
struct Kept {
    all: f64,
    /// The border is one twentieth of the sides wide; the centre is the middle third of rows and columns.
    border: f64,
    centre: f64,
}

/// Masks are probably inverted if they keep more than the first share of the border and less than the second share of the centre.
const INVERTED: [f64; 2] = [0.75, 0.5];

/// Masks of ignored pixels are probably inverted if they keep less than this share.
const LITTLE: f64 = 0.1;

/// Returns warnings about masks that keep all or nothing, or the wrong part.
pub(crate) fn warnings(sources: &[Source], set: &ViewSet) -> Vec<String> {
    let kept = measured(sources, set);
    let Some(role) = sources.iter().find_map(|source| source.mask.as_ref()).map(Mask::role) else {
        return Vec::new();
    };
    let mut warnings = Vec::new();
    let mut tell = |what: &str, test: &dyn Fn(&Kept) -> bool| {
        let such: Vec<&str> = kept.iter().filter(|(_, kept)| test(kept)).map(|(name, _)| *name).collect();
        if let [first, ..] = such[..] {
            warnings.push(format!("masks that keep {what}: {}, the first that of {first}", such.len()));
        }
    };
    tell("nothing of the photograph", &|kept| kept.all == 0.0);
    tell("all of the photograph", &|kept| kept.all == 1.0);
    let mean = |part: fn(&Kept) -> f64| {
        kept.iter().map(|(_, kept)| part(kept)).sum::<f64>() / kept.len().max(1) as f64
    };
    let around = mean(|kept| kept.border) > INVERTED[0] && mean(|kept| kept.centre) < INVERTED[1];
    if (role == Role::Object && around) || (role == Role::Ignore && mean(|kept| kept.all) < LITTLE) {
        warnings.push(format!(
            "the masks keep {:.0} % of the border of the photographs and {:.0} % of their middle: are they inverted? see \
             data.mask_keeps",
            100.0 * mean(|kept| kept.border),
            100.0 * mean(|kept| kept.centre)
        ));
    }
    warnings
}

/// Returns the name and the kept shares of each masked view, at the finest scale.
fn measured<'a>(sources: &'a [Source], set: &ViewSet) -> Vec<(&'a str, Kept)> {
    let finest = set.scales.first().map_or(0..0, |scale| scale.views.clone());
    let views = finest.zip(sources).filter(|(_, source)| source.mask.is_some());
    let of = |(view, source): (usize, &'a Source)| {
        let k = &set.views[view].camera.intrinsics;
        let (width, height) = (k.width as usize, k.height as usize);
        let pixels = set.pixels_of(view);
        let mean = |within: &dyn Fn(usize, usize) -> bool| {
            let (mut sum, mut count) = (0.0, 0_usize);
            for (_, pixel) in pixels.iter().enumerate().filter(|(i, _)| within(i % width, i / width)) {
                sum += f64::from(pixel[3]) / 255.0;
                count += 1;
            }
            sum / count.max(1) as f64
        };
        let edge = |at: usize, side: usize| at.min(side - 1 - at) <= side / 20;
        let middle = |at: usize, side: usize| 3 * at >= side && 3 * at < 2 * side.max(2);
        let kept = Kept {
            all: mean(&|_, _| true),
            border: mean(&|x, y| edge(x, width) || edge(y, height)),
            centre: mean(&|x, y| middle(x, width) && middle(y, height)),
        };
        (source.name.as_str(), kept)
    };
    views.map(of).collect()
}
