//! Ranges of numbers, as the table of defaults states them before the meaning of a setting: `0 to 1024: CPU threads`.

use crate::{Error, Result, Settings, defaults::documented};
use std::collections::BTreeMap;
use std::sync::LazyLock;
use toml::Value;

/// From the lowest to the highest number that a setting may have, both included.
#[derive(Clone, Debug, PartialEq)]
pub struct Range {
    low: f64,
    high: f64,
    /// As in the table.
    text: String,
}

/// The ranges of all settings that are numbers, by dotted path.
static RANGES: LazyLock<BTreeMap<String, Range>> = LazyLock::new(|| {
    let settings = documented().into_iter().flat_map(|section| {
        let path = move |key: &str| match section.name.as_str() {
            "" => key.to_string(),
            name => format!("{name}.{key}"),
        };
        section.settings.into_iter().map(move |setting| (path(&setting.key), setting.range))
    });
    settings.filter_map(|(path, range)| Some((path, Range::parse(&range)?))).collect()
});

impl Range {
    /// The range that a text such as `0 to 1024` states.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let (low, high) = text.split_once(" to ")?;
        let [low, high] = [low, high].map(|number| number.parse::<f64>().ok());
        Some(Self { low: low?, high: high?, text: text.into() })
    }

    /// True if a number lies within. A limit that was rounded to f32 is still that limit.
    fn contains(&self, number: f64) -> bool {
        let limit = |limit: f64| number as f32 == limit as f32;
        (self.low..=self.high).contains(&number)
            || number.fract() != 0.0 && (limit(self.low) || limit(self.high))
    }

    /// True for a number within, a list of such numbers, and pairs with such a second number.
    fn holds(&self, value: &Value) -> bool {
        match value {
            Value::Integer(number) => self.contains(*number as f64),
            Value::Float(number) => self.contains(*number),
            Value::Array(values) => values.iter().all(|value| match value {
                Value::Array(pair) => {
                    matches!(&pair[..], [Value::Integer(_) | Value::Float(_), value] if self.holds(value))
                }
                value => matches!(value, Value::Integer(_) | Value::Float(_)) && self.holds(value),
            }),
            // `eval.final` takes a stride or a flag; no other number can be one.
            Value::Boolean(_) => true,
            _ => false,
        }
    }
}

/// Refuses the first number of `settings` that is not in its range; `place` tells where the value of a path was set.
pub(crate) fn check(settings: &Settings, place: &dyn Fn(&str) -> String) -> Result<()> {
    for (path, value, _) in settings.iter() {
        let Some(range) = RANGES.get(path) else { continue };
        if !range.holds(value) {
            let expected = match value {
                Value::Array(_) => format!("expected {} for each value", range.text),
                _ => format!("expected {}", range.text),
            };
            return Err(Error::input(place(path), "out of range", expected));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_of_the_table_has_a_range_and_lies_within() {
        let numeric = |value: &Value| match value {
            Value::Array(values) => values.iter().all(|value| !value.is_str()),
            value => value.is_integer() || value.is_float(),
        };
        for (path, value, _) in Settings::defaults().iter() {
            assert_eq!(RANGES.contains_key(path), numeric(value), "{path}");
        }
        check(&Settings::defaults(), &|path| path.to_string()).unwrap();
    }

    #[test]
    fn limits_belong_to_a_range_and_what_is_no_number_does_not() {
        let range = Range::parse("1e-6 to 0.5").unwrap();
        for number in [1e-6, f64::from(1e-6_f32), 0.1, 0.5] {
            assert!(range.contains(number), "{number}");
        }
        for number in [0.0, 0.9e-6, 0.51, 1.0, -1e-6, f64::NAN, f64::INFINITY] {
            assert!(!range.contains(number), "{number}");
        }
        let whole = Range::parse("0 to 1e9").unwrap();
        assert!(whole.contains(1e9) && !whole.contains(1e9 + 1.0));
        assert!(Range::parse("photographs").is_none() && Range::parse("a to b").is_none());
    }
}
