//! Values of settings in TOML: parsed from files and assignments, and converted to the types of their defaults.

use toml::de::DeValue;
use toml::{Spanned, Table, Value};

/// Removes the spans from a value.
pub(crate) fn plain(value: &Spanned<DeValue<'_>>) -> Value {
    match value.get_ref() {
        DeValue::String(text) => Value::String(text.to_string()),
        DeValue::Integer(number) => i64::from_str_radix(number.as_str(), number.radix())
            .map_or_else(|_| Value::String(number.to_string()), Value::Integer),
        DeValue::Float(number) => {
            number.as_str().parse().map_or_else(|_| Value::String(number.to_string()), Value::Float)
        }
        DeValue::Boolean(flag) => Value::Boolean(*flag),
        DeValue::Datetime(date) => Value::Datetime(*date),
        DeValue::Array(items) => Value::Array(items.iter().map(plain).collect()),
        DeValue::Table(fields) => Value::Table(
            fields.iter().map(|(key, value)| (key.get_ref().to_string(), plain(value))).collect(),
        ),
    }
}

/// Parses a value as TOML; text that is not valid TOML becomes a string.
pub(crate) fn parsed(text: &str) -> Value {
    toml::from_str::<Table>(&format!("value = {text}"))
        .ok()
        .and_then(|mut table| table.remove("value"))
        .unwrap_or_else(|| Value::String(text.to_string()))
}

/// Formats a value as TOML, for a message. Large floats are written as 1e308, not with all of their digits.
pub(crate) fn shown(value: &Value) -> String {
    match value {
        Value::Float(number) => format!("{number:?}"),
        Value::Array(values) => {
            format!("[{}]", values.iter().map(shown).collect::<Vec<_>>().join(", "))
        }
        value => value.to_string(),
    }
}

/// Converts `value` to the type of the default; integers are accepted for floats. The error holds the value that was found
/// and the type that is expected.
pub(crate) fn fit(default: &Value, value: Value) -> Result<Value, (String, &'static str)> {
    let found = shown(&value);
    match (default, value) {
        (Value::Float(_), Value::Integer(number)) => Ok(Value::Float(number as f64)),
        // A single number becomes a schedule with one piece.
        (Value::Array(items), value @ (Value::Integer(_) | Value::Float(_))) if matches!(items.first(), Some(Value::Array(piece)) if piece.len() == 2) => {
            fit(default, Value::Array(vec![Value::Array(vec![Value::Float(0.0), value])]))
        }
        (Value::Array(items), Value::Array(values)) => match items.first() {
            None => Ok(Value::Array(values)),
            Some(item) => {
                values.into_iter().map(|value| fit(item, value)).collect::<Result<_, _>>().map(Value::Array)
            }
        },
        (default, value) if default.same_type(&value) => Ok(value),
        (default, _) => Err((
            found,
            match default {
                Value::String(_) => "a string",
                Value::Integer(_) => "a whole number",
                Value::Float(_) => "a number",
                Value::Boolean(_) => "true or false",
                Value::Array(_) => "a list",
                Value::Table(_) | Value::Datetime(_) => "a table",
            },
        )),
    }
}

/// Returns true for a value without tables, which can be written on one line.
pub(crate) fn is_plain(value: &Value) -> bool {
    match value {
        Value::Array(values) => values.iter().all(is_plain),
        Value::Table(_) => false,
        _ => true,
    }
}

/// Formats a setting as a line of TOML.
pub(crate) fn line(key: &str, value: &Value) -> String {
    let table = Table::from_iter([(key.to_string(), value.clone())]);
    let text = toml::to_string(&table).unwrap_or_else(|error| unreachable!("a plain value: {error}"));
    text.trim_end().to_string()
}
