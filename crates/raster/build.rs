//! Computes a digest of this crate's sources: a serialised model is valid only for the sources that
//! wrote it.

use std::path::Path;
use std::{env, fs, io};

fn main() -> io::Result<()> {
    let sources =
        Path::new(&env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets the variable")).join("src");
    println!("cargo:rerun-if-changed={}", sources.display());
    let mut files: Vec<_> = fs::read_dir(sources)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<Result<_, _>>()?;
    files.sort();
    assert!(files.iter().all(|file| file.is_file()), "the digest would leave out folders of src");
    // FNV-1a suffices, because nobody would gain from a forged collision.
    let mut digest = 0xcbf2_9ce4_8422_2325_u64;
    for file in &files {
        for byte in fs::read(file)? {
            digest = (digest ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
    println!("cargo:rustc-env=RASTER_SOURCES={digest:016x}");
    Ok(())
}
