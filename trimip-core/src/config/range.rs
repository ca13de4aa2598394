//! Ranges of numbers, as the tables of settings state them before the meaning of a setting: `0 to 1024: CPU threads`.

use toml::Value;

/// From the lowest to the highest number that a setting may have, both included.
#[derive(Clone, Debug, PartialEq)]
pub struct Range {
    low: f64,
    high: f64,
    /// As in the table.
    text: String,
}

impl Range {
    /// Parses a range such as `0 to 1024`.
    pub(crate) fn parse(text: &str) -> Option<Self> {
        let (low, high) = text.split_once(" to ")?;
        let [low, high] = [low, high].map(|number| number.parse::<f64>().ok());
        Some(Self { low: low?, high: high?, text: text.into() })
    }

    /// True if the range contains a number. A limit rounded to f32 still counts as the limit.
    fn contains(&self, number: f64) -> bool {
        let limit = |limit: f64| number as f32 == limit as f32;
        (self.low..=self.high).contains(&number)
            || number.fract() != 0.0 && (limit(self.low) || limit(self.high))
    }

    /// True for a number in the range, a list of such numbers, and a list of pairs whose second numbers are in the range.
    pub(crate) fn holds(&self, value: &Value) -> bool {
        match value {
            Value::Integer(number) => self.contains(*number as f64),
            Value::Float(number) => self.contains(*number),
            Value::Array(values) => values.iter().all(|value| match value {
                Value::Array(pair) => {
                    matches!(&pair[..], [Value::Integer(_) | Value::Float(_), value] if self.holds(value))
                }
                value => matches!(value, Value::Integer(_) | Value::Float(_)) && self.holds(value),
            }),
            // `eval.final` takes a stride or a flag; no other setting with a range has a flag.
            Value::Boolean(_) => true,
            _ => false,
        }
    }

    /// Text of what is expected of a value, for an error.
    pub(crate) fn expected(&self, value: &Value) -> String {
        match value {
            Value::Array(_) => format!("{} for each value", self.text),
            _ => self.text.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
