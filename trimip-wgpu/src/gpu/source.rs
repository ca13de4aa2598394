//! The parts of WGSL that a kernel is composed of: text, generated structs and generated constants. A part names the
//! parts that it needs, and each part appears only once in a kernel.

use super::shared::{Layout, Shared};

/// A part of the WGSL of a kernel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Source {
    /// Text of a WGSL file.
    Text(&'static str),
    /// A struct that Rust defines.
    Struct(&'static Layout),
    /// A constant that Rust defines.
    Constant(&'static str, Value),
    /// Several parts.
    Parts(&'static [Self]),
}

/// Value of a constant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// A `u32`.
    Whole(u32),
    /// An `f32`.
    Real(f32),
    /// An array of `f32`.
    Reals(&'static [f64]),
}

impl Source {
    /// Returns the part that defines the struct `T`.
    pub const fn of<T: Shared>() -> Self {
        Self::Struct(const { &T::LAYOUT })
    }

    /// Returns the part that defines a constant of type `u32`.
    pub const fn whole(name: &'static str, value: u32) -> Self {
        Self::Constant(name, Value::Whole(value))
    }

    /// Returns the part that defines a constant of type `f32`.
    pub const fn real(name: &'static str, value: f32) -> Self {
        Self::Constant(name, Value::Real(value))
    }

    /// Appends this part to `parts`, without nesting. Parts that `parts` already contains are skipped.
    pub fn flatten(self, parts: &mut Vec<Self>) {
        match self {
            Self::Parts(own) => own.iter().for_each(|part| part.flatten(parts)),
            single if parts.contains(&single) => {}
            single => parts.push(single),
        }
    }

    /// Returns the WGSL text of this part.
    pub fn text(self) -> String {
        match self {
            Self::Text(text) => text.to_string(),
            Self::Struct(layout) => layout.text(),
            Self::Constant(name, Value::Whole(value)) => format!("const {name}: u32 = {value}u;\n"),
            Self::Constant(name, Value::Real(value)) => format!("const {name}: f32 = {value:?};\n"),
            Self::Constant(name, Value::Reals(values)) => {
                let list: Vec<String> = values.iter().map(|value| format!("{value:?}")).collect();
                format!("const {name} = array<f32, {}>({});\n", values.len(), list.join(", "))
            }
            Self::Parts(parts) => parts.iter().map(|part| part.text()).collect(),
        }
    }
}
