//! Writes the valid files with which the tests begin to `corpus/FORMAT/`, where cargo-fuzz looks for them.

use std::{fs, path::Path};

fn main() -> std::io::Result<()> {
    for format in &trimip_tests::formats::FORMATS {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(format.name);
        fs::create_dir_all(&folder)?;
        for (index, bytes) in format.valid().iter().enumerate() {
            fs::write(folder.join(format!("valid-{index}")), bytes)?;
        }
    }
    Ok(())
}
