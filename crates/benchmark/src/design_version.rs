//! Identifiers of designs: v0.1, custom designs, rows, and campaigns with a purpose.

use crate::campaign::Purpose;
use crate::design::Design;
use crate::execution::Execution;
use crate::manifest;
use crate::names::{UnknownName, serde_as_text};
use crate::row::ManifestRow;

const V0_1: &str = "v0.1";
const CUSTOM: &str = "custom-";
const ROWS: &str = "rows-";
const PURPOSE: &str = "purpose-";

/// Identifier of the design that results belong to: `v0.1` for exactly LIBERO-CTRL v0.1,
/// otherwise `custom-` and a checksum of the design, `rows-` and a checksum of the rows, or
/// `purpose-` and a checksum of the purpose.
/// Results of different designs are never pooled.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DesignVersion(String);

impl DesignVersion {
    pub(crate) fn v0_1() -> Self {
        Self(V0_1.to_owned())
    }

    /// Returns the version of a design other than v0.1, from a text that identifies the design.
    pub(crate) fn custom(text: &str) -> Self {
        Self(format!("{CUSTOM}{:08x}", crc32fast::hash(text.as_bytes())))
    }

    /// Returns the version of imported rows, independent of their order. Rows identical to
    /// those of v0.1 have the version v0.1. The manifest of the reference implementation has
    /// another version, because its paraphrases differ.
    pub fn of_manifest(rows: &[ManifestRow]) -> Self {
        Self::of_rows(rows).under(&manifest::execution(rows))
    }

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
        Self(format!("{ROWS}{:08x}", crc32fast::hash(imported.as_bytes())))
    }

    pub(crate) fn of_purpose(purpose: &Purpose) -> Self {
        let text = serde_json::to_string(purpose).expect("names and numbers serialise");
        Self(format!("{PURPOSE}{:08x}", crc32fast::hash(text.as_bytes())))
    }

    /// Returns the version of the same rollouts under an execution model: this version for `wait`,
    /// and a distinct version for every other model.
    pub(crate) fn under(self, execution: &Execution) -> Self {
        if execution.is_wait() {
            return self;
        }
        let prefixes = [ROWS, PURPOSE];
        let prefix = prefixes.into_iter().find(|prefix| self.0.starts_with(prefix));
        let text = format!("{} {execution}", self.0);
        Self(format!("{}{:08x}", prefix.unwrap_or(CUSTOM), crc32fast::hash(text.as_bytes())))
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl std::fmt::Display for DesignVersion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::str::FromStr for DesignVersion {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, UnknownName> {
        let prefixes = [CUSTOM, ROWS, PURPOSE];
        match text == V0_1 || prefixes.iter().any(|prefix| text.starts_with(prefix)) {
            true => Ok(Self(text.to_owned())),
            false => {
                let valid = [V0_1, "custom-CHECKSUM", "rows-CHECKSUM", "purpose-CHECKSUM"];
                Err(UnknownName::new("design", text, &valid))
            }
        }
    }
}

serde_as_text!(DesignVersion);
