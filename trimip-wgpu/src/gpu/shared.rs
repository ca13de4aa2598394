//! Structs that Rust and WGSL share. Each is defined once, in Rust; the macros `shared!` and `mirror!` describe its
//! layout, from which the text of the WGSL struct is generated.

use bytemuck::Pod;
use std::fmt::Write;

/// A Rust type that has a counterpart in WGSL.
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
    /// Name of the member.
    pub name: &'static str,
    /// Type of the member in WGSL.
    pub kind: &'static str,
    /// Offset of the member within the Rust struct, in bytes.
    pub offset: usize,
}

/// The layout of a shared struct.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Its name in WGSL.
    pub name: &'static str,
    /// Size of the struct in Rust, in bytes.
    pub size: usize,
    /// Members of the struct, in order.
    pub members: &'static [Member],
}

impl Layout {
    /// Returns the text of the WGSL struct.
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
    /// Layout of the struct.
    const LAYOUT: Layout;
}
