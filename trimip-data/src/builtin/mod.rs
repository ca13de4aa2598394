//! The built-in scene: ray-traced views of checkers, stripes, thin rods and glossy objects within [-1.2, 1.2]³, z up, on a
//! transparent background. Ray intersections are exact, each pixel has a regular grid of rays, and there are no random numbers.

mod paint;
mod scene;
mod shapes;

pub use scene::{radiance, shapes};
pub use shapes::Shape;

use crate::settings::Finish;
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::TAU;
use trimip_core::{Camera, Intrinsics};

/// Value of `data.format` for the built-in scene.
pub const FORMAT: &str = "builtin";

/// Horizontal field of view of NeRF-synthetic, radians.
pub const CAMERA_ANGLE_X: f64 = 0.691_111_207_008_361_8;
/// Distance of the cameras from the origin, about the same as in NeRF-synthetic.
pub const CAMERA_RADIUS: f64 = 4.03;
/// π·(3 − √5), the golden angle: it spreads any number of points evenly.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

/// Returns a camera at the distance `radius` from the origin that looks at the origin. Seen from there, it is
/// `elevation` above the plane z = 0 and turned by `azimuth` from the x axis towards y (radians). z is up in the image;
/// elevations of ±π/2 and beyond have no upright orientation.
pub fn orbit(intrinsics: Intrinsics, radius: f64, elevation: f64, azimuth: f64) -> Camera {
    let (up, out) = elevation.sin_cos();
    let origin = radius * DVec3::new(out * azimuth.cos(), out * azimuth.sin(), up);
    Camera::look_at(intrinsics, origin, DVec3::ZERO, DVec3::Z)
}

/// Returns `count` cameras, evenly spaced on one turn around the origin from +x towards +y; the first is on the side of
/// +x. `radius` and `elevation` are as in [`orbit`].
pub fn turntable(intrinsics: Intrinsics, radius: f64, elevation: f64, count: usize) -> Vec<Camera> {
    (0..count).map(|i| orbit(intrinsics, radius, elevation, TAU * i as f64 / count as f64)).collect()
}

/// Returns the `count` training cameras: a golden-angle spiral upwards, uniform in area over the upper hemisphere.
pub fn train_cameras(intrinsics: Intrinsics, count: usize) -> Vec<Camera> {
    (0..count)
        .map(|i| {
            let height = 0.02 + 0.95 * (i as f64 + 0.5) / count as f64;
            orbit(intrinsics, CAMERA_RADIUS, height.asin(), GOLDEN_ANGLE * i as f64)
        })
        .collect()
}

/// Returns the `count` test cameras: a ring from +x towards +y, with elevations of 30°, 12°, 30° and 55° in turn.
pub fn test_cameras(intrinsics: Intrinsics, count: usize) -> Vec<Camera> {
    (0..count)
        .map(|i| {
            let degrees: f64 = match i % 4 {
                1 => 12.0,
                3 => 55.0,
                _ => 30.0,
            };
            let azimuth = TAU * (i as f64 + 0.37) / count as f64;
            orbit(intrinsics, CAMERA_RADIUS, degrees.to_radians(), azimuth)
        })
        .collect()
}

/// Renders the scene to straight 8-bit RGBA, row by row. Each pixel has `supersampling`² rays at the centres of a
/// regular grid: its colour is the mean over the rays that hit, its alpha their share; both are rounded. `finish`
/// selects the glossy surfaces. `row` is called after each row, from any thread.
pub fn render(camera: &Camera, supersampling: u32, finish: Finish, row: &(dyn Fn() + Sync)) -> Vec<[u8; 4]> {
    let k = camera.intrinsics;
    let n = supersampling.max(1);
    let mut pixels = vec![[0; 4]; k.width as usize * k.height as usize];
    pixels.par_chunks_mut(k.width.max(1) as usize).enumerate().for_each(|(y, pixels)| {
        for (x, pixel) in pixels.iter_mut().enumerate() {
            *pixel = render_pixel(camera, x as f64, y as f64, n, finish);
        }
        row();
    });
    pixels
}

fn render_pixel(camera: &Camera, x: f64, y: f64, n: u32, finish: Finish) -> [u8; 4] {
    let k = &camera.intrinsics;
    if !k.lens.is_straight() {
        return render_cones(camera, [x, y], n, finish);
    }
    let direction = |x: f64, y: f64| {
        (camera.rotation * DVec3::new((x - k.cx) / k.fx, -(y - k.cy) / k.fy, -1.0)).normalize()
    };
    // Half the pixel's diagonal at unit depth bounds the tangent of the angle between the pixel's rays and its central ray.
    let spread = 0.5 * k.fx.recip().hypot(k.fy.recip());
    let near = scene::near_line(camera.origin, direction(x + 0.5, y + 0.5), spread);
    if near == 0 {
        return [0; 4];
    }
    let (mut color, mut hits) = (DVec3::ZERO, 0_u32);
    let step = f64::from(n).recip();
    for j in 0..n {
        for i in 0..n {
            let ray = direction(x + (f64::from(i) + 0.5) * step, y + (f64::from(j) + 0.5) * step);
            if let Some(hit) = scene::radiance_of(near, camera.origin, ray, finish) {
                color += hit;
                hits += 1;
            }
        }
    }
    mean(color, hits, step)
}

/// Renders a pixel of a camera that is no pinhole, from `n` × `n` rays.
fn render_cones(camera: &Camera, [x, y]: [f64; 2], n: u32, finish: Finish) -> [u8; 4] {
    let (mut color, mut hits) = (DVec3::ZERO, 0_u32);
    let step = f64::from(n).recip();
    for i in 0..n * n {
        let [right, down] = [i % n, i / n].map(|part| (f64::from(part) + 0.5) * step);
        let cone = camera.cone_at::<f64>([x + right, y + down], step);
        let Some(ray) = DVec3::from(cone.direction).try_normalize() else { continue };
        if let Some(hit) = scene::radiance_of(u32::MAX, DVec3::from(cone.origin), ray, finish) {
            color += hit;
            hits += 1;
        }
    }
    mean(color, hits, step)
}

/// Returns the pixel for `hits` rays whose colours add up to `color`; each ray covers `step`² of the pixel.
fn mean(color: DVec3, hits: u32, step: f64) -> [u8; 4] {
    if hits == 0 {
        return [0; 4];
    }
    let byte = |value: f64| (255.0 * value).round() as u8;
    let [r, g, b] = (color / f64::from(hits)).to_array().map(byte);
    [r, g, b, byte(f64::from(hits) * step * step)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn difference(a: &[[u8; 4]], b: &[[u8; 4]]) -> f64 {
        // Compares the images on white, where the colour of a transparent pixel does not matter.
        let white = |p: &[u8; 4]| {
            let a = f64::from(p[3]) / 255.0;
            [0, 1, 2].map(|c| f64::from(p[c]) / 255.0 * a + 1.0 - a)
        };
        let squares = a.iter().zip(b).flat_map(|(a, b)| {
            let (a, b) = (white(a), white(b));
            [0, 1, 2].map(|c| (a[c] - b[c]).powi(2))
        });
        (squares.sum::<f64>() / (3 * a.len()) as f64).sqrt()
    }

    #[test]
    fn more_rays_converge() {
        let camera = orbit(Intrinsics::from_angle(48, 48, CAMERA_ANGLE_X), CAMERA_RADIUS, 0.5, 0.7);
        let truth = render(&camera, 64, Finish::Mixed, &|| ());
        let errors = [1, 2, 4, 8, 16].map(|n| difference(&render(&camera, n, Finish::Mixed, &|| ()), &truth));
        assert!(errors.windows(2).all(|pair| pair[1] < 0.7 * pair[0]), "{errors:?}");
        assert!(errors[3] < 0.01, "{errors:?}");
    }

    #[test]
    fn leaving_out_far_shapes_changes_no_pixel() {
        let camera = orbit(Intrinsics::from_angle(40, 30, CAMERA_ANGLE_X), 2.5, 0.4, 2.0);
        let k = camera.intrinsics;
        let pixels = render(&camera, 1, Finish::Mixed, &|| ());
        for y in 0..k.height {
            for x in 0..k.width {
                let cone = camera.cone::<f64>(x, y);
                let expected = radiance(cone.origin.into(), cone.direction.into());
                let found = pixels[(y * k.width + x) as usize];
                assert_eq!(expected.is_some(), found[3] == 255);
                if let Some(color) = expected {
                    for c in 0..3 {
                        assert!((f64::from(found[c]) - 255.0 * color[c]).abs() < 0.51);
                    }
                }
            }
        }
    }

    #[test]
    fn cameras_see_the_whole_scene_from_above_and_differ() {
        let k = Intrinsics::from_angle(64, 64, CAMERA_ANGLE_X);
        let (train, test) = (train_cameras(k, 48), test_cameras(k, 12));
        for camera in train.iter().chain(&test) {
            assert!((camera.origin.length() - CAMERA_RADIUS).abs() < 1e-12 && camera.origin.z > 0.0);
            let pixels = render(camera, 1, Finish::Mixed, &|| ());
            let border = (0..64).flat_map(|i| [i, 63 * 64 + i, 64 * i, 64 * i + 63]);
            assert!(border.into_iter().all(|i| pixels[i][3] == 0));
            assert!(pixels.iter().filter(|pixel| pixel[3] > 0).count() > 64 * 64 / 8);
        }
        for test in &test {
            let nearest =
                train.iter().map(|train| train.origin.angle_between(test.origin)).fold(PI, f64::min);
            assert!(nearest > 1e-3);
        }
    }

    #[test]
    fn one_turn_of_the_table_is_even() {
        let k = Intrinsics::from_angle(8, 8, 0.7);
        let cameras = turntable(k, 3.0, 0.3, 5);
        let steps: Vec<f64> =
            (0..5).map(|i| cameras[i].origin.distance(cameras[(i + 1) % 5].origin)).collect();
        assert!(steps.iter().all(|step| (step - steps[0]).abs() < 1e-12));
    }
}
