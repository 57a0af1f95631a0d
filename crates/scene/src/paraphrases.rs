//! Sentences of LIBERO-Para: the BDDL files of a checkout, verified and copied beside LIBERO's.

use std::fmt::Write;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use benchmark::family::para;
use benchmark::family::protocol::Benchmark;
use sha2::{Digest, Sha256};

use crate::error::SceneError;
use crate::family::{
    MAX_FILE_BYTES, UNPACKED, UNPACKING, read_limited, remove, required_files, write, write_error,
};
use crate::sources::Sources;

const BDDL_FILES: &str = "bddl_files";

/// Verifies a checkout's metadata, too. Returns the folder of the copies.
pub fn copy_paraphrases(checkout: &Path, sources: &Sources) -> Result<PathBuf, SceneError> {
    let refused = |problem: String| SceneError::Checkout { path: checkout.to_owned(), problem };
    let folder = Sources::family(sources.dir(), Benchmark::Para);
    let unpacking = folder.join(UNPACKING);
    let required = required_files(Benchmark::Para);
    let mut files = Vec::new();
    let mut missing = Vec::new();
    let mut digests = String::new();
    let inside = required.iter().map(|path| {
        let inside = format!("{}/{path}", para::PACKAGE);
        (inside, Some(path))
    });
    for (inside, copy) in inside.chain([(para::METADATA.to_owned(), None)]) {
        let file = File::open(checkout.join(&inside));
        match file.and_then(|file| read_limited(file, MAX_FILE_BYTES)) {
            Ok(bytes) => {
                let _ = writeln!(digests, "{}  {inside}", hex::encode(Sha256::digest(&bytes)));
                files.extend(copy.map(|path| (path, bytes)));
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => missing.push(inside),
            Err(error) => return Err(refused(format!("`{inside}` cannot be read: {error}"))),
        }
    }
    if let Some(first) = missing.first() {
        let all = required.len() + 1;
        let count = missing.len();
        return Err(refused(format!("{count} of {all} files are missing, for example `{first}`")));
    }
    let found = hex::encode(Sha256::digest(&digests));
    let expected = para::digest();
    if found != expected {
        return Err(refused(format!(
            "its files have the SHA-256 {found}, and those of the supported version {expected}"
        )));
    }
    remove(&unpacking)?;
    for (path, bytes) in files {
        write(&unpacking.join(path), &bytes)?;
    }
    let target = folder.join(BDDL_FILES);
    remove(&target)?;
    fs::rename(unpacking.join(BDDL_FILES), &target)
        .map_err(|source| write_error(&target, source))?;
    remove(&unpacking)?;
    write(&folder.join(UNPACKED), expected.as_bytes())?;
    Ok(folder)
}
