//! Writes valid files of every format to `fuzz/corpus`, the initial corpus of libFuzzer.
//!
//!     cargo run -p trimip-tests --example corpus

use std::{fs, io};
use trimip_tests::{binary::root, formats::FORMATS};

fn main() -> io::Result<()> {
    for format in FORMATS.iter() {
        let folder = root().join("fuzz/corpus").join(format.name);
        fs::create_dir_all(&folder)?;
        for (index, bytes) in format.valid().iter().enumerate() {
            fs::write(folder.join(format!("valid-{index}")), bytes)?;
        }
    }
    Ok(())
}
