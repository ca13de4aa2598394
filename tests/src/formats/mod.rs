//! What any bytes get from every reader of files: no panic, no more memory than a stated multiple of their number, and where
//! they are refused an error of one line that begins with the file's name and says what to do. The tests try changes of valid
//! files ([`Format::try_changes`]); the programs in `fuzz/` let libFuzzer choose the bytes ([`Format::check`]).

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

/// A format of files, and what any bytes get from its reader.
pub struct Format {
    /// Its name.
    pub name: &'static str,
    /// Names with one of which every refusal begins.
    files: &'static [&'static str],
    read: Read,
    seeds: Seeds,
    /// The most memory of the reader, bytes, for these bytes.
    limit: Limit,
}

impl Format {
    /// The format of that name.
    ///
    /// # Panics
    /// If there is none.
    pub fn of(name: &str) -> &'static Self {
        FORMATS
            .iter()
            .find(|format| format.name == name)
            .unwrap_or_else(|| panic!("there is no format {name}"))
    }

    /// Valid files.
    pub fn valid(&self) -> Vec<Vec<u8>> {
        (self.seeds)()
    }

    /// The most memory that reading `bytes` takes at a time.
    pub fn memory(&self, bytes: &[u8]) -> usize {
        memory::measured(|| (self.read)(bytes)).1
    }

    /// Reads `bytes`; true if they are a valid file.
    ///
    /// # Panics
    /// If they break a law.
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

    /// An error that a person can act on.
    fn expect_told(&self, error: &Error) {
        let message = &error.message;
        assert_eq!((error.kind, error.exit_code()), (ErrorKind::Input, 2), "{message}");
        assert!(!message.contains('\n'), "{message}");
        assert!(
            self.files.iter().any(|file| message.starts_with(file)),
            "{}: no place: {message}",
            self.name
        );
        assert!(message.contains("; "), "nothing to do: {message}");
    }

    /// Checks `cases` changes of valid files; returns how many of them were valid.
    ///
    /// # Panics
    /// If one breaks a law; its number and its bytes, in a file, are printed.
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

/// Says which case it is that panics.
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
