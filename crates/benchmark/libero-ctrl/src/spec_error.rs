//! Errors in the specification of a campaign.

use crate::design::DesignError;
use crate::execution::Execution;
use crate::manifest::ManifestErrors;
use crate::rollout_id::RolloutId;
use crate::stop::StopError;
use crate::suite_file::SuiteFileError;
use crate::variants::VariantsError;
use crate::wanted::MIN_DIGEST_DIGITS;

/// Largest number of replicates of a campaign.
pub const MAX_REPLICATES: u32 = 100;

/// Error in a specification.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SpecError {
    /// The text is not valid JSON, a field is missing or unknown, or a value is not a known
    /// name.
    #[error("read campaign specification: {problem}")]
    Json {
        /// Problem and its line.
        problem: String,
    },
    /// A required field is empty.
    #[error("read campaign specification: `{field}` is empty, {remedy}")]
    Empty {
        /// The field.
        field: &'static str,
        /// Remedy: the value to write.
        remedy: &'static str,
    },
    /// Too few or too many replicates.
    #[error(
        "read campaign specification: `replicates` has {given}, valid are 1 to {MAX_REPLICATES}"
    )]
    Replicates {
        /// The number given.
        given: u32,
    },
    /// The policy's endpoint is not the URL of a server. The text is not quoted, since it may
    /// contain a password.
    #[error(
        "read campaign specification: `policy.endpoint` is no server's address, write \
         http://HOST:PORT or grpc://HOST:PORT, or over TLS https:// or grpcs://, without a user, a \
         password and a path"
    )]
    Endpoint,
    /// The asset pack is neither a known name nor a digest.
    #[error(
        "read campaign specification: `assets` is `{given}`, write `primitives`, `libero` or at \
         least the first {MIN_DIGEST_DIGITS} digits of a pack's digest; the pack's folder is an \
         option of workers"
    )]
    Assets {
        /// The text given.
        given: String,
    },
    /// A campaign derived from the outcomes of another campaign has a realisation other than
    /// `matched`.
    #[error(
        "read campaign specification: `{field}` with `realisation` reference, in which each \
         condition perturbs an axis differently: write matched"
    )]
    Unmatched {
        /// The field that names the source campaign.
        field: &'static str,
    },
    /// A radius, or the tolerance of a radius, is out of range.
    #[error(
        "read campaign specification: `{field}` is {given}, valid are {} to {}", valid[0], valid[1]
    )]
    Radius {
        /// The field.
        field: &'static str,
        /// The number given.
        given: f64,
        /// Valid range.
        valid: [f64; 2],
    },
    /// The execution model differs from that of the manifest's rows.
    #[error(
        "read campaign specification: `execution` is {given}, but the rows of its manifest have \
         `{row_model}`: remove `execution` from the specification or from the rows"
    )]
    Execution {
        /// The campaign's model.
        given: Execution,
        /// Model of the rows.
        row_model: Execution,
    },
    /// The campaign has the latency axis and an execution model other than `wait`.
    #[error(
        "read campaign specification: axis `latency` with `execution` {given}: its rollouts are \
         compared with rollouts without delay; remove `execution` or the axis"
    )]
    Latency {
        /// The campaign's model.
        given: Execution,
    },
    /// The stop rule cannot end the campaign.
    #[error("read campaign specification: {0}")]
    Stop(StopError),
    /// The design is invalid.
    #[error("read campaign specification: {0}")]
    Design(DesignError),
    /// A campaign of LIBERO's family or of a suite file has a field that it excludes.
    #[error("read campaign specification: {0}")]
    Variants(VariantsError),
    /// The selection of variants is invalid.
    #[error("read campaign specification: {problem}")]
    Selection {
        /// Problem and remedy, as `libero-family` formats them.
        problem: String,
    },
    /// The manifest has a row of LIBERO's family or of a suite file.
    #[error(
        "read campaign specification: row {id} of its manifest is of another benchmark, whose \
         campaigns are specified with `variants` or `suite_file`: remove the row"
    )]
    VariantRow {
        /// The row's id.
        id: RolloutId,
    },
    /// The suite file is invalid.
    #[error("read campaign specification: {0}")]
    SuiteFile(SuiteFileError),
    /// Some imported rows are invalid. Their line numbers are positions in the specification's list
    /// of rows, from 1.
    #[error(transparent)]
    Manifest(#[from] ManifestErrors),
}

// The message includes that of the inner error, which would be printed twice if the inner error
// were the source.
impl From<StopError> for SpecError {
    fn from(error: StopError) -> Self {
        Self::Stop(error)
    }
}

impl From<VariantsError> for SpecError {
    fn from(error: VariantsError) -> Self {
        Self::Variants(error)
    }
}

impl From<SuiteFileError> for SpecError {
    fn from(error: SuiteFileError) -> Self {
        Self::SuiteFile(error)
    }
}

impl From<DesignError> for SpecError {
    fn from(error: DesignError) -> Self {
        Self::Design(error)
    }
}
