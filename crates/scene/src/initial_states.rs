//! Released initial states: `.pruned_init` files.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::error::SceneError;
use crate::pickle::read_matrix;

/// The initial states of a task; each is the simulator's state vector: time
/// (s), qpos, qvel.
#[derive(Debug, Clone)]
pub struct InitialStates {
    path: PathBuf,
    width: usize,
    values: Vec<f64>,
}

/// Larger than any released file by far; bounds what is read into memory.
const MAX_FILE_BYTES: u64 = 64 << 20;

impl InitialStates {
    /// Reads a `.pruned_init` file: a zip with `archive/data.pkl`.
    pub fn read(path: &Path) -> Result<Self, SceneError> {
        const WHAT: &str = "initial states";
        let malformed = |problem: String| SceneError::Malformed {
            what: WHAT.to_owned(),
            path: path.to_owned(),
            problem,
        };
        let file = File::open(path).map_err(|source| SceneError::Read {
            what: WHAT.to_owned(),
            path: path.to_owned(),
            remedy: "run `cargo xtask setup`, or give the file's right name".to_owned(),
            source,
        })?;
        let mut archive =
            zip::ZipArchive::new(file).map_err(|error| malformed(format!("no zip: {error}")))?;
        let name = archive
            .file_names()
            .filter_map(|name| name.ok().map(|name| name.into_owned()))
            .find(|name| name.ends_with("/data.pkl"))
            .ok_or_else(|| malformed("no `data.pkl` in the zip".to_owned()))?;
        let member = archive
            .by_name(&name)
            .map_err(|error| malformed(error.to_string()))?;
        let mut bytes = Vec::new();
        member
            .take(MAX_FILE_BYTES)
            .read_to_end(&mut bytes)
            .map_err(|error| malformed(error.to_string()))?;
        let matrix = read_matrix(&bytes).map_err(malformed)?;
        if matrix.rows == 0 || matrix.columns == 0 {
            return Err(malformed("it holds no state".to_owned()));
        }
        if let Some(index) = matrix.values.iter().position(|value| !value.is_finite()) {
            let row = index / matrix.columns;
            return Err(malformed(format!(
                "state {row} holds a number that is not finite"
            )));
        }
        Ok(Self {
            path: path.to_owned(),
            width: matrix.columns,
            values: matrix.values,
        })
    }

    /// How many there are.
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
