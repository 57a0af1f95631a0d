//! Comparison of a pack's files with the table of their sizes and digests.

use std::collections::HashMap;
use std::fmt;
use std::fs::{self, File, Metadata};
use std::io::{self, Read};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use sha2::{Digest, Sha256};

use crate::assets::table::{FileFacts, Table};

const BLOCK_BYTES: usize = 1 << 16;

#[derive(Debug)]
pub enum Difference {
    Missing,
    Unreadable(io::Error),
    Size {
        found: u64,
        expected: u64,
    },
    /// The file has the expected size, but its SHA-256 differs from the table's.
    Content,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing => write!(f, "missing"),
            Self::Unreadable(error) => write!(f, "unreadable: {error}"),
            Self::Size { found, expected } => {
                write!(f, "altered: {found} bytes instead of {expected}")
            }
            Self::Content => write!(f, "altered: another SHA-256"),
        }
    }
}

/// Folder of a pack, whose files are compared with a table on request. A file that was found equal
/// is hashed again only after its metadata changed.
#[derive(Debug)]
pub struct VerifiedFolder {
    table: &'static Table,
    folder: PathBuf,
    verified: Mutex<HashMap<&'static str, Stamp>>,
}

/// A file's owner can set the modification time (mtime) back, but not the change time (ctime).
#[derive(Debug, PartialEq, Eq)]
struct Stamp {
    bytes: u64,
    /// Device and inode.
    identity: (u64, u64),
    /// Seconds and nanoseconds.
    modified: (i64, i64),
    changed: (i64, i64),
}

impl VerifiedFolder {
    /// Describes the folder of a pack with files of `table`, without reading the folder.
    pub fn new(table: &'static Table, folder: &Path) -> Self {
        Self { table, folder: folder.to_owned(), verified: Mutex::default() }
    }

    pub fn table(&self) -> &'static Table {
        self.table
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    pub fn verify(&self, file: &FileFacts) -> Result<(), Difference> {
        let path = self.folder.join(file.path);
        let stamp = stamp(&fs::metadata(&path).map_err(unreadable)?);
        if self.lock().get(file.path) == Some(&stamp) {
            return Ok(());
        }
        let (found, expected) = (stamp.bytes, file.bytes);
        if found != expected {
            return Err(Difference::Size { found, expected });
        }
        if sha256_of(&path).map_err(unreadable)? != file.sha256 {
            return Err(Difference::Content);
        }
        self.lock().insert(file.path, stamp);
        Ok(())
    }

    /// Returns true if a file of the expected size exists. Does not read the file.
    pub fn seems_present(&self, file: &FileFacts) -> bool {
        fs::metadata(self.folder.join(file.path)).is_ok_and(|found| found.len() == file.bytes)
    }

    /// Returns all existing files that differ from the table, and the number of existing files.
    pub fn differences(&self) -> (Vec<(&'static str, Difference)>, usize) {
        let mut differences = Vec::new();
        let mut present = 0;
        for file in self.table.files() {
            let outcome = self.verify(file);
            present += usize::from(!matches!(outcome, Err(Difference::Missing)));
            match outcome {
                Ok(()) | Err(Difference::Missing) => {}
                Err(difference) => differences.push((file.path, difference)),
            }
        }
        (differences, present)
    }

    /// Locks the map. Ignores poisoning: no thread panics while it holds the lock.
    fn lock(&self) -> std::sync::MutexGuard<'_, HashMap<&'static str, Stamp>> {
        self.verified.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn stamp(metadata: &Metadata) -> Stamp {
    Stamp {
        bytes: metadata.len(),
        identity: (metadata.dev(), metadata.ino()),
        modified: (metadata.mtime(), metadata.mtime_nsec()),
        changed: (metadata.ctime(), metadata.ctime_nsec()),
    }
}

fn unreadable(error: io::Error) -> Difference {
    match error.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => Difference::Missing,
        _ => Difference::Unreadable(error),
    }
}

fn sha256_of(path: &Path) -> io::Result<String> {
    let mut file = File::open(path)?;
    let mut hash = Sha256::new();
    let mut block = vec![0; BLOCK_BYTES];
    loop {
        match file.read(&mut block)? {
            0 => return Ok(hex::encode(hash.finalize())),
            read => hash.update(&block[..read]),
        }
    }
}
