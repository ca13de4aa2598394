//! The systems that are compared: each has a layer of settings from `trimip/systems`, a title, and the published figures to compare it
//! with. A system overrides the defaults, and a user's settings override the system.
//!
//! A new system is a file in `trimip/systems` and an entry in [`SYSTEMS`].

pub mod published;

use published::Published;
use serde::Serialize;
use trimip_core::{Error, Result, Settings};

/// How a system relates to the published one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
#[non_exhaustive]
pub enum Kind {
    /// The system as published, except for what `differs` states.
    Whole,
    /// The system without one of its parts, as in an ablation of the paper.
    Ablation,
    /// A variant with fewer parameters or less work than the published one. It never has the name of the published system.
    Smaller,
    /// The published system with changes of this program.
    Changed,
}

impl Kind {
    /// Returns the kind in a word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Whole => "whole",
            Self::Ablation => "ablation",
            Self::Smaller => "smaller",
            Self::Changed => "changed",
        }
    }
}

/// A system.
#[derive(Clone, Copy, Debug)]
pub struct System {
    /// Name of the system: that of its file in `trimip/systems`, and of the folders of its runs.
    pub name: &'static str,
    /// Title in tables.
    pub title: &'static str,
    /// Relation to the published system.
    pub kind: Kind,
    /// The text of its settings.
    pub settings: &'static str,
    /// Name of the published row to compare the system with; see [`published::PUBLISHED`].
    pub beside: Option<&'static str>,
    /// Differences from the published system, one line.
    pub differs: &'static str,
}

impl System {
    /// Returns the published row to compare the system with.
    pub fn published(&self) -> Option<&'static Published> {
        self.beside.and_then(published::find)
    }

    /// Applies the settings of the system.
    ///
    /// # Errors
    /// When a setting does not exist or has another type; the message names file, line and column.
    pub fn apply(&self, settings: &mut Settings) -> Result<()> {
        settings.apply_file(&format!("trimip/systems/{}.toml", self.name), self.settings)
    }
}

macro_rules! file {
    ($name:literal) => {
        include_str!(concat!("../../systems/", $name, ".toml"))
    };
}

/// Every system, in the order of tables.
pub const SYSTEMS: &[System] = &[
    System {
        name: "nerf-occ-64",
        title: "NeRF's form, 8×64",
        kind: Kind::Smaller,
        settings: file!("nerf-occ-64"),
        beside: Some("NeRF"),
        differs: "one network of a quarter of the width; uniform steps through an occupancy grid instead of two passes; a softplus \
                  density that is empty at first; four times the learning rate",
    },
    System {
        name: "mip-occ-64",
        title: "mip-NeRF's form, 8×64",
        kind: Kind::Smaller,
        settings: file!("mip-occ-64"),
        beside: Some("MipNeRF"),
        differs: "a quarter of the width; uniform steps through an occupancy grid instead of two passes; the density is empty at \
                  first; four times the learning rate; the sigmoid is not widened; no sine warm-up",
    },
    System {
        name: "plenoxels-160",
        title: "Plenoxels' form, 160³",
        kind: Kind::Smaller,
        settings: file!("plenoxels-160"),
        beside: Some("Plenoxels"),
        differs: "all of 160³ grid points instead of a sparse 512³; no total variation; steps of 2^16 samples; \
                  moments that grow with the grid; an occupancy grid; random starts of rays",
    },
    System {
        name: "tensorf-vm",
        title: "TensoRF",
        kind: Kind::Whole,
        settings: file!("tensorf-vm"),
        beside: Some("TensoRF"),
        differs: "an occupancy grid instead of the alpha mask; the box is found at the start; \
                  steps of 2^15 samples, not of 4,096 rays, so all samples have colours at first (renderer.color_weight); the published \
                  figures come from a GPU",
    },
    System {
        name: "tensorf-cp",
        title: "TensoRF CP",
        kind: Kind::Whole,
        settings: file!("tensorf-cp"),
        beside: None,
        differs: "as tensorf-vm",
    },
    System {
        name: "ngp",
        title: "Instant-ngp",
        kind: Kind::Whole,
        settings: file!("ngp"),
        beside: Some("Instant-ngp"),
        differs: "no running mean of the weights; no decay of the networks' weights; the colour network reads 15 of the density \
                  network's 16 outputs; smooth-L1 instead of Huber; eight times as many steps, of 2^15 samples instead of 2^18; this \
                  program's refreshes of the grid; the published figures come from a GPU",
    },
    System {
        name: "ngp-17",
        title: "Hash grid 2^17",
        kind: Kind::Smaller,
        settings: file!("ngp-17"),
        beside: Some("Instant-ngp"),
        differs: "2^17 entries a level instead of 2^19; otherwise as ngp",
    },
    System {
        name: "ngp-5x",
        title: "Instant-ngp 5×",
        kind: Kind::Whole,
        settings: file!("ngp-5x"),
        beside: Some("Instant-ngp 5×"),
        differs: "as ngp; the four outer rays of a pixel are half-way to its corners, which is not published",
    },
    System {
        name: "ngp-down",
        title: "Hash grid with downweighting",
        kind: Kind::Changed,
        settings: file!("ngp-down"),
        beside: None,
        differs: "ngp with Zip-NeRF's weights alone, without their input to the networks",
    },
    System {
        name: "ngp-zip",
        title: "Hash grid, six points a sample",
        kind: Kind::Changed,
        settings: file!("ngp-zip"),
        beside: None,
        differs: "ngp with Zip-NeRF's points and weights; no proposals, contraction, anti-aliased loss or random turns",
    },
    System {
        name: "tri-mip-no-mipmap",
        title: "Tri-MipRF w/o mipmap",
        kind: Kind::Ablation,
        settings: file!("tri-mip-no-mipmap"),
        beside: Some("Tri-MipRF w/o mipmap"),
        differs: "as tri-mip-paper",
    },
    System {
        name: "tri-mip-paper",
        title: "Tri-MipRF by the paper",
        kind: Kind::Whole,
        settings: file!("tri-mip-paper"),
        beside: Some("Tri-MipRF"),
        differs: "nothing that the paper states; with a time budget, as many of its 25,000 steps as fit",
    },
    System {
        name: "tri-mip",
        title: "Tri-MipRF, this program",
        kind: Kind::Changed,
        settings: file!("tri-mip"),
        beside: Some("Tri-MipRF"),
        differs: "the scene plan chooses box, detail, networks and batch; the visual hull; wide pixels are means of several cones; edge \
                  exponents of the set",
    },
    System {
        name: "rip-nerf",
        title: "Rip-NeRF",
        kind: Kind::Whole,
        settings: file!("rip-nerf"),
        beside: Some("Rip-NeRF"),
        differs: "planes cover the projection of the whole box, not of the unit ball; the published figures are second-hand",
    },
];

/// Returns the system with this name.
///
/// # Errors
/// When there is none; the message lists the names.
pub fn find(name: &str) -> Result<&'static System> {
    SYSTEMS.iter().find(|system| system.name == name).ok_or_else(|| {
        let names: Vec<&str> = SYSTEMS.iter().map(|system| system.name).collect();
        Error::input(format!("system `{name}`"), "is unknown", format!("name one of: {}", names.join(", ")))
    })
}

#[cfg(test)]
mod tests {
    use super::published::PUBLISHED;
    use super::*;
    use std::path::Path;
    use trimip_core::{Config, Origin};

    #[test]
    fn every_system_is_accepted_and_stands_beside_a_published_row() {
        for system in SYSTEMS {
            let mut settings = crate::settings::defaults();
            system.apply(&mut settings).unwrap_or_else(|error| panic!("{error}"));
            Config::from_settings(&settings).unwrap_or_else(|error| panic!("{}: {error}", system.name));
            // The comparison sets scene, seed, splits and evaluation.
            let own = |path: &str| {
                ["data.", "eval.", "seed", "backend", "threads"].iter().any(|p| path.starts_with(p))
            };
            for (path, _, origin) in settings.iter().filter(|(path, ..)| own(path)) {
                assert_eq!(*origin, Origin::Default, "{}: {path}", system.name);
            }
            assert_eq!(system.beside.is_some(), system.published().is_some(), "{}", system.name);
            assert!(system.settings.starts_with("# ") && !system.differs.is_empty(), "{}", system.name);
        }
    }

    /// Checks that a published system which switches off one decision of the plan switches off all of them, so that a new decision does not
    /// change it. Only the box may be planned.
    #[test]
    fn the_plan_decides_all_of_a_system_or_nothing_but_the_box() {
        let mut published = 0;
        for system in SYSTEMS {
            let mut settings = crate::settings::defaults();
            system.apply(&mut settings).unwrap_or_else(|error| panic!("{error}"));
            let decisions = trimip_core::scene_plan::keys().filter(|key| *key != "aabb");
            let (off, on): (Vec<_>, Vec<_>) =
                decisions.partition(|key| settings.value(&format!("plan.{key}")) == "\"off\"");
            assert!(off.is_empty() || on.is_empty(), "{}: the plan still decides {on:?}", system.name);
            published += usize::from(on.is_empty());
        }
        assert!(published > 10, "{published}");
    }

    #[test]
    fn the_registry_has_every_file_once() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("systems");
        let mut files: Vec<String> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path().file_stem().unwrap().to_string_lossy().into_owned())
            .collect();
        let mut names: Vec<String> = SYSTEMS.iter().map(|system| system.name.to_string()).collect();
        files.sort();
        names.sort();
        assert_eq!(files, names);
        assert_eq!(find("nerf").unwrap_err().kind(), trimip_core::ErrorKind::Input);
    }

    #[test]
    fn what_is_not_the_published_system_never_has_its_name() {
        let plain = |text: &str| text.to_lowercase().replace(|c: char| !c.is_alphanumeric(), "");
        for system in SYSTEMS.iter().filter(|system| matches!(system.kind, Kind::Smaller | Kind::Changed)) {
            for row in PUBLISHED {
                for own in [system.name, system.title] {
                    assert_ne!(plain(own), plain(row.name), "{own}");
                }
            }
        }
    }

    #[test]
    fn variants_differ_from_their_systems_as_they_say() {
        let changed = |name: &str, other: &str| {
            let config = |name: &str| {
                let mut settings = crate::settings::defaults();
                find(name).unwrap().apply(&mut settings).unwrap();
                Config::from_settings(&settings).unwrap()
            };
            config(name).differences(&config(other))
        };
        assert_eq!(changed("ngp-17", "ngp"), ["hash_grid.log2_entries is 17, was 19"]);
        assert_eq!(changed("ngp-down", "ngp"), ["hash_grid.downweight is true, was false"]);
        assert_eq!(changed("ngp-zip", "ngp-down"), ["hash_grid.points is 6, was 1"]);
        assert_eq!(changed("tri-mip-no-mipmap", "tri-mip-paper"), ["encoder.mipmap is false, was true"]);
    }
}
