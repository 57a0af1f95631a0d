//! Table of LIBERO's assets: size and SHA-256 of every file, its position in the wheels of the
//! package index, and the files that each model references. The table is compiled into the program
//! (`assets/libero`), so that downloads need not be trusted.

use std::collections::HashMap;
use std::sync::OnceLock;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FileFacts {
    /// Path in the pack's folder, with `/` as separator.
    pub path: &'static str,
    pub bytes: u64,
    pub sha256: &'static str,
    pub(crate) wheel: usize,
    /// Position of the deflated bytes in the wheel.
    pub(crate) offset: u64,
    pub(crate) stored: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Wheel {
    pub(crate) project: &'static str,
    pub(crate) version: &'static str,
    pub(crate) file: &'static str,
    pub(crate) bytes: u64,
    pub(crate) sha256: &'static str,
}

#[derive(Debug)]
pub struct Table {
    pub(crate) wheels: Vec<Wheel>,
    files: Vec<FileFacts>,
    by_path: HashMap<&'static str, usize>,
    references: HashMap<&'static str, Vec<&'static str>>,
    digest: &'static str,
}

/// Source texts of a table: tab-separated values with a header line.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Text {
    /// Columns: project, version, file, bytes, sha256.
    pub(crate) wheels: &'static str,
    /// Columns: path, bytes, sha256, wheel (from 1), offset, stored.
    pub(crate) files: &'static str,
    /// Columns: model, file.
    pub(crate) models: &'static str,
    pub(crate) digest: &'static str,
}

const LIBERO: Text = Text {
    wheels: include_str!("../../../../assets/libero/wheels.tsv"),
    files: include_str!("../../../../assets/libero/files.tsv"),
    models: include_str!("../../../../assets/libero/models.tsv"),
    digest: include_str!("../../../../assets/libero/digest.txt"),
};

const LIBERO_FAMILY: Text = Text {
    wheels: include_str!("../../../../assets/libero-family/wheels.tsv"),
    files: include_str!("../../../../assets/libero-family/files.tsv"),
    models: "model\tfile\n",
    digest: "",
};

impl FileFacts {
    /// Returns true if the file is a whole wheel rather than a member of a wheel.
    pub(crate) fn is_a_wheel(&self) -> bool {
        self.stored == self.bytes
    }

    pub fn transfer_bytes(&self) -> u64 {
        self.stored
    }
}

impl Table {
    pub fn libero() -> &'static Self {
        static TABLE: OnceLock<Table> = OnceLock::new();
        TABLE.get_or_init(|| Self::parse(LIBERO).expect("the committed table is well-formed"))
    }

    /// Returns the table of the wheels with the task files of the LIBERO family, each as one file.
    pub fn libero_family() -> &'static Self {
        static TABLE: OnceLock<Table> = OnceLock::new();
        TABLE
            .get_or_init(|| Self::parse(LIBERO_FAMILY).expect("the committed table is well-formed"))
    }

    pub(crate) fn parse(text: Text) -> Option<Self> {
        let mut wheels = Vec::new();
        for row in rows(text.wheels) {
            let [project, version, file, bytes, sha256] = row?;
            wheels.push(Wheel { project, version, file, bytes: bytes.parse().ok()?, sha256 });
        }
        let mut files = Vec::new();
        for row in rows(text.files) {
            let [path, bytes, sha256, wheel, offset, stored] = row?;
            files.push(FileFacts {
                path,
                bytes: bytes.parse().ok()?,
                sha256,
                wheel: wheel.parse::<usize>().ok()?.checked_sub(1)?,
                offset: offset.parse().ok()?,
                stored: stored.parse().ok()?,
            });
        }
        let mut references: HashMap<_, Vec<_>> = HashMap::new();
        for row in rows(text.models) {
            let [model, file] = row?;
            references.entry(model).or_default().push(file);
        }
        let by_path = files.iter().enumerate();
        let by_path = by_path.map(|(index, file)| (file.path, index)).collect();
        let has_valid_wheels = files.iter().all(|file| file.wheel < wheels.len());
        has_valid_wheels.then_some(Self {
            wheels,
            files,
            by_path,
            references,
            digest: text.digest.trim_end(),
        })
    }

    /// Returns all files, sorted by path.
    pub fn files(&self) -> &[FileFacts] {
        &self.files
    }

    pub fn get(&self, path: &str) -> Option<&FileFacts> {
        Some(&self.files[*self.by_path.get(path)?])
    }

    /// Returns the paths of the files that a model references, without the model's own path.
    pub fn references(&self, model: &str) -> &[&'static str] {
        self.references.get(model).map_or(&[], Vec::as_slice)
    }

    /// SHA-256 over the names and contents of all files, hex, even if a pack is incomplete.
    pub fn digest(&self) -> &str {
        self.digest
    }
}

/// Parses the rows below the header; `None` for a row that does not have `N` columns.
fn rows<const N: usize>(text: &'static str) -> impl Iterator<Item = Option<[&'static str; N]>> {
    let lines = text.lines().skip(1);
    lines.map(|line| line.split('\t').collect::<Vec<_>>().try_into().ok())
}

#[cfg(test)]
mod tests {
    use sha2::{Digest, Sha256};

    use super::*;

    /// The pack's digest depends on the files' contents, so every edit of the table must also
    /// change the digest: `assets/libero/table.py` writes both.
    #[test]
    fn the_committed_table_has_the_pinned_digest() {
        let mut hash = Sha256::new();
        for part in [LIBERO.wheels, LIBERO.files, LIBERO.models, LIBERO.digest] {
            hash.update(part);
        }
        assert_eq!(
            hex::encode(hash.finalize()),
            "642c9c05df66699488304ea680ec2a23e7f49656b88598a3f8c32ce0100ffe39"
        );
    }

    #[test]
    fn libero_has_585_files_of_422_mb() {
        let table = Table::libero();
        assert_eq!((table.files().len(), table.wheels.len()), (585, 5));
        let bytes: u64 = table.files().iter().map(|file| file.bytes).sum();
        assert_eq!(bytes / 1_000_000, 422);
        for file in table.files() {
            assert_eq!(table.get(file.path), Some(file));
            let wheel = table.wheels[file.wheel];
            assert!(file.offset + file.stored < wheel.bytes, "{}", file.path);
            assert!(!file.is_a_wheel(), "{}", file.path);
            for part in table.references(file.path) {
                assert!(table.get(part).is_some(), "{part}");
            }
        }
    }

    #[test]
    fn the_family_table_has_two_whole_wheels() {
        let table = Table::libero_family();
        assert_eq!((table.wheels.len(), table.files().len()), (2, 2));
        for (wheel, file) in table.wheels.iter().zip(table.files()) {
            assert!(file.is_a_wheel());
            assert_eq!(file.path, wheel.file);
            assert_eq!((file.bytes, file.sha256), (wheel.bytes, wheel.sha256));
        }
    }

    #[test]
    fn a_malformed_table_is_refused() {
        let files = "path\tbytes\tsha256\twheel\toffset\tstored\na\t1\tx\t6\t0\t1\n";
        assert!(
            Table::parse(Text { files, ..LIBERO }).is_none(),
            "the table refers to a sixth wheel, and there are five"
        );
        let files = "path\tbytes\na\t1\n";
        assert!(Table::parse(Text { files, ..LIBERO }).is_none());
    }
}
