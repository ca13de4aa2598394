//! `render --strip`: one camera at increasing pixel sizes, as if from increasing distance. All pictures are enlarged to one size. There is
//! one row per model. If there is an original, it is the last row, and the PSNR of every picture relative to it is printed, in dB.

use super::selection;
use crate::{args::RenderArguments, interrupt, terminal};
use image::{GenericImage, RgbImage, imageops};
use std::sync::atomic::Ordering;
use trimip::run::folder as run_folder;
use trimip::view::{cameras, pictures};
use trimip::{backends, settings};
use trimip_core::{
    Alpha, Camera, Config, Error, Result, measures::metrics::psnr, scene::views::composite_pixel,
};
use trimip_data::{builtin, settings::DataConfig};

/// Pixel size of each column, in pixels of the camera.
const FACTORS: [u32; 5] = [1, 2, 4, 8, 16];
/// Number of white pixels between pictures.
const GAP: u32 = 2;
/// Largest width or height of a strip, pixels.
const MAX_SIDE: u32 = 16_384;

/// A picture: colours in [0, 1] in row-major order.
struct Picture {
    width: u32,
    height: u32,
    rgb: Vec<[f32; 3]>,
}

/// Renders the strip of the camera that the arguments select.
pub fn run(arguments: &RenderArguments) -> Result<u8> {
    let mut models = Vec::new();
    for path in std::iter::once(&arguments.model).chain(&arguments.against) {
        let mut model = run_folder::read_model(path)?;
        settings::override_model(&mut model, &arguments.set)?;
        backends::check(&model.config.backend)?;
        models.push((path.display().to_string(), model));
    }
    let config = models[0].1.config.clone();
    let camera = match selection::resize(selection::chosen(arguments, &config)?, arguments.scale)?.as_slice()
    {
        [(_, camera)] => *camera,
        many => {
            return Err(Error::input(
                "--strip",
                format!("shows one camera, but {} are named", many.len()),
                "name one, such as --views 0",
            ));
        }
    };
    let columns = FACTORS.map(|factor| {
        let intrinsics = cameras::resized(camera.intrinsics, 1.0 / f64::from(factor));
        intrinsics.map(|intrinsics| Camera { intrinsics, ..camera })
    });
    let columns = columns.into_iter().collect::<Result<Vec<_>>>()?;
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    check_size(width, height, models.len() as u32 + 1)?;
    let out = arguments.out.clone().unwrap_or_else(|| selection::beside(&arguments.model));
    run_folder::create_writable(&out)?;

    let stop = interrupt::install()?;
    let mut rows: Vec<(String, Vec<Picture>)> = Vec::new();
    for (name, model) in models {
        let mut session = backends::load(&model)?;
        session.notes().iter().for_each(|note| terminal::note(format!("warning: {note}")));
        let mut row = Vec::new();
        for camera in &columns {
            if stop.load(Ordering::Relaxed) {
                return Ok(interrupt::EXIT_CODE);
            }
            let frame = session.render(camera)?;
            row.push(Picture { width: frame.width, height: frame.height, rgb: frame.rgb() });
        }
        rows.push((name, row));
    }
    if let Some(original) = original(&config, arguments, &camera)? {
        let averages = columns.iter().map(|c| original.averaged(c.intrinsics.width, c.intrinsics.height));
        rows.push(("the original".into(), averages.collect()));
        table(&rows).iter().for_each(terminal::aside);
    }
    let path = out.join("strip.png");
    pictures::write_png(&path, sheet(width, height, &rows)?)?;
    terminal::line(path.display());
    Ok(0)
}

fn check_size(width: u32, height: u32, rows: u32) -> Result<()> {
    let [wide, high] =
        [(width, FACTORS.len() as u32), (height, rows)].map(|(side, count)| count * (side + GAP));
    if wide.max(high) <= MAX_SIDE {
        return Ok(());
    }
    Err(Error::input(
        "--strip",
        format!("would be {wide}×{high} pixels, more than {MAX_SIDE}"),
        "choose a smaller --scale",
    ))
}

/// Returns the ground truth for the camera: rays traced through the built-in scene, or the photograph of the test view.
fn original(config: &Config, arguments: &RenderArguments, camera: &Camera) -> Result<Option<Picture>> {
    let background = config.data.background;
    let data: DataConfig = config.section()?;
    if data.format == builtin::FORMAT {
        let DataConfig { builtin_supersampling, builtin_finish, .. } = data;
        let pixels = builtin::render(camera, builtin_supersampling, builtin_finish, &|| ());
        let rgb =
            pixels.into_iter().map(|pixel| composite_pixel(pixel, Alpha::Straight, background)).collect();
        return Ok(Some(Picture { width: camera.intrinsics.width, height: camera.intrinsics.height, rgb }));
    }
    let Some(index) = selection::test_view(arguments) else {
        return Ok(None);
    };
    let set = trimip_data::open_test(&data)?.frames.load(index)?;
    Ok(set.views.first().map(|view| {
        let k = view.camera.intrinsics;
        Picture { width: k.width, height: k.height, rgb: set.composited(0, background) }
    }))
}

impl Picture {
    /// Resamples the picture: each new pixel is the mean over the area that it covers.
    fn averaged(&self, width: u32, height: u32) -> Self {
        let (across, down) = (fractions(self.width, width), fractions(self.height, height));
        let mut rgb = Vec::with_capacity(width as usize * height as usize);
        for rows in &down {
            for columns in &across {
                let mut mean = [0.0_f64; 3];
                for &(y, weight_y) in rows {
                    for &(x, weight_x) in columns {
                        let pixel = self.rgb[y * self.width as usize + x];
                        (0..3).for_each(|c| mean[c] += weight_y * weight_x * f64::from(pixel[c]));
                    }
                }
                rgb.push(mean.map(|value| value as f32));
            }
        }
        Self { width, height, rgb }
    }
}

/// Returns, for each of `to` equal parts of a side of `from` pixels, the indices of the pixels that it covers, and the fraction of each.
fn fractions(from: u32, to: u32) -> Vec<Vec<(usize, f64)>> {
    let size = f64::from(from) / f64::from(to);
    let part = |i: u32| {
        let (start, end) = (f64::from(i) * size, f64::from(i + 1) * size);
        (start as usize..(end.ceil() as usize).min(from as usize))
            .map(|pixel| (pixel, ((pixel as f64 + 1.0).min(end) - (pixel as f64).max(start)) / size))
            .collect()
    };
    (0..to).map(part).collect()
}

/// Returns all pictures in a grid, enlarged without smoothing to the size of the first.
fn sheet(width: u32, height: u32, rows: &[(String, Vec<Picture>)]) -> Result<RgbImage> {
    let side = |size: u32, count: usize| count as u32 * (size + GAP) - GAP;
    let white = image::Rgb([255; 3]);
    let mut sheet = RgbImage::from_pixel(side(width, FACTORS.len()), side(height, rows.len()), white);
    for (row, (_, pictures)) in (0..).zip(rows) {
        for (column, picture) in (0..).zip(pictures) {
            let picture = pictures::rgb_image(picture.width, picture.height, &picture.rgb);
            let large = imageops::resize(&picture, width, height, imageops::FilterType::Nearest);
            sheet.copy_from(&large, column * (width + GAP), row * (height + GAP)).map_err(Error::run)?;
        }
    }
    Ok(sheet)
}

/// Returns lines with the PSNR of every row's pictures relative to those of the last row.
fn table(rows: &[(String, Vec<Picture>)]) -> Vec<String> {
    let Some(((_, originals), models)) = rows.split_last() else {
        return Vec::new();
    };
    let widest = models.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    let heads: String = FACTORS.iter().map(|factor| format!("{:>8}", format!("1/{factor}"))).collect();
    let head = format!("{:widest$}{heads}  PSNR against the original, dB", "");
    let line = |(name, pictures): &(String, Vec<Picture>)| {
        let values: String =
            pictures.iter().zip(originals).map(|(a, b)| format!("{:8.2}", psnr(&a.rgb, &b.rgb))).collect();
        format!("{name:widest$}{values}")
    };
    std::iter::once(head).chain(models.iter().map(line)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: u32, height: u32) -> Picture {
        let rgb = (0..width * height).map(|i| [i as f32, 1.0, -(i as f32)]).collect();
        Picture { width, height, rgb }
    }

    #[test]
    fn an_average_is_that_of_the_area_and_keeps_the_mean() {
        let halved = ramp(4, 2).averaged(2, 1);
        assert_eq!(halved.rgb, [[2.5, 1.0, -2.5], [4.5, 1.0, -4.5]]);
        let mean = |picture: &Picture| {
            picture.rgb.iter().map(|rgb| f64::from(rgb[0])).sum::<f64>() / picture.rgb.len() as f64
        };
        // If the larger size is not a multiple of the smaller one, output pixels share input pixels.
        for (width, height) in [(7, 5), (3, 2), (1, 1), (9, 11)] {
            assert!((mean(&ramp(7, 5).averaged(width, height)) - 17.0).abs() < 1e-5, "{width}×{height}");
        }
    }

    #[test]
    fn a_sheet_shows_every_picture_at_one_size() {
        let row: Vec<Picture> = FACTORS.map(|factor| ramp(16 / factor, 16 / factor)).into();
        let rows = [("a".to_string(), row)];
        let sheet = sheet(16, 16, &rows).unwrap();
        assert_eq!((sheet.width(), sheet.height()), (5 * 16 + 4 * GAP, 16));
        let last = |x: u32, y: u32| *sheet.get_pixel(4 * (16 + GAP) + x, y);
        assert!(last(0, 0) == last(15, 15), "one pixel fills the last picture");
        assert!(
            check_size(800, 800, 3).is_ok()
                && check_size(4000, 10, 2).unwrap_err().kind() == trimip_core::ErrorKind::Input
        );
    }
}
