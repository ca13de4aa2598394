//! The section `[data]` for a program to register: its tables, and the checks across its settings.

use crate::{
    layout,
    settings::{DataConfig, HoldoutBy},
};
use trimip_core::{Checker, Error, ForeignSection, Fragment, Result, Section};

/// The settings of this crate, for a program to register.
pub const SECTION: ForeignSection = ForeignSection::of::<DataConfig>();

impl Section for DataConfig {
    const NAME: &'static str = "data";
    const FRAGMENTS: &'static [Fragment] = &[
        Fragment { after: "root", table: include_str!("settings/photographs.toml") },
        Fragment { after: "background", table: include_str!("settings/builtin.toml") },
        Fragment { after: "builtin_finish", table: include_str!("settings/pixels.toml") },
    ];

    fn check(&self, to: &Checker<'_>) -> Result<()> {
        if !layout::is_format(&self.format) {
            let expected = format!("expected {}", layout::formats());
            return Err(Error::input(to.place("data.format"), "is not a layout of scenes", expected));
        }
        to.check(self.holdout != 1, "data.holdout", "0, or 2 and more")?;
        to.check(
            self.holdout == 0 || self.test_list.is_empty(),
            "data.test_list",
            "\"\" if data.holdout holds out frames",
        )?;
        to.check(
            self.holdout_by == HoldoutBy::Stride || self.test_list.is_empty(),
            "data.test_list",
            "\"\" if data.holdout_by = \"sector\" chooses the test frames",
        )?;
        to.check(!self.train.is_empty(), "data.train", "at least one split")?;
        let once = |(i, split)| !self.train[..i].contains(split);
        to.check(self.train.iter().enumerate().all(once), "data.train", "each split once")
    }
}
