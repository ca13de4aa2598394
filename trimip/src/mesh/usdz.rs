//! USDZ: a text layer of Universal Scene Description and its texture in an archive, as Apple's and Pixar's programs read it.
//! Colours already contain the light of the photographs, so the surface emits them and reflects nothing.

use super::surface::{Mesh, Texture};
use crate::view::pictures::linear;
use flate2::Crc;
use std::fmt::Write as _;
use trimip_core::{Error, Result};

/// The files of a package begin at multiples of this number of bytes.
const ALIGNMENT: usize = 64;

/// Name of the texture within the package.
const PICTURE: &str = "texture.png";

/// Name of the layer, which is the first file.
const LAYER: &str = "surface.usda";

/// Returns the bytes of a package. A texture comes with its PNG; `translation` moves the whole mesh, and `offset` is a comment.
///
/// # Errors
/// When the mesh has no triangles, or the package would be larger than 4 GiB.
pub fn usdz(
    mesh: &Mesh,
    texture: Option<(&Texture, Vec<u8>)>,
    translation: Option<[f64; 3]>,
    offset: Option<&str>,
) -> Result<Vec<u8>> {
    if mesh.triangles.is_empty() {
        return Err(Error::run("a mesh without triangles cannot be written as USDZ"));
    }
    let layer = layer(mesh, texture.as_ref().map(|(texture, _)| *texture), translation, offset);
    let mut files = vec![(LAYER, layer.into_bytes())];
    files.extend(texture.map(|(_, png)| (PICTURE, png)));
    package(&files)
}

/// Writes an array of tuples, or of numbers if they have one element.
fn array<const N: usize>(text: &mut String, values: impl Iterator<Item = [f32; N]>) {
    text.push('[');
    for (i, value) in values.enumerate() {
        text.push_str(if i == 0 { "(" } else { ", (" });
        for (k, number) in value.iter().enumerate() {
            // Writing to a string does not fail.
            let _ = write!(text, "{}{number}", if k == 0 { "" } else { ", " });
        }
        text.push(')');
    }
    text.push(']');
}

/// Returns the text of the layer.
fn layer(
    mesh: &Mesh,
    texture: Option<&Texture>,
    translation: Option<[f64; 3]>,
    offset: Option<&str>,
) -> String {
    let mut text = String::from("#usda 1.0\n(\n");
    if let Some(offset) = offset {
        let _ = writeln!(text, "    doc = \"{offset}\"");
    }
    text += "    defaultPrim = \"surface\"\n    metersPerUnit = 1\n    upAxis = \"Z\"\n)\n\ndef Xform \"surface\"\n{\n";
    if let Some([x, y, z]) = translation {
        let _ = writeln!(text, "    double3 xformOp:translate = ({x}, {y}, {z})");
        text += "    uniform token[] xformOpOrder = [\"xformOp:translate\"]\n";
    }
    text += "    def Mesh \"mesh\" (\n        prepend apiSchemas = [\"MaterialBindingAPI\"]\n    )\n    {\n";
    if let Some([low, high]) = mesh.bounds() {
        text += "        float3[] extent = ";
        array(&mut text, [low, high].into_iter());
    }
    text += "\n        int[] faceVertexCounts = [";
    text += &vec!["3"; mesh.triangles.len()].join(", ");
    text += "]\n        int[] faceVertexIndices = [";
    let indices: Vec<String> = mesh.triangles.as_flattened().iter().map(u32::to_string).collect();
    text += &indices.join(", ");
    text += "]\n        point3f[] points = ";
    array(&mut text, mesh.positions.iter().copied());
    let per_vertex = " (\n            interpolation = \"vertex\"\n        )";
    if !mesh.normals.is_empty() {
        text += "\n        normal3f[] normals = ";
        array(&mut text, mesh.normals.iter().copied());
        text += per_vertex;
    }
    let colors = match texture {
        Some(texture) => {
            text += "\n        texCoord2f[] primvars:st = ";
            // In USD, v grows upward.
            array(&mut text, texture.coordinates.iter().map(|[u, v]| [*u, 1.0 - v]));
            text += per_vertex;
            Some(TEXTURED)
        }
        None if mesh.colors.is_empty() => None,
        None => {
            text += "\n        color3f[] primvars:displayColor = ";
            array(&mut text, mesh.colors.iter().map(|color| color.map(linear)));
            text += per_vertex;
            Some(COLORED)
        }
    };
    text += "\n        uniform token subdivisionScheme = \"none\"\n        uniform bool doubleSided = 1\n";
    if colors.is_some() {
        text += "        rel material:binding = </surface/material>\n";
    }
    text += "    }\n";
    text += colors.unwrap_or_default();
    text += "}\n";
    text
}

/// Material that shows the texture.
const TEXTURED: &str = r#"
    def Material "material"
    {
        token outputs:surface.connect = </surface/material/shader.outputs:surface>

        def Shader "shader"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0, 0, 0)
            color3f inputs:emissiveColor.connect = </surface/material/texture.outputs:rgb>
            float inputs:roughness = 1
            token outputs:surface
        }

        def Shader "coordinates"
        {
            uniform token info:id = "UsdPrimvarReader_float2"
            string inputs:varname = "st"
            float2 outputs:result
        }

        def Shader "texture"
        {
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @texture.png@
            float2 inputs:st.connect = </surface/material/coordinates.outputs:result>
            token inputs:sourceColorSpace = "sRGB"
            token inputs:wrapS = "clamp"
            token inputs:wrapT = "clamp"
            float3 outputs:rgb
        }
    }
"#;

/// Material that shows the colours of the vertices.
const COLORED: &str = r#"
    def Material "material"
    {
        token outputs:surface.connect = </surface/material/shader.outputs:surface>

        def Shader "shader"
        {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:diffuseColor = (0, 0, 0)
            color3f inputs:emissiveColor.connect = </surface/material/colors.outputs:result>
            float inputs:roughness = 1
            token outputs:surface
        }

        def Shader "colors"
        {
            uniform token info:id = "UsdPrimvarReader_float3"
            string inputs:varname = "displayColor"
            float3 outputs:result
        }
    }
"#;

/// Signatures of a zip archive: a file, its entry in the directory, the end of the directory.
const FILE: u32 = 0x0403_4b50;
const ENTRY: u32 = 0x0201_4b50;
const END: u32 = 0x0605_4b50;

/// Length of the header of a file without its name and its padding, and identifier of the field that holds the padding.
const HEADER: usize = 30;
const PADDING: u16 = 0x1986;

/// Version of the archive's format, 2.0, and the date of its files, 1 January 1980: the same mesh gives the same bytes.
const VERSION: u16 = 20;
const DATE: u16 = 0x21;

/// Returns an archive of files without compression, each at a multiple of [`ALIGNMENT`].
fn package(files: &[(&str, Vec<u8>)]) -> Result<Vec<u8>> {
    let too_large = || Error::run("the mesh is larger than the 4 GiB of a USDZ file; simplify it");
    let size = |length: usize| u32::try_from(length).map_err(|_| too_large());
    let mut bytes = Vec::new();
    let mut directory = Vec::new();
    for (name, content) in files {
        let start = size(bytes.len())?;
        let mut crc = Crc::new();
        crc.update(content);
        // The padding has a header of four bytes.
        let unpadded = bytes.len() + HEADER + name.len() + 4;
        let padding = unpadded.next_multiple_of(ALIGNMENT) - unpadded;
        let common = |out: &mut Vec<u8>, extra: usize| -> Result<()> {
            // Version, flags, no compression, time, date.
            for half in [VERSION, 0, 0, 0, DATE] {
                out.extend(half.to_le_bytes());
            }
            for word in [crc.sum(), size(content.len())?, size(content.len())?] {
                out.extend(word.to_le_bytes());
            }
            for half in [name.len() as u16, extra as u16] {
                out.extend(half.to_le_bytes());
            }
            Ok(())
        };
        bytes.extend(FILE.to_le_bytes());
        common(&mut bytes, 4 + padding)?;
        bytes.extend(name.as_bytes());
        bytes.extend(PADDING.to_le_bytes());
        bytes.extend((padding as u16).to_le_bytes());
        bytes.resize(bytes.len() + padding, 0);
        bytes.extend(content);
        directory.extend(ENTRY.to_le_bytes());
        directory.extend(VERSION.to_le_bytes());
        common(&mut directory, 0)?;
        // No comment, first disk, no attributes.
        directory.extend([0; 10]);
        directory.extend(start.to_le_bytes());
        directory.extend(name.as_bytes());
    }
    let (first, length) = (size(bytes.len())?, size(directory.len())?);
    bytes.extend(directory);
    bytes.extend(END.to_le_bytes());
    bytes.extend([0; 4]);
    for count in [files.len() as u16; 2] {
        bytes.extend(count.to_le_bytes());
    }
    for word in [length, first] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend([0; 2]);
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::fixtures::cube;

    /// CRC-32 bit by bit (ISO 3309).
    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(!0_u32, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (0xedb8_8320 * (crc & 1)))
        })
    }

    #[test]
    fn files_are_aligned_and_whole() {
        let files = [("a.usda", b"#usda 1.0\n".to_vec()), ("picture.png", (0..=255).collect())];
        let bytes = package(&files).unwrap();
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let half = |at: usize| usize::from(u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap()));
        let mut at = 0;
        for (name, content) in &files {
            assert_eq!((word(at), half(at + 8)), (FILE, 0), "stored without compression");
            assert_eq!([word(at + 18), word(at + 22)], [content.len() as u32; 2]);
            assert_eq!(word(at + 14), crc32(content));
            let (length, extra) = (half(at + 26), half(at + 28));
            assert_eq!(&bytes[at + HEADER..][..length], name.as_bytes());
            let first = at + HEADER + length + extra;
            assert!(first.is_multiple_of(ALIGNMENT));
            assert_eq!(&bytes[first..][..content.len()], &content[..]);
            at = first + content.len();
        }
        let end = bytes.len() - 22;
        assert_eq!((word(end), half(end + 10), word(end + 16)), (END, 2, at as u32));
        assert_eq!((word(at), at + word(end + 12) as usize), (ENTRY, end));
    }

    #[test]
    fn a_layer_has_the_mesh() {
        let mesh = cube();
        let text = layer(&mesh, None, Some([1.0, 2.5, -3.0]), None);
        assert!(text.starts_with("#usda 1.0\n") && text.contains("xformOp:translate = (1, 2.5, -3)"));
        let counts = text.split("faceVertexCounts = [").nth(1).unwrap().split(']').next().unwrap();
        assert_eq!(counts.split(", ").count(), mesh.triangles.len());
        assert_eq!(text.matches('{').count(), text.matches('}').count());
        assert!(!text.contains("material"), "there are no colours");
    }
}
