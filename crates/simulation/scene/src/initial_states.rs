//! Released initial states: `.pruned_init` files.

use std::fs::File;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::error::SceneError;
use crate::pickle::{Matrix, read_matrix};

/// The initial states of a task; each is the simulator's state vector: time
/// (s), qpos, qvel.
#[derive(Debug, Clone)]
pub struct InitialStates {
    path: PathBuf,
    width: usize,
    values: Vec<f64>,
}

/// Name of these files in messages.
const WHAT: &str = "initial states";
/// Larger than any released file by far; bounds what is read into memory.
const MAX_FILE_BYTES: u64 = 64 << 20;

impl InitialStates {
    /// Reads a `.pruned_init` file: a zip with `archive/data.pkl`.
    pub fn read(path: &Path) -> Result<Self, SceneError> {
        let file = File::open(path).map_err(|source| SceneError::Read {
            what: WHAT.to_owned(),
            path: path.to_owned(),
            remedy: "run `cargo xtask setup`, or give the file's right name".to_owned(),
            source,
        })?;
        Self::from_reader(file, path)
    }

    /// Reads the contents of a `.pruned_init` file; messages call it `path`.
    pub fn from_reader(reader: impl Read + Seek, path: &Path) -> Result<Self, SceneError> {
        let matrix = read_archive(reader).map_err(|problem| SceneError::Malformed {
            what: WHAT.to_owned(),
            path: path.to_owned(),
            problem,
        })?;
        Ok(Self {
            path: path.to_owned(),
            width: matrix.columns,
            values: matrix.values,
        })
    }

    /// Number of states.
    pub fn count(&self) -> usize {
        self.values.len() / self.width
    }

    /// Numbers in each: 1 + nq + nv.
    pub fn width(&self) -> usize {
        self.width
    }

    /// The file they came from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// One of them.
    pub fn get(&self, id: usize) -> Option<&[f64]> {
        let start = id.checked_mul(self.width)?;
        self.values.get(start..start.checked_add(self.width)?)
    }

    /// SHA-256 of one of them, hex, over its little-endian bytes.
    pub fn digest(&self, id: usize) -> Option<String> {
        let mut hash = Sha256::new();
        for value in self.get(id)? {
            hash.update(value.to_le_bytes());
        }
        Some(crate::pack::hex(&hash.finalize()))
    }
}

/// The states in a zip, one a row: at least one, all of them finite numbers.
fn read_archive(reader: impl Read + Seek) -> Result<Matrix, String> {
    let mut archive = zip::ZipArchive::new(reader).map_err(|error| format!("no zip: {error}"))?;
    let name = archive
        .file_names()
        .filter_map(|name| name.ok().map(|name| name.into_owned()))
        .find(|name| name.ends_with("/data.pkl"))
        .ok_or("no `data.pkl` in the zip")?;
    let member = archive.by_name(&name).map_err(|error| error.to_string())?;
    let mut bytes = Vec::new();
    member
        .take(MAX_FILE_BYTES)
        .read_to_end(&mut bytes)
        .map_err(|error| error.to_string())?;
    let matrix = read_matrix(&bytes)?;
    if matrix.rows == 0 || matrix.columns == 0 {
        return Err("it holds no state".to_owned());
    }
    if let Some(index) = matrix.values.iter().position(|value| !value.is_finite()) {
        let row = index / matrix.columns;
        return Err(format!("state {row} holds a number that is not finite"));
    }
    Ok(matrix)
}
