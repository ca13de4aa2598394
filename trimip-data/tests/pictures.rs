//! Tests of photographs in WebP, TIFF and BMP: they have the same pixels as in PNG, are found by their names, and are
//! refused if they are broken.

use crate::common::{assert_same, frame, save_image, settings, write};
use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, Rgb, Rgba};
use serde_json::{Value, json};
use std::{fs, io::Cursor, path::Path};
use trimip_data::{Scene, in_memory::photograph, open};

/// The formats other than PNG and JPEG, with the endings of their files.
const FORMATS: [(ImageFormat, &[&str]); 3] = [
    (ImageFormat::WebP, &["webp", "WEBP"]),
    (ImageFormat::Tiff, &["tif", "tiff", "TIF"]),
    (ImageFormat::Bmp, &["bmp"]),
];

fn bytes(image: impl Into<DynamicImage>, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image.into().write_to(&mut bytes, format).unwrap();
    bytes.into_inner()
}

/// Returns the pixels of a file.
fn pixels(bytes: &[u8]) -> Vec<u8> {
    photograph("a file", bytes).unwrap().2
}

#[test]
fn every_format_has_the_pixels_that_were_written() {
    let grey = ImageBuffer::from_fn(5, 4, |x, y| Luma([(x * 40 + y) as u8]));
    let color = ImageBuffer::from_fn(5, 4, |x, y| Rgb([(x * 40 + y) as u8, (y * 50) as u8, 7]));
    let soft =
        ImageBuffer::from_fn(5, 4, |x, y| Rgba([(x * 40 + y) as u8, (y * 50) as u8, 7, (x * y) as u8]));
    for (format, _) in FORMATS {
        for image in [DynamicImage::from(grey.clone()), color.clone().into(), soft.clone().into()] {
            assert_eq!(pixels(&bytes(image.clone(), format)), image.into_rgba8().into_raw(), "{format:?}");
        }
    }
}

#[test]
fn sixteen_bits_of_tiff_are_rounded_to_the_nearest_eight() {
    let nearest = |value: u16| (f64::from(value) / 257.0).round() as u8;
    let grey = ImageBuffer::from_fn(256, 256, |x, y| Luma([(y * 256 + x) as u16]));
    for (value, pixel) in (0..=u16::MAX).zip(pixels(&bytes(grey, ImageFormat::Tiff)).chunks_exact(4)) {
        let own = nearest(value);
        assert_eq!(pixel, [own, own, own, 255]);
    }
    let color = ImageBuffer::from_pixel(3, 2, Rgb([900_u16, 30_000, 65_000]));
    let soft = ImageBuffer::from_pixel(3, 2, Rgba([900_u16, 30_000, 65_000, 12_345]));
    let [r, g, b, a] = [900, 30_000, 65_000, 12_345].map(nearest);
    assert_eq!(pixels(&bytes(color, ImageFormat::Tiff)), [r, g, b, 255].repeat(6));
    assert_eq!(pixels(&bytes(soft, ImageFormat::Tiff)), [r, g, b, a].repeat(6));
}

/// Decodes hexadecimal digits to bytes.
fn hexadecimal(digits: &str) -> Vec<u8> {
    let digit = |byte: u8| char::from(byte).to_digit(16).unwrap() as u8;
    digits.as_bytes().chunks_exact(2).map(|pair| 16 * digit(pair[0]) + digit(pair[1])).collect()
}

/// Checks images of 16 × 12 pixels of (200, 60, 20) that libwebp compressed with loss, opaque and with alpha 128.
#[test]
fn webp_with_loss_is_read() {
    for (digits, alpha) in [(OPAQUE, 255), (SOFT, 128)] {
        let (width, height, pixels) = photograph("a file", &hexadecimal(digits)).unwrap();
        assert_eq!((width, height), (16, 12));
        for pixel in pixels.chunks_exact(4) {
            assert!(pixel.iter().zip([200, 60, 20, alpha]).all(|(a, b)| a.abs_diff(b) <= 4), "{pixel:?}");
            assert_eq!(pixel[3], alpha);
        }
    }
}

const OPAQUE: &str = "5249464640000000574542505650382034000000d001009d012a10000c0000c01225a00274ba01f80003b000fef36997\
    feef37ee7cfdcf9ff17bffeb60feb60feb60ffeb40000000";
const SOFT: &str = "524946466000000057454250565038580a000000100000000f00000b0000414c50480500000001286044040056503820\
    34000000d001009d012a10000c0000c01225a00274ba01f80003b000fef36997feef37ee7cfdcf9ff17bffeb60feb60f\
    eb60ffeb40000000";

/// Opens a scene of ten frames whose entries have the ending `named`, and whose photographs have the ending `stored`.
fn scene(root: &Path, named: &str, stored: &str) -> Result<Scene, String> {
    (0..10).for_each(|i| save_image(&root.join(format!("images/{i}{stored}")), 16, 12));
    let frames: Vec<Value> = (0..10).map(|i| frame(&format!("images/{i}{named}"))).collect();
    write(&root.join("transforms.json"), &json!({ "camera_angle_x": 0.7, "frames": frames }));
    open(&settings(root, 2)).map_err(|error| error.message())
}

#[test]
fn photographs_are_found_by_stem_and_ending_and_reduced_as_others() {
    let folder = tempfile::tempdir().unwrap();
    let usual = scene(folder.path(), ".png", ".png").unwrap();
    for ending in FORMATS.iter().flat_map(|(_, endings)| *endings) {
        for named in [format!(".{ending}"), String::new(), ".png".into(), ".jpg".into()] {
            let folder = tempfile::tempdir().unwrap();
            let found = scene(folder.path(), &named, &format!(".{ending}")).unwrap();
            assert_same(&found.train, &usual.train);
            let elsewhere = found.warnings.iter().any(|warning| warning.contains("not where"));
            let as_named =
                named == format!(".{ending}") || named.is_empty() && ending.to_lowercase() == **ending;
            assert_eq!(elsewhere, !as_named, "{named} {ending}: {:?}", found.warnings);
        }
    }
}

#[test]
fn broken_photographs_are_named() {
    for (format, endings) in FORMATS {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let named = format!(".{}", endings[0]);
        scene(root, &named, &named).unwrap();
        let path = root.join(format!("images/3{named}"));
        let whole = fs::read(&path).unwrap();
        for length in [0, 3, 11, 30, whole.len() / 2, whole.len() - 40] {
            fs::write(&path, &whole[..length]).unwrap();
            let error = open(&settings(root, 1)).unwrap_err();
            let place = format!("frame 3 (images/3{named}): image ");
            assert!(
                error.kind() == trimip_core::ErrorKind::Input && error.message().contains(&place),
                "{format:?} {length}: {error}"
            );
            assert!(error.message().contains("cannot be decoded"), "{format:?} {length}: {error}");
        }
    }
}

/// Checks that a file that states more than it holds is refused before memory is allocated.
#[test]
fn webp_files_hold_the_parts_that_they_state() {
    let whole = hexadecimal(SOFT);
    let put = |at: usize, with: &[u8]| {
        let mut bytes = whole.clone();
        bytes[at..at + with.len()].copy_from_slice(with);
        photograph("a file", &bytes).unwrap_err().message()
    };
    // The widths of the file and of the picture, and the lengths of the last chunk and of its first partition.
    let picture = whole.windows(4).position(|name| name == b"VP8 ").unwrap();
    assert!(put(24, &[255, 63, 0]).contains("a picture has another size than the file states"));
    assert!(put(picture + 14, &[255, 63]).contains("a picture has another size than the file states"));
    assert!(put(picture + 4, &[0, 0, 0, 16]).contains("a part ends beyond the file"));
    assert!(put(picture + 8, &[0xf0, 0xff, 0xff]).contains("a part ends beyond the file"));
}

/// Checks nested pictures of an animation, as deep as the file is long: they take no more stack than one picture.
#[test]
fn webp_pictures_hold_no_others() {
    let depth = 200_000_u32;
    let mut bytes = b"RIFF\0\0\0\0WEBP".to_vec();
    for level in (0..depth).rev() {
        bytes.extend(b"ANMF");
        bytes.extend((16 + 24 * level).to_le_bytes());
        bytes.extend([0; 16]);
    }
    let message = photograph("a file", &bytes).unwrap_err().message();
    assert!(message.contains("a picture of the animation contains another"), "{message}");
}

/// Checks this for TIFF as for WebP, with both byte orders and both sizes of entries.
#[test]
fn tiff_files_hold_the_values_that_they_state() {
    let color = ImageBuffer::from_fn(19, 11, |x, y| Rgb([x as u8, y as u8, 9]));
    let whole = bytes(color, ImageFormat::Tiff);
    let place = |at: usize| u32::from_le_bytes(whole[at..at + 4].try_into().unwrap()) as usize;
    let directory = place(4);
    let entries = usize::from(u16::from_le_bytes(whole[directory..directory + 2].try_into().unwrap()));
    for entry in (0..entries).map(|index| directory + 2 + 12 * index) {
        let mut broken = whole.clone();
        broken[entry + 4..entry + 8].copy_from_slice(&0x1000_0000_u32.to_le_bytes());
        let message = photograph("a file", &broken).unwrap_err().message();
        assert!(message.contains("the values of an entry end beyond the file"), "{message}");
    }
    // A directory with an entry of 2^28 floats.
    let big = [
        &b"MM\0\x2b\0\x08\0\0\0\0\0\0\0\0\0\x10\0\0\0\0\0\0\0\x01\x01\0\0\x0b\0\0\0\0\x10\0\0\0"[..],
        &[0; 8],
    ]
    .concat();
    let small = [&b"MM\0\x2a\0\0\0\x08\0\x01\x01\0\0\x0b\x10\0\0\0\0\0\0\0\0\0"[..], &[0; 8]].concat();
    for file in [big, small] {
        let message = photograph("a file", &file).unwrap_err().message();
        assert!(message.contains("the values of an entry end beyond the file"), "{message}");
    }
}

/// Checks that no pixels are made up, wherever a file ends.
#[test]
fn truncated_files_are_errors_wherever_pixels_are_missing() {
    let image = ImageBuffer::from_fn(33, 17, |x, y| Rgb([(x * 7) as u8, (y * 13) as u8, (x * y) as u8]));
    for (format, _) in FORMATS {
        let whole = bytes(image.clone(), format);
        let expected = pixels(&whole);
        for length in 0..whole.len() {
            if let Ok((_, _, found)) = photograph("a file", &whole[..length]) {
                assert!(found == expected, "{format:?} of {length} bytes of {}", whole.len());
            }
        }
    }
}

#[test]
fn what_is_not_read_has_a_next_command() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scene(root, ".tif", ".tif").unwrap();
    let refused = || open(&settings(root, 1)).unwrap_err().message();
    let path = root.join("images/3.tif");
    let float = ImageBuffer::from_pixel(16, 12, Rgb([0.25_f32, 0.5, 4.0]));
    fs::write(&path, bytes(float, ImageFormat::Tiff)).unwrap();
    assert!(
        refused().contains("images/3.tif has pixels of floating-point numbers; convert it"),
        "{}",
        refused()
    );
    // The first picture of a raw file is a small copy.
    let small = bytes(ImageBuffer::from_pixel(4, 3, Rgb([9_u8, 9, 9])), ImageFormat::Tiff);
    for raw in ["DNG", "nef"] {
        let named = format!("images/3.{raw}");
        fs::write(root.join(&named), &small).unwrap();
        let frames: Vec<Value> = ["images/1.tif", &named].map(frame).into();
        write(&root.join("transforms.json"), &json!({ "camera_angle_x": 0.7, "frames": frames }));
        let message = refused();
        assert!(
            message.contains("is a camera's raw image") && message.contains("darktable-cli"),
            "{message}"
        );
    }
    for (name, head, format) in [
        ("a.heic", &b"\0\0\0\x18ftypheic\0\0\0\0"[..], "heif-convert"),
        ("a.avif", b"\0\0\0\x18ftypavif\0\0\0\0", "ffmpeg"),
        ("a.jxl", b"\xff\x0a\0\0\0\0\0\0", "djxl"),
    ] {
        fs::write(root.join(name), head).unwrap();
        let frames: Vec<Value> = ["images/1.tif", name].map(frame).into();
        write(&root.join("transforms.json"), &json!({ "camera_angle_x": 0.7, "frames": frames }));
        assert!(refused().contains(format), "{}", refused());
    }
}
