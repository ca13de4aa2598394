//! Motion blur of films: a frame is the mean of pictures of several cameras, as a film camera sees them while its shutter is open.

use super::cameras::Named;
use super::pictures::{linear, srgb};
use glam::{DMat3, DQuat};
use trimip_core::{Camera, Frame, Pixel};

/// The cameras of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionBlur {
    /// Number of cameras of a frame, at least 1.
    pub cameras: u32,
    /// Time for which the shutter is open, as a fraction of the time between two frames. 0.5 is the usual shutter of 180°.
    pub shutter: f64,
}

impl MotionBlur {
    /// Returns the cameras of frame `index` of a path, evenly spaced in time around the frame. Positions are interpolated between neighbouring
    /// frames linearly, and rotations on the shortest arc; the path goes on beyond its ends. A path of one frame has no motion.
    pub fn of_frame(&self, path: &[Named], index: usize) -> Vec<Camera> {
        let own = path[index].1;
        let at = |time: f64| {
            let beside = if time < 0.0 { index.checked_sub(1) } else { Some(index + 1) };
            let opposite = if time < 0.0 { Some(index + 1) } else { index.checked_sub(1) };
            let camera = |at: Option<usize>| at.and_then(|at| path.get(at)).map(|(_, camera)| camera);
            match (camera(beside), camera(opposite)) {
                (Some(beside), _) => between(&own, beside, time.abs()),
                (None, Some(opposite)) => between(&own, opposite, -time.abs()),
                (None, None) => own,
            }
        };
        let count = f64::from(self.cameras);
        (0..self.cameras).map(|i| at(self.shutter * ((f64::from(i) + 0.5) / count - 0.5))).collect()
    }

    /// Returns all cameras of all frames of a path, with the names of the frames.
    pub fn of_path(&self, path: &[Named]) -> Vec<Named> {
        let frame = |index: usize| self.of_frame(path, index).into_iter().map(move |camera| (index, camera));
        (0..path.len()).flat_map(frame).map(|(index, camera)| (path[index].0.clone(), camera)).collect()
    }
}

/// Returns the camera on the way from `from` (0) to `to` (1).
fn between(from: &Camera, to: &Camera, part: f64) -> Camera {
    let [start, end] = [from, to].map(|camera| DQuat::from_mat3(&camera.rotation));
    // Both signs of a quaternion are one rotation; `slerp` takes the shorter arc between 0 and 1, and goes on beyond them.
    let end = if start.dot(end) < 0.0 { -end } else { end };
    Camera {
        rotation: DMat3::from_quat(start.slerp(end, part)),
        origin: from.origin + part * (to.origin - from.origin),
        ..*from
    }
}

/// Sums of the pixels of pictures of one size.
#[derive(Debug, Default)]
pub struct Mean {
    sums: Vec<[f64; 5]>,
    size: [u32; 2],
    count: u32,
}

impl Mean {
    /// Adds a picture. All pictures have the size of the first.
    pub fn add(&mut self, frame: &Frame) {
        if self.count == 0 {
            (self.sums, self.size) = (vec![[0.0; 5]; frame.pixels.len()], [frame.width, frame.height]);
        }
        self.count += 1;
        for (sums, pixel) in self.sums.iter_mut().zip(&frame.pixels) {
            let [r, g, b] = pixel.rgb.map(linear);
            let parts = [r, g, b, pixel.opacity, pixel.depth];
            sums.iter_mut().zip(parts).for_each(|(sum, part)| *sum += f64::from(part));
        }
    }

    /// Returns the mean picture. Colours are averaged as light (sRGB, IEC 61966-2-1); opacities, and depths weighted by them, as they are.
    pub fn frame(&self) -> Frame {
        let share = f64::from(self.count.max(1)).recip();
        let pixel = |sums: &[f64; 5]| {
            let [r, g, b, opacity, depth] = sums.map(|sum| (sum * share) as f32);
            Pixel { rgb: [r, g, b].map(srgb), opacity, depth }
        };
        let [width, height] = self.size;
        Frame { width, height, pixels: self.sums.iter().map(pixel).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use trimip_core::Intrinsics;

    /// Returns a quarter of a circle around the origin, in steps of 10°.
    fn circle() -> Vec<Named> {
        let camera = |i: u32| {
            let angle = f64::from(10 * i).to_radians();
            let eye = 4.0 * DVec3::new(angle.cos(), angle.sin(), 0.0);
            let k = Intrinsics::from_angle(8, 6, 0.7);
            (format!("{i:04}"), Camera::look_at(k, eye, DVec3::ZERO, DVec3::Z))
        };
        (0..10).map(camera).collect()
    }

    #[test]
    fn the_cameras_of_a_frame_lie_around_it_within_the_time_of_the_shutter() {
        let path = circle();
        let blur = MotionBlur { cameras: 4, shutter: 0.5 };
        // The times are -3/16, -1/16, 1/16 and 3/16 of 10°. At both ends the path goes on.
        for index in [0, 4, 9] {
            let cameras = blur.of_frame(&path, index);
            for (camera, time) in cameras.iter().zip([-3.0, -1.0, 1.0, 3.0]) {
                let angle = (10.0 * (index as f64 + time / 16.0)).to_radians();
                let expected = 4.0 * DVec3::new(angle.cos(), angle.sin(), 0.0);
                // The chord of 10° is at most 4·(1 − cos 5°) = 0.015 from the arc, and its end beyond the path at most twice as far.
                assert!((camera.origin - expected).length() < 0.02, "{} {expected}", camera.origin);
                let looks = -camera.rotation.z_axis;
                assert!((looks + expected / 4.0).length() < 1e-6, "{looks}: rotations follow the arc");
            }
        }
        assert_eq!(blur.of_path(&path).len(), 40);
        assert_eq!(blur.of_path(&path)[39].0, "0009");
        let still = MotionBlur { cameras: 3, shutter: 0.0 }.of_frame(&path, 5);
        assert!(still.iter().all(|camera| (camera.origin - path[5].1.origin).length() < 1e-12));
        assert_eq!(blur.of_frame(&path[..1], 0), [path[0].1; 4], "one frame has no motion");
    }

    #[test]
    fn the_mean_of_pictures_is_that_of_their_light() {
        let frame = |rgb: f32, opacity: f32, depth: f32| Frame {
            width: 1,
            height: 1,
            pixels: vec![Pixel { rgb: [rgb; 3], opacity, depth }],
        };
        let mut mean = Mean::default();
        mean.add(&frame(0.0, 0.0, 0.0));
        mean.add(&frame(1.0, 1.0, 3.0));
        let found = mean.frame();
        // Half of the light of white is 0.735 in sRGB.
        assert!((found.pixels[0].rgb[0] - 0.735_357).abs() < 1e-5, "{found:?}");
        assert_eq!((found.width, found.pixels[0].opacity, found.pixels[0].depth), (1, 0.5, 1.5));
        let mut same = Mean::default();
        (0..5).for_each(|_| same.add(&frame(0.3, 0.25, 2.0)));
        assert!((same.frame().pixels[0].rgb[2] - 0.3).abs() < 1e-6);
    }
}
