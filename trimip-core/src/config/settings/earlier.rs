//! Settings of earlier versions, which old configurations, runs and model files still name.

/// Retired settings: path, the only value that is accepted (and ignored), and the expected value that the error about any
/// other value names.
pub(super) const RETIRED: [(&str, i64, &str); 1] =
    [("encoder.channels", 16, "16, or leave it out: a texel of the tri-mip planes has 16 features")];

/// Old and new paths of renamed settings.
const RENAMED: [(&str, &str); 6] = [
    ("eval.perceived", "eval.perceptual_views"),
    ("eval.share", "eval.time_fraction"),
    ("hybrid.share", "hybrid.shared_weight"),
    ("train.background_share", "train.background_fraction"),
    ("train.parts", "train.leaves"),
    ("train.scale_balance", "train.scale_weighting"),
];

/// Returns the new path of a renamed setting; `None` for all others.
pub(super) fn renamed(path: &str) -> Option<&'static str> {
    RENAMED.iter().find(|(old, _)| *old == path).map(|(_, new)| *new)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::settings::Settings;

    #[test]
    fn an_old_name_sets_the_setting_of_the_new_one() {
        for (old, new) in RENAMED {
            let mut settings = Settings::defaults();
            let default = settings.value(new);
            assert!(!default.is_empty() && settings.value(old).is_empty(), "{old} is {new} now");
            let value = if default.starts_with('[') { "[[0.0, 0.25]]" } else { "8" };
            let (section, key) = old.split_once('.').unwrap();
            settings.apply_file("old.toml", &format!("[{section}]\n{key} = {value}\n")).unwrap();
            assert!([value, "8.0"].contains(&&*settings.value(new)), "{}", settings.value(new));
            assert_eq!(settings.origin(new).to_string(), "old.toml:2:1");
            settings.apply_assignment(&format!("{new}={default}")).unwrap();
            settings.apply_assignment(&format!("{old}={value}")).unwrap();
            assert_ne!(settings.value(new), default);
        }
    }

    #[test]
    fn a_file_with_both_names_is_refused() {
        for (old, new) in RENAMED {
            let [(section, old_key), (_, new_key)] = [old, new].map(|path| path.split_once('.').unwrap());
            let text = format!("[{section}]\n{new_key} = 1\n{old_key} = 1\n");
            let error = Settings::defaults().apply_file("both.toml", &text).unwrap_err();
            assert_eq!(error.kind(), crate::ErrorKind::Input);
            for part in ["both.toml:3:1", old, new] {
                assert!(error.message().contains(part), "{part} in {error}");
            }
        }
    }
}
