//! Released initial states: `.pruned_init` files, and `.npz` files with an array `states`.

use std::fs::File;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::error::SceneError;
use crate::family::read_limited;
use crate::pickle::{Matrix, read_matrix};
use crate::sources::REMEDY;

/// Initial states of a task. Each is a state vector of the simulator: time (s), qpos, qvel.
#[derive(Debug, Clone)]
pub struct InitialStates {
    path: PathBuf,
    width: usize,
    values: Vec<f64>,
}

const WHAT: &str = "initial states";
const NPZ_MEMBER: &str = "states.npy";
const SAVE: &str = "save states with `torch.save(numpy.array(states, dtype=\"float64\"), file)`";
/// Limit on the size of a file; released files are far smaller.
const MAX_FILE_BYTES: u64 = 64 << 20;

impl InitialStates {
    /// Reads a `.pruned_init` file (a zip with `archive/data.pkl`) or an `.npz` file.
    pub fn read(path: &Path) -> Result<Self, SceneError> {
        let file = File::open(path).map_err(|source| SceneError::Read {
            what: WHAT.to_owned(),
            path: path.to_owned(),
            remedy: format!("correct the file's name, or {REMEDY}"),
            source,
        })?;
        Self::from_reader(file, path)
    }

    /// Parses the contents of a `.pruned_init` or `.npz` file; errors name `path`.
    pub fn from_reader(reader: impl Read + Seek, path: &Path) -> Result<Self, SceneError> {
        let matrix = read_archive(reader).map_err(|problem| SceneError::Malformed {
            what: WHAT.to_owned(),
            path: path.to_owned(),
            problem,
        })?;
        Ok(Self { path: path.to_owned(), width: matrix.columns, values: matrix.values })
    }

    pub fn count(&self) -> usize {
        self.values.len() / self.width
    }

    /// Returns the length of a state: 1 + nq + nv.
    pub fn width(&self) -> usize {
        self.width
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn get(&self, id: usize) -> Option<&[f64]> {
        let start = id.checked_mul(self.width)?;
        self.values.get(start..start.checked_add(self.width)?)
    }

    /// Returns the SHA-256 of a state's little-endian bytes, hex.
    pub fn digest(&self, id: usize) -> Option<String> {
        let mut hash = Sha256::new();
        for value in self.get(id)? {
            hash.update(value.to_le_bytes());
        }
        Some(hex::encode(hash.finalize()))
    }
}

/// Reads the states in a zip, one per row. Refuses an empty matrix and values that are not finite.
fn read_archive(mut reader: impl Read + Seek) -> Result<Matrix, String> {
    let mut start = [0; 64];
    let length = reader.read(&mut start).map_err(|error| error.to_string())?;
    if let Some(other) = other_file(&start[..length]) {
        return Err(other.to_owned());
    }
    let mut archive =
        zip::ZipArchive::new(reader).map_err(|error| format!("not a zip archive: {error}"))?;
    let name = archive
        .file_names()
        .filter_map(|name| name.ok().map(|name| name.into_owned()))
        .find(|name| name.ends_with("/data.pkl") || name == NPZ_MEMBER)
        .ok_or("neither `data.pkl` nor `states.npy` is in the zip")?;
    let mut room = MAX_FILE_BYTES;
    let mut read = |name: &str| {
        let member = archive.by_name(name).map_err(|error| format!("`{name}`: {error}"))?;
        let bytes = read_limited(member, room).map_err(|error| format!("`{name}`: {error}"))?;
        room -= bytes.len() as u64;
        Ok(bytes)
    };
    let bytes = read(&name)?;
    let matrix = match name.strip_suffix("data.pkl") {
        None => read_npy(&bytes)?,
        Some(root) => read_matrix(&bytes, &mut |key| read(&format!("{root}data/{key}")))
            .map_err(|problem| format!("{problem}; {SAVE}"))?,
    };
    if matrix.rows == 0 || matrix.columns == 0 {
        return Err("the file holds no numbers".to_owned());
    }
    if let Some(index) = matrix.values.iter().position(|value| !value.is_finite()) {
        let row = index / matrix.columns;
        return Err(format!("state {row} holds a number that is not finite"));
    }
    Ok(matrix)
}

fn other_file(start: &[u8]) -> Option<&'static str> {
    match start.trim_ascii_start() {
        [] => Some("the file is empty; fetch or save it again"),
        [b'<', ..] => Some("it is a web page; download the file that the page shows"),
        start if start.starts_with(b"version https://git-lfs") => {
            Some("it is a pointer of Git LFS; fetch the file with `git lfs pull`")
        }
        _ => None,
    }
}

/// Parses NumPy's format 1.0: a row-major matrix of little-endian doubles.
fn read_npy(bytes: &[u8]) -> Result<Matrix, String> {
    let malformed = || "`states.npy` is not a row-major matrix of little-endian doubles".to_owned();
    let rest = bytes.strip_prefix(b"\x93NUMPY\x01\x00").ok_or_else(malformed)?;
    let (length, rest) = rest.split_first_chunk::<2>().ok_or_else(malformed)?;
    let length = usize::from(u16::from_le_bytes(*length));
    let (header, data) = rest.split_at_checked(length).ok_or_else(malformed)?;
    let header = std::str::from_utf8(header).map_err(|_| malformed())?;
    let header: String = header.split_whitespace().collect();
    let shape = header
        .strip_prefix("{'descr':'<f8','fortran_order':False,'shape':(")
        .and_then(|rest| rest.strip_suffix("),}"))
        .ok_or_else(malformed)?;
    let (rows, columns) = shape.split_once(',').ok_or_else(malformed)?;
    let number = |text: &str| text.parse::<usize>().map_err(|_| malformed());
    let (rows, columns) = (number(rows)?, number(columns)?);
    let (chunks, rest) = data.as_chunks::<8>();
    if !rest.is_empty() || rows.checked_mul(columns) != Some(chunks.len()) {
        return Err("the size of `states.npy` does not match its shape".to_owned());
    }
    Ok(Matrix {
        rows,
        columns,
        values: chunks.iter().map(|chunk| f64::from_le_bytes(*chunk)).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn npy(header: &str, values: &[f64]) -> Vec<u8> {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        bytes
    }

    #[test]
    fn other_files_are_named() {
        for (content, expected) in [
            ("", "is empty"),
            ("\n<!DOCTYPE html>", "web page"),
            ("version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
            ("PK", "not a zip archive"),
        ] {
            let states = InitialStates::from_reader(std::io::Cursor::new(content), Path::new("f"));
            let SceneError::Malformed { problem, .. } = states.expect_err(expected) else {
                panic!("{content}");
            };
            assert!(problem.contains(expected), "{problem}");
        }
    }

    #[test]
    fn only_a_matrix_of_doubles_is_read() {
        let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (2, 3), }   \n";
        let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.5];
        let read = read_npy(&npy(header, &values)).unwrap();
        assert_eq!((read.rows, read.columns), (2, 3));
        assert_eq!(read.values, values);
        for invalid_header in [
            header.replace("<f8", "|O"),
            header.replace("False", "True"),
            header.replace("(2, 3)", "(6,)"),
            header.replace("(2, 3)", "(2, 4)"),
            header.replace("(2, 3)", "(18446744073709551615, 2)"),
        ] {
            assert!(read_npy(&npy(&invalid_header, &values)).is_err(), "{invalid_header}");
        }
        let whole = npy(header, &values);
        for end in 0..whole.len() {
            assert!(read_npy(&whole[..end]).is_err(), "{end}");
        }
    }
}
