//! Checks that every file reader must pass for arbitrary bytes: it does not panic, and it needs no more memory than a stated
//! multiple of the file's size. The error of a refused file has one line that begins with the file's name and says what to do.
//! The tests change valid files at random ([`Format::try_changes`]); the programs in `fuzz/` let libFuzzer choose the bytes
//! ([`Format::check`]).

pub mod memory;
mod mutate;
mod readers;
mod seeds;

pub use readers::FORMATS;
pub use seeds::{Sparse, sparse};

use mutate::{Random, changed};
use trimip_core::{Error, ErrorKind, Result};

type Read = Box<dyn Fn(&[u8]) -> Result<()> + Send + Sync>;
type Seeds = Box<dyn Fn() -> Vec<Vec<u8>> + Send + Sync>;
type Limit = Box<dyn Fn(&[u8]) -> usize + Send + Sync>;

/// A file format, with its reader and the reader's limits.
pub struct Format {
    /// Name of the format.
    pub name: &'static str,
    /// Names of the format's files; the error of a refused file begins with one of them.
    files: &'static [&'static str],
    read: Read,
    seeds: Seeds,
    /// Returns the memory limit of the reader for the given bytes, in bytes.
    limit: Limit,
}

impl Format {
    /// Returns the format called `name`.
    ///
    /// # Panics
    /// If no format has that name.
    pub fn of(name: &str) -> &'static Self {
        FORMATS
            .iter()
            .find(|format| format.name == name)
            .unwrap_or_else(|| panic!("there is no format {name}"))
    }

    /// Returns valid files of the format.
    pub fn valid(&self) -> Vec<Vec<u8>> {
        (self.seeds)()
    }

    /// Returns the peak memory of reading `bytes`, in bytes.
    pub fn memory(&self, bytes: &[u8]) -> usize {
        memory::measured(|| (self.read)(bytes)).1
    }

    /// Reads `bytes`; returns true if they are a valid file.
    ///
    /// # Panics
    /// If a check fails.
    pub fn check(&self, bytes: &[u8]) -> bool {
        let (result, most) = memory::measured(|| (self.read)(bytes));
        let limit = (self.limit)(bytes);
        assert!(
            most <= limit,
            "{}: {most} bytes of memory for a file of {}, at most {limit}",
            self.name,
            bytes.len()
        );
        match result {
            Ok(()) => true,
            Err(error) => {
                self.expect_told(&error);
                false
            }
        }
    }

    /// Asserts that an error has one line, which begins with the file's name and contains an action.
    fn expect_told(&self, error: &Error) {
        let message = &error.message();
        assert_eq!(error.kind(), ErrorKind::Input, "{message}");
        assert!(!message.contains('\n'), "{message}");
        assert!(
            self.files.iter().any(|file| message.starts_with(file)),
            "{}: no place: {message}",
            self.name
        );
        assert!(message.contains("; "), "nothing to do: {message}");
    }

    /// Checks `cases` random changes of valid files; returns how many changed files are still valid.
    ///
    /// # Panics
    /// If a check fails. The number of the change, and the path of a file with the changed bytes, are printed.
    pub fn try_changes(&self, seed: u64, cases: u64) -> u64 {
        let seeds = self.valid();
        for (index, bytes) in seeds.iter().enumerate() {
            let read = (self.read)(bytes);
            assert!(read.is_ok(), "{}: file {index} is valid before it is changed: {read:?}", self.name);
            self.check(bytes);
        }
        let mut valid = 0;
        for case in 0..cases {
            let mut random = Random(Random(seed ^ case).next());
            let (one, other) = (random.below(seeds.len()), random.below(seeds.len()));
            let bytes = changed(&seeds[one], &seeds[other], &mut random);
            let report = CaseReport { format: self.name, case, bytes: &bytes };
            valid += u64::from(self.check(&bytes));
            drop(report);
        }
        valid
    }
}

/// Prints the number of a change, and the path of a file with its bytes, if the check of that change panics.
struct CaseReport<'a> {
    format: &'a str,
    case: u64,
    bytes: &'a [u8],
}

impl Drop for CaseReport<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let path = std::env::temp_dir().join(format!("trimip-{}-{}", self.format, self.case));
            let written = std::fs::write(&path, self.bytes).is_ok();
            println!("{}: case {}, bytes in {} ({written})", self.format, self.case, path.display());
        }
    }
}
