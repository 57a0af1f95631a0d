//! Archive of a campaign in one file, for storage or for import by another coordinator: a gzipped
//! tar of a table of contents, the specification, the provenance, the report, the rollouts with
//! their results, and the films.
//!
//! | member | content |
//! | --- | --- |
//! | `archive.json` | table of contents: the other members with their sizes and SHA-256 |
//! | `specification.json` | the campaign's specification |
//! | `provenance.json` | provenance of the results, and the policy seeds |
//! | `report.json` | the campaign's report, as printed by `coordinator report --json` |
//! | `rollouts.jsonl` | the campaign's state, then a line per rollout with its attempts and result |
//! | `artifacts/NAME/…` | the campaign's films |

mod computed;
mod pack;
mod unpack;

use std::io;
use std::path::PathBuf;

use benchmark::JsonError;
use queue::{PortableError, SourceOutcomes, StoreError};
use report::DocumentError;
use serde::{Deserialize, Serialize};

use crate::reading::ReadError;

pub use pack::{Package, package};
pub use unpack::{Unpacked, unpack};

/// Version of the archive format; archives of another format are refused.
const FORMAT: u32 = 2;
/// Member that holds the table of contents.
const CONTENTS_FILE: &str = "archive.json";

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Contents {
    pub format: u32,
    /// Name and version of the program that wrote the archive.
    pub program: String,
    pub campaign: String,
    /// SHA-256 of the specification, hex.
    pub spec_digest: String,
    /// Outcomes of the source campaign; `None` if this campaign is not derived from another one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<SourceOutcomes>,
    /// Members after the table of contents, in order.
    pub members: Vec<Member>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Member {
    pub name: String,
    /// Size, bytes.
    pub bytes: u64,
    /// SHA-256, hex.
    pub sha256: String,
}

/// Error of writing or reading an archive. `archive` is the name of the archive's file.
#[derive(Debug, thiserror::Error)]
pub enum ArchiveError {
    #[error("read archive {archive}: is it there, and may this user read it?")]
    Read { archive: String, source: io::Error },
    #[error(
        "read archive {archive}: it is not an archive of a campaign ({problem}); make one with `coordinator campaign archive`"
    )]
    Foreign { archive: String, problem: String },
    #[error(
        "read archive {archive}: it has format {found}, written by {program}, and this program reads format {FORMAT} only; use the program that wrote it"
    )]
    OtherVersion { archive: String, program: String, found: u32 },
    #[error("read archive {archive}: it is cut off or damaged in {member}; copy it again")]
    Damaged { archive: String, member: String },
    #[error(
        "read archive {archive}: {member} is altered ({problem}); copy it again, or archive the campaign again"
    )]
    Altered { archive: String, member: String, problem: String },
    #[error("use member {member} of archive {archive}: archive the campaign again")]
    Content { archive: String, member: &'static str, source: Box<PortableError> },
    #[error(
        "use archive {archive}: {member}, made from its rows, differs from the archived one at {place}; import it with {program}, which wrote it"
    )]
    Differs {
        archive: String,
        member: &'static str,
        /// JSON path of the first difference, such as `.a[1].b`.
        place: String,
        program: String,
    },
    #[error(transparent)]
    Results(#[from] ReadError),
    #[error(transparent)]
    Report(#[from] DocumentError),
    #[error("write {member} of the archive")]
    Json { member: &'static str, source: JsonError },
    #[error("write {}: make room on the disk, and make the folder writable for this user", path.display())]
    Write { path: PathBuf, source: io::Error },
    #[error("archive {}: it changed or cannot be read; archive the campaign again", path.display())]
    Input { path: PathBuf, source: io::Error },
    #[error(
        "unpack archive {archive}: that takes {needed_mib} MiB and the disk of {} has {free_mib} \
         left; make room",
        folder.display()
    )]
    NoRoom {
        archive: String,
        folder: PathBuf,
        /// Space that the archive needs, with the reserve that must stay free, MiB.
        needed_mib: u64,
        /// Free space, MiB.
        free_mib: u64,
    },
    #[error("process archive {archive}: a thread panicked; the log says where")]
    Panicked { archive: String },
}

impl From<StoreError> for ArchiveError {
    fn from(error: StoreError) -> ArchiveError {
        ArchiveError::Results(error.into())
    }
}
