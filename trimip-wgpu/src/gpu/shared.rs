//! Structs that Rust and WGSL share. Each is defined once, in Rust; the macros `shared!` and `mirror!` describe its
//! layout, from which the text of the WGSL struct is generated.

use bytemuck::Pod;
use std::fmt::Write;

/// A type of Rust that WGSL has as well.
pub trait Wgsl {
    /// Its name in WGSL.
    const TYPE: &'static str;
}

/// Names the types of WGSL that correspond to types of Rust.
macro_rules! types {
    ($($rust:ty => $wgsl:literal),* $(,)?) => {
        $(impl Wgsl for $rust {
            const TYPE: &'static str = $wgsl;
        })*
    };
}

types! {
    u32 => "u32",
    f32 => "f32",
    [u32; 2] => "vec2<u32>",
    [u32; 3] => "vec3<u32>",
    [u32; 4] => "vec4<u32>",
    [f32; 2] => "vec2<f32>",
    [f32; 3] => "vec3<f32>",
    [f32; 4] => "vec4<f32>",
    [u32; 8] => "array<vec4<u32>, 2>",
    [f32; 8] => "array<vec4<f32>, 2>",
    [[f32; 4]; 2] => "array<vec4<f32>, 2>",
    [[f32; 4]; 3] => "array<vec4<f32>, 3>",
}

/// A member of a shared struct.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Member {
    /// Its name.
    pub name: &'static str,
    /// Its type in WGSL.
    pub kind: &'static str,
    /// Its offset in bytes within the Rust struct.
    pub offset: usize,
}

/// The layout of a shared struct.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Its name in WGSL.
    pub name: &'static str,
    /// Its size in bytes in Rust.
    pub size: usize,
    /// Its members, in order.
    pub members: &'static [Member],
}

impl Layout {
    /// The text of the WGSL struct.
    pub fn text(&self) -> String {
        let mut text = format!("struct {} {{\n", self.name);
        for Member { name, kind, .. } in self.members {
            let _ = writeln!(text, "    {name}: {kind},");
        }
        text + "}\n"
    }
}

/// A struct that Rust and WGSL share.
pub trait Shared: Pod {
    /// Its layout.
    const LAYOUT: Layout;
}
