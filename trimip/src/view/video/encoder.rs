//! The interface of the encoders of films.

use image::RgbaImage;

/// A film that is being encoded. Pictures arrive in order and have equal sizes.
pub trait Encoder {
    /// Appends a picture.
    fn add(&mut self, picture: RgbaImage) -> Result<(), String>;

    /// Ends the film and writes what is left of it.
    fn end(self: Box<Self>) -> Result<(), String>;
}

/// Returns the time from the start of the film to a picture, in units of `unit` seconds, rounded. Rounding the times, not the
/// durations, keeps the length of the film.
pub fn time_of(picture: usize, rate: f64, unit: f64) -> u64 {
    (picture as f64 / rate / unit).round() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounded_times_keep_the_length() {
        // 30 pictures a second are 3.33 hundredths of a second each.
        let durations: Vec<u64> =
            (0..30).map(|i| time_of(i + 1, 30.0, 0.01) - time_of(i, 30.0, 0.01)).collect();
        assert!(durations.iter().all(|duration| [3, 4].contains(duration)));
        assert_eq!(durations.iter().sum::<u64>(), 100);
    }
}
