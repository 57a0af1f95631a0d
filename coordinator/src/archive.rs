//! Archive of a campaign in one file, to be kept or imported by another coordinator: a compressed
//! tar of a data folder with this campaign alone. It begins with a table of contents, the
//! specification, the provenance and the report.
//!
//! | member | what it is |
//! | --- | --- |
//! | `archive.json` | the list of the others, with their sizes and SHA-256 |
//! | `specification.json` | the campaign's specification |
//! | `provenance.json` | where its results came from, and its policy's seeds |
//! | `report.json` | its report, as `coordinator report --json` prints it |
//! | `coordinator.sqlite` | its rows, in a database of the coordinator's schema |
//! | `artifacts/NAME/…` | its films |

mod derived;
mod pack;
mod unpack;

use std::io;
use std::path::PathBuf;

use ::report::DocumentError;
use libero_ctrl::JsonError;
use queue::{PortableError, SourceOutcomes, StoreError};
use serde::{Deserialize, Serialize};

use crate::reading::ReadError;

pub use pack::{Package, package};
pub use unpack::{Unpacked, unpack};

/// The version of this form. A newer one is not read.
const FORMAT: u32 = 1;
/// The member that lists the others.
const LIST: &str = "archive.json";
/// Prefix of folders and files that hold a campaign on its way in or out.
pub const MOVING_PREFIX: &str = queue::MOVING_PREFIX;

/// Table of contents of an archive.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Contents {
    /// The version of the form.
    pub format: u32,
    /// The program that wrote it.
    pub program: String,
    /// The version of the database's schema.
    pub schema: i64,
    /// Name of the campaign.
    pub campaign: String,
    /// SHA-256 of its specification, hex.
    pub spec_digest: String,
    /// Outcomes that it follows from, if it follows from another campaign.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<SourceOutcomes>,
    /// The halves that it was merged from, if it was.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub merged_from: Vec<Half>,
    /// The other members, in order.
    pub members: Vec<Member>,
}

/// An archive that was merged into another.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Half {
    /// Name of its campaign.
    pub campaign: String,
    /// The program that wrote it.
    pub program: String,
    /// SHA-256 of its database, hex.
    pub database: String,
}

/// A file in an archive.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Member {
    /// Its path in the archive.
    pub name: String,
    /// Its size.
    pub bytes: u64,
    /// Its SHA-256, hex.
    pub sha256: String,
}

/// An archive that cannot be written or used. `archive` is its file.
#[derive(Debug, thiserror::Error)]
pub enum ArchiveError {
    /// The file cannot be read.
    #[error("read archive {archive}: is it there, and may this user read it?")]
    Read {
        /// The file.
        archive: String,
        /// Error of the system.
        source: io::Error,
    },
    /// The file is not an archive of a campaign.
    #[error(
        "read archive {archive}: it is no archive of a campaign ({problem}); make one with `coordinator campaign archive`"
    )]
    Foreign {
        /// The file.
        archive: String,
        /// Evidence that the file is something else.
        problem: String,
    },
    /// A newer program wrote it.
    #[error(
        "read archive {archive}: {program} wrote it, with {what} {found}, and this program knows up to {known}; use a release as new as that one"
    )]
    Newer {
        /// The file.
        archive: String,
        /// The program that wrote it.
        program: String,
        /// The form's version, or the schema's.
        what: &'static str,
        /// The version that was found.
        found: i64,
        /// The newest that this program knows.
        known: i64,
    },
    /// It ends early, or its compression is damaged.
    #[error("read archive {archive}: it is cut off or damaged in member {member}; copy it again")]
    Damaged {
        /// The file.
        archive: String,
        /// The damaged member.
        member: String,
    },
    /// A member is not what the list says.
    #[error(
        "read archive {archive}: member {member} is not what {LIST} says ({problem}); copy it again, or archive the campaign again"
    )]
    Altered {
        /// The file.
        archive: String,
        /// The altered member.
        member: String,
        /// The difference.
        problem: String,
    },
    /// Its database does not hold what it should.
    #[error("use member {member} of archive {archive}: archive the campaign again")]
    Content {
        /// The file.
        archive: String,
        /// The member.
        member: &'static str,
        /// Error of the database.
        source: Box<PortableError>,
    },
    /// A member that is derived from the database differs from the archived one.
    #[error(
        "use archive {archive}: {member}, made from its rows, differs from the archived one at {place}; import it with {program}, which wrote it"
    )]
    Differs {
        /// The file.
        archive: String,
        /// The member that differs.
        member: &'static str,
        /// Place of the difference, as a path of names.
        place: String,
        /// The program that wrote it.
        program: String,
    },
    /// The results cannot be read.
    #[error(transparent)]
    Results(#[from] ReadError),
    /// The report cannot be made.
    #[error(transparent)]
    Report(#[from] DocumentError),
    /// Something cannot be written as JSON.
    #[error("write {member} of the archive")]
    Json {
        /// The member.
        member: &'static str,
        /// Why not.
        source: JsonError,
    },
    /// A file cannot be written.
    #[error("write {}: is there room on the disk, and may this user write there?", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// A file that goes into the archive cannot be read, or is another one now.
    #[error("archive {}: it changed or cannot be read; archive the campaign again", path.display())]
    Input {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The disk lacks space for the content that the archive declares.
    #[error(
        "unpack archive {archive}: that takes {needed_mib} MiB and the disk of {} has {free_mib} \
         left; make room",
        folder.display()
    )]
    NoRoom {
        /// The file.
        archive: String,
        /// Folder that it was to be unpacked into.
        folder: PathBuf,
        /// Space that the archive needs, with the reserve that must stay free, MiB.
        needed_mib: u64,
        /// Free space, MiB.
        free_mib: u64,
    },
    /// A thread that packs, unpacks or computes ended.
    #[error("go on with archive {archive}: a thread panicked; the log says where")]
    Panicked {
        /// The file, or the campaign.
        archive: String,
    },
}

impl From<StoreError> for ArchiveError {
    fn from(error: StoreError) -> ArchiveError {
        ArchiveError::Results(error.into())
    }
}
