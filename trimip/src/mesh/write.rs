//! Mesh files: PLY (binary), OBJ, GLB (binary glTF 2.0) and USDZ, with normals and vertex colours where the mesh has them. Positions keep the
//! units and axes of the scene; viewers of glTF take its y axis as up, whatever the scene's up axis is. Positions far from the origin of
//! the coordinates need 64 bits: a PLY file then stores doubles, an OBJ file all digits, and a GLB or USDZ file a node that translates
//! the vertices.

use super::colors::eight_bits;
use super::surface::{Mesh, Texture};
use super::usdz::usdz;
use crate::view::pictures::linear;
use serde_json::json;
use std::path::{Path, PathBuf};
use trimip_core::{Error, Result, atomic::write_atomically};

/// A format of mesh files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum MeshFormat {
    /// Stanford PLY, binary little-endian; colours in 8 bits.
    Ply,
    /// Wavefront OBJ; colours as three more numbers of a vertex.
    Obj,
    /// Binary glTF 2.0; colours linear, as the format demands.
    Glb,
    /// Universal Scene Description as text, in an archive; colours linear.
    Usdz,
}

impl MeshFormat {
    /// Returns the format that the extension of a file name stands for.
    ///
    /// # Errors
    /// When the extension is none of the four.
    pub fn of(path: &Path) -> Result<Self> {
        match path.extension().map(|end| end.to_string_lossy().to_lowercase()).as_deref() {
            Some("ply") => Ok(Self::Ply),
            Some("obj") => Ok(Self::Obj),
            Some("glb") => Ok(Self::Glb),
            Some("usdz") => Ok(Self::Usdz),
            _ => Err(Error::input(
                path.display(),
                "names no mesh format",
                "end it in .ply, .obj, .glb or .usdz",
            )),
        }
    }
}

impl MeshFormat {
    /// Returns the format if it has textures.
    ///
    /// # Errors
    /// When it has none; `path` is the file of the message.
    pub fn expect_textures(self, path: &Path) -> Result<Self> {
        match self {
            Self::Ply => {
                Err(Error::input(path.display(), "PLY has no textures", "end it in .glb, .obj or .usdz"))
            }
            Self::Obj | Self::Glb | Self::Usdz => Ok(self),
        }
    }
}

/// Name of the material in an OBJ.
const MATERIAL: &str = "surface";

/// The coordinates of a file. The two kinds differ only for a scene far from the origin of its coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Coordinates {
    /// Coordinates of the photographs.
    #[default]
    Stated,
    /// Coordinates of the mesh, which fit into 32 bits. The file states the `offset` to add: in a comment of a PLY or OBJ, or in the
    /// `extras` of a GLB's asset, or in the documentation of a USDZ.
    Local,
}

/// Writes a mesh atomically, in the format of the file name's extension and in the coordinates of the photographs; returns the size of the
/// file in bytes.
///
/// # Errors
/// When the extension stands for no format, the mesh is empty, or the file cannot be written.
pub fn write(mesh: &Mesh, path: &Path) -> Result<u64> {
    write_in(mesh, Coordinates::Stated, path)
}

/// Like [`write()`], in the given coordinates.
///
/// # Errors
/// As [`write()`].
pub fn write_in(mesh: &Mesh, coordinates: Coordinates, path: &Path) -> Result<u64> {
    let bytes = match MeshFormat::of(path)? {
        MeshFormat::Ply => ply(mesh, coordinates),
        MeshFormat::Obj => obj(mesh, coordinates, None).into_bytes(),
        MeshFormat::Glb => glb(mesh, coordinates, None)?,
        MeshFormat::Usdz => package(mesh, coordinates, None)?,
    };
    write_atomically(path, &bytes)?;
    Ok(bytes.len() as u64)
}

/// Writes a mesh with its texture. A GLB contains the texture; an OBJ refers to a material file and a PNG of its name next to it.
/// Returns the files with their sizes in bytes; the mesh is the last.
///
/// # Errors
/// As [`write()`], and for a PLY, which has no textures.
pub fn write_textured(
    mesh: &Mesh,
    texture: &Texture,
    coordinates: Coordinates,
    path: &Path,
) -> Result<Vec<(PathBuf, u64)>> {
    let format = MeshFormat::of(path)?.expect_textures(path)?;
    let png = crate::view::pictures::png(texture.image.clone())?;
    let mut files = Vec::new();
    let mut keep = |path: PathBuf, bytes: &[u8]| {
        write_atomically(&path, bytes)?;
        files.push((path, bytes.len() as u64));
        Ok::<(), Error>(())
    };
    match format {
        MeshFormat::Obj => {
            let material = path.with_extension("mtl");
            let stem = path.file_stem().unwrap_or_default().to_string_lossy();
            let picture = path.with_file_name(format!("{stem}_texture.png"));
            let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            // Colours already contain the light of the photographs: illumination model 0 adds none.
            let text = format!("newmtl {MATERIAL}\nillum 0\nKd 1 1 1\nmap_Kd {}\n", name(&picture));
            keep(picture, &png)?;
            keep(material.clone(), text.as_bytes())?;
            keep(path.into(), obj(mesh, coordinates, Some((texture, &name(&material)))).as_bytes())?;
        }
        MeshFormat::Usdz => keep(path.into(), &package(mesh, coordinates, Some((texture, png)))?)?,
        _ => keep(path.into(), &glb(mesh, coordinates, Some((texture, png)))?)?,
    }
    Ok(files)
}

/// Returns the comment that states the offset of a file in local coordinates, without the format's comment marker.
fn offset(mesh: &Mesh, coordinates: Coordinates) -> Option<String> {
    let [x, y, z] = mesh.origin.numbers();
    let wanted = coordinates == Coordinates::Local && !mesh.origin.is_zero();
    wanted.then(|| format!("offset {x} {y} {z} is to be added to all positions"))
}

/// Returns the bytes of a USDZ. A texture comes with its PNG.
fn package(mesh: &Mesh, coordinates: Coordinates, texture: Option<(&Texture, Vec<u8>)>) -> Result<Vec<u8>> {
    let moved = coordinates == Coordinates::Stated && !mesh.origin.is_zero();
    let translation = moved.then(|| mesh.origin.numbers());
    usdz(mesh, texture, translation, offset(mesh, coordinates).as_deref())
}

/// Returns the positions in the photographs' coordinates, if these are requested and do not fit into 32 bits.
fn in_64_bits(mesh: &Mesh, coordinates: Coordinates) -> Option<impl Iterator<Item = [f64; 3]>> {
    let wanted = coordinates == Coordinates::Stated && !mesh.origin.is_zero();
    wanted.then(|| mesh.positions.iter().map(|position| mesh.origin.stated(position.map(f64::from))))
}

fn ply(mesh: &Mesh, coordinates: Coordinates) -> Vec<u8> {
    let comment = offset(mesh, coordinates).map_or_else(String::new, |text| format!("comment {text}\n"));
    let mut header =
        format!("ply\nformat binary_little_endian 1.0\n{comment}element vertex {}\n", mesh.positions.len());
    let mut places = in_64_bits(mesh, coordinates);
    let mut properties = |kind: &str, names: &[&str]| {
        names.iter().for_each(|name| header += &format!("property {kind} {name}\n"));
    };
    properties(if places.is_some() { "double" } else { "float" }, &["x", "y", "z"]);
    if !mesh.normals.is_empty() {
        properties("float", &["nx", "ny", "nz"]);
    }
    if !mesh.colors.is_empty() {
        properties("uchar", &["red", "green", "blue"]);
    }
    header += &format!(
        "element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        mesh.triangles.len()
    );
    let mut bytes = header.into_bytes();
    for (i, position) in mesh.positions.iter().enumerate() {
        match places.as_mut().and_then(Iterator::next) {
            Some(place) => bytes.extend(place.map(f64::to_le_bytes).into_iter().flatten()),
            None => bytes.extend(bytemuck_of(position)),
        }
        bytes.extend(mesh.normals.get(i).into_iter().flat_map(bytemuck_of));
        bytes.extend(mesh.colors.get(i).into_iter().flat_map(|&color| eight_bits(color)));
    }
    for triangle in &mesh.triangles {
        bytes.push(3);
        bytes.extend(triangle.iter().flat_map(|vertex| vertex.to_le_bytes()));
    }
    bytes
}

/// Returns the bytes of three floats, little-endian.
fn bytemuck_of(values: &[f32; 3]) -> impl Iterator<Item = u8> + use<> {
    values.map(f32::to_le_bytes).into_iter().flatten()
}

/// Returns the text of an OBJ. With a texture, it names the material file.
fn obj(mesh: &Mesh, coordinates: Coordinates, texture: Option<(&Texture, &str)>) -> String {
    use std::fmt::Write as _;
    let mut text = offset(mesh, coordinates).map_or_else(String::new, |text| format!("# {text}\n"));
    let mut places = in_64_bits(mesh, coordinates);
    for (i, [x, y, z]) in mesh.positions.iter().enumerate() {
        // Writing to a string does not fail.
        let _ = match places.as_mut().and_then(Iterator::next) {
            Some([x, y, z]) => write!(text, "v {x} {y} {z}"),
            None => write!(text, "v {x} {y} {z}"),
        };
        let _ = match mesh.colors.get(i) {
            Some([r, g, b]) => writeln!(text, " {r} {g} {b}"),
            None => writeln!(text),
        };
    }
    for [x, y, z] in &mesh.normals {
        let _ = writeln!(text, "vn {x} {y} {z}");
    }
    if let Some((texture, material)) = texture {
        // In an OBJ, v grows upward.
        for [u, v] in &texture.coordinates {
            let _ = writeln!(text, "vt {u} {}", 1.0 - v);
        }
        let _ = writeln!(text, "mtllib {material}\nusemtl {MATERIAL}");
    }
    for triangle in &mesh.triangles {
        let corner = |vertex: u32| match (texture.is_some(), !mesh.normals.is_empty()) {
            (false, false) => format!("{vertex}"),
            (true, false) => format!("{vertex}/{vertex}"),
            (false, true) => format!("{vertex}//{vertex}"),
            (true, true) => format!("{vertex}/{vertex}/{vertex}"),
        };
        let [a, b, c] = triangle.map(|vertex| corner(vertex + 1));
        let _ = writeln!(text, "f {a} {b} {c}");
    }
    text
}

/// Component types and targets of glTF 2.0.
const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// Filters and wrapping of glTF 2.0.
const LINEAR: u32 = 9729;
const LINEAR_MIPMAP_LINEAR: u32 = 9987;
const CLAMP_TO_EDGE: u32 = 33071;

/// Magic words of the GLB container.
const GLB: u32 = 0x4654_6c67;
const JSON: u32 = 0x4e4f_534a;
const BIN: u32 = 0x004e_4942;

/// Returns the bytes of a GLB. A texture comes with its PNG.
fn glb(mesh: &Mesh, coordinates: Coordinates, texture: Option<(&Texture, Vec<u8>)>) -> Result<Vec<u8>> {
    let Some([low, high]) = mesh.bounds().filter(|_| !mesh.triangles.is_empty()) else {
        return Err(Error::run("a mesh without triangles cannot be written as glTF"));
    };
    let mut data: Vec<u8> = Vec::new();
    let (mut views, mut accessors) = (Vec::new(), Vec::new());
    let mut add = |bytes: Vec<u8>, target: u32, mut accessor: serde_json::Value| {
        accessor["bufferView"] = views.len().into();
        views.push(
            json!({ "buffer": 0, "byteOffset": data.len(), "byteLength": bytes.len(), "target": target }),
        );
        data.extend(bytes);
        accessors.push(accessor);
        accessors.len() - 1
    };
    let count = mesh.positions.len();
    let floats = |list: &[[f32; 3]]| list.iter().flat_map(bytemuck_of).collect::<Vec<u8>>();
    let vectors = json!({ "componentType": FLOAT, "count": count, "type": "VEC3" });
    let mut positions = vectors.clone();
    (positions["min"], positions["max"]) = (json!(low), json!(high));
    let mut attributes = json!({ "POSITION": add(floats(&mesh.positions), ARRAY_BUFFER, positions) });
    if !mesh.normals.is_empty() {
        attributes["NORMAL"] = add(floats(&mesh.normals), ARRAY_BUFFER, vectors.clone()).into();
    }
    if !mesh.colors.is_empty() {
        let linear: Vec<[f32; 3]> = mesh.colors.iter().map(|color| color.map(linear)).collect();
        attributes["COLOR_0"] = add(floats(&linear), ARRAY_BUFFER, vectors).into();
    }
    if let Some((texture, _)) = &texture {
        let coordinates = texture.coordinates.iter().flatten().flat_map(|part| part.to_le_bytes()).collect();
        let pairs = json!({ "componentType": FLOAT, "count": count, "type": "VEC2" });
        attributes["TEXCOORD_0"] = add(coordinates, ARRAY_BUFFER, pairs).into();
    }
    let indices: Vec<u8> = mesh.triangles.iter().flatten().flat_map(|vertex| vertex.to_le_bytes()).collect();
    let scalars =
        json!({ "componentType": UNSIGNED_INT, "count": 3 * mesh.triangles.len(), "type": "SCALAR" });
    let indices = add(indices, ELEMENT_ARRAY_BUFFER, scalars);
    let png = texture.map(|(_, png)| png);
    let picture = views.len();
    if let Some(png) = &png {
        views.push(json!({ "buffer": 0, "byteOffset": data.len(), "byteLength": png.len() }));
        data.extend(png);
        data.resize(data.len().next_multiple_of(4), 0);
    }
    let mut root = json!({
        "asset": { "version": "2.0", "generator": format!("trimip {}", env!("CARGO_PKG_VERSION")) },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        // Vertex colours already contain the light of the photographs, so the material is unlit.
        "extensionsUsed": ["KHR_materials_unlit"],
        "materials": [{
            "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 1.0 },
            "extensions": { "KHR_materials_unlit": {} },
        }],
        "meshes": [{ "primitives": [{ "attributes": attributes, "indices": indices, "material": 0 }] }],
        "buffers": [{ "byteLength": data.len() }],
        "bufferViews": views,
        "accessors": accessors,
    });
    if png.is_some() {
        root["images"] = json!([{ "bufferView": picture, "mimeType": "image/png" }]);
        root["samplers"] = json!([{
            "magFilter": LINEAR, "minFilter": LINEAR_MIPMAP_LINEAR, "wrapS": CLAMP_TO_EDGE, "wrapT": CLAMP_TO_EDGE,
        }]);
        root["textures"] = json!([{ "sampler": 0, "source": 0 }]);
        root["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
    }
    if !mesh.origin.is_zero() {
        let numbers = json!(mesh.origin.numbers());
        match coordinates {
            Coordinates::Stated => root["nodes"][0]["translation"] = numbers,
            Coordinates::Local => root["asset"]["extras"] = json!({ "offset": numbers }),
        }
    }
    let mut text = serde_json::to_vec(&root).map_err(Error::run)?;
    text.resize(text.len().next_multiple_of(4), b' ');
    // All values have four bytes and the picture is padded, so the data need no padding.
    let total = 12 + 8 + text.len() + 8 + data.len();
    let too_large = || Error::run("the mesh is larger than the 4 GiB of a GLB file; simplify it");
    let size = |length: usize| u32::try_from(length).map_err(|_| too_large());
    let mut bytes = Vec::with_capacity(total);
    for word in [GLB, 2, size(total)?, size(text.len())?, JSON] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(text);
    for word in [size(data.len())?, BIN] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(data);
    Ok(bytes)
}
