//! The options of `export`.

use super::CropChoice;
use clap::{Args, Subcommand, ValueEnum};
use std::path::PathBuf;

/// Options of `export`.
#[derive(Args, Debug)]
pub struct ExportArguments {
    /// The form of the output.
    #[command(subcommand)]
    pub what: ExportWhat,
}

/// The form of the output of `export`.
#[derive(Subcommand, Debug)]
pub enum ExportWhat {
    /// The surface as triangles with normals and colours, in the units and axes of the cameras: PLY, OBJ, GLB or USDZ
    Mesh(MeshArguments),
    /// A folder for any static web server: the model, and a page that renders it on the visitor's GPU (WebGPU)
    Web(WebArguments),
    /// The cameras of the photographs or of a path: a transforms file, the text files of a COLMAP model, or a glTF scene
    Cameras(CamerasArguments),
}

/// Where the colours of a texture come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TextureSource {
    /// The photographs if the data set is there, otherwise the field
    Auto,
    /// The field, seen against the normals of the surface
    Field,
    /// The training photographs, and the field where none shows the surface (needs the data set)
    Photographs,
}

/// Definition of the surface of a mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SurfaceSource {
    /// Depths in contracted space, otherwise the density
    Auto,
    /// Where the density crosses a level; closed unless a crop or --seen-by opens it
    Density,
    /// Where the depths of pictures from the training cameras agree; open where fewer than --seen-by pictures show it
    Depths,
}

/// Options of `export cameras`.
#[derive(Args, Debug)]
pub struct CamerasArguments {
    /// Run folder
    pub model: PathBuf,
    /// File or folder to write: FILE.json (transforms), FILE.gltf, or a folder without extension (COLMAP's text files) [default: `colmap`
    /// next to the model]
    #[arg(long, value_name = "PATH")]
    pub out: Option<PathBuf>,
    /// The photographs whose cameras are written. Those of the training photographs are the ones that the run used or refined; the others
    /// come from the data set
    #[arg(long, value_enum, default_value = "train")]
    pub views: CameraSet,
    /// Write the cameras of this path file instead
    #[arg(long, value_name = "FILE", conflicts_with = "views")]
    pub path: Option<PathBuf>,
}

/// Photographs whose cameras `export cameras` writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CameraSet {
    /// The training photographs
    Train,
    /// The test photographs
    Test,
    /// Both
    All,
}

/// Options of `export web`.
#[derive(Args, Debug)]
pub struct WebArguments {
    /// Run folder or model file
    pub model: PathBuf,
    /// Folder to write [default: `web` next to the model]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Folder with the WebAssembly program of the page, which tools/web.sh builds
    #[arg(long, value_name = "DIR", default_value = "target/web")]
    pub viewer: PathBuf,
    /// Part of the world that the page initially shows, in world units: none (everything), auto (the model's scene.crop), "box X,Y,Z,X,Y,Z"
    /// (lower and upper corner), "ball X,Y,Z,RADIUS" or "half X,Y,Z,X,Y,Z" (a point of a plane and the direction to the side that is kept).
    /// Crops follow the cells of the occupancy grid. A switch on the page toggles between the crop and everything
    #[arg(long, default_value = "none", value_name = "CROP")]
    pub crop: CropChoice,
}

/// Options of `export mesh`.
#[derive(Args, Debug)]
pub struct MeshArguments {
    /// Run folder or model file
    pub model: PathBuf,
    /// File to write; its name ends in .ply, .obj, .glb or .usdz [default: mesh.ply next to the model]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Number of grid cells along the longest side of the box
    #[arg(long, default_value_t = 512, value_name = "N", value_parser = clap::value_parser!(u32).range(8..=2048))]
    pub resolution: u32,
    /// Definition of the surface
    #[arg(long, value_enum, default_value = "auto", value_name = "SOURCE")]
    pub surface: SurfaceSource,
    /// Density of the surface, per world unit; implies --surface density [default: the density at which a marching step has an optical depth
    /// of 0.2]
    #[arg(long, value_name = "DENSITY")]
    pub level: Option<f64>,
    /// Leave out connected parts whose diagonal is smaller than this share of the longest side of the box
    #[arg(long, default_value_t = 0.02, value_name = "SHARE")]
    pub specks: f64,
    /// Rounds of smoothing, which removes noise of the size of a cell and keeps the size of the mesh
    #[arg(long, default_value_t = 0, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1000))]
    pub smooth: u32,
    /// Simplify to about this many triangles; 0 = keep all
    #[arg(long, default_value_t = 100_000, value_name = "N")]
    pub triangles: usize,
    /// Simplify as long as the surface moves by less than this share of the mesh's longest side; replaces --triangles
    #[arg(long, value_name = "SHARE", conflicts_with = "triangles")]
    pub error: Option<f64>,
    /// Part of the scene to write, in world units: auto (the model's scene.crop), none, "box X,Y,Z,X,Y,Z" (lower and upper corner), "ball
    /// X,Y,Z,RADIUS" or "half X,Y,Z,X,Y,Z" (a point of a plane and the direction to the side that is kept); the surface is open where the
    /// crop cuts it
    #[arg(long, default_value = "auto", value_name = "CROP")]
    pub crop: CropChoice,
    /// Leave out triangles that fewer than N training cameras see; 0 = keep all [default: 3 in contracted space, otherwise 0]
    #[arg(long, value_name = "N")]
    pub seen_by: Option<u32>,
    /// Write coordinates relative to data.origin, for programs with 32-bit coordinates; the file states the offset. By default, coordinates
    /// are those of the photographs. The two only differ if the photographs are far from the origin of their coordinates
    #[arg(long)]
    pub local: bool,
    /// Leave out the colours of the vertices
    #[arg(long)]
    pub no_colors: bool,
    /// Write a texture of N by N texels instead of colours of the vertices (GLB, OBJ or USDZ)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(64..=16_384))]
    pub texture: Option<u32>,
    /// Where the colours of the texture come from
    #[arg(long, value_enum, default_value = "auto", requires = "texture", value_name = "SOURCE")]
    pub texture_source: TextureSource,
    /// Also write a mesh of about N triangles without colours, for collisions: `mesh_collision.glb` next to `mesh.glb`
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(4..))]
    pub collision: Option<u32>,
    /// Compare pictures of the mesh with every N-th test photograph (needs the data set)
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "1", value_parser = clap::value_parser!(u32).range(1..))]
    pub psnr: Option<u32>,
    /// Compare the silhouettes with the masks of every N-th test view (needs the data set)
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "1", value_parser = clap::value_parser!(u32).range(1..))]
    pub silhouettes: Option<u32>,
    /// Override a setting of data, backend, threads or wgpu
    #[arg(long, value_name = "SECTION.KEY=VALUE")]
    pub set: Vec<String>,
}
