//! Parses progress counts from the output of COLMAP, of all versions: `Processed file [3/50]`, `Matching block [1/2, 2/2]`, `Registering
//! image #7 (5)`, `Registering image #7 (num_reg_frames=5)`.

/// Reads the progress of a program from its output lines.
pub struct Counter {
    what: What,
    /// Number of pictures.
    all: u64,
    /// Largest count so far. It is kept because the count restarts at 2 when the mapper begins another model.
    most: u64,
    found_nothing: bool,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum What {
    Features,
    Matches,
    Model,
}

/// Messages of a mapper that found no model.
const NOTHING: [&str; 3] =
    ["failed to create sparse model", "Failed to create any sparse model", "No images with matches found"];

impl Counter {
    /// Creates a counter of the files whose features have been found.
    pub fn features(all: u64) -> Self {
        Self { what: What::Features, all, most: 0, found_nothing: false }
    }

    /// Creates a counter of the pictures or blocks that have been compared.
    pub fn matches() -> Self {
        Self { what: What::Matches, all: 0, most: 0, found_nothing: false }
    }

    /// Creates a counter of the cameras that have been placed.
    pub fn model(all: u64) -> Self {
        Self { what: What::Model, all, most: 0, found_nothing: false }
    }

    /// Returns the number of items done and their total, if a line states them.
    pub fn count(&mut self, line: &str) -> Option<(u64, u64)> {
        let lower = line.to_lowercase();
        self.found_nothing |= NOTHING.iter().any(|sign| lower.contains(&sign.to_lowercase()));
        match self.what {
            What::Features => {
                in_brackets(line.split_once("Processed file")?.1).map(|(done, _)| (done, self.all))
            }
            What::Matches => {
                let rest =
                    ["Matching", "Processing", "Indexing"].iter().find_map(|word| line.split_once(word))?.1;
                in_brackets(rest)
            }
            What::Model => {
                let rest = line.split_once("Registering image #")?.1;
                let counted = rest.split_once('(')?.1;
                let digits: String = counted
                    .chars()
                    .skip_while(|c| !c.is_ascii_digit())
                    .take_while(char::is_ascii_digit)
                    .collect();
                self.most = self.most.max(digits.parse().ok()?);
                Some((self.most.min(self.all), self.all))
            }
        }
    }

    /// Returns true if the mapper has reported that it found no model.
    pub fn found_nothing(&self) -> bool {
        self.found_nothing
    }
}

/// Returns the numbers of `[3/50]`, or the combined numbers of `[1/2, 2/2]`.
fn in_brackets(text: &str) -> Option<(u64, u64)> {
    let inner = text.split_once('[')?.1.split_once(']')?.0;
    let pair = |part: &str| {
        let (done, all) = part.trim().split_once('/')?;
        Some((done.parse::<u64>().ok()?, all.parse::<u64>().ok()?))
    };
    match inner.split_once(',') {
        None => pair(inner),
        Some((rows, columns)) => {
            let ((row, rows), (column, columns)) = (pair(rows)?, pair(columns)?);
            Some((row.saturating_sub(1) * columns + column, rows * columns))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_all_versions_are_counted() {
        let mut features = Counter::features(50);
        assert_eq!(features.count("Processed file [3/50]"), Some((3, 50)));
        assert_eq!(
            features.count("I20250101 10:00:00.1 12 feature_extraction.cc:258] Processed file [50/50]"),
            Some((50, 50))
        );
        assert_eq!(features.count("  Name:            0003.jpg"), None);
        let mut matches = Counter::matches();
        assert_eq!(matches.count("Matching block [2/3, 1/3] in 1.2s"), Some((4, 9)));
        assert_eq!(matches.count("I2025 pairing.cc:10] Matching image [7/50]"), Some((7, 50)));
        assert_eq!(matches.count("Processing image [7/50]"), Some((7, 50)));
        assert_eq!(matches.count("Elapsed time: 0.5 [minutes]"), None);
        let mut model = Counter::model(50);
        assert_eq!(model.count("Registering image #31 (12)"), Some((12, 50)));
        assert_eq!(
            model.count("incremental_pipeline.cc:3] Registering image #7 (num_reg_frames=15)"),
            Some((15, 50))
        );
        assert_eq!(model.count("Registering image #3 (3)"), Some((15, 50)), "another model");
        assert!(!model.found_nothing());
        assert_eq!(model.count("ERROR: failed to create sparse model"), None);
        assert!(model.found_nothing());
    }
}
