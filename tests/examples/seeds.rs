//! Writes the inputs that the fuzz targets begin with: `seeds CORPUS_FOLDER`.

#![forbid(unsafe_code)]

use std::io;
use std::path::Path;

fn main() -> io::Result<()> {
    let Some(corpus) = std::env::args_os().nth(1) else {
        eprintln!("failed to write seeds: name the folder of the corpora, as fuzz/seed.sh does");
        std::process::exit(2);
    };
    for target in tests::untrusted_input::TARGETS {
        let folder = Path::new(&corpus).join(target.name);
        std::fs::create_dir_all(&folder)?;
        for (number, seed) in (target.seeds)().into_iter().enumerate() {
            std::fs::write(folder.join(format!("seed-{number}")), seed)?;
        }
    }
    Ok(())
}
