//! Identifiers of imported rows: `v0.1` for exactly the rows of v0.1, otherwise a checksum.

use crate::condition::Condition;
use crate::design::Design;
use crate::design_version::DesignVersion;
use crate::execution::Execution;
use crate::manifest;
use crate::row::ManifestRow;

impl DesignVersion {
    /// Returns the version of imported rows, independent of their order. Rows identical to
    /// those of v0.1 have the version v0.1. The manifest of the reference implementation has
    /// another version, because its paraphrases differ.
    pub fn of_manifest(rows: &[ManifestRow]) -> Self {
        let version = Self::of_rows(rows);
        let mut iterator = rows.iter();
        match iterator.find(|row| row.id.condition() != Condition::Latency) {
            Some(row) => version.under(&row.execution),
            None => version,
        }
    }

    /// Returns the version of imported rows regardless of their execution model.
    pub(crate) fn of_rows(rows: &[ManifestRow]) -> Self {
        let text = |rows: &[ManifestRow]| {
            let rows = rows.iter().cloned().map(|row| row.under(&Execution::Wait));
            let mut rows: Vec<ManifestRow> = rows.collect();
            rows.sort_by_key(|row| row.id);
            manifest::to_text(&rows)
        };
        let imported = text(rows);
        let v0_1 = Design::v0_1().expand().expect("v0.1 is a design");
        if rows.len() == v0_1.len() && imported == text(&v0_1) {
            return Self::v0_1();
        }
        Self::manifest(&imported)
    }
}
