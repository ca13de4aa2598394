//! Ranges of numbers, which the tables of settings state as `range = [0, 1024]`.

use toml::Value;

/// Range from the lowest to the highest number that a setting may have, both included.
#[derive(Clone, Debug, PartialEq)]
pub struct Range {
    low: f64,
    high: f64,
    /// Both limits as text, such as `0 to 1e9`.
    text: String,
}

impl Range {
    /// Returns the range from the first to the second number. Ranges are compiled in and tested.
    ///
    /// # Panics
    /// If an end is not a number, or if the first is not below the second.
    pub(crate) fn new(ends: [Value; 2]) -> Self {
        let [low, high] = ends.each_ref().map(|end| match end {
            Value::Integer(number) => *number as f64,
            Value::Float(number) => *number,
            other => panic!("{other} is not a number"),
        });
        assert!(low < high, "{low} is not below {high}");
        Self { low, high, text: ends.each_ref().map(written).join(" to ") }
    }

    /// Returns true if the range contains `number`. A fraction that equals a limit when both are rounded to f32 counts as
    /// the limit.
    fn contains(&self, number: f64) -> bool {
        let limit = |limit: f64| number as f32 == limit as f32;
        (self.low..=self.high).contains(&number)
            || number.fract() != 0.0 && (limit(self.low) || limit(self.high))
    }

    /// Returns true for a number in the range, for a list of such numbers, and for a list of pairs whose second numbers are
    /// in the range.
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
            // `eval.final` takes a stride or a flag; no other setting with a range takes a flag.
            Value::Boolean(_) => true,
            _ => false,
        }
    }

    /// Returns the text of the expected range, for an error about `value`.
    pub(crate) fn expected(&self, value: &Value) -> String {
        match value {
            Value::Array(_) => format!("{} for each value", self.text),
            _ => self.text.clone(),
        }
    }
}

impl std::fmt::Display for Range {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.text)
    }
}

/// Formats a number, with a power of ten for large and small floats.
fn written(number: &Value) -> String {
    match number {
        Value::Float(number) if *number != 0.0 && (number.abs() <= 1e-3 || number.abs() >= 1e3) => {
            format!("{number:e}")
        }
        Value::Float(number) => number.to_string(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_belong_to_a_range_and_what_is_no_number_does_not() {
        let range = Range::new([1e-6.into(), 0.5.into()]);
        assert_eq!(range.to_string(), "1e-6 to 0.5");
        for number in [1e-6, f64::from(1e-6_f32), 0.1, 0.5] {
            assert!(range.contains(number), "{number}");
        }
        for number in [0.0, 0.9e-6, 0.51, 1.0, -1e-6, f64::NAN, f64::INFINITY] {
            assert!(!range.contains(number), "{number}");
        }
        let whole = Range::new([0.into(), 1e9.into()]);
        assert_eq!(whole.to_string(), "0 to 1e9");
        assert!(whole.contains(1e9) && !whole.contains(1e9 + 1.0));
    }
}
