//! `export mesh`: writes the surface of a model as a triangle mesh.

use crate::{
    args::{MeshArguments, SurfaceSource, TextureSource},
    interrupt,
    progress::bar,
    terminal,
};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Instant;
use trimip::mesh::{
    self, Coordinates, Extracted, Extraction, Goal, MeshFormat, Photographs, Source, Surface, Texturing,
};
use trimip::run::{cameras::named_training_cameras, folder as run_folder};
use trimip::{Crop, Error, Result, backends, settings};
use trimip_core::{Camera, Config, scene::origin::LocalOrigin};

/// Number of steps of the bar.
const BAR: u64 = 1000;

/// Writes the surface of a model as a triangle mesh.
pub fn export(arguments: &MeshArguments) -> Result<u8> {
    let out = arguments.out.clone().unwrap_or_else(|| beside(&arguments.model));
    let format = MeshFormat::of(&out)?;
    if arguments.texture.is_some() {
        format.expect_textures(&out)?;
    }
    let mut model = run_folder::read_model(&arguments.model)?;
    settings::override_model(&mut model, &arguments.set)?;
    backends::check(&model.config.backend)?;
    let origin = LocalOrigin::of(&model.config.data);
    // The data set is opened first, so that a missing one is reported before the work begins.
    let data = match trimip_data::open_test(&model.config.section()?) {
        Ok(data) => Some(data),
        Err(error) if needs_data(arguments) => return Err(error),
        Err(_) => None,
    };
    // A run may have refined the cameras of its photographs.
    let stored = named_training_cameras(&arguments.model, origin)?.unwrap_or_default();
    let cameras = match &data {
        Some(data) if stored.is_empty() => data.train.clone(),
        _ => stored.iter().map(|&(_, camera)| camera).collect(),
    };
    let surface = surface(arguments, &model.config, &cameras)?;
    if cameras.is_empty() {
        terminal::aside(
            "neither the data set nor the run folder has training cameras: a void counts as hidden only if no line of sight \
             from any direction reaches it",
        );
    }
    if let Some(folder) = out.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        run_folder::create_writable(folder)?;
    }
    let stop = interrupt::install()?;
    // The pictures whose depths are used are smaller than the photographs; one cone per pixel is enough for them.
    model.config.renderer.cones = 1;
    let mut viewer = backends::load(&model)?;
    backends::software_remark(&model.config)
        .iter()
        .for_each(|remark| terminal::note(format!("warning: {remark}")));

    let what = Extraction {
        resolution: arguments.resolution,
        surface,
        level: arguments.level,
        specks: arguments.specks,
        smoothing: arguments.smooth,
        goal: match (arguments.error, arguments.triangles) {
            (Some(error), _) => Goal::Error(error),
            (None, 0) => Goal::Everything,
            (None, count) => Goal::Triangles(count),
        },
        colors: !arguments.no_colors && arguments.texture.is_none(),
        crop: arguments.crop.of(&model.config),
        least_cameras: arguments.seen_by.unwrap_or(Extraction::of(&model.config, &cameras).least_cameras),
    };
    let started = Instant::now();
    let bar = bar("{bar:30} {percent:>3} %  {eta} left", BAR);
    let extracted = mesh::extract(viewer.as_mut(), &model, &what, &cameras, &mut |fraction| {
        bar.set_position((fraction * BAR as f64) as u64);
        !stop.load(Ordering::Relaxed)
    })?;
    let Some(extracted) = extracted else { return Ok(interrupt::EXIT_CODE) };
    let seconds = started.elapsed().as_secs_f64();
    let coordinates = if arguments.local { Coordinates::Local } else { Coordinates::Stated };
    let textured = match arguments.texture {
        None => None,
        Some(side) => {
            let mut watch = |fraction: f64| {
                bar.set_position((fraction * BAR as f64) as u64);
                !stop.load(Ordering::Relaxed)
            };
            let refined: HashMap<_, _> = stored.into_iter().collect();
            let photographs = match (&data, arguments.texture_source) {
                (Some(data), TextureSource::Auto | TextureSource::Photographs) => {
                    Some(Photographs { frames: data.photographs.as_ref(), cameras: &refined })
                }
                _ => None,
            };
            let threads = model.config.threads as usize;
            let what =
                Texturing { side, spacing: extracted.spacing, photographs, cameras: &cameras, threads };
            let made = mesh::texture(viewer.as_mut(), &extracted.mesh, &what, &mut watch)?;
            let Some(made) = made else { return Ok(interrupt::EXIT_CODE) };
            Some((made, started.elapsed().as_secs_f64() - seconds))
        }
    };
    bar.finish_and_clear();
    let mut files = match &textured {
        None => vec![(out.clone(), mesh::write_in(&extracted.mesh, coordinates, &out)?)],
        Some(((mesh, texture), _)) => mesh::write_textured(mesh, texture, coordinates, &out)?,
    };
    if let Some(count) = arguments.collision {
        let mesh = mesh::for_collisions(&extracted.mesh, count as usize);
        let file = with_collision(&out);
        terminal::prose(format!("collisions: {} triangles", mesh.triangles.len()));
        files.push((file.clone(), mesh::write_in(&mesh, coordinates, &file)?));
    }
    if !origin.is_zero() {
        terminal::prose(match coordinates {
            Coordinates::Stated => {
                "coordinates: those of the photographs, with 64 bits; for programs that read 32 bits, and therefore show steps, \
                 export with --local"
                    .to_string()
            }
            Coordinates::Local => format!("coordinates: those of the photographs minus {origin}"),
        });
    }
    describe(&extracted, origin.stated(what.crop), seconds).iter().for_each(terminal::prose);
    if let (Some(stride), Some(data)) = (arguments.silhouettes, &data) {
        terminal::prose(match mesh::overlap(&extracted.mesh, data.frames.as_ref(), stride as usize)? {
            Some(found) => format!(
                "silhouettes: intersection over union with the masks of {}: mean {:.4}, least {:.4}",
                terminal::many(found.views as u64, "test view"),
                found.mean,
                found.least
            ),
            None => "silhouettes: no test photograph has a mask to compare with".into(),
        });
    }
    if let Some(((_, texture), seconds)) = &textured {
        terminal::prose(format!(
            "texture: {}, {:.0} % of the texels show the surface, {}; {seconds:.1} s",
            terminal::many(texture.charts.into(), "chart"),
            100.0 * texture.used,
            match texture.photographs {
                0 => "colours of the field".to_string(),
                count => format!(
                    "{:.0} % of these have colours of {}, the others of the field",
                    100.0 * texture.shown,
                    terminal::many(count as u64, "photograph")
                ),
            }
        ));
    }
    if let (Some(stride), Some(data)) = (arguments.psnr, &data) {
        let (mesh, texture) = match &textured {
            Some(((mesh, texture), _)) => (mesh, Some(texture)),
            None => (&extracted.mesh, None),
        };
        let background = model.config.data.background;
        terminal::prose(
            match mesh::psnr(mesh, texture, data.frames.as_ref(), stride as usize, background)? {
                Some(found) => format!(
                    "pictures of the mesh: {:.2} dB on {}, {:.2} dB within the mesh",
                    found.whole,
                    terminal::many(found.views as u64, "test view"),
                    found.covered
                ),
                None => "pictures of the mesh: no test view shows the mesh".into(),
            },
        );
    }
    for (file, bytes) in files {
        terminal::line(format!("{}: {}", file.display(), terminal::bytes(bytes)));
    }
    Ok(0)
}

/// Returns the definition of the surface that the options select.
///
/// # Errors
/// When options contradict each other, or need cameras and there are none.
fn surface(arguments: &MeshArguments, config: &Config, cameras: &[Camera]) -> Result<Surface> {
    if cameras.is_empty() && arguments.seen_by.is_some_and(|least| least > 0) {
        return Err(needs_cameras("--seen-by"));
    }
    match (arguments.surface, arguments.level) {
        (SurfaceSource::Density, _) | (SurfaceSource::Auto, Some(_)) => Ok(Surface::Density),
        (SurfaceSource::Auto, None) => Ok(Extraction::of(config, cameras).surface),
        (SurfaceSource::Depths, Some(_)) => Err(Error::input(
            "--level",
            "given beside --surface depths, which has no level",
            "leave one of them out",
        )),
        (SurfaceSource::Depths, None) if cameras.is_empty() => Err(needs_cameras("--surface depths")),
        (SurfaceSource::Depths, None) => Ok(Surface::Depths),
    }
}

/// Returns the error for an option that needs cameras when there are none.
fn needs_cameras(option: &str) -> Error {
    Error::input(
        option,
        "needs the cameras of the photographs, and neither the data set nor the run folder has them",
        "name the data set with --set data.root=FOLDER, or leave the option out",
    )
}

/// Returns true if the options need the data set.
fn needs_data(arguments: &MeshArguments) -> bool {
    let compares = arguments.silhouettes.is_some() || arguments.psnr.is_some();
    compares || (arguments.texture.is_some() && arguments.texture_source == TextureSource::Photographs)
}

/// Returns the path of the mesh for collisions: `_collision` follows the name of the file.
fn with_collision(out: &Path) -> PathBuf {
    let mut name = out.file_stem().unwrap_or_default().to_os_string();
    name.push("_collision.");
    name.push(out.extension().unwrap_or_default());
    out.with_file_name(name)
}

/// Returns the path of `mesh.ply` in the run folder, or next to the model file.
fn beside(model: &Path) -> PathBuf {
    let folder = if model.is_dir() { model } else { model.parent().unwrap_or("".as_ref()) };
    folder.join("mesh.ply")
}

/// Describes the extracted mesh and the extraction.
fn describe(extracted: &Extracted, crop: Crop, seconds: f64) -> Vec<String> {
    let Extracted { mesh, source, spacing, removed, unseen, triangles } = extracted;
    let defects = mesh.defects();
    let only_open = mesh::Defects { open: defects.open, ..mesh::Defects::default() };
    let sound = match defects {
        _ if defects == mesh::Defects::default() => {
            format!("volume {:.5} cubic units, closed and manifold", mesh.volume())
        }
        _ if defects == only_open => {
            format!("manifold, open along {}", terminal::count(defects.open as u64, "edge"))
        }
        _ => format!(
            "not closed or not manifold: {} open, {} crowded and {} twisted edges, {} collapsed triangles",
            defects.open, defects.crowded, defects.twisted, defects.collapsed
        ),
    };
    let mut lines = vec![
        format!(
            "surface: {} on cells {spacing:.5} units wide; {}, {} removed",
            match source {
                Source::Density(level) => format!("density {level:.4} per unit"),
                Source::Depths(pictures) =>
                    format!("depths of {}", terminal::many(*pictures as u64, "picture")),
            },
            terminal::many(removed.specks as u64, "speck"),
            match removed.cavities {
                1 => "1 cavity".to_string(),
                count => format!("{count} cavities"),
            },
        ),
        format!(
            "mesh: {} triangles of {triangles}, {} vertices, {sound}; {seconds:.1} s",
            mesh.triangles.len(),
            mesh.positions.len(),
        ),
    ];
    let few = || format!("left out {} that few cameras see", terminal::many(*unseen as u64, "triangle"));
    let parts = [(crop != Crop::None).then(|| format!("crop: {crop}")), (*unseen > 0).then(few)];
    let parts: Vec<String> = parts.into_iter().flatten().collect();
    if !parts.is_empty() {
        lines.insert(0, parts.join("; "));
    }
    lines
}
