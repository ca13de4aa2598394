//! Values that programs give to settings.

use super::values::shown;
use serde::Serialize;
use std::fmt;
use toml::Value;

/// Value of a setting: a flag, a number, a string, or a list of values. A schedule is a list of pairs.
///
/// ```
/// use trimip_core::Settings;
///
/// let settings = Settings::defaults()
///     .with("train.seconds", 60)?
///     .with("data.background", [0.5, 0.5, 0.5])?
///     .with("train.batch_scale", [[0.0, 0.5], [0.3, 1.0]])?;
/// assert_eq!(settings.value("train.seconds"), "60.0");
/// # Ok::<(), trimip_core::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SettingValue(pub(crate) Value);

impl fmt::Display for SettingValue {
    /// Writes the value as in a configuration file.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&shown(&self.0))
    }
}

/// Implements the conversions from types that convert to a TOML value.
macro_rules! plain {
    ($($from:ty),+) => {
        $(
            impl From<$from> for SettingValue {
                fn from(value: $from) -> Self {
                    Self(value.into())
                }
            }
        )+
    };
}

plain!(bool, i32, i64, u32, f32, f64, &str, String);

impl<T: Into<Self>> From<Vec<T>> for SettingValue {
    fn from(values: Vec<T>) -> Self {
        Self(Value::Array(values.into_iter().map(|value| value.into().0).collect()))
    }
}

impl<T: Into<Self>, const N: usize> From<[T; N]> for SettingValue {
    fn from(values: [T; N]) -> Self {
        Vec::from(values).into()
    }
}
